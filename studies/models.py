"""The registry of models: name -> what answers load steps. The only place that knows both solver packages.

A model declares all that a study, a plan and a report need to know of it: what it reads decides its content keys,
what superposes is combined instead of solved. Solver packages are imported inside, so that naming models costs
nothing.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from .case import ModelResult, StepStatus
from .memory import peak_bytes_since, reset_peak
from .model_name import reads, split
from .scene import Scene, SurfaceLoad
from .surface_measures import enclosed_volumes
from .surface_model import prepare_surface

if TYPE_CHECKING:
    from fem_reference.condensed import CondensedProblem
    from fem_reference.linear import LinearProblem
    from fem_reference.loads import Load as FemLoad
    from fem_reference.solution import Solution as FemSolution
    from vdm.solution import Solution as VdmSolution
    from vdm.solvers.linear import LinearSolver

    Solution = FemSolution | VdmSolution
    PressureProblem = LinearSolver | LinearProblem | CondensedProblem


@dataclass(frozen=True)
class SetUp:
    """A model made ready for a body: its operators and factors.

    Attributes
    ----------
    solve : load steps -> Solution; the steps are independent where the model superposes, else one load path
    problem : what answers contact pressures linearly; None where nothing does
    """

    solve: Callable[[Sequence[SurfaceLoad]], Solution]
    problem: PressureProblem | None = None


class Prepare(Protocol):
    """Sets a model up on the body of a scene, for about so many load steps. Raises ValueError with a sentence."""

    def __call__(self, scene: Scene, solver: str, name: str, n_loads: int) -> SetUp: ...


@dataclass(frozen=True, kw_only=True)
class Model:
    """A model of the registry.

    Attributes
    ----------
    name : what a study writes, without the solver
    version : raised whenever its numbers change; part of every key
    prepare : sets it up
    volumetric : whether it needs tetrahedra
    solvers : the solvers it offers, the default first
    superposes : of these the ones whose answers to loads superpose
    tissue : keys of [tissue] that it reads, the density apart, which all read where a weight acts
    parameters : keys of [vdm] and of its own table that it reads
    fibres : whether it solves a body with fibres, or refuses it
    contact_in_setup : whether its set-up depends on where the body is touched and how it is moved
    continues : set up for loads of one rising path, each solved from the last: as `prepare`; None where it cannot
    """

    name: str
    version: str
    prepare: Prepare
    volumetric: bool
    solvers: tuple[str, ...]
    superposes: tuple[str, ...]
    tissue: tuple[str, ...]
    parameters: tuple[str, ...]
    fibres: bool
    contact_in_setup: bool = False
    continues: Prepare | None = None


MODELS: dict[str, Model] = {}
REFUSED = "refused"  # status of a model that could not be set up: before any solve, for a reason of the input


def register(model: Model) -> None:
    """Add a model.

    Raises
    ------
    ValueError
        a name that is taken, or a declaration that does not fit together.
    """
    if model.name in MODELS:
        raise ValueError(f"a model {model.name!r} is registered already")
    if not model.version or not model.solvers or not set(model.superposes) <= set(model.solvers):
        raise ValueError(
            f"{model.name}: a model needs a version, a solver, and superposes by its own solvers only"
        )
    MODELS[model.name] = model


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
    return find(name)[0].fibres


_surface = partial(
    Model, prepare=prepare_surface, volumetric=False, superposes=("linear",), tissue=("youngs_modulus",)
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
for _model in (
    _surface(
        name="vdm-paper",
        version="4",
        # MINRES needs a symmetric matrix, which the printed form has not
        solvers=tuple(name for name in VDM_SOLVERS if name != "minres"),
        parameters=reads("vdm-paper"),
        fibres=True,
    ),
    _surface(
        name="vdm-consistent",
        version="5",
        solvers=VDM_SOLVERS,
        parameters=reads("vdm-consistent"),
        fibres=True,
    ),
    _surface(
        name="vdm-vector", version="8", solvers=VDM_SOLVERS, parameters=reads("vdm-vector"), fibres=True
    ),
    _surface(
        name="vdm-boundary",
        version="12",
        solvers=("linear", "nonlinear"),
        tissue=("youngs_modulus", "poisson_ratio"),
        parameters=reads("vdm-boundary"),
        fibres=False,
    ),
    _surface(
        name="mass-spring", version="6", solvers=VDM_SOLVERS, parameters=reads("mass-spring"), fibres=False
    ),
):
    register(_model)

# scikit-fem's own assembly and a general LU factor: what the fast path is held to
PLAIN = "plain"
_ELEMENTS = {"fem-linear": "P2-P1", "fem-p1": "P1", "fem-p2": "P2"}
_LARGEST = ("max_det_f_deviation", "max_principal_strain")


def _small_strain(scene: Scene, solver: str, name: str, n_loads: int) -> SetUp:
    """One factorisation, and on the fast path the loads that are independent in one batch of right-hand sides."""
    if solver == PLAIN:
        from fem_reference.plain_linear import PlainLinearProblem

        plain = PlainLinearProblem(**_body(scene))
        return SetUp(lambda loads: plain.solve(_fem_loads(loads)))
    from fem_reference.linear import LinearProblem

    problem = LinearProblem(**_body(scene), element=_ELEMENTS[split(name)[0]], expected_loads=n_loads)
    return SetUp(lambda loads: problem.solve(_fem_loads(loads), _asked(scene)), problem)


def _condensed(scene: Scene, solver: str, name: str, n_loads: int) -> SetUp:  # noqa: ARG001
    from fem_reference.condensed import CondensedProblem
    from fem_reference.linear import LinearProblem

    body = _body(scene)
    if not scene.gravity.any():
        body["density"] = 0.0  # no columns for a weight that does not act
    # one motion of held nodes, in units of its largest component
    largest = scene.prescribed.flat[np.abs(scene.prescribed).argmax()]
    motions = scene.prescribed[None] / largest if largest else np.zeros((0, *scene.prescribed.shape))
    n_columns = 12 * int(scene.contact.sum())  # three components at the vertices and three edge middles each
    whole = LinearProblem(**body, expected_loads=n_columns + len(motions))
    problem = CondensedProblem(whole, scene.contact, motions=motions)
    return SetUp(lambda loads: problem.solve(_fem_loads(loads), _asked(scene)), problem)


def _coarse(scene: Scene, solver: str, name: str, n_loads: int) -> SetUp:  # noqa: ARG001
    from .meshing.coarse import CoarseProblem

    return SetUp(CoarseProblem(scene, n_loads).solve)


def _finite_strain(scene: Scene, solver: str, name: str, n_loads: int) -> SetUp:  # noqa: ARG001
    if solver == PLAIN:
        from fem_reference.plain_finite_strain import PlainFiniteStrainProblem

        plain = PlainFiniteStrainProblem(**_body(scene), material=_material(scene))
        return SetUp(lambda loads: plain.solve(_fem_loads(loads), frozenset(_LARGEST)))
    from fem_reference.finite_strain import FiniteStrainProblem

    problem = FiniteStrainProblem(**_neo_hookean(scene, n_loads))
    return SetUp(lambda loads: problem.solve(_fem_loads(loads), _asked(scene, *_LARGEST)))


def _finite_strain_onward(scene: Scene, solver: str, name: str, n_loads: int) -> SetUp:
    if solver == PLAIN:
        return _finite_strain(scene, solver, name, n_loads)
    from fem_reference.finite_strain import FiniteStrainProblem
    from fem_reference.load_path import LoadPath

    problem, path = FiniteStrainProblem(**_neo_hookean(scene, n_loads)), LoadPath()
    return SetUp(lambda loads: problem.solve(_fem_loads(loads), _asked(scene, *_LARGEST), path))


def _neo_hookean(scene: Scene, n_loads: int) -> dict[str, Any]:
    return {**_body(scene), "material": _material(scene), "expected_loads": n_loads}


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


def _fem_loads(loads: Sequence[SurfaceLoad]) -> list[FemLoad]:
    from fem_reference.loads import Load

    return [Load(load.facet_pressure, load.prescribed, load.gravity) for load in loads]


def _asked(scene: Scene, *outputs: str) -> frozenset[str]:
    """Further outputs of a volumetric model."""
    return frozenset({*outputs, "condition_estimate"} if scene.condition else outputs)


_elements = partial(
    Model,
    volumetric=True,
    solvers=("linear",),
    superposes=("linear",),
    tissue=("youngs_modulus", "poisson_ratio"),
    parameters=(),
    fibres=True,
)
for _model in (
    _elements(
        name="fem-linear",
        version="3",
        prepare=_small_strain,
        solvers=("linear", PLAIN),
        superposes=("linear", PLAIN),
    ),
    _elements(name="fem-p1", version="2", prepare=_small_strain),
    _elements(name="fem-p2", version="2", prepare=_small_strain),
    _elements(name="fem-condensed", version="4", prepare=_condensed, contact_in_setup=True),
    _elements(name="fem-coarse", version="4", prepare=_coarse),
    _elements(
        name="fem",
        version="2",
        prepare=_finite_strain,
        solvers=("linear", PLAIN),
        superposes=(),
        continues=_finite_strain_onward,
    ),
):
    register(_model)


def superposes(name: str, *, penalty: bool = False) -> bool:
    """Whether a model's answers to loads superpose; a penalty leaves more rounding than that may have."""
    model, solver = find(name)
    return solver in model.superposes and not penalty


