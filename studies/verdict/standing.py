"""Where a form stands over all cases: from its worst limit in each, the reference's own error counted."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from solver_common.arrays import Array

from ..measures import uncertainty
from ..measures.case import CaseResult
from ..measures.metrics import VECTOR
from .acceptance import BEYOND, LOST, OPEN, WITHIN, Acceptance

YES, IN_PART, UNDECIDED, NO = "Yes", "In part", "Undecided", "No"
_WORDS = (YES, IN_PART, UNDECIDED, NO)  # the best first


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


def word_of(states: Sequence[str]) -> str:
    """The answer to "is it good enough?" from a form's state in each case: no, where most cases have no answer."""
    count, within, left, lost = len(states), *map(states.count, (WITHIN, OPEN, LOST))
    if within == count:
        return YES
    if 2 * lost > count:
        return NO
    if within:
        return IN_PART
    return UNDECIDED if left else NO


def standing(cases: Sequence[CaseResult], model: str, limits: Acceptance) -> tuple[float, ...]:
    """Sorts forms, the best first: by the answer, then by the median of the largest error over its limit.

    Of equal ones, or where half the cases or more have no answer, by how many have one. So one more form in a study
    never makes its answer a worse one.
    """
    states = [limits.state(case, model, case.full_load) for case in cases]
    shares = np.array([limits.share(case, model) for case in cases])
    known = shares[np.isfinite(shares)]
    usual = float(np.median(known)) if len(known) else math.inf
    word = word_of(states)
    hopeless = word == UNDECIDED and bool({BEYOND, LOST} & set(states))
    return _WORDS.index(word), hopeless, float(np.median(shares)), -len(known), usual
