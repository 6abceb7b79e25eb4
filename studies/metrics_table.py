"""Every metric of every case, model and step as one long table of text."""

from __future__ import annotations

import csv
import io
import math

from .case import CaseResult, MetricSeries, Run
from .uncertainty import value_bar


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
    writer.writerow(["case", *keys, "model", "load_factor", "metric", "value", "unit", "reference_error"])
    for case, model, metric, series in metric_rows(run):
        swept = [_cell(case.swept.get(key, "")) for key in keys]
        full_load, bar = case.full_load, value_bar(case, model, metric)
        for step, (factor, value) in enumerate(zip(case.load_factors, series.values, strict=True)):
            own = repr(bar) if step == full_load and math.isfinite(bar) else ""  # measured at full load only
            row = [model, repr(float(factor)), metric, repr(float(value)), series.unit, own]
            writer.writerow([case.hash[:12], *swept, *row])
    return out.getvalue()


def _cell(value: float | str) -> str:
    """A text that a spreadsheet would run as a formula gets a quote in front."""
    if isinstance(value, str):
        return f"'{value}" if value.startswith(("=", "+", "-", "@", "\t", "\r")) else value
    return repr(value)
