"""The answers of a case's models to other values of its inputs, and what comes of them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..body.mesh import Array
from ..body.surface_measures import Surface
from ..measures.input_spread import InputSpread, Propagation, input_spread
from ..measures.measurement import Spread
from ..scene.result import ModelResult
from ..study.model_name import REFINED
from ..study.schema import Study
from .answers import stored_answer
from .keys import Wanted


class Varied:
    """Of one case, by what its node was given; the refined reference has the answers on the case's own mesh."""

    def __init__(self, payload: Mapping[str, Any], study: Study, results: Mapping[str, ModelResult]) -> None:
        self._payload, self._study, self._results = payload, study, results
        self._variations: list[dict[str, tuple[Wanted, float]]] = [
            {
                entry["name"]: (Wanted(**{k: v for k, v in entry.items() if k != "times"}), entry["times"])
                for entry in one
            }
            for one in payload["variations"]
        ]

    def answers(self, name: str) -> list[Array]:
        """Of each variation (S, N, 3) [m]."""
        return [self._displacement(*one[name.removesuffix(REFINED)]) for one in self._variations]

    def _displacement(self, wanted: Wanted, times: float) -> Array:
        cache, run = Path(self._payload["cache"]), self._payload["run"]
        found = {key: stored_answer(cache, key, run).displacement for key in dict.fromkeys(wanted.answers)}
        if not wanted.scales:
            return times * found[wanted.answers[0]]
        parts = [scale * found[key] for key, scale in zip(wanted.answers, wanted.scales, strict=True)]
        return np.asarray(times * np.concatenate(parts))

    def spread(self, surface: Surface, step: int) -> InputSpread | None:
        """What comes of not knowing the inputs, at a step; None where the study does not tell how well it does."""
        if self._study.inputs is None:
            return None
        own = {name: result.displacement[step] for name, result in self._results.items()}
        return input_spread(self._study, surface, own, lambda name: [u[step] for u in self.answers(name)])

    def rules(self) -> dict[str, Spread]:
        """Model -> what makes u_input of its answers."""
        if self._study.inputs is None:
            return {}
        rule = Propagation(self._study)
        return {name: (rule, partial(self.answers, name)) for name in self._results}
