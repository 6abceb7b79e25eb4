"""The entry of the library: a surface, its material and supports, solved over a history of loads."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from solver_common.arrays import Array
from vdm.bending import bending_error
from vdm.constraints import (
    CONTACT_SIGNS,
    ConstraintError,
    ContactSign,
    Load,
    Support,
    check_apart,
    checked_load,
    hydrostatic_pressure,
    node_mask,
)
from vdm.formulations.base import Formulation
from vdm.formulations.consistent import ConsistentFormulation
from vdm.formulations.paper import PaperFormulation
from vdm.formulations.vector import VectorFormulation
from vdm.material import ParameterError, Parameters
from vdm.mesh_error import MeshError
from vdm.parts.cut import Cut
from vdm.parts.lumps import LumpyFormulation
from vdm.parts.solve import PartsSolver
from vdm.peers.bem import BoundaryFormulation
from vdm.peers.bem_sparse import SparseFormulation
from vdm.peers.mass_spring import MassSpringFormulation
from vdm.problem import Problem, Step, check_held
from vdm.reservations import reserved
from vdm.solution import Solution, SolverError, Status
from vdm.solvers import FIGURE_8, SOLVERS
from vdm.solvers.audit import Audit, judged
from vdm.solvers.bicg import TOLERANCE, BicgSolver
from vdm.solvers.condition import Condition, condition_of_matrix, condition_of_operator
from vdm.solvers.figure_8 import STOPS, Figure8Solver, Stop
from vdm.solvers.linear import BorderedFactor, LinearSolver
from vdm.solvers.lu import CONSTRAINT_METHODS, ConstraintMethod, LuSolver
from vdm.solvers.nonlinear import DeformedStep, NonlinearSolver
from vdm.solvers.quasi_linear import VOLUME_ROWS, QuasiLinearSolver, VolumeRow
from vdm.surface import SurfaceMesh


class Solver(Protocol):
    """Solves one load after another."""

    def step(self, load: Load, previous: Step | None = None) -> Step:
        """Solution of one load, started from the previous step where that helps."""
        ...

    def audited(self, load: Load, step: Step) -> tuple[Step, Audit]:
        """The step, refined where the solver can, and its audit."""
        ...


FactorSolver = LinearSolver | QuasiLinearSolver | NonlinearSolver | PartsSolver
FORMULATIONS: dict[str, type[Formulation]] = {
    cls.name: cls
    for cls in (
        PaperFormulation,
        ConsistentFormulation,
        VectorFormulation,
        BoundaryFormulation,
        SparseFormulation,
        MassSpringFormulation,
    )
}


class Model:
    """A fluid-filled body: assembles and factors once, then solves any number of loads.

    Parameters
    ----------
    points : (N, 3) coordinates [m]
    triangles : (F, 3) outward facets
    parameters : the formulation's material, or a rule that gives it for the surface; `Solution.seconds_setup`
        then includes the rule's time
    formulation : a key of `FORMULATIONS`
    fixed, constrained : (N,) masks of nodes that are held or moved by `Load.prescribed`
    density : of the fluid [kg/m^3]
    gravity : (3,) [m/s^2], constant over the history like the environment's pressure
    environment_pressure : P_ep [Pa]
    solver : one of `vdm.solvers.SOLVERS`, or of the printed form "figure-8"
    contact_sign : "inward", or "printed" for the sign of equation 24
    constraint_method : "elimination", or one of the paper's two penalties (solver "lu")
    penalty : alpha over the largest diagonal entry of the state matrix
    volume_row : "corrected", the default of quasi-linear, or "printed" as in equation 33, the default of
        figure-8; no other solver reads it
    stop : of figure-8: the rule that ends an iteration, see `vdm.solvers.figure_8`; "printed" by default
    tolerance : of the iterative solvers: residual over the right-hand side
    cut : of boundary elements at large displacements: the parts of the body; None for as many as it needs

    Raises
    ------
    ValueError
        `SurfaceError`, `ParameterError`, `ConstraintError` or `SolverError`, each with what to change.
    """

    def __init__(
        self,
        points: ArrayLike,
        triangles: ArrayLike,
        parameters: Parameters | Callable[[SurfaceMesh], Parameters],
        *,
        formulation: str = "paper",
        fixed: ArrayLike | None = None,
        constrained: ArrayLike | None = None,
        density: float = 0.0,
        gravity: ArrayLike = (0.0, 0.0, 0.0),
        environment_pressure: float = 0.0,
        solver: str = "linear",
        contact_sign: ContactSign = "inward",
        constraint_method: ConstraintMethod = "elimination",
        penalty: float = 1e8,
        volume_row: VolumeRow | None = None,
        stop: Stop | None = None,
        tolerance: float = TOLERANCE,
        cut: Cut | None = None,
    ) -> None:
        start = time.perf_counter()
        _check_choices(formulation, solver, constraint_method, contact_sign, volume_row, stop, tolerance)
        if not np.isfinite(environment_pressure):
            raise ConstraintError(f"environment_pressure must be finite, not {environment_pressure}")
        self.surface = SurfaceMesh(points, triangles)
        if not isinstance(parameters, Parameters):
            parameters = parameters(self.surface)
        at_large = solver in ("nonlinear", "quasi-linear")
        if formulation in ("bem", "bem-sparse") and solver == "quasi-linear" and not parameters.is_filled:
            raise ParameterError(
                "the quasi-linear solver needs a fluid that keeps the volume, not a Poisson's ratio of"
                f" {parameters.poisson_ratio:g}; take the nonlinear solver"
            )
        if parameters.lumps is not None and (formulation != "bem" or at_large):
            raise ParameterError("lumps inside need the bem formulation and a linear solver")
        if self.surface.shells.any() and formulation != "bem":
            raise ParameterError(f"the {formulation} formulation knows no cavities; take bem")
        if parameters.tension_stiffening and (formulation, solver) != ("paper", "nonlinear"):
            raise ParameterError("tension_stiffening needs the paper formulation and the nonlinear solver")
        n_nodes = self.surface.n_nodes
        hydrostatic = hydrostatic_pressure(self.surface, density, gravity)
        support = Support(
            fixed=node_mask(fixed, "fixed", n_nodes),
            constrained=node_mask(constrained, "constrained", n_nodes),
            hydrostatic=hydrostatic,
            density=float(density),
            gravity=None if hydrostatic is None else np.asarray(gravity, dtype=np.float64),
            environment_pressure=float(environment_pressure),
            contact_sign=contact_sign,
        )
        check_apart(support)
        form: type[Formulation] = (
            LumpyFormulation if parameters.lumps is not None else FORMULATIONS[formulation]
        )
        check_held(form, self.surface, parameters, support.held)
        compiling = time.perf_counter()
        form.compile(self.surface, parameters)
        start += time.perf_counter() - compiling
        self.formulation = form.supported(self.surface, parameters, support.held)
        self.problem = Problem(self.formulation, support)
        self.solver_name = solver
        self.solver: Solver
        self.solver = _make_solver(
            solver, self.problem, constraint_method, penalty, volume_row, stop, tolerance, cut
        )
        self.seconds_setup = time.perf_counter() - start
        self._judged: Problem | None = None
        self._mesh_error: MeshError | None = None
        self._is_warm = False

    def solve(self, loads: Sequence[Load], condition: bool = False) -> Solution:
        """One step per load.

        `fluid_pressure` is dP + P_ep at the datum, the highest surface point along gravity (17).

        `scalars` holds, for each step:

        - `relative_residual`, from an audit of each step. Where the step is not reliable, its status is not
          converged.
        - `path_error`, with the quasi-linear solver: the effect of the load steps on the way, over the largest
          displacement so far. Beyond 1e-3 the status is still converged, with a message and a remedy.
        - `load_factor`, where a step of the nonlinear solver failed: the share of the way to the step that was
          reached. The step holds the last state on that way.
        - `mesh_error`, of a form of boundary integrals: the error of its mesh; at large rotations also
          `shape_error` (see `vdm.mesh_error`).
        - `condition_estimate`, with `condition`: that of the whole system, the same for all steps, from the
          method of that name.

        A body in parts is cut into twice as many where its answers require it, and solved again; that time counts
        as set-up.

        Raises
        ------
        ConstraintError
            a load that does not fit the surface.
        """
        if isinstance(loads, Load):
            raise ConstraintError(
                "solve takes a list of loads, one per step; for a single one: solve([load])"
            )
        loads = [checked_load(load, self.problem.support) for load in loads]
        if not isinstance(self.solver, PartsSolver) or not loads:
            return self._history(loads, condition)
        start = time.perf_counter()
        chosen = self.solver.prepare(loads)
        found = self._history(loads, condition)
        while self.solver.doubled(found):
            chosen = time.perf_counter() - start
            found = self._history(loads, condition)
        return replace(found, seconds_setup=self.seconds_setup + chosen)

    def _history(self, loads: Sequence[Load], condition: bool) -> Solution:
        count, n_nodes = len(loads), self.surface.n_nodes
        displacement, reaction_force = (np.empty((count, n_nodes, 3)) for _ in range(2))
        pressure, energy, seconds, residual, path_error, mesh_error = (np.empty(count) for _ in range(6))
        shape_error = np.empty(count)
        iterations = np.empty(count, dtype=np.int64)
        status: list[Status] = []
        told: list[dict[str, float]] = []
        reached = np.ones(count)
        last: Step | None = None
        self._warm_up(loads)
        bending = self.bending_error
        for k, load in enumerate(loads):
            start = time.perf_counter()
            solved = self.solver.step(load, last)
            # evaluated here: a solution holds them, and their time counts
            displacement[k], reaction_force[k], energy[k] = _results(solved)
            seconds[k] = time.perf_counter() - start
            step, found = self.solver.audited(load, solved)
            if step.unknown is not solved.unknown:
                # a frame needs no audit, unless the audit corrected it
                displacement[k], reaction_force[k], energy[k] = _results(step)
                seconds[k] = time.perf_counter() - start
            last = judged(step, found)
            if isinstance(step, DeformedStep):
                reached[k] = step.reached
            pressure[k], iterations[k], residual[k] = step.pressure_change, step.iterations, found.residual
            path_error[k], (mesh_error[k], shape_error[k]) = found.path, self._of_mesh(load, step)
            told.append(self.solver.scalars(step) if isinstance(self.solver, PartsSolver) else {})
            apart = told[-1].get("parts_error", np.nan)
            errors = (bending, mesh_error[k], self._solved.formulation, apart, shape_error[k])
            status.append(reserved(last.status, *errors))
        return Solution(
            displacement=displacement,
            fluid_pressure=pressure + self.problem.support.environment_pressure,
            reaction_force=reaction_force,
            energy=energy,
            iterations=iterations,
            status=tuple(status),
            seconds_setup=self.seconds_setup,
            seconds_per_step=seconds,
            parameters=self._record(),
            scalars={
                "relative_residual": residual,
                **({"load_factor": reached} if (reached < 1.0).any() else {}),
                **({} if np.isnan(path_error).all() else {"path_error": path_error}),
                **({} if np.isnan(mesh_error).all() else {"mesh_error": mesh_error}),
                **({} if np.isnan(shape_error).all() else {"shape_error": shape_error}),
                **{name: np.array([one.get(name, np.nan) for one in told]) for name in _names(told)},
                **(self.condition_scalars(count) if condition else {}),
            },
            part_of_node=self.solver.part_of_node if isinstance(self.solver, PartsSolver) else None,
        )

    @property
    def _solved(self) -> Problem:
        """The problem at small displacements; for a body in parts that of its parts."""
        return self.solver.problem if isinstance(self.solver, PartsSolver) else self.problem

    @property
    def bending_error(self) -> float:
        """Error of the form under known bendings. Its time counts neither as set-up nor as a step, like an audit's.

        It uses the solver's factor, or its own where there is none; NaN where no factor exists.
        """
        if self._judged is not self._solved:
            self._judged, self._mesh_error = self._solved, None
            try:
                known = self.solver.factor if isinstance(self.solver, FactorSolver) else None
                self._bending_error = bending_error(self._solved, known or BorderedFactor(self.problem))
            except SolverError:
                self._bending_error = np.nan
        return self._bending_error

    def _of_mesh(self, load: Load, step: Step) -> tuple[float, float]:
        """Errors of the mesh at the load that a step reached, see `vdm.mesh_error`; NaN for other forms."""
        form = self._solved.formulation
        if not isinstance(form, BoundaryFormulation) or not isinstance(self.solver, FactorSolver):
            return np.nan, np.nan
        if self._mesh_error is None:
            self._mesh_error = MeshError(self._solved, self.solver.factor)
        linear = step if isinstance(self.solver, LinearSolver) else None
        if isinstance(step, DeformedStep) and step.balance is not None:
            load = step.balance.load
        return self._mesh_error.of(load, linear, shape=isinstance(self.solver, PartsSolver))

    def _warm_up(self, loads: Sequence[Load]) -> None:
        """Solve one frame that is not timed: the first one after a set-up takes several times as long as others.

        Only for the linear solver, whose frame costs next to nothing beside the set-up.
        """
        if loads and not self._is_warm and isinstance(self.solver, LinearSolver):
            _results(self.solver.step(loads[0]))
            self._is_warm = True

    def condition_estimate(self) -> Condition:
        """Condition of the system that the solver solves, see `vdm.solvers.condition`.

        For "lu" and "bicg" it is the state matrix in its printed units, with its penalty and before the scaling
        of "bicg"; for all others the symmetric operator at rest, scaled.

        Raises
        ------
        SolverError
            an operator that is singular in double precision, in which a solver in single precision has no factor.
        """
        solver, n_border = self.solver, self.formulation.columns.count
        if isinstance(solver, LuSolver):
            return condition_of_matrix(solver.solved_matrix(), n_border)
        if isinstance(solver, BicgSolver):
            return condition_of_matrix(solver.printed, n_border)
        if isinstance(solver, FactorSolver):
            single = isinstance(solver, LinearSolver) and solver.precision == "single"
            return condition_of_operator(self._solved, None if single else solver.factor)
        return condition_of_operator(self.problem)

    def condition_scalars(self, n_steps: int) -> dict[str, Array]:
        """`Solution.scalars` of the condition estimate, the same for all steps."""
        try:
            estimate = self.condition_estimate().system
        except SolverError as error:  # singular in double precision, which the solver itself did not notice
            estimate = np.inf if error.status.code == "singular" else np.nan
        return {"condition_estimate": np.full(n_steps, estimate)}

    def _record(self) -> dict[str, float | str]:
        formulation = self.formulation
        return {
            **formulation.record(),
            "solver": self.solver_name,
            "clamped_edges": float(self.surface.clamped_edges),
            **({} if np.isnan(self.bending_error) else {"bending_error": self.bending_error}),
        }


def _names(told: Sequence[dict[str, float]]) -> list[str]:
    """All names in the dictionaries, in order of first appearance."""
    return list(dict.fromkeys(name for one in told for name in one))


def _results(step: Step) -> tuple[Array, Array, float]:
    return step.displacement, step.reaction_force, step.energy


def _make_solver(
    name: str,
    problem: Problem,
    constraint_method: ConstraintMethod,
    penalty: float,
    volume_row: VolumeRow | None,
    stop: Stop | None,
    tolerance: float,
    cut: Cut | None,
) -> Solver:
    makers: dict[str, Callable[[], Solver]] = {
        "linear": lambda: LinearSolver(problem),
        "single": lambda: LinearSolver(problem, "single", refine=False),
        "refined": lambda: LinearSolver(problem, "single"),
        "lu": lambda: LuSolver(problem, constraint_method, penalty),
        "quasi-linear": lambda: QuasiLinearSolver(problem, volume_row or "corrected"),
        "nonlinear": lambda: (
            PartsSolver(problem, cut)
            if isinstance(problem.formulation, BoundaryFormulation)
            else NonlinearSolver(problem)
        ),
        "bicg": lambda: BicgSolver(problem, tolerance=tolerance),
        "bicg-cold": lambda: BicgSolver(problem, warm_start=False, tolerance=tolerance),
        FIGURE_8: lambda: Figure8Solver(problem, stop or "printed", volume_row or "printed", tolerance),
    }
    return makers[name]()


def _check_choices(
    formulation: str,
    solver: str,
    constraint_method: ConstraintMethod,
    contact_sign: ContactSign,
    volume_row: VolumeRow | None,
    stop: Stop | None,
    tolerance: float,
) -> None:
    for value, allowed, name in (
        (formulation, tuple(FORMULATIONS), "formulation"),
        (solver, (*SOLVERS, FIGURE_8), "solver"),
        (constraint_method, CONSTRAINT_METHODS, "constraint_method"),
        (contact_sign, CONTACT_SIGNS, "contact_sign"),
        *((row, VOLUME_ROWS, "volume_row") for row in (volume_row,) if row is not None),
        *((rule, STOPS, "stop") for rule in (stop,) if rule is not None),
    ):
        if value not in allowed:
            raise ParameterError(f"{name} must be one of {', '.join(allowed)}, not {value!r}")
    if not 0.0 < tolerance < 1.0:
        raise ParameterError(f"tolerance must lie between 0 and 1, not {tolerance}")
    if solver == FIGURE_8 and formulation != "paper":
        raise ParameterError("Figure 8 solves the printed matrix; take the paper formulation")
    if volume_row is not None and solver not in ("quasi-linear", FIGURE_8):
        raise ParameterError(
            f"volume_row is read by quasi-linear and {FIGURE_8}; the {solver} solver has none"
        )
    if stop is not None and solver != FIGURE_8:
        raise ParameterError(f"stop is read by {FIGURE_8}; the {solver} solver has none")
    if constraint_method != "elimination" and solver != "lu":
        raise ParameterError('a penalty needs solver "lu"; the other solvers eliminate held nodes exactly')
