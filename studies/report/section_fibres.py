"""What fibres do to the shape: the body's mean strain along x, y and z, model by model."""

from __future__ import annotations

import math

from ..measures.bars import at_full_load
from ..measures.case import CaseResult
from ..verdict.digest import Digest
from ..verdict.formatting import percent, plain
from .blocks import Cell, Column, Section, Table, Text

AXES = ("x", "y", "z")


def anisotropy_of_the_response(digest: Digest) -> Section | None:
    """Mean strains at full load of every case with fibres; None where no case has any."""
    cases = [case for case in digest.cases if case.study.anisotropy]
    rows, names = [], []
    for case in cases:
        for model in digest.models:
            strains = [at_full_load(case, model, f"mean_strain_{axis}") for axis in AXES]
            if all(map(math.isfinite, strains)):
                rows.append(_row(digest, case, model, strains))
                names.append(model)
    if not rows:
        return None
    note = (
        "Means over the volume of the body at full load. Without fibres a body of revolution strains alike along x "
        "and y. Fibres along x make the strain along x the smaller one. VDM puts the contrast into the moduli of "
        "nodes and edges; the reference has fibres through its volume."
    )
    columns = [
        Column("Case", numeric=False),
        Column("Model", numeric=False),
        *(Column(f"Mean strain {axis}", unit="1") for axis in AXES),
        Column("x over y", unit="1"),
    ]
    table = Table("anisotropy", "", columns, rows, digest.marks(names))
    return Section("anisotropy", "Anisotropy of the response", [table, Text(note, kind="note")])


def _row(digest: Digest, case: CaseResult, model: str, strains: list[float]) -> list[Cell]:
    x, y, _ = strains
    ratio = x / y if y else math.nan
    return [
        Cell(digest.case_name(case)),
        Cell(model),
        *(Cell(percent(strain, signed=True), value=strain) for strain in strains),
        Cell(plain(ratio, 2), value=ratio),
    ]
