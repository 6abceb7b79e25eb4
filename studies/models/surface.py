"""From a scene to a surface model of the library `vdm`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from solver_common.arrays import Array
from solver_common.solution import SolverError
from vdm.solvers import FIGURE_8, SOLVERS

from ..body.surface_measures import facet_area_vectors
from ..scene.inclusions import interfaces
from ..scene.scene import Scene, SurfaceLoad
from ..study.registry import SCANNED, Family, split
from ..study.registry import Model as Registered
from .model import SetUp, register
from .scanned import UNSTABLE, from_scan, no_rest_shape, rest_shape

if TYPE_CHECKING:
    from scipy import sparse

    from vdm.constraints import Load
    from vdm.formulations.base import Formulation
    from vdm.incremental import IncrementalModel
    from vdm.material import Lumps, Parameters
    from vdm.model import Model
    from vdm.parts.cut import Cut
    from vdm.solution import Solution
    from vdm.surface import SurfaceMesh


def prepare_surface(scene: Scene, solver: str, name: str, n_loads: int) -> SetUp:  # noqa: ARG001
    """The model `name` set up on the scene's body; see `vdmbench.models.Model`."""
    if SCANNED in scene.extras:
        return _scanned(scene, name)
    springs = _springs(scene)
    return _set_up(_model(scene, name, springs), springs, scene)


def _scanned(scene: Scene, name: str) -> SetUp:
    """For a body scanned under its weight: find the rest shape, then measure displacements from the scanned one."""
    from solver_common.jit import clock
    from vdm.model import Model
    from vdm.parts.solve import PartsSolver
    from vdm.parts.unloaded import Unloading

    def solver() -> PartsSolver:
        assert isinstance(model, Model)
        assert isinstance(model.solver, PartsSolver)
        return model.solver

    start, mesh, rest, springs = clock(), scene.mesh, scene, _springs(scene)
    model = _model(scene, name, springs)
    seconds = clock() - start
    measured = mesh.surface_points
    search = Unloading(measured, _load(scene.load(0.0)))

    def sag(points: Array) -> Array:
        """The sag that the stiffness of the body at `points` gives; at convergence it is that of the rest shape."""
        nonlocal rest, springs, model
        if points is not measured:
            moved = mesh.points.copy()
            moved[mesh.surface_nodes] = points
            rest = dataclasses.replace(scene, mesh=dataclasses.replace(mesh, points=moved))
            springs = _springs(rest)
            model = _model(rest, name, springs, search.cut(points))
        return measured - search.rest(solver())

    points = measured

    def led_back(least: int) -> tuple[SetUp, Array]:
        """The body at rest and its sag (N, 3) [m], in at least `least` parts, and as many as the sag needs."""
        nonlocal points, seconds
        began, number, needed = clock(), -1, least
        while needed != number:
            search.begin(needed)
            points, _ = rest_shape(measured, sag, points)
            if search.stiffness_left() <= 0.0:
                raise no_rest_shape(UNSTABLE)
            number, solver().least = solver().body.n_parts, least
            found = _set_up(model, springs, scene)
            weighed = found.solve([rest.load(0.0)])
            if not weighed.status[0].ok:
                raise SolverError(weighed.status[0])
            needed = solver().body.n_parts
            if needed > number:  # later rounds have at least as many
                least = needed
        solver().least = number
        sagged = np.asarray(weighed.displacement[0])
        if (finer := solver().finer) is not None:
            search.doubt(finer - sagged)
        seconds += clock() - began
        return found, sagged

    def on_rest(load: SurfaceLoad) -> SurfaceLoad:
        """A load whose pressures are forces on the rest shape; they follow its surface."""
        own = dataclasses.replace(rest, facet_pressure=load.facet_pressure).load(1.0)
        return dataclasses.replace(
            load, contact_pressure=own.contact_pressure, contact_force=own.contact_force
        )

    found, sagged = led_back(0)

    def solve(loads: Sequence[SurfaceLoad]) -> Solution:
        """The answer in as many parts as the loads need, from the rest shape for that number of parts."""
        nonlocal found, sagged
        while True:
            number = solver().body.n_parts
            solution = found.solve([on_rest(load) for load in loads])
            if solver().body.n_parts <= number:
                return from_scan(solution, loads, sagged, seconds, search.open)
            found, sagged = led_back(solver().body.n_parts)

    return SetUp(solve)


