"""The registry of models: name -> function of a Scene. The only place that knows both solver packages.

A model is one registered function. Solver packages are imported inside, so that naming models costs nothing.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from .case import ModelResult, StepStatus
from .memory import peak_bytes_since, reset_peak
from .meshing.mesh import Array, Mask
from .scene import Scene
from .setups import shared, watched
from .surface_measures import enclosed_volumes
from .surface_model import linear_solver, scaled, solve_surface

if TYPE_CHECKING:
    from fem_reference.condensed import CondensedProblem
    from fem_reference.linear import LinearProblem
    from fem_reference.loads import Load as FemLoad
    from fem_reference.solution import Solution as FemSolution
    from vdm.solution import Solution as VdmSolution
    from vdm.solvers.linear import LinearSolver

    Solution = FemSolution | VdmSolution
    Solve = Callable[[Scene, str, str], Solution]
    Together = Callable[[Sequence[Scene], str], Sequence[Solution]]
    Onward = Callable[[Scene, str, dict[str, Any]], Solution]


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
    together : (scenes that differ in their loads only, solver), all in one; None where that saves nothing
    onward : (scene, solver, what it left of the last) -> Solution of full load alone, from loads below that it
        has solved of scenes that differ in one rising load only; None where that saves nothing
    """

    name: str
    version: str
    volumetric: bool
    solvers: tuple[str, ...]
    solve: Solve
    together: Together | None = None
    onward: Onward | None = None


MODELS: dict[str, Model] = {}
REFUSED = "refused"  # status of a model that could not be set up: before any solve, for a reason of the input


def _model(
    name: str,
    *,
    version: str,
    solvers: tuple[str, ...] = ("linear",),
    volumetric: bool = False,
    together: Together | None = None,
    onward: Onward | None = None,
) -> Callable[[Solve], Solve]:
    def register(solve: Solve) -> Solve:
        MODELS[name] = Model(name, version, volumetric, solvers, solve, together, onward)
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


def most_nodes(name: str) -> int | None:
    """Surface nodes beyond which a model refuses a mesh, whatever else; None where it has no such limit."""
    if find(name)[0].name != "mass-spring":
        return None
    from vdm.formulations.mass_spring import MAX_NODES

    return MAX_NODES


def moduli_by_rule(name: str) -> tuple[str, ...]:
    """Which moduli a surface model takes from the tissue where a study does not set them."""
    from vdm.material import RULED

    return RULED[find(name)[0].name.removeprefix("vdm-")]


def knows_fibres(name: str) -> bool:
    """Whether a model solves a body with fibres, or refuses it."""
    from vdm.material import ISOTROPIC

    return find(name)[0].name.removeprefix("vdm-") not in ISOTROPIC


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


# MINRES needs a symmetric matrix, which the printed form has not
_model("vdm-paper", version="4", solvers=tuple(name for name in VDM_SOLVERS if name != "minres"))(
    solve_surface
)
_model("vdm-consistent", version="5", solvers=VDM_SOLVERS)(solve_surface)
_model("vdm-vector", version="8", solvers=VDM_SOLVERS)(solve_surface)
_model("vdm-boundary", version="11", solvers=("linear", "nonlinear"))(solve_surface)
_model("mass-spring", version="6", solvers=VDM_SOLVERS)(solve_surface)


_ELEMENTS = {"fem-linear": "P2-P1", "fem-p1": "P1", "fem-p2": "P2"}
# scikit-fem's own assembly and a general LU factor: what the fast path is held to
PLAIN = "plain"


def _fem_small_strain(scenes: Sequence[Scene], solver: str, name: str) -> list[FemSolution]:
    """One factorisation, and on the fast path one batch of right-hand sides, for the loads of all scenes."""
    if solver == PLAIN:
        from fem_reference.plain_linear import PlainLinearProblem

        problem = shared(PlainLinearProblem, **_body(scenes[0]))
        return [problem.solve(_fem_loads(scene)) for scene in scenes]
    loads = [load for scene in scenes for load in _fem_loads(scene)]
    whole = _linear_problem(scenes[0], name, loads).solve(loads, _asked(scenes[0]))
    ends = np.cumsum([len(scene.load_factors) for scene in scenes]).tolist()
    return [_part(whole, slice(*ends)) for ends in zip([0, *ends], ends, strict=False)]


