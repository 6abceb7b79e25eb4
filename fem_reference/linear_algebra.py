"""Sparse solvers for the scaled system, and the choice between them, in one place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import rslab
from numpy.typing import NDArray

from fem_reference.memory import check_memory
from fem_reference.solution import SolverError, Status
from fem_reference.system import LinearSystem

Array = NDArray[np.float64]

BATCH = 32  # right-hand sides per triangular solve: beyond it a single one gets no cheaper
DIRECT_TOLERANCE = 1e-9
# The factor of an incompressible system needs a small pressure block; refinement takes its effect out again.
_LEAST_COMPRESSIBILITY = 1e-7
_REFINED = 1e-13
_MAX_REFINEMENTS = 6


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
    """A system ready to be solved for many right-hand sides."""

    name: str
    reason: str
    tolerance: float
    estimated_bytes: float

    def solve(self, rhs: Array) -> Solved:
        """Solve for (size, S) right-hand sides."""
        ...


class DirectSolver:
    """Sparse LDL^T of the symmetric indefinite system, with iterative refinement on the true residual.

    Raises
    ------
    SolverError
        If the factors would not fit into memory, or the matrix is singular.
    """

    name = "direct"
    tolerance = DIRECT_TOLERANCE

    def __init__(self, system: LinearSystem, memory_limit: float | None = None, reason: str = "") -> None:
        self.reason = reason
        self._system = system
        matrix = system.lower_triangle(max(system.compressibility, _LEAST_COMPRESSIBILITY))
        symbolic = rslab.analyze(matrix, path="ldlt")
        self.estimated_bytes = float(symbolic.memory_plan(nrhs=BATCH)["peak_bytes"])
        check_memory(self.estimated_bytes, memory_limit, "direct")
        try:
            self._factor = symbolic.factor(matrix)
        except RuntimeError as error:
            raise SolverError(
                Status(
                    "singular",
                    "the stiffness matrix is singular",
                    "hold more of the surface, or remove parts of the mesh that hang on a vertex or an edge",
                )
            ) from error

    def solve(self, rhs: Array) -> Solved:
        """Solve in batches; see `Solver`."""
        x = np.empty_like(rhs)
        residual = np.empty(rhs.shape[1])
        for start in range(0, rhs.shape[1], BATCH):
            part = slice(start, start + BATCH)
            x[:, part], residual[part] = refine(
                self._system.apply, self._factor.solve_many, np.ascontiguousarray(rhs[:, part])
            )
        return Solved(x, residual, np.zeros(rhs.shape[1], dtype=np.int64))


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
        if not better.any():
            break
        gain = trial_residual[better] < 0.5 * residual[better]
        x[:, better] = trial[:, better]
        remainder[:, better] = trial_remainder[:, better]
        residual[better] = trial_residual[better]
        if not gain.any():
            break
    return x, residual


def choose_solver(
    system: LinearSystem, requested: str, expected_loads: int, memory_limit: float | None
) -> Solver:
    """The solver for a system; `requested` is "auto" or "direct"."""
    if requested not in ("auto", "direct"):
        raise SolverError(Status("bad-solver", f"solver {requested!r} is unknown", "use auto or direct"))
    return DirectSolver(system, memory_limit, f"the only path, {expected_loads} loads")
