"""Every metric of every case, model and step as one long table of text."""

from __future__ import annotations

import csv
import io
import math

from ..measures.bars import value_bar
from ..measures.case import CaseResult, MetricSeries, Run


def metric_rows(run: Run) -> list[tuple[CaseResult, str, str, MetricSeries]]:
    """(case, model, metric, its values) of a run."""
    return [
        (case, model, metric, series)
        for case in run.cases
        for model, entries in case.metrics.items()
        for metric, series in entries.items()
    ]


def metrics_csv(run: Run) -> str:
    """The table as CSV; the reference's own error beside the value at full load, where it was measured."""
    keys = list(dict.fromkeys(key for case in run.cases for key in case.swept))
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(
        ["case", *map(_cell, keys), "model", "load_factor", "metric", "value", "unit", "reference_error"]
    )
    for case in run.cases:
        start = [case.hash[:12], *(_cell(case.swept.get(key, "")) for key in keys)]
        factors = [repr(factor) for factor in case.load_factors.tolist()]
        full_load = case.full_load
        for model, metrics in case.metrics.items():
            for metric, series in metrics.items():
                metric_name, unit = _cell(metric), _cell(series.unit)
                bar, values = value_bar(case, model, metric), series.values.tolist()
                error = repr(bar) if math.isfinite(bar) else ""
                for step, (factor, value) in enumerate(zip(factors, values, strict=True)):
                    own = error if step == full_load else ""  # measured at full load only
                    writer.writerow([*start, _cell(model), factor, metric_name, repr(value), unit, own])
    return out.getvalue()


def _cell(value: float | str) -> str:
    """A text that a spreadsheet would run as a formula gets a quote in front."""
    if isinstance(value, str):
        return f"'{value}" if value.startswith(("=", "+", "-", "@", "\t", "\r")) else value
    return repr(value)
