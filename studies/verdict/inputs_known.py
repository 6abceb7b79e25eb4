"""Whether a model's error is larger than what is not known of the inputs, over all cases."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..measures.bars import reference_bar
from ..measures.case import CaseResult
from ..measures.input_spread import ModelSpread
from ..measures.metrics import VECTOR
from .digest import Digest
from .formatting import parameter_name

LARGER, SMALLER, ALIKE = "larger", "smaller", "alike"


@dataclass(frozen=True)
class InputsKnown:
    """What is not known of the inputs, as medians over cases, beside a model's displacement error.

    Attributes
    ----------
    answer : whose answers it is of: the reference's, else the model's
    displacement, deformation : standard deviation of its displacement, over it; NaN where not known
    parts : key of the study -> share of `displacement` by that input alone, the largest first; none of samples
    method : how it was found
    bend : see `vdmbench.measures.input_spread.ModelSpread`
    model, error : the model that the verdict is about, "" for none, and its displacement error
    larger, alike, smaller : cases in which that is larger, cannot be told, or is smaller
    """

    answer: str
    displacement: float
    deformation: float
    parts: tuple[tuple[str, float], ...]
    method: str
    bend: float
    model: str = ""
    error: float = math.nan
    larger: int = 0
    alike: int = 0
    smaller: int = 0


def inputs_known(digest: Digest, model: str) -> InputsKnown | None:
    """None where no case tells how well its inputs are known.

    Parameters
    ----------
    model : the one that the verdict is about, "" for none
    """
    cases = [case for case in digest.cases if case.inputs is not None]
    answer = digest.reference or model or next(iter(digest.models), "")
    found = [(case, spread) for case in cases if (spread := _of(case, answer)) is not None]
    if not found or cases[0].inputs is None:
        return None
    spreads = [spread for _, spread in found]
    keys = cases[0].inputs.keys
    shares = {key: _median([float(spread.parts[k]) for spread in spreads]) for k, key in enumerate(keys)}
    parts = sorted(((k, s) for k, s in shares.items() if math.isfinite(s)), key=lambda part: -part[1])
    states = [_state(digest, case, model, spread) for case, spread in found] if model else []
    return InputsKnown(
        answer=answer,
        displacement=_median([spread.displacement for spread in spreads]),
        deformation=_median([spread.deformation for spread in spreads]),
        parts=tuple(parts),
        method=cases[0].inputs.method,
        bend=_median([spread.bend for spread in spreads]),
        model=model,
        error=_median([digest.at(case, model, VECTOR) for case, _ in found]) if model else math.nan,
        larger=states.count(LARGER),
        alike=states.count(ALIKE),
        smaller=states.count(SMALLER),
    )


def _of(case: CaseResult, answer: str) -> ModelSpread | None:
    return case.inputs.models.get(answer) if case.inputs is not None else None


def _median(values: list[float]) -> float:
    known = [value for value in values if math.isfinite(value)]
    return float(np.median(known)) if known else math.nan


def _state(digest: Digest, case: CaseResult, model: str, spread: ModelSpread) -> str:
    """How the error stands to the spread of the inputs, the reference's own error counted; "" where unknown."""
    error, bar = digest.at(case, model, VECTOR), reference_bar(case)
    bar = bar if math.isfinite(bar) else 0.0
    if not math.isfinite(error) or not math.isfinite(spread.displacement):
        return ""
    if abs(error - spread.displacement) <= bar:
        return ALIKE
    return LARGER if error > spread.displacement else SMALLER


def input_name(key: str) -> str:
    """An input as words; of a region's shape with the region: `fraction of below (base)`."""
    parts = key.split(".")
    return f"{parameter_name(key)} ({parts[1]})" if parts[0] == "regions" else parameter_name(key)
