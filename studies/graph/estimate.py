"""What a plan will take: seconds, memory and disk, by simple laws measured on small bodies, and by what has run.

Seconds are those of one core with nothing else to do. On a machine of 2020 to 2026 most shipped studies take half
to twice as many; the factor that is told leaves room for other machines and for solvers that struggle. Where cases
of the study have run on this one, with solves at least half as dear as those to come, its speed is known and the
factor smaller.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .. import models
from ..body.mesh_cache import mesh_path, read_mesh
from ..study.errors import MeshError
from ..study.model_name import REFINED, split
from ..study.registry import Cost, Size, mesh_seconds
from .nodes import Body, bodies
from .plan import Expected, Plan, PlannedCase, PlannedMesh

FACTOR_MEASURED, FACTOR_LAWS = 3.0, 5.0
_START = 3.0  # s to load the libraries, and to write the tables and the report
_PROCESS_BYTES = 1.3e8  # of a worker that has done nothing
_PER_NODE = 48.0  # bytes of a displacement and a reaction
_COPIES = 5.0  # of a case's results in its worker at the most, while its metrics and its file are made
_KNOWN = 0.5  # weight of the cases that have run, from which on they tell the speed
_MOST_READ = 3  # case files that are read to learn from
_SEARCH_LOADS = 30  # that a search for small-strain limits tries, each of them once for all models
# steps of the study that a load amid the limits costs: of a model that goes there from rest in halved steps,
# and of one that goes on from the last load, the end of its way counted in
_DEEP, _ONWARD = 8.0, 2.0


@dataclass(frozen=True)
class Spent:
    """Seconds on one core, and bytes held at the end."""

    seconds: float
    bytes: float

    def __add__(self, other: Spent) -> Spent:
        return Spent(self.seconds + other.seconds, self.bytes + other.bytes)


@dataclass(frozen=True)
class Estimate:
    """Seconds on one core in all, bytes of the largest worker and bytes on disk; each true within `factor`."""

    seconds: float
    memory: float
    disk: float
    factor: float


def estimate(plan: Plan, cases: Sequence[PlannedCase]) -> Estimate | None:
    """What it takes to run these cases; None where a file cannot be meshed."""
    return plan.remembered(("estimate", *(case.hash for case in cases)), lambda: _estimate(plan, cases))


def _estimate(plan: Plan, cases: Sequence[PlannedCase]) -> Estimate | None:
    sizes = _sizes(plan, cases)
    if sizes is None:
        return None
    seconds = dearest = memory = 0.0
    for body in bodies(plan, cases):
        solves = sum(len(asked.factors) for asked in body.asked)
        cost = _law(body.name, sizes[body.mesh].refined(body.level), solves)
        seconds += cost.setup + solves * cost.step
        dearest = max(dearest, cost.setup + cost.step)
        memory = max(memory, cost.bytes)
    searches = [_search(case, sizes[case.mesh]) for case in cases]
    seconds += sum(search.seconds for search in searches)
    memory = max([memory, *(search.bytes for search in searches)])
    memory += _COPIES * max((case_bytes(case, sizes[case.mesh]) for case in cases), default=0.0)
    speed, weight = _speed(plan, dearest)
    seconds *= speed
    seconds += _START + sum(mesh_seconds(sizes[mesh.key]) for mesh in plan.missing_meshes(cases))
    for case in cases:
        nodes, steps = sizes[case.mesh].nodes, len(case.study.load.history)
        # files, report; metrics of one step, with the distances of surfaces; those of the other steps
        seconds += 0.05 + 1e-6 * len(case.wanted) * nodes * (15.0 + steps)
    factor = FACTOR_MEASURED if weight >= _KNOWN else FACTOR_LAWS
    disk = _disk_bytes(plan, cases, sizes)
    return Estimate(seconds if cases else 0.0, _PROCESS_BYTES + memory, disk, factor)


def disk_bytes(plan: Plan, cases: Sequence[PlannedCase]) -> float:
    """What the results of these cases and all that they need take on disk; 0 where a file cannot be meshed."""
    sizes = _sizes(plan, cases)
    return _disk_bytes(plan, cases, sizes) if sizes is not None else 0.0


def _disk_bytes(plan: Plan, cases: Sequence[PlannedCase], sizes: Mapping[str, Size]) -> float:
    solves = [
        sizes[body.mesh].nodes * sum(len(asked.factors) for asked in body.asked)
        for body in bodies(plan, cases)
    ]
    results = sum(
        len(case.wanted) * (_PER_NODE * len(case.study.load.history) * sizes[case.mesh].nodes + 2e4) + 5e4
        for case in cases
    )
    meshes = [sizes[mesh.key] for mesh in plan.missing_meshes(cases)]
    return (
        sum(_PER_NODE * nodes + 2e3 for nodes in solves)
        + results
        + sum(40.0 * size.tetrahedra + 80.0 * size.nodes for size in meshes)
    )


def _sizes(plan: Plan, cases: Sequence[PlannedCase]) -> dict[str, Size] | None:
    """Mesh -> its size; None where a file cannot be meshed."""
    found = {key: size_of(plan, plan.meshes[key]) for key in dict.fromkeys(case.mesh for case in cases)}
    known = {key: size for key, size in found.items() if size is not None}
    return known if len(known) == len(found) else None


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


def _search(case: PlannedCase, size: Size) -> Spent:
    """What the search for a case's small-strain limits takes; every set-up is held until it is done."""
    study, spent = case.study, Spent(0.0, 0.0)
    if study.limits is None:
        return spent
    steps = study.load.steps or 1

    def tried(name: str, level: int, loads: int) -> Spent:
        cost = _law(name, size.refined(level), steps)
        each = float(steps)
        if models.find(name)[0].continues:
            each = _ONWARD
        elif split(name)[1] == "nonlinear":
            each = max(each, _DEEP)
        return Spent(cost.setup + loads * each * cost.step, cost.bytes)

    thresholds, others = len(study.limits.thresholds), len(study.study.models) - 1
    for name in study.study.models:
        spent += tried(name, 0, _SEARCH_LOADS)
        if study.uncertainty is not None and models.find(name)[0].volumetric:
            # a small load, and if all are found that of each limit: its own, or of the reference everybody's
            limits = thresholds * (others if name == study.study.reference else 1)
            spent += tried(name, 1, 1 + limits)
    return spent


