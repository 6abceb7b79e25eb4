"""Room for results: what a case file holds, what its worker needs beside the solves, and what the disk has left."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from ..machine.safe_open import MAX_CASE_BYTES
from .estimate import case_bytes, disk_bytes, size_of
from .plan import Plan, PlannedCase

DOUBT = 1.3  # expected numbers of a case over those that a file holds: the nodes of a mesh are expected, too
DISK_DOUBT = 2.0  # expected bytes over those that are free


def without_room(plan: Plan, cases: Sequence[PlannedCase]) -> list[str]:
    """What will be refused of these cases because their results have no room in a case file or on the disk."""
    lines = list(dict.fromkeys(filter(None, (_beyond_a_file(plan, case) for case in cases))))
    needed, free = disk_bytes(plan, cases), free_bytes(plan.directory)
    if needed > DISK_DOUBT * free:
        lines.append(
            f"the results would take about {needed / 1e9:.3g} GB, and {plan.directory} has "
            f"{free / 1e9:.3g} GB of disk left; make room, or choose another --out"
        )
    return lines


def _beyond_a_file(plan: Plan, case: PlannedCase) -> str:
    size = size_of(plan, plan.meshes[case.mesh])
    if size is None:
        return ""
    needed = case_bytes(case, size)
    if needed <= DOUBT * MAX_CASE_BYTES:
        return ""
    return (
        f"{len(case.study.load.history):,} load steps on about {size.nodes:,.0f} surface nodes make results of "
        f"{needed / 1e9:.1f} GB, more than the {MAX_CASE_BYTES / 1e9:.1f} GB of a case file; use fewer load steps, "
        "a larger mesh_size or fewer models"
    )


def free_bytes(directory: Path) -> int:
    """What the disk of a directory has left, also before the directory is made."""
    there = next(path for path in (directory.absolute(), *directory.absolute().parents) if path.exists())
    return shutil.disk_usage(there).free