def _linear_problem(scene: Scene, name: str, loads: Sequence[FemLoad]) -> LinearProblem:
    from fem_reference.linear import LinearProblem
    from fem_reference.loads import independent_loads

    n_solves = len(independent_loads(loads)[0])
    return shared(LinearProblem, **_body(scene), element=_ELEMENTS[name], expected_loads=n_solves)


def _asked(scene: Scene, *outputs: str) -> frozenset[str]:
    """Further outputs of a volumetric model."""
    return frozenset({*outputs, "condition_estimate"} if scene.condition else outputs)


def _part(solution: FemSolution, steps: slice) -> FemSolution:
    """Some steps of a solution."""
    arrays = ("displacement", "fluid_pressure", "reaction_force", "energy", "iterations", "seconds_per_step")
    return dataclasses.replace(
        solution,
        **{name: getattr(solution, name)[steps] for name in (*arrays, "status")},
        scalars={name: values[steps] for name, values in solution.scalars.items()},
    )


@_model(
    "fem-linear",
    version="3",
    volumetric=True,
    solvers=("linear", PLAIN),
    together=partial(_fem_small_strain, name="fem-linear"),
)
def _fem_linear(scene: Scene, solver: str, name: str) -> FemSolution:  # noqa: ARG001
    return _fem_small_strain([scene], solver, "fem-linear")[0]


@_model("fem-p1", version="2", volumetric=True, together=partial(_fem_small_strain, name="fem-p1"))
def _fem_p1(scene: Scene, solver: str, name: str) -> FemSolution:  # noqa: ARG001
    return _fem_small_strain([scene], solver, "fem-p1")[0]


@_model("fem-p2", version="2", volumetric=True, together=partial(_fem_small_strain, name="fem-p2"))
def _fem_p2(scene: Scene, solver: str, name: str) -> FemSolution:  # noqa: ARG001
    return _fem_small_strain([scene], solver, "fem-p2")[0]


@_model("fem-condensed", version="4", volumetric=True)
def _fem_condensed(scene: Scene, solver: str, name: str) -> FemSolution:  # noqa: ARG001
    return _condensed_problem(scene).solve(_fem_loads(scene), _asked(scene))


def _condensed_problem(scene: Scene) -> CondensedProblem:
    body = _body(scene)
    if not scene.gravity.any():
        body["density"] = 0.0  # no columns for a weight that does not act
    # one motion of held nodes, in units of its largest component: cases that move them further, or back, share it
    largest = scene.prescribed.flat[np.abs(scene.prescribed).argmax()]
    # 0.0 is added because -0.0 would be another content
    motions = scene.prescribed[None] / largest + 0.0 if largest else np.zeros((0, *scene.prescribed.shape))
    return shared(_condensed_set_up, contact=scene.contact, motions=motions, **body)


def _condensed_set_up(*, contact: Mask, motions: Array, **body: Any) -> CondensedProblem:
    from fem_reference.condensed import CondensedProblem
    from fem_reference.linear import LinearProblem

    n_columns = 12 * int(contact.sum())  # three components at the vertices and three edge middles each
    problem = shared(LinearProblem, **body, expected_loads=n_columns + len(motions))
    return CondensedProblem(problem, contact, motions=motions)


@_model("fem-coarse", version="4", volumetric=True)
def _fem_coarse(scene: Scene, solver: str, name: str) -> FemSolution:  # noqa: ARG001
    from .meshing.coarse import solve_coarse

    return solve_coarse(scene)


