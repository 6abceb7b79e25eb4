"""Whether there is room for a plan: in memory, by what a model declares; in a case file; on the disk."""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from pathlib import Path

from .. import models
from ..body.mesh_cache import mesh_path, read_mesh
from ..machine import machine_memory
from ..study.errors import MeshError
from ..study.registry import REFINED, Size
from ..study.shapes import fewer_nodes
from .plan import Expected, Plan, PlannedCase, PlannedMesh
from .tasks import Body, bodies

DOUBT = 1.3  # expected numbers of a case over those that a file holds: the nodes of a mesh are expected, too
DISK_DOUBT = 2.0  # expected bytes over those that are free
MEMORY_DOUBT = 2.0  # declared bytes over those of the machine, from which on nothing is tried
_MAX_CASE_BYTES = 2 << 30  # of the results of a case
_PER_NODE = 48.0  # bytes of a displacement and a reaction


def expected_mesh(plan: Plan, mesh: PlannedMesh) -> Expected | None:
    """What a mesh in the cache is, or one that is not there will be; None where its file cannot be meshed."""

    def look() -> Expected | None:
        cached = read_mesh(mesh_path(plan.cache, mesh.key))
        if cached is not None:
            return Expected.of_mesh(cached)
        try:
            return mesh.expected
        except MeshError:
            return None

    return plan.remembered(("mesh", mesh.key), look)


def _size(plan: Plan, mesh: str) -> Size | None:
    known = expected_mesh(plan, plan.meshes[mesh])
    return known.size if known is not None else None


def beyond_memory(plan: Plan, work: Sequence[Body], doubt: float = MEMORY_DOUBT) -> dict[str, str]:
    """Mesh -> what cannot be solved on it: it takes more than `doubt` times the memory of this machine."""
    there = machine_memory()
    most: dict[str, tuple[float, str]] = {}
    for part in work:
        needed = _held(plan, part)
        if not isinstance(needed, str):
            name = part.name + (REFINED if part.level else "")
            most[part.mesh] = max(most.get(part.mesh, (0.0, "")), (needed, name))
    lines = {}
    for key, (needed, name) in most.items():
        mesh = plan.meshes[key]
        body = expected_mesh(plan, mesh)
        if body is not None and needed > doubt * there:
            remedy = fewer_nodes(mesh.geometry, float((body.high - body.low).max()))
            lines[key] = (
                f"{name} on a {mesh.label} would take about {needed / 1e9:,.0f} GB, and this machine has "
                f"{there / 1e9:,.0f}; {remedy}"
            )
    return lines


def unknown_memory(plan: Plan, work: Sequence[Body]) -> list[str]:
    """A sentence for each model whose own formula says nothing."""
    return list(dict.fromkeys(found for part in work if isinstance(found := _held(plan, part), str)))


def _held(plan: Plan, body: Body) -> float | str:
    """Bytes that a set-up declares to take, or why its model, which may be another's, does not say."""
    (model, solver), size = models.find(body.name), _size(plan, body.mesh)
    if model.memory is None or size is None:
        return 0.0
    try:
        found = float(model.memory(size.refined(body.level), solver))
    except (Exception, SystemExit) as error:  # noqa: BLE001  of another package
        told = f"{type(error).__name__}: {error}".rstrip(": ")
        return f"{body.name}: the memory that it takes is not known, as its formula raises {told}"
    if math.isfinite(found) and found >= 0.0:
        return found
    return f"{body.name}: the memory that it takes is not known, as its formula says {found:g} B"


def without_room(plan: Plan, cases: Sequence[PlannedCase]) -> list[str]:
    """What will be refused of these cases because their results have no room in a case file or on the disk."""
    lines = list(dict.fromkeys(filter(None, (_beyond_a_file(plan, case) for case in cases))))
    needed, free = stored_bytes(plan, cases), free_bytes(plan.directory)
    if needed > DISK_DOUBT * free:
        lines.append(
            f"the results would take about {needed / 1e9:.3g} GB, and {plan.directory} has "
            f"{free / 1e9:.3g} GB of disk left; make room, or choose another --out"
        )
    return lines


def stored_bytes(plan: Plan, cases: Sequence[PlannedCase]) -> float:
    """Of all files of these cases that are not there, about: meshes, answers, cases; of known meshes alone."""

    def work() -> float:
        sizes = {key: _size(plan, key) or Size(0.0, 0.0) for key in {case.mesh for case in cases}}
        made = [sizes[mesh.key] for mesh in plan.missing_meshes(cases)]
        total = sum(40.0 * size.tetrahedra + 80.0 * size.nodes for size in made)
        for body in bodies(plan, cases):
            solves = sum(len(asked.factors) for asked in body.asked)
            total += _PER_NODE * solves * sizes[body.mesh].nodes + 2e3 * len(body.asked)
        return total + sum(
            case_bytes(case, sizes[case.mesh]) + 2e4 * len(case.wanted) + 5e4 for case in cases
        )

    return plan.remembered(("stored", *(case.hash for case in cases)), work)


def case_bytes(case: PlannedCase, size: Size) -> float:
    """Of the numbers of a case's results: displacement and reaction of each node, step and model."""
    results = len(case.study.study.models) + (case.study.uncertainty is not None)
    return _PER_NODE * results * len(case.study.load.history) * size.nodes


def _beyond_a_file(plan: Plan, case: PlannedCase) -> str:
    size = _size(plan, case.mesh)
    needed = case_bytes(case, size) if size is not None else 0.0
    if size is None or needed <= DOUBT * _MAX_CASE_BYTES:
        return ""
    steps, most, gigabytes = len(case.study.load.history), _MAX_CASE_BYTES / 1e9, needed / 1e9
    return (
        f"{steps:,} load steps on about {size.nodes:,.0f} surface nodes make results of {gigabytes:.1f} GB, "
        f"more than the {most:.1f} GB of a case file; use fewer load steps, a larger mesh_size or fewer models"
    )


def free_bytes(directory: Path) -> int:
    """What the disk of a directory has left, also before the directory is made."""
    there = next(path for path in (directory.absolute(), *directory.absolute().parents) if path.exists())
    return shutil.disk_usage(there).free
