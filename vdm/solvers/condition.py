"""Condition numbers of a problem in the 1-norm, estimated from a few solves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from solver_common.arrays import Array, Mask
from solver_common.condition import Product, estimated_norm, operator
from vdm.formulations.base import Formulation
from vdm.problem import Problem
from vdm.solvers.linear import BorderedFactor

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
    """Condition of the symmetric operator, with each node and each border unknown in its own unit.

    The block is scaled to a unit diagonal, which is nearly the best diagonal scaling (van der Sluis, Numer. Math.
    14 (1969) 14) and does not affect a Cholesky factor. Border columns and rows are scaled by the displacements
    that they cause. The cost is about a dozen solves, and the factor where none is given.

    For an operator without a matrix, as of a coarse body, the norm is estimated too, from as many products.

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
        block=_norm(block) * estimated_norm(operator(n, solve_block, solve_block)),
        system=_norm(whole) * estimated_norm(operator(n + m, solve, solve_transposed)),
    )


def condition_of_matrix(matrix: sparse.csr_array, n_border: int) -> Condition:
    """Condition of a state matrix, unscaled; the border is its last rows and columns."""
    return Condition(
        block=_condition(matrix[:-n_border][:, :-n_border]),
        system=_condition(matrix),
    )


def _scaled_block(formulation: Formulation, inside: Mask, unit: Array) -> Matrix:
    """K over the unknowns `inside`, each in its unit."""
    if formulation.has_matrix:
        scaling = sparse.diags_array(unit)
        return sparse.csc_array(scaling @ formulation.stiffness()[inside][:, inside] @ scaling)
    x = np.zeros(len(inside))

    def apply(b: Array) -> Array:
        x[inside] = unit * b
        force = formulation.apply(x.reshape(-1, formulation.components))
        return np.asarray(unit * force.reshape(-1)[inside])

    return operator(len(unit), apply, apply)


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

    return operator(n + len(corner), apply, apply_transposed)


def _in_own_units(border: Array, solve_block: Product, corner: Array) -> tuple[Array, Array]:
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

    norm = estimated_norm(operator(matrix.shape[0], factors.solve, solve_transposed))
    return _norm(matrix) * norm if np.isfinite(norm) else np.inf


def _norm(matrix: Matrix | sparse.csr_array) -> float:
    if isinstance(matrix, linalg.LinearOperator):
        return estimated_norm(matrix)
    return float(linalg.norm(matrix, 1))