def _fem_onward(scene: Scene, solver: str, known: dict[str, Any]) -> FemSolution:
    from fem_reference.finite_strain import FiniteStrainProblem
    from fem_reference.walk import Walk

    if solver == PLAIN:
        return _fem_plain(scene, _fem_loads(scene)[-1:])
    if not known:
        known.update(problem=FiniteStrainProblem(**_finite_strain(scene)), walk=Walk())
    problem: FiniteStrainProblem = known["problem"]
    return problem.solve(_fem_loads(scene)[-1:], _asked(scene, *_LARGEST), known["walk"])


@_model("fem", version="2", volumetric=True, solvers=("linear", PLAIN), onward=_fem_onward)
def _fem(scene: Scene, solver: str, name: str) -> FemSolution:  # noqa: ARG001
    from fem_reference.finite_strain import FiniteStrainProblem

    if solver == PLAIN:
        return _fem_plain(scene, _fem_loads(scene))
    return FiniteStrainProblem(**_finite_strain(scene)).solve(_fem_loads(scene), _asked(scene, *_LARGEST))


_LARGEST = ("max_det_f_deviation", "max_principal_strain")


def _finite_strain(scene: Scene) -> dict[str, Any]:
    return {**_body(scene), "material": _material(scene), "expected_loads": len(scene.load_factors)}


def _fem_plain(scene: Scene, loads: Sequence[FemLoad]) -> FemSolution:
    from fem_reference.plain_finite_strain import PlainFiniteStrainProblem

    problem = PlainFiniteStrainProblem(**_body(scene), material=_material(scene))
    return problem.solve(loads, frozenset(_LARGEST))


def _material(scene: Scene) -> str:
    return "transversely-isotropic" if scene.anisotropy else "neo-hookean"


def _body(scene: Scene) -> dict[str, Any]:
    """What every volumetric model is built from."""
    mesh, tissue, fibres = scene.mesh, scene.tissue, scene.anisotropy
    return {
        "points": mesh.points,
        "tetrahedra": mesh.tetrahedra,
        "surface_nodes": mesh.surface_nodes,
        "triangles": mesh.triangles,
        "youngs_modulus": tissue.youngs_modulus,
        "poisson_ratio": tissue.poisson_ratio,
        "density": tissue.density,
        "held": scene.held,
        **({"fibre_direction": fibres.fibre_direction, "contrast": fibres.contrast} if fibres else {}),
    }


def _fem_loads(scene: Scene) -> list[FemLoad]:
    from fem_reference.loads import Load

    return [Load(f * scene.facet_pressure, f * scene.prescribed, scene.gravity) for f in scene.load_factors]


def scales(name: str) -> bool:
    """Whether a surface model's result for a multiple of a load is the multiple of its result."""
    model, solver = find(name)
    return not model.volumetric and solver == "linear"


def pressure_problem(scene: Scene, name: str) -> LinearSolver | LinearProblem | CondensedProblem | None:
    """What answers contact pressures linearly, set up as a solve of the model does; None where nothing does."""
    model, solver = find(name)
    if model.name == "fem-condensed":
        return _condensed_problem(scene)
    if model.name in _ELEMENTS and solver != PLAIN:
        return _linear_problem(scene, model.name, _fem_loads(scene))
    return linear_solver(scene, name) if scales(name) else None


def run_model(scene: Scene, name: str, known: dict[str, Any] | None = None) -> ModelResult:
    """Solve one scene with one model and measure what it took.

    A model that cannot be set up gives a result of NaN with the reason in its status: the other models of the
    case are not affected. A set-up that an earlier solve left (`studies.setups`) is reported with the time and
    memory that were measured then, and marked by the parameter `setup_shared`. Where the surface model just solved
    a scene of which this one's loads are a multiple, so is its result (`studies.proportional`): the parameter
    `steps_scaled` marks it.

    Scenes that differ in one rising load only can be run with the same dictionary, empty at first: a model that
    goes to a load step by step then goes to the full one alone, from the largest below that it has solved.
    """
    model, solver = find(name)
    # what it may not depend on, as its results are shared between cases that differ there
    if model.volumetric:
        scene = dataclasses.replace(scene, parameters={}, environment_pressure=0.0)
    follows = scaled(scene, name) if scales(name) else None
    if follows is not None:
        return _result(scene, *follows, model, {"setup_shared": "yes", "steps_scaled": "yes"})
    onward = model.onward
    if known is not None and onward is not None:
        return _measured(model, [scene], lambda: [onward(scene, solver, known)])[0]
    return _measured(model, [scene], lambda: [model.solve(scene, solver, name)])[0]


