"""A plan in words: what is shared, what is known already, and what has no chance."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from .. import models
from ..body.mesh_cache import mesh_path, read_mesh
from ..machine import machine_memory
from ..scene.regions import body_extent, lies_outside
from ..study.config import holds_nothing
from ..study.errors import Finding, MeshError
from ..study.files import told_directory, without_folders
from ..study.registry import DISPLACEMENT_ELEMENTS, REFINED, lacks, split
from ..study.schema import extras_for
from ..study.shapes import fewer_nodes
from .plan import Expected, Plan, PlannedCase, PlannedMesh
from .tasks import Body, bodies

DOUBT = 1.3  # counted nodes of a mesh over those that are expected
MEMORY_DOUBT = 2.0  # declared bytes over those of the machine, from which on nothing is tried


def summary(plan: Plan) -> dict[str, Any]:
    """The plan as plain data: `plan.json`, and what `vdmbench plan` prints."""
    todo = plan.cases_to_run()
    work = bodies(plan, todo)
    study = plan.study.study
    return {
        "study": {"name": study.name, "title": study.title},
        "command": list(plan.command),
        "directory": told_directory(plan.directory, plan.command),
        "surfaces": surfaces(plan),
        "cases": [
            {
                "hash": case.hash,
                "label": case.label,
                "swept": without_folders(case.swept),
                "swept_units": dict(case.swept_units),
                "state": plan.state[case.hash],
                "mesh": case.mesh,
            }
            for case in plan.cases
        ],
        "meshes": len(plan.meshes),
        "meshes_to_make": len(plan.missing_meshes(todo)),
        "cases_to_run": len(todo),
        "work": [
            {
                "model": body.name,
                "level": body.level,
                "mesh": body.mesh,
                "answers": len(body.asked),
                "solves": sum(len(asked.factors) for asked in body.asked),
            }
            for body in work
        ],
        "limits": sum(case.limits is not None for case in todo),
        "refused": refused(plan, todo, work),
    }


def surfaces(plan: Plan) -> dict[str, str]:
    """SHA-256 -> name of the files that the bodies are from; their folders are the user's own affair."""
    return {mesh.file_hash: mesh.geometry.path.name for mesh in plan.meshes.values() if mesh.file_hash}


# --- what has no chance ---


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


def beyond_memory(plan: Plan, work: Sequence[Body], doubt: float = MEMORY_DOUBT) -> dict[str, str]:
    """Mesh -> what cannot be solved on it: it takes more than `doubt` times the memory of this machine."""
    there = machine_memory()
    lines = {}
    held = [(_held(plan, body), body) for body in work]
    for needed, body in sorted(held, key=lambda pair: pair[0]):  # of a mesh the one that takes the most
        mesh = plan.meshes[body.mesh]
        known = expected_mesh(plan, mesh)
        if known is not None and needed > doubt * there:
            remedy = fewer_nodes(mesh.geometry, float((known.high - known.low).max()))
            lines[body.mesh] = (
                f"{body.name}{REFINED if body.level else ''} on a {mesh.label} would take about "
                f"{needed / 1e9:,.0f} GB, and this machine has {there / 1e9:,.0f}; {remedy}"
            )
    return lines


def _held(plan: Plan, body: Body) -> float:
    """Bytes that a set-up declares to take; 0 where nobody knows. Raises ValueError where its formula, a plug-in's
    too, gives none.
    """
    (model, solver), known = models.find(body.name), expected_mesh(plan, plan.meshes[body.mesh])
    if model.memory is None or known is None:
        return 0.0
    try:
        found = float(model.memory(known.size.refined(body.level), solver))
        if not 0.0 <= found < math.inf:
            raise ValueError(f"it says {found:g} B")
    except (Exception, SystemExit) as error:
        why = f"{body.name}: memory(size, solver) fails: {error!r}; mend it, or declare no memory"
        raise ValueError(why) from error
    return found


def refused(plan: Plan, cases: Sequence[PlannedCase], work: Sequence[Body]) -> list[str]:
    """What will be refused of these cases, with their work, so far as that is beyond doubt."""
    lines = [text for _, text in blockers(plan, cases, work)]
    for name in plan.study.study.models:
        lines += dict.fromkeys(f"{name}{told}" for told in _refusals(plan, cases, name))
    return lines


def _refusals(plan: Plan, cases: Sequence[PlannedCase], name: str) -> Iterator[str]:
    """Why a model refuses some of these cases, behind its name."""
    model, studies = models.find(name)[0], [case.study for case in cases]
    if model.volumetric and any(map(holds_nothing, studies)):
        yield ": nothing is held; hold a region, by kind fixed or constrained"
    if split(name)[0] in DISPLACEMENT_ELEMENTS and any(each.tissue.poisson_ratio == 0.5 for each in studies):
        yield (
            " at a Poisson ratio of 0.5: a displacement element cannot be incompressible; use fem-linear, or a "
            "ratio below 0.5"
        )
    if not model.fibres and any(each.anisotropy for each in studies):
        yield ": it is isotropic; use another model for fibres"
    for study in studies:
        yield from (told.removeprefix(name) for told in lacks(name, extras_for(name, study)))
    if model.most_nodes is None:
        return
    missing = plan.missing_meshes(cases)
    for mesh in {case.mesh: plan.meshes[case.mesh] for case in cases}.values():
        known, counted = expected_mesh(plan, mesh), mesh.geometry.has_own_tetrahedra or mesh not in missing
        nodes = known.size.nodes if known is not None else 0.0
        if nodes > model.most_nodes * (1.0 if counted else DOUBT):
            yield (
                f" on a mesh of {'' if counted else 'about '}{nodes:,.0f} surface nodes, more than its "
                f"{model.most_nodes:,}; use a larger mesh_size, or leave the model out"
            )


def blockers(plan: Plan, cases: Sequence[PlannedCase], work: Sequence[Body]) -> list[Finding]:
    """What no case with it gets past, with its place in the study: a region off the body, no memory for a solve."""
    key = (
        "path"
        if plan.study.geometry.shape == "file" and plan.study.geometry.mesh_size is None
        else "mesh_size"
    )
    memory: list[Finding] = [(("geometry", key), text) for text in beyond_memory(plan, work).values()]
    return [*dict.fromkeys(_off_the_body(plan, cases)), *memory]


def _off_the_body(plan: Plan, cases: Sequence[PlannedCase]) -> list[Finding]:
    """The regions of constraints that lie off their body; a mesh may reach an edge further."""
    return [
        (("regions", name), f"region {name!r} lies off the body: {body_extent(body.low, body.high)}")
        for case in cases
        for name in dict.fromkeys(constraint.region for constraint in case.study.constraints)
        if (body := expected_mesh(plan, plan.meshes[case.mesh])) is not None
        if lies_outside(case.study.regions[name], body.low - body.reach, body.high + body.reach)
    ]
