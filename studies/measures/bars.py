"""A case's numbers with their error bars, from what it stores of its reference's own error."""

from __future__ import annotations

import math

from solver_common.arrays import Array

from ..study.registry import REFINED
from . import uncertainty
from .case import CaseResult
from .metrics import VECTOR
from .uncertainty import SIGNED, estimate_error, no_less


def series(case: CaseResult, model: str, metric: str) -> Array | None:
    """(S,) values of a metric, None where the case has none."""
    entry = case.metrics.get(model, {}).get(metric)
    return None if entry is None else entry.values


def where_reached(case: CaseResult, model: str, metric: str) -> float:
    """A metric at the largest load that the reference reached; NaN where there is none."""
    values = series(case, model, metric)
    return math.nan if values is None or not len(values) else float(values[case.reached])


def reference_bar(case: CaseResult, metric: str = VECTOR) -> float:
    """The reference's own part in a metric (GCI) at the largest load that it reached, NaN where not measured."""
    return uncertainty.reference_bar(case.reference_error, metric)


def value_bar(case: CaseResult, model: str, metric: str) -> float:
    """The bar of a metric's value at the largest load that the reference reached; NaN where it has none.

    It is `least_bar` at least. Of a model that is compared, the reference's own part in the metric. Of the
    reference's own figures, such as its volume drift, the GCI from all its levels, of two those that are there.
    What a model that is not compared in a metric does on its own mesh is exact as it stands.
    """
    bar = _measured_bar(case, model, metric)
    if not math.isfinite(bar) or metric not in SIGNED:
        return bar
    figures = {name: where_reached(case, model, name) for name in SIGNED}
    return no_less(bar, metric, figures, reference_bar(case))


def _measured_bar(case: CaseResult, model: str, metric: str) -> float:
    levels = case.reference_error.get("levels", 1.0)
    if model != case.reference or levels < 2.0:
        return reference_bar(case, metric)
    if f"own_gci:{metric}" in case.reference_error:
        return case.reference_error[f"own_gci:{metric}"]
    fine, coarse = (where_reached(case, name, metric) for name in (model, model.removesuffix(REFINED)))
    if not math.isfinite(coarse - fine):
        return math.nan
    return estimate_error([coarse - fine], 2.0 ** (levels - 1.0)).gci