def solves_together(name: str) -> bool:
    """Whether a model gains by solving many scenes at once."""
    return find(name)[0].together is not None


def run_together(scenes: Sequence[Scene], name: str) -> list[ModelResult]:
    """`run_model` for scenes that differ in their loads only: in one solve where the model can, else in turn."""
    model, solver = find(name)
    if len(scenes) == 1 or model.together is None:
        return [run_model(scene, name) for scene in scenes]
    together = model.together
    return _measured(model, scenes, lambda: together(scenes, solver))


def _measured(
    model: Model, scenes: Sequence[Scene], solve: Callable[[], Sequence[Solution]]
) -> list[ModelResult]:
    """What a solve gives, one result per scene, with its peak of memory."""
    resident = reset_peak()
    try:
        with watched() as setups:
            solutions = solve()
    except ValueError as error:  # the sentence of a surface, parameter, support or solver that does not work
        status = getattr(error, "status", None)
        message, remedy = (status.message, status.remedy) if status else (f"{error}", "")
        return [_failed(scene, model, StepStatus(REFUSED, message, remedy)) for scene in scenes]
    peak = max([peak_bytes_since(resident), *(setup.peak_bytes for setup in setups)])
    for setup in setups:
        setup.peak_bytes = peak
    mark: dict[str, float | str] = {}
    if len(scenes) > 1 or any(setup.uses > 1 for setup in setups):
        mark["setup_shared"] = "yes"
    return [_result(*pair, peak, model, mark) for pair in zip(scenes, solutions, strict=True)]


def _result(
    scene: Scene, solution: Solution, peak_bytes: int, model: Model, mark: dict[str, float | str]
) -> ModelResult:
    statuses = tuple(StepStatus(s.code, s.message, s.remedy) for s in solution.status)
    usable = np.array([s.ok for s in statuses])
    displacement = np.where(usable[:, None, None], solution.displacement, np.nan)
    points, triangles = scene.mesh.surface_points, scene.mesh.triangles
    return ModelResult(
        displacement=displacement,
        fluid_pressure=np.where(usable, solution.fluid_pressure, np.nan),
        reaction_force=np.where(usable[:, None, None], solution.reaction_force, np.nan),
        energy=np.where(usable, solution.energy, np.nan),
        volume=enclosed_volumes(points + displacement, triangles),
        iterations=solution.iterations,
        status=statuses,
        seconds_setup=solution.seconds_setup,
        seconds_per_step=solution.seconds_per_step,
        peak_bytes=peak_bytes,
        version=model.version,
        parameters={**solution.parameters, **mark},
        scalars=solution.scalars,
    )


def _failed(scene: Scene, model: Model, reason: StepStatus) -> ModelResult:
    n_steps = len(scene.load_factors)
    vectors = np.full((n_steps, len(scene.fixed), 3), np.nan)
    numbers = np.full(n_steps, np.nan)
    return ModelResult(
        displacement=vectors,
        fluid_pressure=numbers,
        reaction_force=vectors,
        energy=numbers,
        volume=numbers,
        iterations=np.zeros(n_steps, dtype=np.int64),
        status=(reason,) * n_steps,
        seconds_setup=np.nan,
        seconds_per_step=numbers,
        peak_bytes=0,
        version=model.version,
    )
