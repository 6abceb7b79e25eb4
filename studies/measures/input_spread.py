"""What comes of not knowing the inputs: standard deviations of answers, and which input they are from.

By sensitivities: with d_k the standard deviation of an answer through input k alone, the root of the sum of d_k^2.
That is first order: it holds where answers go straight with each input, and inputs know nothing of each other. By
samples: their standard deviation, whatever the answer does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from solver_common.arrays import Array

from ..body.surface_measures import Surface, weighted_norm, without_motions
from ..study.registry import REFINED
from ..study.schema import Study
from ..study.sweep import SENSITIVITIES, Input, inputs_of

_NOTHING = 1e-6  # share of the displacement: less is what solvers leave open
STRAIGHT = 0.2  # `ModelSpread.bend` up to which first order will do: it moves the deviation by a fiftieth


@dataclass(frozen=True)
class ModelSpread:
    """What one model makes of it at full load.

    Attributes
    ----------
    displacement : area-weighted norm of the standard deviation of the displacement, over the norm of it
    deformation : the same without the best-fit rigid motion
    parts : (K,) share of `displacement` by each input alone; NaN where only samples tell
    bend : most by which an answer is off the line between those at an input's ends, over `displacement`; NaN
        likewise
    """

    displacement: float
    deformation: float
    parts: Array
    bend: float


@dataclass(frozen=True)
class InputSpread:
    """The K inputs of a case, how well each is known, and what comes of it: model -> spread."""

    method: str
    variations: int
    keys: Sequence[str]
    units: Sequence[str]
    values: Array  # (K,) of the study, SI
    deviations: Array  # (K,) standard deviations, SI
    models: Mapping[str, ModelSpread]


class Propagation:
    """The rule that makes standard deviations of the answers to a study's variations."""

    def __init__(self, study: Study) -> None:
        assert study.inputs is not None
        self.inputs: Sequence[Input] = inputs_of(study)
        self.table = study.inputs

    @property
    def by_slopes(self) -> bool:
        """Whether it has the answers at both ends of each input, not at samples."""
        return self.table.method == SENSITIVITIES

    def deviation(self, answers: Sequence[Array]) -> Array:
        """Standard deviation of each number of the V answers, arrays of one shape."""
        if self.by_slopes:
            return np.asarray(np.sqrt((self.parts(answers) ** 2).sum(axis=0)))
        return np.asarray(np.std(np.stack(answers), axis=0, ddof=1))

    def parts(self, answers: Sequence[Array]) -> Array:
        """(K, ...) standard deviation of each number through one input alone, with its sign."""
        pairs = zip(self.inputs, answers[0::2], answers[1::2], strict=False)
        return np.stack([one.weight * (high - low) / 2.0 for one, low, high in pairs])


Answers = Callable[[str], Sequence[Array]]  # model -> its V answers at full load (N, 3)


def input_spread(study: Study, surface: Surface, own: Mapping[str, Array], answers: Answers) -> InputSpread:
    """What each model makes of what is not known of the inputs.

    Parameters
    ----------
    own : model -> (N, 3) its answer to the study itself at full load [m]
    """
    rule, count = Propagation(study), 0
    found = {}
    for name, displacement in own.items():
        fields = answers(name)
        count = len(fields)
        # variations are of the case's own mesh, also where the model's own answer is of a finer one
        unvaried = own[name.removesuffix(REFINED)]
        found[name] = _model_spread(rule, surface, displacement, fields, unvaried)
    return InputSpread(
        rule.table.method,
        count,
        [one.key for one in rule.inputs],
        [one.unit for one in rule.inputs],
        np.array([one.value for one in rule.inputs]),
        np.array([one.deviation for one in rule.inputs]),
        found,
    )


def _model_spread(
    rule: Propagation, surface: Surface, own: Array, fields: Sequence[Array], unvaried: Array
) -> ModelSpread:
    areas = surface.areas

    def shape(values: Array) -> Array:
        return without_motions(surface.rigid_motions, values[None], areas)[0]

    def share(values: Array, whole: Array) -> float:
        norm = weighted_norm(whole, areas)
        return weighted_norm(values, areas) / norm if norm else float("nan")

    parts, bend = np.full(len(rule.inputs), np.nan), float("nan")
    if rule.by_slopes:
        slopes = rule.parts(fields)
        parts = np.array([share(slope, own) for slope in slopes])
        shapes = np.array([share(shape(slope), shape(own)) for slope in slopes])
        total, deformation = (float(np.sqrt((values**2).sum())) for values in (parts, shapes))
        bends = [
            share(low + (high - low) * one.place - unvaried, own)
            for one, low, high in zip(rule.inputs, fields[0::2], fields[1::2], strict=False)
        ]
        bend = float(np.max(bends)) / total if total > _NOTHING else 0.0
    else:
        total = share(rule.deviation(fields), own)
        deformation = share(rule.deviation([shape(values) for values in fields]), shape(own))
    return ModelSpread(total, deformation, parts, bend)
