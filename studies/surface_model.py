"""From a scene to a surface model of the library `vdm`, and its answer: solved, or a multiple of the last one."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .meshing.mesh import Mesh
from .model_name import reads, split
from .proportional import Solved
from .scene import Scene
from .setups import kept, shared

if TYPE_CHECKING:
    from vdm.model import Model
    from vdm.solution import Solution
    from vdm.solvers.linear import LinearSolver
    from vdm.surface import SurfaceMesh


def solve_surface(scene: Scene, solver: str, name: str) -> Solution:
    """The model `name` over the scene's load history."""
    from vdm.constraints import Load
    from vdm.solvers.linear import LinearSolver

    made = shared(_set_up, **_inputs(scene, name))
    solution = made.model.solve(
        [
            Load(
                contact_pressure=factor * scene.contact_pressure,
                contact_force=factor * scene.contact_force,
                prescribed=factor * scene.prescribed,
            )
            for factor in scene.load_factors
        ],
        condition=scene.condition,
    )
    # a penalty leaves more rounding than a multiple may differ by
    linear = isinstance(made.model.solver, LinearSolver) and solver == "linear" and not scene.gravity.any()
    good = all(status.ok for status in solution.status)
    made.solved = Solved.largest_step(scene, solution) if linear and good else None
    return solution


@dataclass
class _SetUp:
    model: Model
    solved: Solved | None = None  # the latest


def _set_up(**inputs: Any) -> _SetUp:
    return _SetUp(_model(**inputs))


def scaled(scene: Scene, name: str) -> tuple[Solution, int] | None:
    """The scene's solution as a multiple of the one before on the same set-up, and that set-up's peak of memory.

    None where it is no multiple of it. The model is one that is linear in the loads.
    """
    if scene.gravity.any():
        return None
    setup = kept(_set_up, **_inputs(scene, name))
    solution = setup.value.solved.scaled_to(scene) if setup is not None and setup.value.solved else None
    return None if setup is None or solution is None else (solution, setup.peak_bytes)


def linear_solver(scene: Scene, name: str) -> LinearSolver | None:
    """The solver of a linear surface model, set up; None under a penalty."""
    from vdm.solvers.linear import LinearSolver

    solver = shared(_set_up, **_inputs(scene, name)).model.solver
    return solver if isinstance(solver, LinearSolver) else None


def _inputs(scene: Scene, name: str) -> dict[str, Any]:
    """What decides a set-up. Parameters by the study, by the model's own table, else by rule from the tissue."""
    base, solver = split(name)
    fibres = scene.anisotropy
    given = {**scene.parameters, **scene.overrides.get(name, {})}
    return {
        "mesh": scene.mesh,
        "youngs_modulus": scene.tissue.youngs_modulus,
        "density": scene.tissue.density if scene.gravity.any() else 0.0,
        "given": {key: value for key, value in given.items() if key in reads(name)},
        "fibres": (fibres.fibre_direction, fibres.contrast) if fibres else None,
        "formulation": base.removeprefix("vdm-"),
        "solver": solver,
        "fixed": scene.fixed,
        "constrained": scene.constrained,
        "gravity": scene.gravity,
        "environment_pressure": scene.environment_pressure,
    }


def _model(
    *,
    mesh: Mesh,
    youngs_modulus: float,
    given: dict[str, Any],
    fibres: tuple[tuple[float, ...], float] | None,
    formulation: str,
    solver: str,
    **options: Any,
) -> Model:
    """The model of a tissue of E with the parameters `given`; `options` are the model's own."""
    from vdm.material import Parameters
    from vdm.model import Model

    penalty = given.get("penalty")
    chosen = {name: value for name, value in given.items() if name != "penalty"}
    rotation: Any = chosen.get("rotation", "global")
    held = options["fixed"] | options["constrained"]

    def parameters(surface: SurfaceMesh) -> Parameters:
        rule = Parameters.from_tissue(youngs_modulus, surface, formulation, rotation, held)
        whole = dataclasses.replace(rule, **chosen)
        if isinstance(rule.surface_tension, np.ndarray) and "surface_tension" in chosen:
            # a T of the study is the mean over the edges of one that grows from the support
            grown = chosen["surface_tension"] * (rule.surface_tension / rule.surface_tension.mean())
            whole = dataclasses.replace(whole, surface_tension=grown)
        return whole if fibres is None else whole.anisotropic(surface, *fibres)

    if penalty is not None:
        options |= {"constraint_method": "penalty-replaced", "penalty": penalty}  # (25) and (26) as printed
        solver = "lu" if solver == "linear" else solver  # lu solves the same problem; any other refuses
    return Model(
        mesh.surface_points,
        mesh.triangles,
        parameters,
        formulation=formulation,
        solver=solver,
        **options,
    )
