"""Every measure of every compared model in one table."""

from __future__ import annotations

from typing import Any, NamedTuple

from ..verdict.digest import DRIFT, Digest
from .blocks import Cell, Field, Section, Text, frame_table, spread_cell


class _Measure(NamedTuple):
    name: str
    unit: str
    definition: str


def all_measures(digest: Digest) -> Section | None:
    """Every metric of every compared model at full load, defined, and what the reference has of its own."""
    found = {
        name: _Measure(name, entry.unit, entry.definition)
        for case in digest.cases
        for model in digest.compared
        for name, entry in case.metrics.get(model, {}).items()
    }
    rows = [
        row
        for row in found.values()
        if row.name != DRIFT and any(digest.spread(m, row.name) for m in digest.models)
    ]
    if not rows:
        return None

    def of(model: str) -> Any:
        return lambda row: spread_cell(digest.spread(model, row.name), row.unit)

    fields = [
        Field("Measure", lambda row: Cell(measure_name(row.name), row.definition)),
        *(Field(model, of(model), "#", "median") for model in digest.compared),
        Field(str(digest.reference), of(str(digest.reference)), "#", "reference"),
    ]
    note = "± is the error of the reference itself, where it was measured. The last column is the reference alone."
    table = frame_table(rows, fields, "measures")
    return Section("measures", "All measures at full load", [Text(note, kind="note"), table])


def measure_name(metric: str) -> str:
    """A metric's name as words."""
    words = metric.replace("relative_l2_", "").replace("p95_", "95 % ").replace("_", " ")
    return words[:1].upper() + words[1:]
