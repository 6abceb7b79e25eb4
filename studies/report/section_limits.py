"""The small-strain limits: up to which load small strain, and each model, hold against finite strain."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from ..measures.case import CaseResult, Limit, ModelLimits
from ..measures.limits import CLOSE, LARGEST, MOST_STRAIN
from ..verdict.digest import Digest
from ..verdict.formatting import NOTHING, listed, percent, quantity, short_percent
from .blocks import Cell, Field, Section, Text, bar_detail, frame_table

_WHY = {
    "unresolved": "unresolved: a finer mesh does not bear it out",
    "beyond": "not reached",
    "model-stopped": "the model has no solution beyond",
    "reference-stopped": "the reference has no solution beyond",
}
_READING = (
    "Raised: {raised}. The structural error is the displacement error at a small load. A limit is the load at "
    "which the error has grown from there by the threshold. For fem-linear it is the linearisation limit: "
    "there small-strain theory departs from finite strain on the same mesh. Indentation is the mean "
    "displacement along the contact force, weighted by it. The strain is the reference's principal "
    "Green-Lagrange strain that 95 % of the volume stays below; the paper speaks of less than 10 %. Below it "
    "stands the largest of any point: local, at the rim of the contact or of the support, it grows with each "
    "finer mesh. Figures with a bar are of a mesh with every tetrahedron split into eight. A bar is what that "
    "changes, and the {close} of the threshold that the search leaves open: for a load relative, for the "
    "others in their unit and with the load's bar counted in. A limit is unresolved where the finer mesh has "
    "none; its figures are then of the case's mesh. A search ends at {largest:g} times the study's load, and "
    "at a largest strain of {strain}."
)


class _Row(NamedTuple):
    """One model's limit at one threshold in one case."""

    case: CaseResult
    model: str
    entry: ModelLimits
    limit: Limit


def small_strain_limits(digest: Digest) -> Section | None:
    """Structural error and growth limits per model and case."""
    searched = [(case, case.small_strain) for case in digest.cases if case.small_strain is not None]
    rows = [
        _Row(case, model, entry, limit)
        for case, found in searched
        for model, entry in found.models.items()
        for limit in entry.limits
    ]
    if not rows:
        return None
    raised = {"every load, in proportion" if one.unit == "1" else one.along for _, one in searched}
    metres, unit = partial(quantity, unit="m"), searched[0][1].unit
    fields = [
        *([Field("Case", lambda row: digest.case_name(row.case))] if len(digest.cases) > 1 else []),
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
        Field("Load" if unit != "1" else "Times the study's loads", lambda row: _load(row.limit, unit), unit),
        Field(
            "Indentation",
            lambda row: _found(row.limit, row.limit.indentation, row.limit.indentation_bar, metres),
            "m",
        ),
        Field("Strain", lambda row: _found(row.limit, row.limit.strain, row.limit.strain_bar, percent), "1"),
        Field("Largest strain", lambda row: row.limit.largest_strain, "1", "of any point"),
    ]
    table = frame_table(rows, fields, "limits", mark=lambda row: digest.mark(row.model))
    about = {"close": short_percent(CLOSE), "largest": LARGEST, "strain": short_percent(MOST_STRAIN)}
    note = Text(_READING.format(raised=listed(sorted(raised)), **about), kind="note")
    return Section("limits", "Small-strain limits", [table, note])


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
