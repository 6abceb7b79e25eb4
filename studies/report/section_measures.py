"""Every measure of every compared model in one table; what fibres do to the shape."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from ..measures.case import CaseResult
from ..verdict.digest import DRIFT, Digest, Spread
from ..verdict.formatting import of_unit, percent
from .blocks import Cell, Field, Section, Text, bar_detail, frame_table

AXES = ("x", "y", "z")


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

    def of(model: str | None) -> Any:
        return lambda row: _cell(digest.spread(model, row.name), row.unit)

    fields = [
        Field("Measure", lambda row: Cell(measure_name(row.name), row.definition)),
        *(Field(model, of(model), "#", "median") for model in digest.compared),
        Field(str(digest.reference), of(None), "#", "reference"),
    ]
    note = "± is the error of the reference itself, where it was measured. The last column is the reference alone."
    table = frame_table(rows, fields, "measures")
    return Section("measures", "All measures at full load", [Text(note, kind="note"), table])


def _cell(spread: Spread | None, unit: str) -> Cell | None:
    if spread is None:
        return None
    worst = f"\nworst {of_unit(spread.worst, unit)}" if spread.cases > 1 else ""
    bar = bar_detail(spread.median, spread.median_bar, lambda bar: of_unit(bar, unit), unknown="")
    return Cell(of_unit(spread.median, unit), f"{bar}{worst}".strip(), spread.median)


def measure_name(metric: str) -> str:
    """A metric's name as words."""
    words = metric.replace("relative_l2_", "").replace("p95_", "95 % ").replace("_", " ")
    return words[:1].upper() + words[1:]


def anisotropy_of_the_response(digest: Digest) -> Section | None:
    """Mean strains at full load of every case with fibres; None where no case has any."""
    rows: list[tuple[CaseResult, str, list[float]]] = []
    for case in digest.cases:
        for model in digest.models if case.study.anisotropy else ():
            strains = [digest.at(case, model, f"mean_strain_{axis}") for axis in AXES]
            if all(map(math.isfinite, strains)):
                rows.append((case, model, strains))
    if not rows:
        return None
    note = (
        "Means over the volume of the body at full load. Without fibres a body of revolution strains alike along x "
        "and y. Fibres along x make the strain along x the smaller one. VDM puts the contrast into the moduli of "
        "nodes and edges; the reference has fibres through its volume."
    )

    def strain(k: int) -> Any:
        return lambda row: Cell(percent(row[2][k], signed=True), value=row[2][k])

    fields = [
        Field("Case", lambda row: digest.case_name(row[0])),
        Field("Model", lambda row: row[1]),
        *(Field(f"Mean strain {axis}", strain(k), "1") for k, axis in enumerate(AXES)),
        Field("x over y", lambda row: row[2][0] / row[2][1] if row[2][1] else math.nan, "#"),
    ]
    table = frame_table(rows, fields, "anisotropy", mark=lambda row: digest.colour(row[1]))
    return Section("anisotropy", "Anisotropy of the response", [table, Text(note, kind="note")])
