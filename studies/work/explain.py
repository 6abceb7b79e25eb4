"""A plan in words: shared work, existing results, work that must fail, and doubtful scenes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from .. import models
from ..body.mesh import Mesh
from ..body.mesh_cache import read_mesh, write_mesh
from ..machine import machine_memory
from ..scene.inclusions import interfaces
from ..scene.measured_points import place_measured
from ..scene.scene import Scene, build_scene
from ..scene.warnings import meshing_warnings, scene_warnings
from ..study.checks import refusals
from ..study.config import geometry_error
from ..study.errors import Finding, InputError, Loc, MeshError, Problem
from ..study.files import without_folders
from ..study.registry import FINITE_STRAIN, REFINED, Size, split
from ..study.units import shown
from .plan import Plan, PlannedCase, PlannedMesh
from .tasks import Task, tasks_of

MEMORY_DOUBT = 2.0  # ratio of declared memory to that of the machine above which nothing is tried
MOST_SCENES = 20  # scenes to check, in the order of a study's cases
MOST_NODES = 20_000  # on the surface of a body that is meshed for a check


def summary(plan: Plan) -> dict[str, Any]:
    """The plan as plain data, for `plan.json` and `vdmbench plan`."""
    todo, study = plan.cases_to_run(), plan.study.study
    tasks = tasks_of(plan, todo)
    return {
        "study": {"name": study.name, "title": study.title},
        "command": list(plan.command),
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
                "model": asked["name"],
                "level": asked["level"],
                "mesh": asked["case"]["mesh"],
                "answers": len(asked["asked"]),
                "solves": sum(len(answer["factors"]) for answer in asked["asked"]),
            }
            for asked in _answers(tasks)
        ],
        "limits": sum(case.study.limits is not None for case in todo),
        "refused": [text for _, text in beyond_memory(plan, tasks)] + refused(plan, todo),
    }


def surfaces(plan: Plan) -> dict[str, str]:
    """SHA-256 -> name of the bodies' files; folders are left out as private."""
    return {mesh.file_hash: mesh.geometry.path.name for mesh in plan.meshes.values() if mesh.file_hash}


def require_own(plan: Plan) -> None:
    """Raise InputError if a run would replace the content of its directory.

    That is the case for other files, another study, or another file of the same name from --surface.
    """
    from ..store.plain import StoreError  # slow to load, and not needed to check a study
    from ..store.run_directory import read_plan, refuse_foreign

    refuse_foreign(plan.directory)
    try:
        there = read_plan(plan.directory)
    except StoreError:  # missing or unreadable
        return
    ours, theirs = plan.study.study.name, there["study"]["name"]
    # with --surface `bench` also runs its own bodies, which have no file
    by_name = "--surface" in plan.command and "--out" not in plan.command
    if ours != theirs:
        held = f"the study {shown(theirs)}, not {shown(ours)}"
    elif by_name and (own := surfaces(plan)) and not own.keys() & there.get("surfaces", {}).keys():
        held = "the results of another surface of that name"
    else:
        return
    raise InputError(f"{plan.directory}: holds {held}; choose another --out")


# --- work that must fail ---


def beyond_memory(plan: Plan, tasks: Sequence[Task], doubt: float = MEMORY_DOUBT) -> list[Finding]:
    """Work that takes more than `doubt` times this machine's memory, with its place in the study."""
    there = machine_memory()
    found = {}
    for needed, asked in sorted(
        ((_held(plan, one), one) for one in _answers(tasks)), key=lambda pair: pair[0]
    ):
        mesh = plan.meshes[asked["case"]["mesh"]]
        if needed > doubt * there:  # keeps the largest for each mesh
            own = mesh.geometry.has_own_tetrahedra
            text = (
                f"{asked['name']}{REFINED if asked['level'] else ''} on a {mesh.label} would take about "
                f"{needed / 1e9:,.0f} GB, and this machine has {there / 1e9:,.0f}; "
                f"{'coarsen it' if own else 'use a larger mesh_size'}"
            )
            found[mesh.key] = ("geometry", "path" if own else "mesh_size"), text
    return list(found.values())


def _answers(tasks: Sequence[Task]) -> list[Mapping[str, Any]]:
    """Payloads of the tasks that ask models for answers."""
    return [task.payload for task in tasks if task.kind == "answers"]


def _size(mesh: PlannedMesh) -> Size | None:
    """Size of a mesh; None if its file cannot be meshed, which is reported later."""
    try:
        return mesh.size
    except MeshError:
        return None


def _held(plan: Plan, asked: Mapping[str, Any]) -> float:
    """Declared bytes of a set-up; 0 if unknown. Raises ValueError if the formula fails."""
    (model, solver), size = models.find(asked["name"]), _size(plan.meshes[asked["case"]["mesh"]])
    if model.memory is None or size is None:
        return 0.0
    try:
        found = float(model.memory(size.refined(asked["level"]), solver))
        if not 0.0 <= found < math.inf:
            raise ValueError(f"it says {found:g} B")
    except (Exception, SystemExit) as error:
        told = f"{asked['name']}: memory(size, solver) fails: {error!r}; mend it, or declare no memory"
        raise ValueError(told) from error
    return found


