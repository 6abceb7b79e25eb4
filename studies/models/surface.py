"""From a scene to a surface model of the library `vdm`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from ..body.mesh import Mesh
from ..scene.scene import Scene, SurfaceLoad
from ..study.model_name import split, takes_fluid
from . import costs
from .model import Model as Registered
from .model import SetUp, register

if TYPE_CHECKING:
    from vdm.model import Model
    from vdm.solution import Solution
    from vdm.surface import SurfaceMesh


def prepare_surface(scene: Scene, solver: str, name: str, n_loads: int) -> SetUp:  # noqa: ARG001
    """The model `name` set up on the scene's body; see `vdmbench.models.model.Prepare`."""
    from vdm.constraints import Load
    from vdm.solvers.linear import LinearSolver

    model = _model(**_inputs(scene, name))

    def solve(loads: Sequence[SurfaceLoad]) -> Solution:
        steps = [
            Load(
                contact_pressure=load.contact_pressure,
                contact_force=load.contact_force,
                prescribed=load.prescribed,
                dead_force=load.line_force if load.lines else None,
            )
            for load in loads
        ]
        return model.solve(steps, condition=scene.condition)

    return SetUp(solve, model.solver if isinstance(model.solver, LinearSolver) else None)


def _inputs(scene: Scene, name: str) -> dict[str, Any]:
    """What decides a set-up. Parameters that the study does not set follow a rule from the tissue."""
    base, solver = split(name)
    fibres = scene.anisotropy
    fluid = takes_fluid(solver, scene.parameters.get("compressibility"))
    own = base in ("vdm-boundary", "vdm-sparse") and not fluid
    return {
        "mesh": scene.mesh,
        "youngs_modulus": scene.tissue.youngs_modulus,
        "density": scene.tissue.density if scene.gravity.any() else 0.0,
        "poisson_ratio": scene.tissue.poisson_ratio if own else 0.5,
        "given": dict(scene.parameters),
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
    poisson_ratio: float,
    given: dict[str, Any],
    fibres: tuple[tuple[float, ...], float] | None,
    formulation: str,
    solver: str,
    **options: Any,
) -> Model:
    """The model of a tissue of E and nu with the parameters `given`; `options` are the model's own."""
    from vdm.material import Parameters
    from vdm.model import Model

    penalty = given.get("penalty")
    chosen = {name: value for name, value in given.items() if name not in ("penalty", "compressibility")}
    rotation: Any = chosen.get("rotation", "global")
    held = options["fixed"] | options["constrained"]

    def parameters(surface: SurfaceMesh) -> Parameters:
        rule = Parameters.from_tissue(youngs_modulus, surface, formulation, rotation, held, poisson_ratio)
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


_surface = partial(
    Registered,
    prepare=prepare_surface,
    volumetric=False,
    superposes=("linear",),
    tissue=("youngs_modulus",),
    cost=costs.surface,
)
VDM_SOLVERS = (
    "linear",
    "single",
    "refined",
    "lu",
    "quasi-linear",
    "nonlinear",
    "bicg",
    "bicg-cold",
    "cg",
    "minres",
)
for _registered in (
    _surface(
        name="vdm-paper",
        benched=("quasi-linear", "nonlinear", "bicg"),
        version="4",
        # MINRES needs a symmetric matrix, which the printed form has not
        solvers=tuple(name for name in VDM_SOLVERS if name != "minres"),
        parameters=("bulk_modulus", "connectivity_modulus", "penalty"),
        by_rule=("bulk_modulus", "connectivity_modulus"),
        fibres=True,
    ),
    _surface(
        name="vdm-consistent",
        benched=("nonlinear", "cg"),
        version="5",
        solvers=VDM_SOLVERS,
        parameters=("foundation", "surface_tension", "penalty"),
        by_rule=("foundation", "surface_tension"),
        fibres=True,
    ),
    _surface(
        name="vdm-vector",
        benched=("quasi-linear", "nonlinear"),
        version="8",
        solvers=VDM_SOLVERS,
        parameters=("foundation", "surface_tension", "stretch_stiffness", "rotation", "penalty"),
        by_rule=("surface_tension",),
        lines=VDM_SOLVERS,
        fibres=True,
    ),
    _surface(
        name="vdm-boundary",
        benched=("nonlinear",),
        cost=costs.boundary,
        version="12",
        solvers=("linear", "nonlinear"),
        tissue=("youngs_modulus", "poisson_ratio"),
        parameters=("shear_modulus", "compressibility", "penalty"),
        most_nodes=2000,
        by_rule=("shear_modulus",),
        lines=("linear", "nonlinear"),
        fibres=False,
    ),
    _surface(
        name="vdm-sparse",
        cost=costs.sparse_boundary,
        version="1",
        solvers=("linear", "single", "nonlinear"),
        tissue=("youngs_modulus", "poisson_ratio"),
        parameters=("shear_modulus", "coarse_nodes", "compressibility"),
        by_rule=("shear_modulus",),
        lines=("linear", "single", "nonlinear"),
        fibres=False,
    ),
    _surface(
        name="mass-spring",
        cost=costs.mass_spring,
        version="6",
        solvers=VDM_SOLVERS,
        parameters=("shear_modulus", "penalty"),
        by_rule=("shear_modulus",),
        most_nodes=5000,
        lines=VDM_SOLVERS,
        fibres=False,
    ),
):
    register(_registered)
