"""Linear solves of Newton's method: GMRES on the true tangent, preconditioned by a factor that is kept.

Method: right-preconditioned GMRES. Order: exact to the requested tolerance; the true residual is checked.
Source: Saad and Schultz 1986, doi 10.1137/0907058.

A follower pressure makes the tangent unsymmetric, but only at loaded facets. A factor of the symmetric part, or
of an earlier tangent, is a close approximation at half the cost of an LU factor. It is replaced only when more
GMRES steps would cost more than a new factor. A multigrid preconditioner costs as much as eight steps, and saves
more on its own tangent. It uses the unsymmetric tangent, which saves steps under large pressures.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fem_reference.costs import NEWTON_STEPS, RESTART, estimate_costs, estimate_newton_costs
from fem_reference.factorisation import LIBRARY, Analysis, pivotable_triangle
from fem_reference.krylov import gmres
from fem_reference.linear_algebra import chosen
from fem_reference.memory import allowed_memory, check_memory
from fem_reference.multigrid import BlockPreconditioner
from fem_reference.system import LinearSystem
from solver_common.arrays import Array

Operator = Callable[[Array], Array]


@dataclass(frozen=True)
class TangentSystem:
    """A tangent, the data of its symmetric part for a factor, and its product with all nodes' displacements."""

    true: LinearSystem
    symmetric: Callable[[], LinearSystem]
    action: Operator


class Preconditioner(Protocol):
    """Makes approximate inverses of tangents with one sparsity pattern.

    `library` is the one that factorises, or "none" for multigrid. After `patience` GMRES steps on another tangent
    a new preconditioner is cheaper; `limit` steps count as failure. `sharpen` makes it permanently more exact,
    and returns whether it could.
    """

    name: str
    library: str
    patience: int
    limit: int
    estimated_bytes: float

    def make(self, tangent: TangentSystem) -> Operator | None:
        """The approximate inverse of a tangent; None if it is singular."""
        ...

    def sharpen(self) -> bool:
        """Use more memory for more accuracy from now on; False if that is not possible."""
        ...


class Factors:
    """A sparse factor in single precision, or in double after a failure; one symbolic analysis for all."""

    name = "direct"
    library = LIBRARY
    patience = 40
    limit = 60

    def __init__(self, system: LinearSystem, memory_limit: float | None) -> None:
        self._precision = "float32"
        self._memory_limit = memory_limit
        self._analysis = Analysis(pivotable_triangle(system))
        self.estimated_bytes = self._needed(self._precision)
        check_memory(self.estimated_bytes, memory_limit, self.name)

    def make(self, tangent: TangentSystem) -> Operator | None:
        """See `Preconditioner`."""
        try:
            factor = self._analysis.factor(pivotable_triangle(tangent.symmetric()), self._precision)
        except RuntimeError:  # a pivot is zero at this precision
            return self.make(tangent) if self.sharpen() else None
        return lambda residual: np.asarray(factor.solve(residual))

    def is_stable(self, tangent: LinearSystem, fluid: Array) -> bool:
        """Whether a symmetric tangent is stable, with `fluid` (k, size) gradients of volumes that are kept.

        It then has one negative eigenvalue for each pressure and volume, and no others. What single precision finds
        unstable is factored again in double; it counts as stable where that does not fit into memory.
        """
        lower = pivotable_triangle(tangent)
        # a body of negative Poisson ratio has positive pressures
        pressures = tangent.mesh.n_pressures if tangent.compressibility >= 0.0 else 0
        for precision in ("float32", "float64"):
            if self._needed(precision) > allowed_memory(self._memory_limit):
                return True
            try:
                factor = self._analysis.factor(lower, precision)
            except RuntimeError:  # a pivot is zero at this precision
                continue
            negative = factor.inertia[1]
            if len(fluid):  # of the bordered matrix, by Haynsworth's formula
                moved = fluid @ factor.solve_many(np.ascontiguousarray(fluid.T))
                negative += int((np.linalg.eigvalsh(moved) > 0.0).sum())
            if negative <= pressures + len(fluid):
                return True
        return False

    def sharpen(self) -> bool:
        """See `Preconditioner`."""
        needed = self._needed("float64")
        if self._precision == "float64" or needed > allowed_memory(self._memory_limit):
            return False
        self._precision = "float64"
        self.estimated_bytes = needed
        return True

    def _needed(self, precision: str) -> float:
        return self._analysis.needed_bytes(precision, 1)