def refused(plan: Plan, cases: Sequence[PlannedCase]) -> list[str]:
    """Refusals of models for these cases, as sentences."""
    found: dict[str, None] = {}
    for name in plan.study.study.models:
        model, solver = models.find(name)
        most = model.most_nodes.get(solver)
        for case in cases:
            found |= dict.fromkeys(told for _, told in refusals(case.study, name))
        for mesh in dict.fromkeys(case.mesh for case in cases):
            size = _size(plan.meshes[mesh]) if most else None
            if most and size is not None and size.nodes > most:
                told = f"{name} on a mesh of about {size.nodes:,.0f} surface nodes, more than its {most:,}"
                sparse = f"{model.name}-sparse"
                instead = f" or {sparse}" if sparse in models.all_models() else ""
                found[f"{told}; use a larger mesh_size{instead}, or leave the model out"] = None
    return list(found)


# --- scenes on their meshes before solving; the meshes are kept for the run ---


def scene_problems(plan: Plan) -> list[Problem]:
    """Doubts about the scenes, with file and line.

    Raises
    ------
    StudyError
        a scene that does not fit its mesh, or a mesh that cannot be made.
    """
    softest_last = list(plan.cases[::-1])  # among equals the first comes last
    softest_last.sort(key=lambda case: -case.study.tissue.youngs_modulus)
    scenes = {(case.mesh, repr((case.study.regions, case.study.constraints))): case for case in softest_last}
    meshes: dict[str, Mesh | None] = {}
    doubts: dict[Loc, str] = {}
    for case in list(scenes.values())[::-1][:MOST_SCENES]:
        if case.mesh not in meshes:
            meshes[case.mesh] = _mesh(plan, case)
        mesh = meshes[case.mesh]
        if mesh is not None:
            doubts = dict(_doubts(case, _scene(plan, case, mesh))) | doubts  # the first of several cases
            for other in _other_scenes(case):
                _scene(plan, other, mesh)
    return plan.study.error(list(doubts.items())).problems


def _other_scenes(case: PlannedCase) -> list[PlannedCase]:
    """The variations of a case with other regions."""
    found = {repr(part.study.regions): part for part in case.parts}
    del found[repr(case.study.regions)]
    return list(found.values())[:MOST_SCENES]


def scene_of(plan: Plan, case: PlannedCase) -> Scene:
    """A case's scene on its mesh, which is made even if that takes long. Raises StudyError."""
    mesh = _mesh(plan, case, most=math.inf)
    assert mesh is not None
    return _scene(plan, case, mesh)


def _mesh(plan: Plan, case: PlannedCase, most: float = MOST_NODES) -> Mesh | None:
    """The case's mesh; None if it is missing and would take long."""
    planned = plan.meshes[case.mesh]
    mesh = read_mesh(planned.path)
    if mesh is None and planned.size.nodes <= most:
        from ..body.geometry import build_mesh  # gmsh is slow to load

        try:
            mesh = build_mesh(planned.geometry, volume=planned.volume)
        except MeshError as error:
            raise geometry_error(plan.study, error) from error
        with suppress(OSError):  # a study can be checked in a read-only directory
            write_mesh(planned.path, mesh)
    return mesh


def _doubts(case: PlannedCase, scene: Scene) -> list[Finding]:
    study, mesh, reference = case.study, scene.mesh, case.study.study.reference
    found = scene_warnings(
        study.constraints,
        study.tissue,
        scene.regions,
        mesh.surface_points,
        mesh.triangles,
        max(map(abs, study.load.history)),
        small_strain=reference is not None and split(reference)[0] not in FINITE_STRAIN,
    )
    meshed = meshing_warnings(mesh.quality, study.acceptance.displacement_error)
    told = [(loc, _in_case(text, case)) for loc, text in (*found, *meshed)]
    if not (scene.sags or any(load.acts for load in scene.loads)):
        scan = " but the weight of its scan" if scene.gravity.any() else ""
        told.append((("constraints",), _in_case(f"nothing{scan} loads the body: every answer is zero", case)))
    elif len(study.load.history) > 1 and not any(
        np.any(getattr(part, key) or 0.0) for part in study.constraints for key in part.loads
    ):
        same = "every step is the same, as no factor acts on the weight"
        told.append((("load",), _in_case(f"{same}; leave load out, or sweep gravity.acceleration", case)))
    if scene.inclusions:
        told += _touching(case, scene)
    return told


def _touching(case: PlannedCase, scene: Scene) -> Iterator[Finding]:
    """Surface models that will refuse touching inclusions."""
    study = case.study
    knowing = [
        name
        for name in study.study.models
        if not (
            models.find(name)[0].volumetric or name in study.study.homogeneous or any(refusals(study, name))
        )
    ]
    try:
        if knowing:
            interfaces(scene.mesh, scene.inclusions)
    except InputError as error:
        yield error.place, _in_case(f"{' and '.join(knowing)} will refuse: {error}", case)


def _scene(plan: Plan, case: PlannedCase, mesh: Mesh) -> Scene:
    try:
        place_measured(case.study, mesh)
        return build_scene(case.study, mesh)
    except InputError as error:
        finding = (error.place or ("constraints",), _in_case(str(error), case))
        raise plan.study.error([finding]) from error


def _in_case(text: str, case: PlannedCase) -> str:
    return f"{text} (in the case {case.label})" if case.label else text
