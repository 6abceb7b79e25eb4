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
    for case, model, metric, series in metric_rows(run):
        start = [case.hash[:12], *(case.swept.get(key, "") for key in keys), model]
        bar = value_bar(case, model, metric)
        steps = zip(case.load_factors.tolist(), series.values.tolist(), strict=True)
        for step, (factor, value) in enumerate(steps):
            known = step == case.full_load and math.isfinite(bar)  # measured at full load only
            row = [*start, factor, metric, value, series.unit, bar if known else ""]
            writer.writerow(map(_cell, row))
    return out.getvalue()


def _cell(value: float | str) -> str:
    return no_formula(value) if isinstance(value, str) else repr(value)


def no_formula(text: str) -> str:
    """A text that a spreadsheet would run as a formula gets a quote in front."""
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t", "\r")) else text
