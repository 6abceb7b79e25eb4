"""Every measure of every compared model in one table, each with its definition."""

from __future__ import annotations

from .blocks import Cell, Column, Section, Table
from .digest import Digest
from .formatting import NOTHING, of_unit

_IN_HEADLINE = frozenset({"volume_drift"})


def all_measures(digest: Digest) -> Section | None:
    """Every metric of every compared model at full load, with its definition."""
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
        row = [Cell(measure_name(name), definition)]
        for model in digest.compared:
            spread = digest.spread(model, name)
            if spread is None:
                row.append(Cell(NOTHING))
                continue
            text = of_unit(spread.median, unit)
            row.append(Cell(text, f"worst {of_unit(spread.worst, unit)}" if many else "", spread.median))
        rows.append(row)
    if not rows:
        return None
    columns = [
        Column("Measure", numeric=False),
        *(Column(model, "median" if many else "") for model in digest.compared),
    ]
    return Section("measures", "All measures at full load", [Table("measures", "", columns, rows)])


def measure_name(metric: str) -> str:
    """A metric's name as words."""
    words = metric.replace("relative_l2_", "").replace("p95_", "95 % ").replace("_", " ")
    return words[:1].upper() + words[1:]
