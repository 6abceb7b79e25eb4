"""Every measure of every compared model in one table, each with its definition."""

from __future__ import annotations

import math

from ..uncertainty import is_resolved
from .blocks import Cell, Column, Section, Table, Text
from .digest import Digest, Spread
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
            worst = f"\nworst {of_unit(spread.worst, unit)}" if many else ""
            row.append(
                Cell(of_unit(spread.median, unit), f"{_bar(spread, unit)}{worst}".strip(), spread.median)
            )
        rows.append(row)
    if not rows:
        return None
    columns = [
        Column("Measure", numeric=False),
        *(Column(model, "median" if many else "") for model in digest.compared),
    ]
    note = "± is the reference's own part in a measure, from its mesh levels; none where it was not measured."
    table = Table("measures", "", columns, rows)
    return Section("measures", "All measures at full load", [Text(note, kind="note"), table])


def _bar(spread: Spread, unit: str) -> str:
    if not math.isfinite(spread.median_bar):
        return ""
    text = f"± {of_unit(spread.median_bar, unit)}"
    return text if is_resolved(spread.median, spread.median_bar) else f"{text} unresolved"


def measure_name(metric: str) -> str:
    """A metric's name as words."""
    words = metric.replace("relative_l2_", "").replace("p95_", "95 % ").replace("_", " ")
    return words[:1].upper() + words[1:]
