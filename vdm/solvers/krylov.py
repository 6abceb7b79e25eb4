"""Iterative solvers (equation 38): BiCG on the printed matrix, CG and MINRES on the symmetric one."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from solver_common.arrays import Array
from vdm.constraints import Load
from vdm.formulations.base import Factor
from vdm.problem import LinearStep, Problem, Step
from vdm.solution import CONVERGED, SolverError, Status
from vdm.solvers.audit import Audit, audit
from vdm.solvers.linear import BORDER_TOLERANCE, check_border

Method = Literal["bicg", "cg", "minres"]

# Of the sum of |A_i L_i|: how far the volume row may be from zero. MINRES has forces beside the volume row: where
# the moduli are large the second disappears from the residual, and a wrong answer would count as converged.
_BORDER_TOLERANCE = 1e-6
TOLERANCE = 1e-10
# an audit measures forces node by node, a tolerance the whole: where one is asked for, a node may lack so much more
_NODE_BY_NODE = 100.0

NOT_CONVERGED = Status(
    "not-converged",
    "the iterative solver did not reach its tolerance",
    "use the linear solver, or a larger tolerance",
)


class KrylovSolver:
    """Solves the state matrix with held nodes eliminated, without factors of the whole.

    What a warm start is worth to BiCG, at 10,242 nodes and a load that grows by a twentieth a step: 199 iterations
    on average against 217 from zero, 195 from the exact last solution. A residual that starts at a twentieth saves
    the iterations of its one digit and no more.

    Parameters
    ----------
    problem : formulation and supports
    method : "bicg": on the state matrix as printed, its rows and unknowns scaled, no preconditioner; Figure 8
        itself is `vdm.solvers.figure_8`.
        "minres": on the symmetric bordered matrix, which the paper's formulation does not have. "cg": on the block
        K alone, once for the load and once, at set-up, for the border columns. MINRES and CG are scaled by the
        diagonal unless `factor` is given.
    warm_start : begin with the previous step's solution instead of zero
    tolerance : of the true residual, relative to the right-hand side
    factor : of the block K over the same free nodes as it was at rest or with other moduli: preconditions CG and
        MINRES (with the border's Schur complement, made positive) while the operator itself has changed

    Raises
    ------
    SolverError
        MINRES asked for an unsymmetric state matrix; a border that is singular to rounding, which CG solves apart.
    """

    def __init__(
        self,
        problem: Problem,
        method: Method = "bicg",
        warm_start: bool = True,
        tolerance: float = TOLERANCE,
        factor: Factor | None = None,
    ) -> None:
        self.problem, self.method, self.warm_start, self.tolerance = problem, method, warm_start, tolerance
        formulation = problem.formulation
        self.n_border = formulation.columns.count
        held = np.repeat(problem.support.held, formulation.components)
        self.free = np.concatenate([~held, np.ones(self.n_border, dtype=np.bool_)])
        matrix = formulation.state_matrix()
        self.row_scale, self.column_scale = formulation.row_scale, formulation.column_scale
        if method != "bicg":
            self.row_scale = self.column_scale = np.ones_like(self.row_scale)
            columns, rows = (
                part.dense().reshape(-1, self.n_border) for part in (formulation.columns, formulation.rows)
            )
            if method == "minres" and not np.array_equal(columns, rows):
                raise SolverError(
                    Status(
                        "unsymmetric",
                        "MINRES needs a symmetric state matrix",
                        "use cg, or another formulation",
                    )
                )
            right, below = sparse.csr_array(-columns), sparse.csr_array(-rows.T)
            corner = sparse.csr_array(-formulation.corner)
            matrix = sparse.csr_array(sparse.block_array([[formulation.stiffness(), right], [below, corner]]))
        self.printed = matrix[self.free][:, self.free]
        self.border_row = self.border_column = np.ones(self.n_border)
        if method == "bicg":
            matrix = self._without_units(matrix)
        self.full = matrix
        self.matrix = matrix[self.free][:, self.free]
        self.preconditioner = self._preconditioner(factor)
        self._prepare()
        self._guess: Array | None = None

    def _without_units(self, matrix: sparse.csr_array) -> sparse.csr_array:
        """The state matrix scaled: a diagonal of ones, a border of columns and rows of length one.

        As printed, rows in Pa stand beside one in m^3: the units chosen would decide how fast BiCG is.
        """
        m, free = self.n_border, self.free[: -self.n_border]
        unit = 1.0 / np.sqrt(np.abs(matrix.diagonal()[:-m]))
        right, below = matrix[:-m, -m:].toarray() * unit[:, None], matrix[-m:, :-m].toarray() * unit
        self.border_column = 1.0 / np.linalg.norm(right[free], axis=0)
        self.border_row = 1.0 / np.linalg.norm(below[:, free], axis=1)
        rows, columns = (np.concatenate([unit, part]) for part in (self.border_row, self.border_column))
        self.row_scale, self.column_scale = self.row_scale * unit, self.column_scale * unit
        return sparse.csr_array(sparse.diags_array(rows) @ matrix @ sparse.diags_array(columns))

    def _preconditioner(self, factor: Factor | None) -> linalg.LinearOperator | None:
        m, matrix = self.n_border, self.matrix
        n = matrix.shape[0] - m
        if self.method == "bicg":
            return None
        if factor is None:
            return linalg.aslinearoperator(
                sparse.diags_array(
                    _jacobi(matrix, m) if self.method == "minres" else _jacobi(matrix[:n, :n], 0)
                )
            )
        if self.method == "cg":
            return linalg.LinearOperator((n, n), matvec=factor.solve, dtype=np.float64)
        columns = matrix[:n, n:].toarray()
        schur = columns.T @ factor.solve(columns) - matrix[n:, n:].toarray()
        size = np.sqrt(np.abs(schur.diagonal()))  # each border unknown in its own unit
        values, vectors = np.linalg.eigh(schur / np.outer(size, size))
        half = vectors / np.sqrt(np.abs(values)) / size[:, None]
        inverse = half @ half.T

        def both(b: Array) -> Array:
            b = b.reshape(-1)
            return np.concatenate([factor.solve(b[:n]), inverse @ b[n:]])

        return linalg.LinearOperator(matrix.shape, matvec=both, dtype=np.float64)

    def _prepare(self) -> None:
        if self.method != "cg":
            return
        m = self.n_border
        self.block, self.right = self.matrix[:-m, :-m], self.matrix[:-m, -m:].toarray()
        self.below, self.corner = self.matrix[-m:, :-m].toarray(), self.matrix[-m:, -m:].toarray()
        solved = [self._iterate(self.block, column, None) for column in self.right.T]
        self.response = np.stack([s for s, _, _ in solved], axis=1)
        # the signs of this matrix are those of the balance turned round
        check_border(
            self.below @ self.response - self.corner, -self.corner, max(BORDER_TOLERANCE, self.tolerance)
        )

    def step(self, load: Load, previous: Step | None = None) -> Step:
        """Solution of one load; `iterations` counts products with the matrix (BiCG: with its transpose too)."""
        problem = self.problem
        force = problem.force(load)
        n = force.size
        right_hand_side = np.concatenate([self.row_scale * force.reshape(-1), np.zeros(self.n_border)])
        given = np.zeros(n + self.n_border)
        given[:n] = problem.held_unknown(load).reshape(-1) / self.column_scale
        b = (right_hand_side - self.full @ given)[self.free]
        guess = self._guess if self.warm_start and previous is not None else None
        if self.method == "cg":
            solution, iterations, converged = self._by_blocks(b, guess)
        else:
            solution, iterations, converged = self._iterate(self.matrix, b, guess)
        status = CONVERGED if converged else NOT_CONVERGED
        if converged:
            self._guess = solution
        given[self.free] = solution
        x = (given[:n] * self.column_scale).reshape(force.shape)
        return LinearStep(
            problem=problem,
            unknown=x,
            border=given[n:] * self.border_column,
            force=force,
            iterations=iterations,
            status=status,
        )

    def audited(self, load: Load, step: Step) -> tuple[Step, Audit]:
        """The step and what its balance lacks; without a factor of the whole there is no estimate of the error."""
        found = audit(self.problem, load, step, None)
        return step, replace(found, limit=max(found.limit, _NODE_BY_NODE * self.tolerance))

    def _by_blocks(self, b: Array, guess: Array | None) -> tuple[Array, int, bool]:
        m = self.n_border
        start = None if guess is None else guess[:-m] + self.response @ guess[-m:]
        first, iterations, converged = self._iterate(self.block, b[:-m], start)
        schur = self.corner - self.below @ self.response
        border = np.linalg.solve(schur, b[-m:] - self.below @ first)
        return np.concatenate([first - self.response @ border, border]), iterations, converged

    def _iterate(self, matrix: sparse.csr_array, b: Array, guess: Array | None) -> tuple[Array, int, bool]:
        """Restarted until the true residual is small: the recursive one of MINRES and BiCG drifts away from it."""
        count = 0

        def counted(_: Array) -> None:
            nonlocal count
            count += 1

        size = float(np.linalg.norm(b))
        x = np.zeros_like(b) if guess is None else guess
        limit = 10 * len(b)
        if size == 0.0:
            return np.zeros_like(b), 0, True
        for _ in range(4):
            residual = b - matrix @ x
            if float(np.linalg.norm(residual)) <= self.tolerance * size:
                return x, count, self._border_holds(matrix, b, residual, x)
            share = 0.5 * self.tolerance * size / float(np.linalg.norm(residual))
            if self.method == "minres":
                # its own measure divides by the norms of matrix and solution, which in mixed units is far too kind
                share *= 1e-4
            if self.method == "bicg":
                change, _info = linalg.bicg(matrix, residual, rtol=share, maxiter=limit, callback=counted)
            else:
                solver = linalg.cg if self.method == "cg" else linalg.minres
                change, _info = solver(
                    matrix, residual, rtol=share, maxiter=limit, M=self.preconditioner, callback=counted
                )
            x = x + change
        residual = b - matrix @ x
        small = bool(np.linalg.norm(residual) <= self.tolerance * size)
        return x, count, small and self._border_holds(matrix, b, residual, x)

    def _border_holds(self, matrix: sparse.csr_array, b: Array, residual: Array, x: Array) -> bool:
        """Whether the border rows, in units of their own, are met too; the block of CG has none."""
        if self.method == "cg":
            return True
        m = self.n_border
        # a load that cancels moves nothing: what its parts move alone is the measure (`Problem.own_motion`)
        alone = np.abs(b[:-m]) / np.abs(matrix.diagonal()[:-m])
        motion = np.append(np.maximum(np.abs(x[:-m]), alone), np.abs(x[-m:]))
        size = abs(matrix[-m:]) @ motion
        return bool(np.all(np.abs(residual[-m:]) <= max(_BORDER_TOLERANCE, self.tolerance) * size))


def _jacobi(matrix: sparse.csr_array, n_border: int) -> Array:
    """Inverse diagonal; for the border rows that of the Schur complement with the diagonal of the block."""
    inverse = 1.0 / np.abs(matrix.diagonal()[: matrix.shape[0] - n_border])
    if n_border == 0:
        return np.asarray(inverse)
    below = matrix[-n_border:]
    schur = (below[:, :-n_border] ** 2) @ inverse + np.abs(below[:, -n_border:].diagonal())
    return np.concatenate([inverse, 1.0 / schur])
