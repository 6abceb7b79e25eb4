"""What a plan will take: seconds, memory and disk, by simple laws measured on small bodies, and by what has run.

The laws hold within a factor of about five on a machine of 2020 to 2026; where cases of the study have run on this
one, their measured times take over and the factor is about three.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import models
from .case import CaseResult
from .hdf5 import StoreError
from .meshing.mesh import MeshError
from .meshing.mesh_cache import mesh_path, read_mesh
from .model_name import FINITE_STRAIN, split
from .plan import Plan, PlannedCase, PlannedMesh
from .store import read_case
from .work import ModelWork, work_of

FACTOR_MEASURED, FACTOR_LAWS = 3.0, 5.0
_START = 2.0  # s to load the libraries, and to write the tables and an empty report
_PROCESS_BYTES = 1.3e8  # of a worker that has done nothing
_DENSE_NODES = 1000.0  # `vdm.formulations.boundary.MAX_NODES`, which would load the library
_MOST_READ = 3  # case files that are read to learn from
_SEARCH_LOADS = 30  # that a search for small-strain limits tries, each of them once for all models
_DEEP = (
    8.0  # cost of a load amid the limits, which is reached in steps that are halved, over one of the study's
)
# unknowns per tetrahedron, as these elements have them on meshes of some thousand
_UNKNOWNS = {"P1": 0.7, "P2": 4.7}
# the path's own estimate is for choosing one; of it, a solve of 3,000 to 25,000 tetrahedra takes
_MEASURED_SHARE = {"direct": 1.0, "iterative": 0.6}


@dataclass(frozen=True)
class Size:
    """Surface nodes and tetrahedra of a mesh, as counted or as expected."""

    nodes: float
    tetrahedra: float

    def refined(self, times: int) -> Size:
        """The size after so many refinements; the results stay on the nodes of the case's mesh."""
        return Size(4.0**times * self.nodes, 8.0**times * self.tetrahedra)


@dataclass(frozen=True)
class Cost:
    """Of one set-up and one step [s], and the memory of both [B]."""

    setup: float
    step: float
    bytes: float


@dataclass(frozen=True)
class Estimate:
    """Seconds on one core in all, bytes of the largest worker and bytes on disk; each true within `factor`."""

    seconds: float
    memory: float
    disk: float
    factor: float


def estimate(plan: Plan, cases: Sequence[PlannedCase], jobs: int = 1) -> Estimate | None:
    """What it takes to run these cases in `jobs` workers; None where a file cannot be meshed."""
    sizes: dict[str, Size] = {}
    for key, mesh in plan.meshes.items():
        size = size_of(plan, mesh)
        if size is None:
            return None
        sizes[key] = size
    learnt = _learn(plan, sizes)
    work = work_of(plan, cases, jobs)
    seconds = _START + sum(1.0 + 2e-4 * sizes[mesh.key].tetrahedra for mesh in plan.missing_meshes(cases))
    held: dict[int, float] = {}
    for part in work:
        cost = _cost(part, sizes[part.mesh], learnt)
        seconds += part.setups * cost.setup + part.solves * cost.step
        # what the cases of a group share is held until the group is done
        held[part.worker] = held.get(part.worker, 0.0) + cost.bytes
    for case in cases:
        seconds += _search(case, sizes[case.mesh], learnt)
    disk = 0.0
    for case in cases:
        results, steps = len(case.results) + 1, len(case.study.load.history)
        per_result = 48.0 * steps * sizes[case.mesh].nodes
        nodes = sizes[case.mesh].nodes
        # files, report; metrics of one step, with the distances of surfaces; those of the other steps
        seconds += 0.04 + results * (2e-3 + 1.2e-5 * nodes + 1e-6 * steps * nodes)
        disk += results * (per_result + 2e4) + 5e4
        if case.reference is not None and not plan.reference_cached(case):
            disk += 2 * per_result
    disk += sum(
        40.0 * sizes[mesh.key].tetrahedra + 80.0 * sizes[mesh.key].nodes
        for mesh in plan.missing_meshes(cases)
    )
    factor = FACTOR_MEASURED if learnt else FACTOR_LAWS
    return Estimate(seconds if cases else 0.0, _PROCESS_BYTES + max(held.values(), default=0.0), disk, factor)


def _search(case: PlannedCase, size: Size, learnt: Mapping[str, Cost]) -> float:
    """Seconds that the search for a case's small-strain limits takes."""
    study = case.study
    if study.limits is None:
        return 0.0
    seconds, steps = 0.0, study.load.steps or 1

    def tried(name: str, level: int, loads: int) -> float:
        cost = _cost(ModelWork(name, case.mesh, 0, level, loads, steps * loads, steps), size, learnt)
        base, solver = split(name)
        bent = base in FINITE_STRAIN or solver == "nonlinear"
        setups = loads if base in FINITE_STRAIN else 1
        return setups * cost.setup + loads * (max(steps, _DEEP) if bent else steps) * cost.step

    for name in study.study.models:
        seconds += tried(name, 0, _SEARCH_LOADS)
        if study.uncertainty is not None and models.find(name)[0].volumetric:
            seconds += tried(name, 1, 4)  # a small load and some amid the limits of the models
    return seconds


