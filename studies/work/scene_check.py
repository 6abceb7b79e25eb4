"""The scenes of a plan, put on their meshes before anything is solved; the meshes are kept for the run."""

from __future__ import annotations

import math
from contextlib import suppress

import numpy as np

from ..body.mesh import Mesh
from ..body.mesh_cache import read_mesh, write_mesh
from ..scene.measured_points import place_measured
from ..scene.scene import Scene, build_scene
from ..scene.warnings import scene_warnings
from ..study.config import geometry_error
from ..study.errors import Finding, InputError, Loc, MeshError, Problem
from ..study.registry import FINITE_STRAIN, split
from .plan import Plan, PlannedCase

MOST_SCENES = 20  # of a study, in the order of its cases
MOST_NODES = 20_000  # of the surface of a body that is meshed for it


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
    for case in list(scenes.values())[::-1][:MOST_SCENES]:
        if case.mesh not in meshes:
            meshes[case.mesh] = _mesh(plan, case)
        mesh = meshes[case.mesh]
        if mesh is not None:
            doubts = dict(_doubts(case, _scene(plan, case, mesh))) | doubts  # of several cases the first
            for other in _other_scenes(case):
                _scene(plan, other, mesh)
    return plan.study.error(list(doubts.items())).problems


def _other_scenes(case: PlannedCase) -> list[PlannedCase]:
    """The variations of a case whose regions are others."""
    found = {repr(part.study.regions): part for part in case.parts}
    del found[repr(case.study.regions)]
    return list(found.values())[:MOST_SCENES]


def scene_of(plan: Plan, case: PlannedCase) -> Scene:
    """A case's scene on its mesh, which is made however long that takes. Raises StudyError."""
    mesh = _mesh(plan, case, most=math.inf)
    assert mesh is not None
    return _scene(plan, case, mesh)


def _mesh(plan: Plan, case: PlannedCase, most: float = MOST_NODES) -> Mesh | None:
    """The case's mesh; None where it is not there and would take long."""
    planned = plan.meshes[case.mesh]
    mesh = read_mesh(planned.path)
    if mesh is None and planned.size.nodes <= most:
        from ..body.geometry import build_mesh  # gmsh is slow to load

        try:
            mesh = build_mesh(planned.geometry, volume=planned.volume)
        except MeshError as error:
            raise geometry_error(plan.study, error) from error
        with suppress(OSError):  # a study can be checked where nothing can be written
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
    told = [(loc, _in_case(text, case)) for loc, text in found]
    if not any(load.acts for load in scene.loads):
        told.append((("constraints",), _in_case("nothing loads the body: every answer is zero", case)))
    elif len(study.load.history) > 1 and not any(
        np.any(getattr(part, key) or 0.0) for part in study.constraints for key in part.loads
    ):
        same = "every step is the same, as no factor acts on the weight"
        told.append((("load",), _in_case(f"{same}; leave load out, or sweep gravity.acceleration", case)))
    return told


def _scene(plan: Plan, case: PlannedCase, mesh: Mesh) -> Scene:
    try:
        place_measured(case.study, mesh)
        return build_scene(case.study, mesh)
    except InputError as error:
        finding = (error.place or ("constraints",), _in_case(str(error), case))
        raise plan.study.error([finding]) from error


def _in_case(text: str, case: PlannedCase) -> str:
    return f"{text} (in the case {case.label})" if case.label else text