def _set_up(model: Model | IncrementalModel, springs: sparse.csr_array | None, scene: Scene) -> SetUp:
    """A model that is ready to solve, whose answers separate the forces of the springs."""
    from vdm.model import Model
    from vdm.solvers.linear import LinearSolver

    def solve(loads: Sequence[SurfaceLoad]) -> Solution:
        solution = model.solve([_load(load) for load in loads], condition=scene.condition)
        # the incremental model declares that it takes no springs
        if springs is None or not isinstance(model, Model):
            return solution
        return _apart(solution, springs, model.formulation)

    solver_of_pressures = model.solver if isinstance(model, Model) else None
    return SetUp(solve, solver_of_pressures if isinstance(solver_of_pressures, LinearSolver) else None)


def _load(load: SurfaceLoad) -> Load:
    from vdm.constraints import Load

    return Load(
        contact_pressure=load.contact_pressure,
        contact_force=load.contact_force,
        prescribed=load.prescribed,
        dead_force=load.dead_force if load.dead else None,
    )


def _springs(scene: Scene) -> sparse.csr_array | None:
    """(3N, 3N) stiffness of the springs between facets and the ground [N/m]; None without springs.

    It is exact for displacements that are linear on each facet. Lumped springs, a third of a facet's at each of its
    nodes, would hold a body that turns in a round bed four times too stiffly.
    """
    if not scene.springs:
        return None
    from scipy import sparse  # slow to load, and a plan does not solve

    points, triangles = scene.mesh.surface_points, scene.mesh.triangles
    vectors = facet_area_vectors(points, triangles)
    areas = np.linalg.norm(vectors, axis=1)[:, None, None]
    along = np.einsum("fi,fj->fij", vectors, vectors) / areas  # area times n n^T
    found = np.zeros((len(areas), 3, 3))
    for part in scene.springs:
        shape = along if part.direction == "normal" else areas * np.eye(3)
        found += part.stiffness * part.facets[:, None, None] * shape
    under = found.any(axis=(1, 2))
    dofs = (3 * triangles[under][:, :, None] + np.arange(3)).reshape(-1, 9)
    blocks = np.kron((np.ones((3, 3)) + np.eye(3)) / 12.0, found[under])  # integrals of two shape functions
    at = (np.repeat(dofs, 9, axis=1).ravel(), np.tile(dofs, 9).ravel())
    return sparse.csr_array((blocks.ravel(), at), shape=(3 * len(points), 3 * len(points)))


def _along_normals(springs: sparse.csr_array, normals: Array) -> Array:
    """(N,) lumped springs of nodes that move along their normals [N/m]: a third of a facet's at each node."""
    lumped = (springs @ np.tile(np.eye(3), (len(normals), 1))).reshape(-1, 3, 3)
    return np.asarray(np.einsum("ni,nij,nj->n", normals, lumped, normals))


def _apart(solution: Solution, springs: sparse.csr_array, formulation: Formulation) -> Solution:
    """The solution with spring forces among the reactions, and without the energy of the springs."""
    u = solution.displacement
    force = np.asarray(u.reshape(len(u), -1) @ springs).reshape(u.shape)  # symmetric
    if formulation.components == 1:
        normals = formulation.surface.normals
        along = np.einsum("sni,ni->sn", u, normals) * _along_normals(springs, normals)
        force = along[:, :, None] * normals
    stored = 0.5 * np.einsum("sni,sni->s", force, u)
    return dataclasses.replace(
        solution, reaction_force=solution.reaction_force - force, energy=solution.energy - stored
    )


