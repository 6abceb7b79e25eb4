"""The scenes of a plan, put on the surfaces of their meshes before anything is solved."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from ..body.mesh import Mesh
from ..body.mesh_cache import mesh_path, read_mesh, write_mesh
from ..scene.measured_points import place_measured
from ..scene.scene import Scene, SceneError, build_scene
from ..scene.warnings import MOST_DRIFT, MOST_MOVED, scene_warnings
from ..study.config import geometry_error
from ..study.errors import Finding, Loc, MeshError, Problem
from ..study.registry import FINITE_STRAIN, split
from ..study.shapes import geometry_key
from .plan import Plan, PlannedCase

MOST_SCENES = 20  # of a study, in the order of its cases
MOST_ESTIMATES = 5  # of how far a load moves the body: those cases that are pulled the most
MOST_NODES = 20_000  # of a surface that is meshed for it


def scene_problems(plan: Plan) -> list[Problem]:
    """What is doubtful about the scenes, with file and line.

    Raises
    ------
    StudyError
        a scene that cannot be put on its mesh, or a mesh that cannot be made.
    """
    softest_last = list(plan.cases[::-1])  # of equals the first comes last
    softest_last.sort(key=lambda case: -case.study.tissue.youngs_modulus)
    scenes = {(case.mesh, repr((case.study.regions, case.study.constraints))): case for case in softest_last}
    meshes: dict[str, Mesh | None] = {}
    doubts: dict[Loc, str] = {}
    loaded: list[tuple[PlannedCase, Scene]] = []
    for case in list(scenes.values())[::-1][:MOST_SCENES]:
        if case.mesh not in meshes:
            meshes[case.mesh] = _surface(plan, case)
        mesh = meshes[case.mesh]
        if mesh is not None:
            loaded.append((case, _scene(plan, case, mesh)))
            doubts = dict(_doubts(*loaded[-1])) | doubts  # of several cases the first
            for other in _other_scenes(case):
                _scene(plan, other, mesh)
    doubts |= dict(_too_far(loaded))
    return plan.study.error(list(doubts.items())).problems


def _other_scenes(case: PlannedCase) -> list[PlannedCase]:
    """The variations of a case whose regions are others."""
    found = {repr(part.study.regions): part for part in case.parts}
    del found[repr(case.study.regions)]
    return list(found.values())[:MOST_SCENES]


def scene_of(plan: Plan, case: PlannedCase) -> Scene:
    """A case's scene on its surface, which is meshed however long that takes. Raises StudyError."""
    mesh = _surface(plan, case, most=math.inf, keep=False)
    assert mesh is not None
    return _scene(plan, case, mesh)


def _surface(plan: Plan, case: PlannedCase, most: float = MOST_NODES, *, keep: bool = True) -> Mesh | None:
    """The case's mesh, of one that is not there the surface alone; None where that would take long."""
    planned = plan.meshes[case.mesh]
    cached = read_mesh(mesh_path(plan.cache, planned.key))
    if cached is not None or planned.expected.size.nodes > most:
        return cached
    try:
        path = mesh_path(plan.cache, geometry_key(planned.geometry, volume=False))
        surface = read_mesh(path)
        if surface is None:
            from ..body.geometry import build_mesh  # gmsh is slow to load

            surface = build_mesh(planned.geometry, volume=False)
            if keep:
                with suppress(OSError):  # a study can be checked where nothing can be written
                    write_mesh(path, surface)
    except MeshError as error:
        raise geometry_error(plan.study, error) from error
    return surface


def _doubts(case: PlannedCase, scene: Scene) -> list[Finding]:
    study, mesh = case.study, scene.mesh
    factor = max(map(abs, study.load.history))
    found = scene_warnings(
        study.constraints, study.tissue, scene.regions, mesh.surface_points, mesh.triangles, factor
    )
    return [(loc, _in_case(text, case)) for loc, text in found]


def _too_far(loaded: list[tuple[PlannedCase, Scene]]) -> Iterator[Finding]:
    """The case that a run will not judge because its load is beyond a small-strain reference, by an estimate."""

    def pull(scene: Scene) -> float:
        forces = float(np.abs(scene.contact_force).sum()) + float(np.abs(scene.load(1.0).dead_force).sum())
        weight = float(np.abs(scene.gravity).max()) * scene.tissue.density
        moved = float(np.abs(scene.prescribed).max()) + (scene.indenter.depth if scene.indenter else 0.0)
        size = float(np.ptp(scene.mesh.points, axis=0).max())
        strain = (forces / size**2 + weight * size) / scene.tissue.youngs_modulus + moved / size
        return strain * float(np.abs(scene.load_factors).max())

    judged = [
        (case, scene)
        for case, scene in loaded
        if (name := case.study.study.reference) is not None and split(name)[0] not in FINITE_STRAIN
    ]
    judged.sort(key=lambda one: -pull(one[1]))
    for case, scene in judged[:MOST_ESTIMATES]:
        with suppress(ValueError):  # nothing holds the body, or no coarse mesh is of it
            from ..models.coarse import expected_motion  # gmsh is slow to load

            moved, drift = expected_motion(scene)
            parts = [f"moves the body by about {100 * moved:.2g} % of its smallest extent"] * (
                moved > MOST_MOVED
            )
            parts += [f"changes its volume by about {100 * drift:.2g} %"] * (drift > MOST_DRIFT)
            if parts:
                told = (
                    f"the load {' and '.join(parts)}; the reference holds for small strain and will not judge "
                    f"that (more than {MOST_MOVED:.0%} or {MOST_DRIFT:.0%}): "
                    'lower the load, or take study.reference = "fem"'
                )
                yield ("study", "reference"), _in_case(told, case)
                return


def _scene(plan: Plan, case: PlannedCase, mesh: Mesh) -> Scene:
    try:
        place_measured(case.study, mesh)
        return build_scene(case.study, mesh)
    except (SceneError, MeshError) as error:
        place: Loc = error.place if isinstance(error, SceneError) else ("constraints",)
        finding = (place, _in_case(str(error), case))
        raise plan.study.error([finding]) from error


def _in_case(text: str, case: PlannedCase) -> str:
    return f"{text} (in the case {case.label})" if case.label else text
