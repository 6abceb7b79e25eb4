"""What is doubtful about the scenes."""

from __future__ import annotations

from ..verdict.digest import Digest
from ..verdict.verdict import doubts as found
from .blocks import Cell, Column, Section, Table


def doubts(digest: Digest) -> Section | None:
    """A row per constraint and doubt, of several cases the first."""
    rows = [
        [Cell(doubt.constraint), Cell(digest.case_name(doubt.case)), Cell(doubt.text)]
        for doubt in found(digest)
    ]
    columns = [Column(name, numeric=False) for name in ("Constraint", "Case", "What is doubtful")]
    table = Table("doubts", "", columns, rows)
    return Section("doubts", "What is doubtful about the scene", [table]) if rows else None