class Prepared:
    """A model set up on the body of a scene, with what its set-up took; it answers load steps as results.

    A model that cannot be set up answers with NaN and the reason in its status: other models are not affected.
    """

    def __init__(self, scene: Scene, name: str, n_loads: int = 1, *, onward: bool = False) -> None:
        self.model, solver = find(name)
        if (
            self.model.volumetric
        ):  # what it may not depend on, as its answers are shared between cases that differ there
            scene = dataclasses.replace(scene, parameters={}, environment_pressure=0.0)
        self._scene = scene
        self._resident = reset_peak()
        self.set_up: SetUp | None = None
        prepare = (self.model.continues if onward else None) or self.model.prepare
        try:
            self.set_up = prepare(scene, solver, name, n_loads)
        except (
            ValueError
        ) as error:  # the sentence of a surface, parameter, support or solver that does not work
            self._refusal = _refusal(error)

    def answer(self, loads: Sequence[SurfaceLoad]) -> ModelResult:
        """The result of some load steps: one load path, or independent of each other where the model superposes."""
        if self.set_up is None:
            return _failed(self._scene, self.model, self._refusal, len(loads))
        try:
            solution = self.set_up.solve(loads)
        except ValueError as error:
            return _failed(self._scene, self.model, _refusal(error), len(loads))
        return _result(self._scene, solution, peak_bytes_since(self._resident), self.model)


def run_model(scene: Scene, name: str) -> ModelResult:
    """Solve one scene with one model and measure what it took."""
    return Prepared(scene, name, len(scene.load_factors)).answer(scene.loads)


def _refusal(error: ValueError) -> StepStatus:
    status = getattr(error, "status", None)
    message, remedy = (status.message, status.remedy) if status else (f"{error}", "")
    return StepStatus(REFUSED, message, remedy)


def _result(scene: Scene, solution: Solution, peak_bytes: int, model: Model) -> ModelResult:
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
        parameters=solution.parameters,
        scalars=solution.scalars,
    )


def _failed(scene: Scene, model: Model, reason: StepStatus, n_steps: int) -> ModelResult:
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
