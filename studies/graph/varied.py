"""The answers of a case's models to other values of its inputs, and what comes of them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..body.surface_measures import Surface
from ..measures.input_spread import InputSpread, Propagation, input_spread
from ..measures.measurement import Spread
from ..measures.pushed import INDENTER_FORCE, Answer
from ..scene.result import ModelResult
from ..study.model_name import REFINED
from ..study.schema import Study
from .answers import stored_answer
from .keys import Wanted


class Varied:
    """Of one case, by what its node was given; the refined reference has the answers on the case's own mesh."""

    def __init__(self, payload: Mapping[str, Any], study: Study, results: Mapping[str, ModelResult]) -> None:
        self._payload, self._study, self._results = payload, study, results
        self._variations = [{one["wanted"]["name"]: one for one in entry} for entry in payload["variations"]]
        self._linear = {entry["name"] for entry in payload["wanted"] if entry["scales"]}

    def answer(self, name: str, result: ModelResult) -> Answer:
        """A result of a model of the case as what it answers."""
        return Answer(
            result.displacement,
            result.reaction_force,
            name.removesuffix(REFINED) in self._linear,
            indenter_force=result.scalars.get(INDENTER_FORCE),
        )

    def answers(self, name: str) -> list[Answer]:
        """What a model answers to each variation."""
        return [self._varied(**one[name.removesuffix(REFINED)]) for one in self._variations]

    def _varied(self, wanted: Mapping[str, Any], times: float, values: Mapping[str, float]) -> Answer:
        want = Wanted(**wanted)
        cache, run = Path(self._payload["cache"]), self._payload["run"]
        found = {key: stored_answer(cache, key, run) for key in dict.fromkeys(want.answers)}
        if not want.scales:
            only = found[want.answers[0]]
            force = only.scalars.get(INDENTER_FORCE)
            return Answer(only.displacement, only.reaction_force, values=values, indenter_force=force)
        parts = [(scale, found[key]) for key, scale in zip(want.answers, want.scales, strict=True)]
        displacement = np.concatenate([times * scale * one.displacement for scale, one in parts])
        reaction = np.concatenate([scale * one.reaction_force for scale, one in parts])
        return Answer(displacement, reaction, linear=True, values=values)

    def spread(self, surface: Surface, step: int) -> InputSpread | None:
        """What comes of not knowing the inputs, at a step; None where the study does not tell how well it does."""
        if self._study.inputs is None:
            return None
        own = {name: result.displacement[step] for name, result in self._results.items()}
        return input_spread(
            self._study, surface, own, lambda name: [one.displacement[step] for one in self.answers(name)]
        )

    def rules(self) -> dict[str, Spread]:
        """Model -> what makes u_input of its answers."""
        if self._study.inputs is None:
            return {}
        rule = Propagation(self._study)
        return {name: (rule, partial(self.answers, name)) for name in self._results}