def _model(
    scene: Scene, name: str, springs: sparse.csr_array | None, cut: Cut | None = None
) -> Model | IncrementalModel:
    """The model of the scene. Parameters that the study does not set follow from the tissue by a rule."""
    from vdm.incremental import IncrementalModel
    from vdm.material import Parameters
    from vdm.model import Model

    base, solver = split(name)
    formulation, mesh, given = base.removeprefix("vdm-"), scene.mesh, scene.parameters
    own_ratio = base in ("bem", "bem-sparse") and given.get("compressibility") != "fluid"
    chosen: dict[str, Any] = {k: value for k, value in given.items() if k not in _NOT_OF_THE_MATERIAL}

    def parameters(surface: SurfaceMesh) -> Parameters:
        rule = Parameters.from_tissue(
            scene.tissue.youngs_modulus,
            surface,
            formulation,
            chosen.get("rotation", "global"),
            scene.held,
            scene.tissue.poisson_ratio if own_ratio else 0.5,
        )
        whole = dataclasses.replace(rule, **chosen)
        if isinstance(rule.surface_tension, np.ndarray) and "surface_tension" in chosen:
            # T varies over the edges; the study's value is its mean
            grown = chosen["surface_tension"] * (rule.surface_tension / rule.surface_tension.mean())
            whole = dataclasses.replace(whole, surface_tension=grown)
        if FLUID in scene.extras:
            whole = dataclasses.replace(whole, fluid_in_cavities=True)
        if scene.inclusions:
            whole = dataclasses.replace(whole, lumps=_lumps(scene, own_ratio))
        if fibres := scene.anisotropy:
            whole = whole.anisotropic(surface, fibres.fibre_direction, fibres.contrast)
        return whole if springs is None else _on_springs(whole, springs, surface, formulation)

    options: dict[str, Any] = {
        "formulation": formulation,
        "density": scene.tissue.density if scene.gravity.any() else 0.0,
        "fixed": scene.fixed,
        "constrained": scene.constrained,
        "gravity": scene.gravity,
        "environment_pressure": scene.environment_pressure,
    }
    if "penalty" in given:  # (25) and (26) as printed
        options |= {"constraint_method": "penalty-replaced", "penalty": given["penalty"]}
        solver = "lu" if solver == "linear" else solver  # the same problem; other solvers refuse the penalty
    options |= {key: given[key] for key in _OF_SOLVERS if key in given}
    if solver == INCREMENTAL:
        return IncrementalModel(mesh.surface_points, mesh.triangles, parameters, **options)
    return Model(mesh.surface_points, mesh.triangles, parameters, solver=solver, cut=cut, **options)


def _lumps(scene: Scene, own_ratio: bool) -> Lumps:
    """The inclusions as closed regions, bounded by tetrahedron facets; in a fluid each keeps its volume."""
    from vdm.material import Lumps

    mesh, tissue = scene.mesh, scene.tissue
    facets, sides, owners = interfaces(mesh, scene.inclusions)
    declared = [scene.inclusions[k].declared if k >= 0 else tissue for k in owners]
    young = np.array([part.youngs_modulus for part in declared])
    ratio = np.array(
        [tissue.poisson_ratio if part.poisson_ratio is None else part.poisson_ratio for part in declared]
    )
    if not own_ratio:
        ratio[:] = 0.5
    n = len(mesh.surface_nodes)
    inside = np.setdiff1d(facets, mesh.surface_nodes)
    number = np.empty(len(mesh.points), np.int64)
    number[mesh.surface_nodes], number[inside] = np.arange(n), n + np.arange(len(inside))
    return Lumps(mesh.points[inside], number[facets], sides, young / (2.0 * (1.0 + ratio)), ratio)


def _on_springs(
    parameters: Parameters, springs: sparse.csr_array, surface: SurfaceMesh, formulation: str
) -> Parameters:
    """The material with springs to the ground; if nodes move along normals, the springs join the foundation."""
    if formulation not in ("paper", "consistent"):
        return dataclasses.replace(parameters, ground=springs)
    along, changed = _along_normals(springs, surface.normals), dict[str, Any]()
    if parameters.bulk_modulus is not None:  # B_i over V / A is a foundation
        height = surface.volume / surface.area
        changed["bulk_modulus"] = parameters.bulk_modulus + height * along / surface.nodal_areas
    else:
        own = 0.0 if parameters.foundation is None else parameters.foundation
        changed["foundation"] = own + along / surface.vector_areas
    # the bending correction holds for a body without springs
    return dataclasses.replace(parameters, youngs_modulus=None, **changed)


