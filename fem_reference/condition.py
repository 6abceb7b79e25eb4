"""The condition number of a body's system in the 1-norm, estimated from a few solves."""

from __future__ import annotations

import numpy as np
from scipy.sparse import bsr_array, csr_array

from fem_reference.linear_algebra import Solver, choose_solver
from fem_reference.solution import SolverError
from fem_reference.system import LinearSystem
from solver_common.arrays import Array
from solver_common.condition import estimated_norm, operator

_SOLVES = 12  # typical number for one estimate


def condition_estimate(system: LinearSystem, solver: Solver | None = None) -> float:
    """|M|_1 |M^-1|_1 of a system M with each unknown in its own unit; inf where it is singular.

    Displacements are scaled to a unit diagonal. Pressures are scaled by the diagonal of their Schur complement,
    the mass matrix. This is nearly the best diagonal scaling (van der Sluis, Numer. Math. 14 (1969) 14). The
    number then reflects the physics of the body and its supports, and the shape of the elements.

    Parameters
    ----------
    system : symmetric
    solver : of that system; None makes one
    """
    try:
        ready = solver or choose_solver(system, "auto", _SOLVES, None)
    except SolverError as error:
        return np.inf if error.status.code == "singular" else np.nan
    unit = _units(system)

    def solve(b: Array) -> Array:
        x: Array = ready.solve((b / unit)[:, None]).x[:, 0] / unit
        return x

    estimate = _norm(system, unit) * estimated_norm(operator(system.size, solve, solve))
    return estimate if np.isfinite(estimate) else np.inf


def _units(system: LinearSystem) -> Array:
    """(size,) unit of each unknown."""
    displacement = 1.0 / np.sqrt(system.stiffness.diagonal())
    if system.mass is None:
        return np.asarray(displacement)
    pressure = 1.0 / np.sqrt(abs(system.schur_factor) * system.mass.diagonal())
    return np.concatenate([displacement, pressure])


def _norm(system: LinearSystem, unit: Array) -> float:
    """|M|_1 in those units."""
    n = system.n_displacements
    u, q = unit[:n], unit[n:]
    stiffness = system.stiffness
    sizes = bsr_array((np.abs(stiffness.data), stiffness.indices, stiffness.indptr), shape=stiffness.shape)
    columns = u * (sizes @ u)
    if system.divergence is None or system.mass is None:
        return float(columns.max())
    coupling = csr_array(abs(system.divergence))
    columns = columns + u * (coupling.T @ q)
    pressures = q * (coupling @ u)
    if system.compliance is not None:
        pressures = pressures + q * (abs(system.compliance) @ q)
    return float(max(columns.max(), pressures.max()))
