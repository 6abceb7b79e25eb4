"""Sparse solvers for the scaled system, and the choice between them.

Method: LDL^T in single precision with iterative refinement, or GMRES with a block-triangular preconditioner. Order:
exact to the tolerance of each, 1e-9 and 1e-8 of the true residual, which is checked. Source: Higham, Accuracy and
Stability of Numerical Algorithms, chapter 12; Elman, Silvester and Wathen, Finite Elements and Fast Iterative
Solvers, chapter 4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from fem_reference.costs import Estimate, estimate_costs, faster_that_fits
from fem_reference.factorisation import LIBRARY, Analysis, pivotable_triangle
from fem_reference.krylov import gmres
from fem_reference.memory import allowed_memory, check_memory
from fem_reference.multigrid import BlockPreconditioner
from fem_reference.solution import SolverError
from fem_reference.system import LinearSystem
from solver_common.arrays import Array
from solver_common.solution import solver_error

Made = TypeVar("Made")
SOLVERS = ("auto", "direct", "iterative")
BATCH = 32  # right-hand sides per triangular solve: larger batches are no faster
# from this many loads on, a factor in double precision (twice the time and memory) pays: one solve and one residual
# per right-hand side instead of three
_MANY_LOADS = 8 * BATCH
DIRECT_TOLERANCE = 1e-9
ITERATIVE_TOLERANCE = 1e-8
_REFINED = 1e-12
_MAX_REFINEMENTS = 6
# GMRES stops below the promised tolerance: reactions balance the load only as well as the residual
_GMRES_TARGET = 1e-9
_MAX_ITERATIONS = 400


@dataclass(frozen=True)
class Solved:
    """Solutions of a batch.

    Attributes
    ----------
    x : (size, S)
    residual : (S,) true relative residual norm(b - K x) / norm(b)
    iterations : (S,) Krylov iterations, 0 for a direct solve
    """

    x: Array
    residual: Array
    iterations: NDArray[np.int64]


class Solver(Protocol):
    """A system ready to be solved for many right-hand sides.

    `reason` says why it was chosen, `tolerance` is the relative residual that counts as converged,
    `estimated_bytes` its expected memory, and `library` the one that factorised, or "none".
    """

    name: str
    library: str
    reason: str
    tolerance: float
    estimated_bytes: float

    def solve(self, rhs: Array) -> Solved:
        """Solve for (size, S) right-hand sides."""
        ...


class DirectSolver:
    """A sparse factor of the symmetric indefinite system, with iterative refinement on the true residual.

    The factor is in single precision: half the memory and half the time. Two steps of refinement bring the
    residual to rounding in double precision. Where they do not, the matrix is factored again in double precision.
    For many `loads` that is done at once, where it fits.

    Raises
    ------
    SolverError
        If the factors would not fit into memory, or the matrix is singular.
    """

    name = "direct"
    library = LIBRARY
    tolerance = DIRECT_TOLERANCE

    def __init__(self, system: LinearSystem, memory_limit: float | None, reason: str, loads: int = 1) -> None:
        self.reason = reason
        self._system = system
        self._memory_limit = memory_limit
        matrix = pivotable_triangle(system)
        self._analysis = Analysis(matrix)
        double = loads >= _MANY_LOADS and self._needed("float64") <= allowed_memory(memory_limit)
        self._factorise("float64" if double else "float32", matrix)

    def solve(self, rhs: Array) -> Solved:
        """Solve in batches; see `Solver`."""
        x = np.empty_like(rhs)
        residual = np.empty(rhs.shape[1])
        for start in range(0, rhs.shape[1], BATCH):
            part = slice(start, start + BATCH)
            x[:, part], residual[part] = self._refine(rhs[:, part])
            if self.precision == "float32" and not residual[part].max() <= DIRECT_TOLERANCE:
                self._factorise("float64", pivotable_triangle(self._system))
                x[:, part], residual[part] = self._refine(rhs[:, part])
        return Solved(x, residual, np.zeros(rhs.shape[1], dtype=np.int64))

    def _factorise(self, precision: str, matrix: csc_array) -> None:
        self.precision = precision
        self.estimated_bytes = self._needed(precision)
        check_memory(self.estimated_bytes, self._memory_limit, self.name)
        try:
            self._factor = self._analysis.factor(matrix, precision)
        except RuntimeError as error:  # a pivot is zero at this precision
            if precision == "float32":
                self._factorise("float64", matrix)
                return
            raise solver_error(
                "singular",
                "the stiffness matrix is singular",
                "hold more of the surface, or remove parts of the mesh that hang on a vertex or an edge",
            ) from error

    def _needed(self, precision: str) -> float:
        return self._analysis.needed_bytes(precision, BATCH)

    def _refine(self, rhs: Array) -> tuple[Array, Array]:
        return refine(self._system.apply, self._factor.solve_many, np.ascontiguousarray(rhs))


class IterativeSolver:
    """GMRES with the block-triangular multigrid preconditioner."""

    name = "iterative"
    library = "none"
    tolerance = ITERATIVE_TOLERANCE

    def __init__(self, system: LinearSystem, memory_limit: float | None, reason: str) -> None:
        self.reason = reason
        self.estimated_bytes = _system_costs(system, 1)[self.name].bytes
        check_memory(self.estimated_bytes, memory_limit, self.name)
        self._system = system
        self._precondition = BlockPreconditioner(system)

    def solve(self, rhs: Array) -> Solved:
        """Solve one after another; see `Solver`."""
        x = np.empty_like(rhs)
        iterations = np.zeros(rhs.shape[1], dtype=np.int64)
        for column in range(rhs.shape[1]):
            x[:, column], iterations[column] = gmres(
                self._system.apply,
                self._precondition,
                np.ascontiguousarray(rhs[:, column]),
                np.zeros(len(rhs)),
                tolerance=_GMRES_TARGET,
                max_iterations=_MAX_ITERATIONS,
            )
        return Solved(x, relative_residual(self._system, x, rhs), iterations)


class IterativeThenDirect:
    """Iterative until it fails to converge, direct from then on where the factors fit into memory."""

    tolerance = ITERATIVE_TOLERANCE

    def __init__(self, system: LinearSystem, memory_limit: float | None, reason: str) -> None:
        self._system = system
        self._memory_limit = memory_limit
        self._use(IterativeSolver(system, memory_limit, reason))

    def solve(self, rhs: Array) -> Solved:
        """Solve; see `Solver`."""
        solved = self._current.solve(rhs)
        failed = ~(solved.residual <= self.tolerance)
        if self.name == "direct" or not failed.any():
            return solved
        try:
            self._use(DirectSolver(self._system, self._memory_limit, f"{self.reason}; it did not converge"))
        except SolverError:
            return solved
        again = self._current.solve(rhs[:, failed])
        x, residual = solved.x.copy(), solved.residual.copy()
        x[:, failed], residual[failed] = again.x, again.residual
        return Solved(x, residual, solved.iterations)

    def _use(self, solver: DirectSolver | IterativeSolver) -> None:
        self._current = solver
        self.name = solver.name
        self.library = solver.library
        self.reason = solver.reason
        self.estimated_bytes = solver.estimated_bytes


def relative_residual(system: LinearSystem, x: Array, rhs: Array) -> Array:
    """(S,) norm(rhs - K x) / norm(rhs), zero where both norms are."""
    scale = np.linalg.norm(rhs, axis=0)
    difference = np.linalg.norm(rhs - system.apply(x), axis=0)
    return np.asarray(difference / np.where(scale > 0.0, scale, 1.0))


def refine(
    apply: Callable[[Array], Array], approximate: Callable[[Array], Array], rhs: Array
) -> tuple[Array, Array]:
    """Solve by repeated approximate solves of the residual until it stops falling.

    Returns the (size, S) solutions and their (S,) true relative residuals.
    """
    scale = np.linalg.norm(rhs, axis=0)
    scale[scale == 0.0] = 1.0
    x = approximate(rhs)
    remainder = rhs - apply(x)
    residual = np.linalg.norm(remainder, axis=0) / scale
    for _ in range(_MAX_REFINEMENTS):
        if residual.max() <= _REFINED:
            break
        trial = x + approximate(remainder)
        trial_remainder = rhs - apply(trial)
        trial_residual = np.linalg.norm(trial_remainder, axis=0) / scale
        better = trial_residual < residual
        gain = trial_residual < 0.5 * residual
        x[:, better] = trial[:, better]
        remainder[:, better] = trial_remainder[:, better]
        residual[better] = trial_residual[better]
        if not gain.any():
            break
    return x, residual


def _system_costs(system: LinearSystem, loads: int) -> dict[str, Estimate]:
    return estimate_costs(system.size, system.mesh.n_vertices, loads, system.divergence_coefficient)


def chosen(
    requested: str,
    costs: dict[str, Estimate],
    task: str,
    memory_limit: float | None,
    make: dict[str, Callable[[str], Made]],
) -> Made:
    """Make the `requested` path or, for "auto", the faster one that fits into memory.

    Parameters
    ----------
    requested : one of `SOLVERS`
    costs : by name of the path
    task : in words, for the reason
    memory_limit : bytes; None for what is available
    make : by name of the path; takes the reason

    Raises
    ------
    SolverError
        If the name is unknown or no path fits.
    """
    if requested not in SOLVERS:
        raise solver_error(
            "bad-solver", f"solver {requested!r} is unknown", f"use one of {', '.join(SOLVERS)}"
        )
    if requested != "auto":
        return make[requested]("asked for")
    name, reason = faster_that_fits(costs, task, allowed_memory(memory_limit))
    try:
        return make[name](reason)
    except SolverError as error:
        if name != "direct" or error.status.code != "memory":
            raise
    return make["iterative"](f"{reason}; the analysis found that the factors need more")


def choose_solver(
    system: LinearSystem, requested: str, expected_loads: int, memory_limit: float | None
) -> Solver:
    """Set up the solver of a system; raises as `chosen`."""
    iterative = IterativeThenDirect if requested == "auto" else IterativeSolver
    make: dict[str, Callable[[str], Solver]] = {
        "direct": lambda reason: DirectSolver(system, memory_limit, reason, expected_loads),
        "iterative": lambda reason: iterative(system, memory_limit, reason),
    }
    costs = _system_costs(system, max(1, expected_loads))
    return chosen(requested, costs, f"{system.size} unknowns, {expected_loads} loads", memory_limit, make)
