"""The error bars of a case's numbers, from what it stores of its reference's own error."""

from __future__ import annotations

import math

from ..study.model_name import REFINED
from .case import CaseResult
from .metrics import VECTOR
from .uncertainty import SIGNED, estimate_error, no_less, reference_bar


def value_bar(case: CaseResult, model: str, metric: str) -> float:
    """The bar of a metric's value at full load, at least `least_bar`; NaN where it has none.

    Of a model that is compared, the reference's own part in the metric. Of the reference's own figures, such as its
    volume drift, the GCI from all its levels, of two those that are there. What a model that is not compared in a
    metric does on its own mesh is exact as it stands.
    """
    bar = _measured_bar(case, model, metric)
    if not math.isfinite(bar) or metric not in SIGNED:
        return bar
    series, step = case.metrics.get(model, {}), case.full_load
    figures = {name: float(series[name].values[step]) for name in SIGNED if name in series}
    return no_less(bar, metric, figures, reference_bar(case.reference_error, VECTOR))


def _measured_bar(case: CaseResult, model: str, metric: str) -> float:
    levels = case.reference_error.get("levels", 1.0)
    if model != case.reference or levels < 2.0:
        return reference_bar(case.reference_error, metric)
    if f"own_gci:{metric}" in case.reference_error:
        return case.reference_error[f"own_gci:{metric}"]
    coarse = model.removesuffix(REFINED)
    found = [case.metrics.get(name, {}).get(metric) for name in (model, coarse)]
    values = [float(series.values[case.full_load]) for series in found if series is not None]
    if len(values) < 2 or not all(map(math.isfinite, values)):
        return math.nan
    return estimate_error([values[1] - values[0]], 2.0 ** (levels - 1.0)).gci
