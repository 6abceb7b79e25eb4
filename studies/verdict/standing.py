"""Where a form stands in a case and over all: from the larger of its two errors and the reference's own."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..measures import uncertainty
from ..measures.case import CaseResult
from ..measures.metrics import DEFORMATION, VECTOR

Array = NDArray[np.float64]

CLOSE = 0.10  # "within 10 %", the threshold that the paper's claim speaks of
WITHIN, OPEN, BEYOND, LOST = "within", "open", "beyond", "lost"
YES, IN_PART, NOT_SHOWN, UNDECIDED, NO = "Yes", "In part", "Not shown", "Undecided", "No"
# NOT_SHOWN is UNDECIDED with cases beyond; the best first
_WORDS = (YES, IN_PART, UNDECIDED, NOT_SHOWN, NO)


def series(case: CaseResult, model: str, metric: str) -> Array | None:
    """(S,) values of a metric, None where the case has none."""
    entry = case.metrics.get(model, {}).get(metric)
    return None if entry is None else entry.values


def at_full_load(case: CaseResult, model: str, metric: str) -> float:
    """A metric at the step of the largest load; NaN where there is none."""
    values = series(case, model, metric)
    return math.nan if values is None or not len(values) else float(values[case.full_load])


def reference_bar(case: CaseResult, metric: str = VECTOR) -> float:
    """The reference's own part in a metric (GCI) at full load, NaN where not measured."""
    return uncertainty.reference_bar(case.reference_error, metric)


def larger_error(case: CaseResult, model: str) -> float:
    """The larger of displacement and deformation error at full load, infinite without an answer.

    A reference that moves as a rigid body has no deformation: there the displacement counts alone.
    """
    errors = [at_full_load(case, model, metric) for metric in (VECTOR, DEFORMATION)]
    return float(np.nanmax(errors)) if math.isfinite(errors[0]) else math.inf


def case_state(case: CaseResult, model: str, step: int) -> str:
    """Whether displacement and deformation error of a step are within `CLOSE`, the reference's own error counted.

    "open" where that error leaves it undecided; where it was not measured the error is taken as it is.
    """
    states = set()
    for metric in (VECTOR, DEFORMATION):
        values = series(case, model, metric)
        error = math.nan if values is None or not len(values) else float(values[step])
        bar = reference_bar(case, metric)
        bar = bar if math.isfinite(bar) else 0.0
        if not math.isfinite(error):
            states |= (
                {LOST} if metric == VECTOR else set()
            )  # a reference that moves rigidly has no deformation
        elif error + bar <= CLOSE:
            states.add(WITHIN)
        else:
            states.add(BEYOND if error - bar > CLOSE else OPEN)
    return next(state for state in (LOST, BEYOND, OPEN, WITHIN) if state in states)


def word_of(states: Sequence[str]) -> str:
    """The answer to "is it good enough?" from a form's state in each case: no, where most cases have no answer."""
    count, within, left, lost = len(states), *map(states.count, (WITHIN, OPEN, LOST))
    if within == count:
        return YES
    if 2 * lost > count:
        return NO
    if within:
        return IN_PART
    return UNDECIDED if left == count else NOT_SHOWN if left else NO


def standing(cases: Sequence[CaseResult], model: str) -> tuple[float, ...]:
    """Sorts forms, the best first: by the answer, then by the median of the larger error.

    Of equal ones, or where half the cases or more have no answer, by how many have one. So one more form in a study
    never makes its answer a worse one.
    """
    word = word_of([case_state(case, model, case.full_load) for case in cases])
    errors = np.array([larger_error(case, model) for case in cases])
    known = errors[np.isfinite(errors)]
    usual = float(np.median(known)) if len(known) else math.inf
    return _WORDS.index(word), float(np.median(errors)), -len(known), usual
