"""What is doubtful about the scenes: each a judgement, told beside results that were computed all the same."""

from __future__ import annotations

from ..scene.warnings import scene_warnings
from ..verdict.digest import Digest
from .blocks import Cell, Column, Section, Table


def doubts(digest: Digest) -> Section | None:
    """A row per constraint and doubt, of several cases the first."""
    rows: dict[tuple[str | int, ...], list[Cell]] = {}
    for case in digest.cases:
        constraints = case.resolved.get("constraints", [])
        tissue, factor = case.resolved.get("tissue", {}), float(abs(case.load_factors).max())
        for loc, text in scene_warnings(
            constraints, tissue, case.regions, case.points, case.triangles, factor
        ):
            entry = constraints[int(loc[1])]
            name = entry.get("name") or entry["region"]
            rows.setdefault(loc, [Cell(name), Cell(digest.case_name(case)), Cell(text)])
    columns = [Column(name, numeric=False) for name in ("Constraint", "Case", "What is doubtful")]
    table = Table("doubts", "", columns, list(rows.values()))
    return Section("doubts", "What is doubtful about the scene", [table]) if rows else None
