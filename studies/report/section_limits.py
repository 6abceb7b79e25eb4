"""The small-strain limits: up to which load small strain, and each model, hold against finite strain."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from ..measures.case import Limit
from ..measures.limits import CLOSE, LARGEST, MOST_STRAIN
from ..verdict.digest import Digest
from ..verdict.formatting import NOTHING, listed, percent, quantity, short_percent
from ..verdict.growth import LINEAR, LimitRow, against_the_paper, growth_of, limit_rows
from .blocks import Block, Cell, Column, Section, Table, Text, bar_detail

_WHY = {
    "unresolved": "unresolved: a finer mesh does not bear it out",
    "beyond": "not reached",
    "model-stopped": "the model has no solution beyond",
    "reference-stopped": "the reference has no solution beyond",
}


def small_strain_limits(digest: Digest) -> Section | None:
    """Structural error and growth limits per model and case, and how they compare with the paper's 10 % strain."""
    rows = list(limit_rows(digest.cases))
    if not rows:
        return None
    found = [case.small_strain for case in digest.cases if case.small_strain is not None]
    raised = listed(sorted({"every load, in proportion" if one.unit == "1" else one.along for one in found}))
    blocks: list[Block] = [
        Text(sentence)
        for sentence in (growth_of(digest, digest.focus or ""), against_the_paper(digest))
        if sentence
    ]
    reading = (
        f"Raised: {raised}. The structural error is the displacement error at a small load. A limit is the "
        f"load at which the error has grown from there by the threshold. For {LINEAR} it is the "
        "linearisation limit: there small-strain theory departs from finite strain on the same mesh. "
        "Indentation is the mean displacement along the contact force, weighted by it. The strain is the "
        "reference's principal Green-Lagrange strain that 95 % of the volume stays below. Below it stands the "
        "largest of any point: local, at the rim of the contact or of the support, it grows with each finer mesh. "
        "Figures with a bar are of a mesh with every tetrahedron split into eight. A bar "
        f"is what that changes, and the {short_percent(CLOSE)} of the threshold that the search leaves open: "
        "for a load relative, for the others in their unit and with the load's bar counted in. A limit is "
        "unresolved where the finer mesh has none; its figures are then of the case's mesh. A search ends "
        f"at {LARGEST:g} times the study's load, and at a largest strain of {short_percent(MOST_STRAIN)}: no "
        "soft tissue bears to be three times as long."
    )
    return Section(
        "limits", "Small-strain limits", [*blocks, _table(digest, rows), Text(reading, kind="note")]
    )


def _table(digest: Digest, rows: list[LimitRow]) -> Table:
    many = len({row.case.hash for row in rows}) > 1
    columns = [
        *([Column("Case", numeric=False)] if many else []),
        Column("Model", numeric=False),
        Column("Structural error", unit="1"),
        Column("Growth", unit="1"),
        Column("Load", unit=rows[0].unit) if rows[0].unit != "1" else Column("Times the study's loads"),
        Column("Indentation", unit="m"),
        Column("Strain", unit="1"),
    ]
    metres = partial(quantity, unit="m")
    cells = []
    for row in rows:
        limit, error = row.limit, row.entry.structural_error
        cells.append(
            [
                *([Cell(digest.case_name(row.case))] if many else []),
                Cell(row.model),
                Cell(percent(error), bar_detail(error, row.entry.structural_bar), error),
                Cell(f"+ {short_percent(limit.threshold)}", value=limit.threshold),
                _load(limit, row.unit),
                _found(limit, limit.indentation, limit.indentation_bar, metres),
                _strain(limit),
            ]
        )
    return Table("limits", "", columns, cells, marks=digest.marks(row.model for row in rows))


def _strain(limit: Limit) -> Cell:
    cell = _found(limit, limit.strain, limit.strain_bar, percent)
    told = [cell.detail, f"largest {percent(limit.largest_strain)}"]
    return replace(cell, detail="\n".join(filter(None, told)))


def _load(limit: Limit, unit: str) -> Cell:
    if math.isnan(limit.load):
        return Cell(NOTHING, _WHY[limit.state], tone="muted")
    text = quantity(limit.load, unit)
    if limit.state == "found":
        return Cell(text, bar_detail(1.0, limit.bar), limit.load)
    prefix = {"beyond": "≥ ", "unresolved": ""}.get(limit.state, "to ")
    return Cell(f"{prefix}{text}", _WHY[limit.state], limit.load, tone="muted")


def _found(limit: Limit, value: float, bar: float, shown: Callable[[float], str]) -> Cell:
    """An indentation or a strain with its bar; that of a limit not found has none."""
    if limit.state != "found" or not math.isfinite(value):
        return Cell(shown(value), value=value)
    return Cell(shown(value), bar_detail(value, bar * abs(value), shown), value)
