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

from vdm.formulations.base import Formulation, Mask
from vdm.problem import Problem
from vdm.solvers.linear import BorderedFactor

Array = NDArray[np.float64]
Solve = Callable[[Array], Array]
Matrix = sparse.csc_array | linalg.LinearOperator


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

    An operator without a matrix, the skin of a coarse body, has its norm estimated too, from as many products.

    Raises
    ------
    SolverError
        an operator that is singular.
    """
    factor = factor or BorderedFactor(problem)
    formulation = problem.formulation
    unit = 1.0 / np.sqrt(formulation.diagonal()[factor.unknowns])
    block = _scaled_block(formulation, factor.unknowns, unit)

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
    whole = _bordered(block, columns, rows, corner)
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
    return _estimated_norm(_operator(size, solve, solve_transposed))


def _estimated_norm(operator: linalg.LinearOperator) -> float:
    """Lower bound of an operator's 1-norm."""
    size = operator.shape[1]
    found = float(linalg.onenormest(operator, t=1))
    # Higham's second guess, for the matrices that Hager's walk is blind to
    alternating = 1.0 + np.arange(size) / max(size - 1, 1)
    alternating[1::2] *= -1.0
    return max(found, 2.0 * float(np.abs(operator @ alternating).sum()) / (3.0 * size))


def _scaled_block(formulation: Formulation, inside: Mask, unit: Array) -> Matrix:
    """K of the unknowns `inside`, each in its unit."""
    if formulation.has_matrix:
        scaling = sparse.diags_array(unit)
        return sparse.csc_array(scaling @ formulation.stiffness()[inside][:, inside] @ scaling)
    x = np.zeros(len(inside))

    def apply(b: Array) -> Array:
        x[inside] = unit * b
        force = formulation.apply(x.reshape(-1, formulation.components))
        return np.asarray(unit * force.reshape(-1)[inside])

    return _operator(len(unit), apply, apply)


def _bordered(block: Matrix, columns: Array, rows: Array, corner: Array) -> Matrix:
    """[block -columns; rows^T corner]."""
    if not isinstance(block, linalg.LinearOperator):
        return sparse.csc_array(
            sparse.block_array(
                [[block, sparse.csc_array(-columns)], [sparse.csc_array(rows.T), sparse.csc_array(corner)]]
            )
        )
    n = len(columns)

    def apply(b: Array) -> Array:
        x, s = np.split(b, [n])
        return np.concatenate([block @ x - columns @ s, rows.T @ x + corner @ s])

    def apply_transposed(b: Array) -> Array:
        x, s = np.split(b, [n])
        return np.concatenate([block @ x + rows @ s, corner.T @ s - columns.T @ x])

    return _operator(n + len(corner), apply, apply_transposed)


def _operator(size: int, product: Solve, product_transposed: Solve) -> linalg.LinearOperator:
    return linalg.LinearOperator(
        (size, size),
        matvec=lambda b: product(b.reshape(-1)),
        rmatvec=lambda b: product_transposed(b.reshape(-1)),
        dtype=np.float64,
    )


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


def _norm(matrix: Matrix | sparse.csr_array) -> float:
    if isinstance(matrix, linalg.LinearOperator):
        return _estimated_norm(matrix)
    return float(linalg.norm(matrix, 1))