def size_of(plan: Plan, mesh: PlannedMesh) -> Size | None:
    """Of a mesh, counted where the cache or a file has it; None where its file cannot be meshed."""
    known = known_of(plan, mesh)
    return Size(known.nodes, known.tetrahedra) if known is not None else None


def known_of(plan: Plan, mesh: PlannedMesh) -> Expected | None:
    """What a mesh in the cache is, or one that is not there will be; None where its file cannot be meshed."""
    return plan.remembered(("known of", mesh.key), lambda: _known_of(plan, mesh))


def _known_of(plan: Plan, mesh: PlannedMesh) -> Expected | None:
    cached = read_mesh(mesh_path(plan.cache, mesh.key))
    if cached is not None:
        return Expected.of_mesh(cached)
    try:
        return mesh.expected
    except MeshError:
        return None


def _law(name: str, size: Size, loads: int) -> Cost:
    model, solver = models.find(name)
    return model.cost(size, solver, loads)


def _speed(plan: Plan, dearest: float) -> tuple[float, float]:
    """What to multiply the laws' seconds by, from a few of the cases that are done; and the weight that these have.

    Small solves take longer than the laws say, by what they all take whatever their size. So a measurement tells
    of work of its own size: each case counts by its seconds, those on refined meshes included, and all of them as
    far as the dearest set-up and step that they had goes towards the `dearest` one to come [s by the laws].
    """
    from ..store.cases import read_case  # its file format is slow to load, and a new study has no case
    from ..store.hdf5 import StoreError

    ratios, weights, known = [], [], 0.0
    done = [case for case in plan.in_order if plan.state[case.hash] in ("done", "stale")]
    for case in done[:: max(1, len(done) // _MOST_READ)][:_MOST_READ]:
        size = size_of(plan, plan.meshes[case.mesh])
        try:
            solved = read_case(plan.case_file(case)).models
        except StoreError:
            continue
        if size is None:
            continue
        finest = case.study.uncertainty.levels - 1 if case.study.uncertainty else 0
        measured = expected = 0.0
        for name, result in solved.items():
            model, spent = name.removesuffix(REFINED), [result.seconds_setup, *result.seconds_per_step]
            if (
                model in case.study.study.models and np.isfinite(spent).all()
            ):  # one that stopped tells nothing
                law = _law(model, size.refined(finest if name != model else 0), 1)
                measured += sum(spent)
                expected += law.setup + law.step * (len(spent) - 1)
                known = max(known, law.setup + law.step)
        if expected:
            ratios.append(measured / expected)
            weights.append(expected)
    if not ratios:
        return 1.0, 0.0
    weight = min(1.0, known / dearest) if dearest else 1.0
    ratio = float(np.quantile(ratios, 0.5, weights=weights, method="inverted_cdf"))
    return 1.0 + weight * (ratio - 1.0), weight