def size_of(plan: Plan, mesh: PlannedMesh) -> Size | None:
    """Of a mesh, counted where the cache or a file has it; None where its file cannot be meshed."""
    cached = read_mesh(mesh_path(plan.cache, mesh.key))
    if cached is not None:
        return Size(len(cached.surface_nodes), len(cached.tetrahedra))
    try:
        return Size(*mesh.expected_size)
    except MeshError:
        return None


def _law(name: str, size: Size, loads: int) -> Cost:
    """Fits to bodies of 100 to 900 surface nodes; a model without a law of its own gets that of its kind."""
    model, solver = models.find(name)
    n = size.nodes
    if model.volumetric:
        return _volumetric(model.name, size, loads)
    if model.name == "vdm-boundary":
        dense = min(n, _DENSE_NODES)  # more nodes are a sparse skin over a dense body
        step = (3e-7 if solver == "nonlinear" else 3e-8) * dense**2
        return Cost(3e-5 * dense**1.7 + 2e-5 * n + 1e-2, step, 620.0 * dense**2 + 6e3 * (n - dense))
    if model.name == "mass-spring":  # struts from side to side: a dense factor
        step = (1e-7 if solver == "nonlinear" else 3.5e-9) * n**2
        return Cost(1e-2 + 1.6e-9 * n**3, 7e-7 * n + step, 6e3 * n + 36.0 * n**2)
    step = {"nonlinear": 2e-5, "linear": 7e-7, "lu": 2e-6, "quasi-linear": 7e-7}.get(solver, 6e-5)
    return Cost(1e-2 + (2e-4 if solver == "lu" else 2e-5) * n, step * n, (3e4 if solver == "lu" else 6e3) * n)


def _volumetric(name: str, size: Size, loads: int) -> Cost:
    from fem_reference.costs import estimate_costs

    unknowns = _UNKNOWNS["P1" if name == "fem-p1" else "P2"] * size.tetrahedra
    vertices = 0.22 * size.tetrahedra
    if name == "fem-condensed":
        loads = max(loads, 600)
    one, many = (estimate_costs(int(unknowns), int(vertices), k) for k in (0, loads))
    path = min(many, key=lambda kind: many[kind].seconds)
    share = _MEASURED_SHARE[path]
    setup = share * one[path].seconds + 1e-5 * unknowns
    step = share * (many[path].seconds - one[path].seconds) / loads
    if name == "fem-condensed":
        return Cost(setup + loads * step, 1e-7 * unknowns, 2e4 * unknowns)
    if name == "fem":
        return Cost(1e-5 * unknowns + one["iterative"].seconds, 5.0 * one["direct"].seconds, 1.8e4 * unknowns)
    return Cost(setup, step, (1.8e4 if path == "direct" else 2.6e3) * unknowns)


def _cost(part: ModelWork, size: Size, learnt: Mapping[str, Cost]) -> Cost:
    law = _law(part.name, size.refined(part.level), part.solves)
    share = learnt.get(part.name, Cost(1.0, 1.0, 1.0))
    return Cost(law.setup * share.setup, law.step * share.step, law.bytes * share.bytes)


def _learn(plan: Plan, sizes: Mapping[str, Size]) -> dict[str, Cost]:
    """Model -> measured over expected, from a few of the cases that are done."""
    shares: dict[str, list[Cost]] = {}
    done = [case for case in plan.in_order if plan.state[case.hash] in ("done", "stale")]
    for case in done[:: max(1, len(done) // _MOST_READ)][:_MOST_READ]:
        stored = _read(plan.case_file(case))
        for name in case.results if stored is not None else ():
            result = stored.models.get(name) if stored is not None else None
            if result is None or not np.isfinite([result.seconds_setup, *result.seconds_per_step]).all():
                continue
            law = _law(name, sizes[case.mesh], 1)
            step = float(np.median(result.seconds_per_step))
            measured = (result.seconds_setup / law.setup, step / law.step, result.peak_bytes / law.bytes)
            shares.setdefault(name, []).append(Cost(*measured))
    return {
        name: Cost(*(float(np.median([getattr(c, k) for c in costs])) for k in ("setup", "step", "bytes")))
        for name, costs in shares.items()
    }


def _read(path: Path) -> CaseResult | None:
    try:
        return read_case(path)
    except StoreError:
        return None