class Multigrid:
    """The block-triangular multigrid preconditioner of the linear path, on the tangent."""

    name = "iterative"
    library = "none"
    patience = 0
    limit = 2 * RESTART  # a tangent that needs more lies beyond a limit point

    def __init__(self, system: LinearSystem, memory_limit: float | None) -> None:
        self.estimated_bytes = estimate_costs(system.size, system.mesh.n_vertices, 1)[self.name].bytes
        check_memory(self.estimated_bytes, memory_limit, self.name)

    def make(self, tangent: TangentSystem) -> Operator:
        """See `Preconditioner`."""
        return BlockPreconditioner(tangent.true)

    def sharpen(self) -> bool:
        """See `Preconditioner`."""
        return False


class TangentSolver:
    """Solves tangent systems of one sparsity pattern.

    Parameters
    ----------
    system : that of the undeformed body
    requested : "auto", "direct" or "iterative"
    expected_loads : number of load steps to come, for the choice
    memory_limit : bytes the solver may take; None for what the machine has left

    Attributes
    ----------
    reason : why the preconditioner was chosen
    factorisations, steps : preconditioners made and GMRES steps done so far

    Raises
    ------
    SolverError
        If the name is unknown or the memory does not suffice.
    """

    def __init__(
        self, system: LinearSystem, requested: str, expected_loads: int, memory_limit: float | None
    ) -> None:
        make: dict[str, Callable[[str], tuple[Preconditioner, str]]] = {
            "direct": lambda reason: (Factors(system, memory_limit), reason),
            "iterative": lambda reason: (Multigrid(system, memory_limit), reason),
        }
        costs = estimate_newton_costs(system.size, system.mesh.n_vertices, expected_loads)
        task = f"{system.size} unknowns, {NEWTON_STEPS * max(1, expected_loads)} solves"
        self.preconditioner, self.reason = chosen(requested, costs, task, memory_limit, make)
        self.factorisations = 0
        self.steps = 0
        self._approximate: Operator | None = None
        self._of: Callable[[], TangentSystem | None] = lambda: None  # the preconditioned tangent

    def solve(self, tangent: TangentSystem, rhs: Array, tolerance: float) -> tuple[Array, bool]:
        """Solve to norm(rhs - K x) <= tolerance * norm(rhs); returns x and whether that was reached."""
        limit, own = self.preconditioner.limit, self._of() is tangent
        most = limit if own else self.preconditioner.patience
        x = np.zeros_like(rhs)
        done = False
        if most:
            x, done = self._gmres(tangent, rhs, x, tolerance, most)
        if not (done or own):
            self._renew(tangent)
            x, done = self._gmres(tangent, rhs, x, tolerance, limit)
        if not done and self.preconditioner.sharpen():
            self._renew(tangent)
            x, done = self._gmres(tangent, rhs, x, tolerance, limit)
        return x, done

    def _renew(self, tangent: TangentSystem) -> None:
        self._approximate = None  # free it first: two may not fit
        self._approximate, self._of = self.preconditioner.make(tangent), weakref.ref(tangent)
        self.factorisations += 1

    def _gmres(
        self, tangent: TangentSystem, rhs: Array, start: Array, tolerance: float, most: int
    ) -> tuple[Array, bool]:
        if self._approximate is None:
            return start, False
        apply = tangent.true.apply
        x, steps = gmres(apply, self._approximate, rhs, start, tolerance=tolerance, max_iterations=most)
        self.steps += steps
        residual = float(np.linalg.norm(rhs - apply(x)))
        # Rounding of the recurrence may leave the true residual a little above the target.
        return x, residual <= 2.0 * tolerance * float(np.linalg.norm(rhs))
