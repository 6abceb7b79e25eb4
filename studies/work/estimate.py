"""What a plan will take, by simple laws measured on small bodies, and whether there is room for it.

Seconds are those of one core with nothing else to do. On a machine of 2020 to 2026 most shipped studies take half
to twice as many; the factor that is told leaves room for other machines and for solvers that struggle.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from .. import models
from ..body.mesh_cache import mesh_path, read_mesh
from ..machine.safe_open import MAX_CASE_BYTES
from ..study.errors import MeshError
from ..study.registry import REFINED, Cost, Size, mesh_seconds
from .nodes import Body, bodies
from .plan import Expected, Plan, PlannedCase, PlannedMesh

FACTOR = 5.0
DOUBT = 1.3  # expected numbers of a case over those that a file holds: the nodes of a mesh are expected, too
DISK_DOUBT = 2.0  # expected bytes over those that are free
_START = 3.0  # s to load the libraries, and to write the tables and the report
_PROCESS_BYTES = 1.3e8  # of a worker that has done nothing
_PER_NODE = 48.0  # bytes of a displacement and a reaction
_COPIES = 5.0  # of a case's results in its worker at the most, while its metrics and its file are made
_SEARCH_LOADS = 30  # that a search for small-strain limits tries, each of them once for all models
# steps of the study that a load amid the limits costs: of a model that goes there from rest in halved steps,
# and of one that goes on from the last load, the end of its way counted in
_DEEP, _ONWARD = 8.0, 2.0


@dataclass(frozen=True)
class Estimate:
    """Seconds on one core in all, bytes of the largest worker and bytes on disk; each true within `factor`."""

    seconds: float
    memory: float
    disk: float
    factor: float = FACTOR


def estimate(plan: Plan, cases: Sequence[PlannedCase]) -> Estimate | None:
    """What it takes to run these cases; None where a file cannot be meshed."""
    return plan.remembered(("estimate", *(case.hash for case in cases)), lambda: _estimate(plan, cases))


def _estimate(plan: Plan, cases: Sequence[PlannedCase]) -> Estimate | None:
    sizes: dict[str, Size] = {}
    for key in dict.fromkeys(case.mesh for case in cases):
        known = expected_mesh(plan, plan.meshes[key])
        if known is None:
            return None
        sizes[key] = known.size
    seconds = disk = memory = 0.0
    for body in bodies(plan, cases):
        solves = sum(len(asked.factors) for asked in body.asked)
        cost = _law(body.name, sizes[body.mesh].refined(body.level), solves)
        seconds += cost.setup + solves * cost.step
        memory = max(memory, cost.bytes)
        disk += _PER_NODE * solves * sizes[body.mesh].nodes + 2e3
    for case in cases:
        searched, held = _search(case, sizes[case.mesh])
        seconds += searched
        memory = max(memory, held)
    memory += _COPIES * max((case_bytes(case, sizes[case.mesh]) for case in cases), default=0.0)
    for mesh in plan.missing_meshes(cases):
        size = sizes[mesh.key]
        seconds += mesh_seconds(size)
        disk += 40.0 * size.tetrahedra + 80.0 * size.nodes
    for case in cases:
        results, steps, nodes = len(case.wanted), len(case.study.load.history), sizes[case.mesh].nodes
        # files, report; metrics of one step, with the distances of surfaces; those of the other steps
        seconds += 0.05 + 1e-6 * results * nodes * (15.0 + steps)
        disk += results * (_PER_NODE * steps * nodes + 2e4) + 5e4
    return Estimate(seconds + _START if cases else 0.0, _PROCESS_BYTES + memory, disk)


def case_bytes(case: PlannedCase, size: Size) -> float:
    """Of the numbers of a case's results: displacement and reaction of each node, step and model."""
    results = len(case.study.study.models) + (case.study.uncertainty is not None)
    return _PER_NODE * results * len(case.study.load.history) * size.nodes


def largest_solve(size: Size, work: Iterable[Body]) -> tuple[float, str]:
    """Bytes of the largest set-up and solve of a single load on a mesh, by the laws, and which model's it is."""
    return max(
        (_law(part.name, size.refined(part.level), 1).bytes, part.name + (REFINED if part.level else ""))
        for part in work
    )


def _search(case: PlannedCase, size: Size) -> tuple[float, float]:
    """Seconds and bytes of the search for a case's small-strain limits; every set-up is held until it is done."""
    study = case.study
    if study.limits is None:
        return 0.0, 0.0
    steps, seconds, held = study.load.steps or 1, 0.0, 0.0
    thresholds, others = len(study.limits.thresholds), len(study.study.models) - 1
    for name in study.study.models:
        model, solver = models.find(name)
        each = _ONWARD if model.continues else max(steps, _DEEP) if solver == "nonlinear" else float(steps)
        loads = {0: _SEARCH_LOADS}  # by mesh level
        if study.uncertainty is not None and model.volumetric:
            # a small load, and if all are found that of each limit: its own, or of the reference everybody's
            loads[1] = 1 + thresholds * (others if name == study.study.reference else 1)
        for level, count in loads.items():
            cost = _law(name, size.refined(level), steps)
            seconds += cost.setup + count * each * cost.step
            held += cost.bytes
    return seconds, held


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


def _law(name: str, size: Size, loads: int) -> Cost:
    model, solver = models.find(name)
    return model.cost(size, solver, loads)


def without_room(plan: Plan, cases: Sequence[PlannedCase]) -> list[str]:
    """What will be refused of these cases because their results have no room in a case file or on the disk."""
    lines = list(dict.fromkeys(filter(None, (_beyond_a_file(plan, case) for case in cases))))
    expected, free = estimate(plan, cases), free_bytes(plan.directory)
    if expected is not None and expected.disk > DISK_DOUBT * free:
        lines.append(
            f"the results would take about {expected.disk / 1e9:.3g} GB, and {plan.directory} has "
            f"{free / 1e9:.3g} GB of disk left; make room, or choose another --out"
        )
    return lines


def _beyond_a_file(plan: Plan, case: PlannedCase) -> str:
    known = expected_mesh(plan, plan.meshes[case.mesh])
    needed = case_bytes(case, known.size) if known is not None else 0.0
    if known is None or needed <= DOUBT * MAX_CASE_BYTES:
        return ""
    steps, most, gigabytes = len(case.study.load.history), MAX_CASE_BYTES / 1e9, needed / 1e9
    return (
        f"{steps:,} load steps on about {known.size.nodes:,.0f} surface nodes make results of {gigabytes:.1f} GB, "
        f"more than the {most:.1f} GB of a case file; use fewer load steps, a larger mesh_size or fewer models"
    )


def free_bytes(directory: Path) -> int:
    """What the disk of a directory has left, also before the directory is made."""
    there = next(path for path in (directory.absolute(), *directory.absolute().parents) if path.exists())
    return shutil.disk_usage(there).free