_surface = partial(
    Registered,
    prepare=prepare_surface,
    volumetric=False,
    superposes=("linear",),
    tissue=("youngs_modulus",),
)
# names in `vdmbench.study.registry.EXTRAS`
SPRINGS, FULL, DEAD, INCLUSIONS = "normal springs", "full springs", "dead forces", "inclusions"
CAVITIES, FLUID, FIBRES = "cavities", "fluid in cavities", "fibres"
INCREMENTAL = "incremental"  # a solver of the printed form alone: it tests a claim of the paper
PRINTED = (*SOLVERS, INCREMENTAL, FIGURE_8)
DIRECT = ("linear", "lu")  # the only solvers of the penalty form, (25) and (26)
_OF_SOLVERS = ("tolerance", "stop", "volume_row")
_NOT_OF_THE_MATERIAL = ("penalty", "compressibility", *_OF_SOLVERS)
for _registered in (
    _surface(
        name="vdm-paper",
        family=Family.PRINTED,
        version="6",
        solvers=PRINTED,
        # the nonlinear solver's areas, and with them its springs, grow with the deformation
        takes={FIBRES: PRINTED, SPRINGS: tuple(one for one in SOLVERS if one != "nonlinear")},
        parameters=("bulk_modulus", "connectivity_modulus", "penalty", "tolerance", "stop", "volume_row"),
        of_solvers={"penalty": DIRECT, "stop": (FIGURE_8,), "volume_row": ("quasi-linear", FIGURE_8)},
        by_rule=("bulk_modulus", "connectivity_modulus"),
    ),
    _surface(
        name="vdm-consistent",
        family=Family.DERIVED,
        version="7",
        solvers=SOLVERS,
        takes=dict.fromkeys((SPRINGS, FIBRES), SOLVERS),
        parameters=("foundation", "surface_tension", "penalty", "tolerance"),
        of_solvers={"penalty": DIRECT},
        by_rule=("foundation", "surface_tension"),
    ),
    _surface(
        name="vdm-vector",
        family=Family.DERIVED,
        version="10",
        solvers=SOLVERS,
        takes=dict.fromkeys((SPRINGS, FULL, DEAD, FIBRES), SOLVERS),
        parameters=("foundation", "surface_tension", "stretch_stiffness", "rotation", "penalty"),
        of_solvers={"penalty": DIRECT},
        by_rule=("surface_tension",),
    ),
    _surface(
        name="bem",
        family=Family.PEERS,
        takes={
            **dict.fromkeys((SPRINGS, FULL, DEAD, CAVITIES, FLUID), ("linear", "nonlinear")),
            INCLUSIONS: ("linear",),
            SCANNED: ("nonlinear",),
        },
        version="52",
        solvers=("linear", "nonlinear"),
        tissue=("youngs_modulus", "poisson_ratio"),
        parameters=("shear_modulus", "compressibility", "parts", "penalty"),
        of_solvers={"parts": ("nonlinear",), "penalty": ("linear",)},
        most_nodes={"linear": 2000},  # the nonlinear solver cuts the body into parts
        by_rule=("shear_modulus",),
    ),
    _surface(
        name="bem-sparse",
        family=Family.PEERS,
        version="31",
        solvers=("linear", "single", "nonlinear"),
        tissue=("youngs_modulus", "poisson_ratio"),
        parameters=("shear_modulus", "coarse_nodes", "compressibility", "parts"),
        of_solvers={"parts": ("nonlinear",)},
        by_rule=("shear_modulus",),
        takes={DEAD: ("linear", "single", "nonlinear")},
    ),
    _surface(
        name="mass-spring",
        family=Family.PEERS,
        takes=dict.fromkeys((SPRINGS, FULL, DEAD), SOLVERS),
        version="8",
        solvers=SOLVERS,
        parameters=("shear_modulus", "penalty"),
        of_solvers={"penalty": DIRECT},
        by_rule=("shear_modulus",),
        most_nodes=dict.fromkeys(SOLVERS, 5000),
    ),
):
    register(_registered)
