"""The registry of models: name -> function of a Scene. The only place that knows both solver packages.

A model is one decorated function. Solver packages are imported inside, so that naming models costs nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .case import ModelResult, StepStatus
from .memory import peak_bytes_since, reset_peak
from .metrics import enclosed_volume
from .scene import Scene

if TYPE_CHECKING:
    from fem_reference.solution import Solution as FemSolution
    from vdm.solution import Solution as VdmSolution

    Solve = Callable[[Scene, str, str], FemSolution | VdmSolution]


@dataclass(frozen=True)
class Model:
    """A model of the registry.

    Attributes
    ----------
    name : what a study writes, without the solver
    version : raised whenever its numbers change; part of every case's hash
    volumetric : whether it needs tetrahedra
    solvers : the solvers it offers, the default first
    solve : (scene, solver, the full name) -> Solution
    """

    name: str
    version: str
    volumetric: bool
    solvers: tuple[str, ...]
    solve: Solve


MODELS: dict[str, Model] = {}


def _model(
    name: str, *, version: str, solvers: tuple[str, ...] = ("linear",), volumetric: bool = False
) -> Callable[[Solve], Solve]:
    def register(solve: Solve) -> Solve:
        MODELS[name] = Model(name, version, volumetric, solvers, solve)
        return solve

    return register


def model_names() -> list[str]:
    """Every name that a study can write, with and without solver."""
    return [
        name
        for model in MODELS.values()
        for name in (model.name, *(f"{model.name}:{solver}" for solver in model.solvers))
    ]


def find(name: str) -> tuple[Model, str]:
    """The model and solver behind "name" or "name:solver".

    Raises
    ------
    KeyError
        no such model or solver.
    """
    base, _, solver = name.partition(":")
    model = MODELS[base]
    if solver and solver not in model.solvers:
        raise KeyError(name)
    return model, solver or model.solvers[0]


@_model("vdm-paper", version="1")
def _vdm_paper(scene: Scene, solver: str, name: str) -> VdmSolution:
    return _vdm(scene, "paper", solver, name)


@_model("fem-linear", version="1", volumetric=True)
def _fem_linear(scene: Scene, solver: str, name: str) -> FemSolution:  # noqa: ARG001
    from fem_reference.linear import LinearProblem, Load

    mesh = scene.mesh
    problem = LinearProblem(
        mesh.points,
        mesh.tetrahedra,
        mesh.surface_nodes,
        mesh.triangles,
        youngs_modulus=scene.tissue.youngs_modulus,
        poisson_ratio=scene.tissue.poisson_ratio,
        density=scene.tissue.density,
        held=scene.held,
        expected_loads=len(scene.load_factors),
    )
    return problem.solve(
        [
            Load(factor * scene.facet_pressure, factor * scene.prescribed, scene.gravity)
            for factor in scene.load_factors
        ]
    )


def _vdm(scene: Scene, formulation: str, solver: str, name: str) -> VdmSolution:
    from vdm.material import Parameters
    from vdm.model import Load, Model

    from vdm.surface import SurfaceMesh

    surface = SurfaceMesh(scene.mesh.surface_points, scene.mesh.triangles)
    raise NotImplementedError
    _ = (Load, Model, Parameters, surface, formulation, solver, name)


def run_model(scene: Scene, name: str) -> ModelResult:
    """Solve one scene with one model and measure what it took."""
    model, solver = find(name)
    reset_peak()
    began = time.perf_counter()
    solution = model.solve(scene, solver, name)
    elapsed = time.perf_counter() - began
    points, triangles = scene.mesh.surface_points, scene.mesh.triangles
    steps = [
        u if status.ok else np.full_like(u, np.nan)
        for u, status in zip(solution.displacement, solution.status, strict=True)
    ]
    return ModelResult(
        displacement=np.array(steps),
        fluid_pressure=solution.fluid_pressure,
        reaction_force=solution.reaction_force,
        energy=solution.energy,
        volume=np.array([enclosed_volume(points + u, triangles) for u in steps]),
        iterations=solution.iterations,
        status=tuple(StepStatus(s.code, s.message, s.remedy) for s in solution.status),
        seconds_setup=solution.seconds_setup,
        seconds_per_step=solution.seconds_per_step,
        peak_bytes=peak_bytes_since(),
        version=model.version,
        parameters={**solution.parameters, "seconds_total": elapsed},
        scalars=solution.scalars,
        point_fields=solution.point_fields,
    )
