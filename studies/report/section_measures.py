"""Every measure of every compared model in one table, each with its definition."""

from __future__ import annotations

from ..verdict.digest import Digest, Spread
from ..verdict.formatting import NOTHING, of_unit
from .blocks import Cell, Column, Section, Table, Text, bar_detail

_IN_HEADLINE = frozenset({"volume_drift"})


def all_measures(digest: Digest) -> Section | None:
    """Every metric of every compared model at full load, defined, and what the reference has of its own."""
    if not digest.compared:
        return None
    many = len(digest.cases) > 1
    first: dict[str, tuple[str, str]] = {}
    for case in digest.cases:
        for model in digest.compared:
            for name, entry in case.metrics.get(model, {}).items():
                first.setdefault(name, (entry.unit, entry.definition))
    rows = []
    for name, (unit, definition) in first.items():
        if name in _IN_HEADLINE:
            continue
        own = digest.spread(None, name)
        farthest = "" if not many else "worst" if own is None else "largest"
        spreads = [*(digest.spread(model, name) for model in digest.compared), own]
        rows.append([Cell(measure_name(name), definition), *(_cell(s, unit, farthest) for s in spreads)])
    if not rows:
        return None
    columns = [
        Column("Measure", numeric=False),
        *(Column(model, "median" if many else "") for model in digest.compared),
        Column(str(digest.reference), "reference"),
    ]
    note = "± is the error of the reference itself, where it was measured. The last column is the reference alone."
    table = Table("measures", "", columns, rows)
    return Section("measures", "All measures at full load", [Text(note, kind="note"), table])


def _cell(spread: Spread | None, unit: str, farthest: str) -> Cell:
    if spread is None:
        return Cell(NOTHING)
    extreme = f"\n{farthest} {of_unit(spread.worst, unit)}" if farthest else ""
    bar = bar_detail(spread.median, spread.median_bar, lambda bar: of_unit(bar, unit), unknown="")
    return Cell(of_unit(spread.median, unit), f"{bar}{extreme}".strip(), spread.median)


def measure_name(metric: str) -> str:
    """A metric's name as words."""
    words = metric.replace("relative_l2_", "").replace("p95_", "95 % ").replace("_", " ")
    return words[:1].upper() + words[1:]
