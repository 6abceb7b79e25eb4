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
from ..verdict.growth import LINEAR, LimitRow, growth_of, limit_rows, paper_bound
from ..verdict.words import said
from .blocks import Block, Cell, Field, Section, Table, Text, bar_detail, frame_table

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
    growth, bound = growth_of(digest, digest.focus or ""), paper_bound(digest)
    told = [("growth", growth), ("paper", bound)]
    blocks: list[Block] = [Text(text) for name, one in told if one is not None for text in said(name, one)]
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
    metres, unit = partial(quantity, unit="m"), rows[0].unit
    many = len({row.case.hash for row in rows}) > 1
    fields = [
        *([Field("Case", lambda row: digest.case_name(row.case))] if many else []),
        Field("Model", lambda row: row.model),
        Field(
            "Structural error",
            lambda row: row.entry.structural_error,
            "1",
            bar=lambda row: row.entry.structural_bar,
        ),
        Field(
            "Growth",
            lambda row: Cell(f"+ {short_percent(row.limit.threshold)}", value=row.limit.threshold),
            "1",
        ),
        Field(
            "Load" if unit != "1" else "Times the study's loads", lambda row: _load(row.limit, row.unit), unit
        ),
        Field(
            "Indentation",
            lambda row: _found(row.limit, row.limit.indentation, row.limit.indentation_bar, metres),
            "m",
        ),
        Field("Strain", lambda row: _strain(row.limit), "1"),
    ]
    return frame_table(rows, fields, "limits", mark=lambda row: digest.mark(row.model))


def _strain(limit: Limit) -> Cell:
    cell = _found(limit, limit.strain, limit.strain_bar, percent)
    if not math.isfinite(limit.largest_strain):
        return cell
    return replace(
        cell, detail="\n".join(filter(None, [cell.detail, f"largest {percent(limit.largest_strain)}"]))
    )


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
