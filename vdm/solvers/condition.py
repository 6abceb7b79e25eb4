"""How well conditioned a problem is: condition numbers in the 1-norm, estimated from a few solves.

Hager (1984) and Higham (ACM Trans. Math. Softw. 14 (1988) 381, algorithm 4.1): a lower bound of the norm of the
inverse, rarely more than three times too small. The same number every time: no random vector is in it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import linalg

from vdm.problem import Problem
from vdm.solvers.linear import BorderedFactor

Array = NDArray[np.float64]
Solve = Callable[[Array], Array]


@dataclass(frozen=True)
class Condition:
    """Condition numbers |M|_1 |M^-1|_1, inf where M is singular.

    Attributes
    ----------
    block : of the block K over the free nodes
    system : of the whole matrix, border included
    """

    block: float
    system: float


def condition_of_operator(problem: Problem, factor: BorderedFactor | None = None) -> Condition:
    """Of the symmetric operator, each node and each border unknown in a unit of its own.

    The block is scaled to a unit diagonal, which is nearly the best that a diagonal can do (van der Sluis, Numer.
    Math. 14 (1969) 14), and a Cholesky factor does not see it; border columns and rows are scaled by what they
    move. Costs about a dozen solves, and the factor where none is given.

    Raises
    ------
    SolverError
        an operator that is singular, or that is too large for a matrix.
    """
    factor = factor or BorderedFactor(problem)
    formulation = problem.formulation
    inside = np.repeat(factor.free, formulation.components)
    stiffness = formulation.stiffness()[inside][:, inside]
    unit = 1.0 / np.sqrt(stiffness.diagonal())
    scaling = sparse.diags_array(unit)
    block = sparse.csc_array(scaling @ stiffness @ scaling)

    def solve_block(b: Array) -> Array:
        each = unit if b.ndim == 1 else unit[:, None]
        return np.asarray(factor.block.solve(b / each) / each)

    m = factor.n_border
    columns, rows = (
        part.at(factor.free).dense().reshape(-1, m) * unit[:, None]
        for part in (formulation.columns, formulation.rows)
    )
    columns, column_unit = _in_own_units(columns, solve_block, formulation.corner)
    rows, row_unit = _in_own_units(rows, solve_block, formulation.corner)
    corner = row_unit[:, None] * formulation.corner * column_unit
    whole = sparse.csc_array(
        sparse.block_array(
            [[block, sparse.csc_array(-columns)], [sparse.csc_array(rows.T), sparse.csc_array(corner)]]
        )
    )
    solved_columns, solved_rows = solve_block(columns), solve_block(rows)
    schur = rows.T @ solved_columns + corner
    n = len(unit)

    def solve(b: Array) -> Array:
        border = np.linalg.solve(schur, b[n:] - solved_rows.T @ b[:n])
        return np.concatenate([solve_block(b[:n]) + solved_columns @ border, border])

    def solve_transposed(b: Array) -> Array:
        border = np.linalg.solve(schur.T, b[n:] + solved_columns.T @ b[:n])
        return np.concatenate([solve_block(b[:n]) - solved_rows @ border, border])

    return Condition(
        block=_norm(block) * inverse_norm(solve_block, solve_block, n),
        system=_norm(whole) * inverse_norm(solve, solve_transposed, n + m),
    )


def condition_of_matrix(matrix: sparse.csr_array, n_border: int) -> Condition:
    """Of a state matrix with its last rows and columns the border, as it is: pressures beside displacements."""
    return Condition(
        block=_condition(matrix[:-n_border][:, :-n_border]),
        system=_condition(matrix),
    )


def inverse_norm(solve: Solve, solve_transposed: Solve, size: int) -> float:
    """Lower bound of |M^-1|_1 of a matrix (size, size) from solves with M and with its transpose."""
    inverse = linalg.LinearOperator(
        (size, size),
        matvec=lambda b: solve(b.reshape(-1)),
        rmatvec=lambda b: solve_transposed(b.reshape(-1)),
        dtype=np.float64,
    )
    found = float(linalg.onenormest(inverse, t=1))
    # Higham's second guess, for the matrices that Hager's walk is blind to
    alternating = 1.0 + np.arange(size) / max(size - 1, 1)
    alternating[1::2] *= -1.0
    return max(found, 2.0 * float(np.abs(solve(alternating)).sum()) / (3.0 * size))


def _in_own_units(border: Array, solve_block: Solve, corner: Array) -> tuple[Array, Array]:
    energy = np.einsum("ij,ij->j", border, solve_block(border))
    unit = 1.0 / np.sqrt(np.maximum(energy, np.abs(corner.diagonal())))
    return border * unit, unit


def _condition(matrix: sparse.csr_array) -> float:
    try:
        factors = linalg.splu(sparse.csc_array(matrix))
    except RuntimeError:  # exactly singular
        return np.inf

    def solve_transposed(b: Array) -> Array:
        return np.asarray(factors.solve(b, trans="T"))  # type: ignore[call-overload] # scipy-stubs knows no trans

    norm = inverse_norm(factors.solve, solve_transposed, matrix.shape[0])
    return _norm(matrix) * norm if np.isfinite(norm) else np.inf


def _norm(matrix: sparse.csc_array | sparse.csr_array) -> float:
    return float(linalg.norm(matrix, 1))
