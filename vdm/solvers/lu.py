"""The paper's linear solver (equations 22, 25, 26, 29-32): LU of the whole state matrix, penalty included."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from solver_common.arrays import Array
from vdm.constraints import ConstraintError, Load
from vdm.problem import LinearStep, Problem, Step
from vdm.solution import SolverError, Status
from vdm.solvers.audit import Audit, audit

ConstraintMethod = Literal["elimination", "penalty-added", "penalty-replaced"]
HELD_SLIP = 1e-4  # of the largest displacement: a held node that moves more is not held
CONSTRAINT_METHODS: tuple[ConstraintMethod, ...] = ("elimination", "penalty-added", "penalty-replaced")


class LuSolver:
    """LU factors of K (22) with held nodes eliminated or penalised.

    Parameters
    ----------
    problem : formulation and supports
    method : "elimination"; "penalty-added", alpha added to K_ii as in the text; "penalty-replaced", K_ii = alpha
        as in equations 25 and 26. Both penalties leave an error of the order of dP / alpha. A step with a held
        node that moves by more than `HELD_SLIP` of the largest displacement has the status "inaccurate".
    penalty : alpha as a multiple of the largest diagonal entry of K

    Raises
    ------
    SolverError
        where the state matrix is singular to rounding.
    ConstraintError
        a penalty that is not positive.
    """

    def __init__(
        self, problem: Problem, method: ConstraintMethod = "elimination", penalty: float = 1e8
    ) -> None:
        if not (np.isfinite(penalty) and penalty > 0.0):
            raise ConstraintError(f"penalty must be positive, not {penalty}")
        self.problem = problem
        self.method = method
        matrix = problem.formulation.state_matrix()
        n_border = problem.formulation.columns.count
        held = np.repeat(problem.support.held, problem.formulation.components)
        self.held = np.concatenate([held, np.zeros(n_border, dtype=np.bool_)])
        self.alpha = penalty * float(np.abs(matrix.diagonal()).max())
        self.matrix = matrix
        try:
            self._factors = linalg.splu(self.solved_matrix().tocsc())
        except RuntimeError as error:
            raise SolverError(
                Status("singular", "the state matrix is singular", "hold more nodes or add a foundation")
            ) from error

    def solved_matrix(self) -> sparse.csr_array:
        """The matrix that is factored: held nodes eliminated, or all of it with alpha on their diagonal."""
        if self.method == "elimination":
            return self.matrix[~self.held][:, ~self.held]
        there = self.matrix.diagonal() if self.method == "penalty-replaced" else 0.0
        return sparse.csr_array(
            self.matrix + sparse.diags_array(np.where(self.held, self.alpha - there, 0.0))
        )

    def step(self, load: Load, previous: Step | None = None) -> Step:  # noqa: ARG002 - one interface for all solvers
        """Solution of one load (30-32)."""
        problem, formulation = self.problem, self.problem.formulation
        force = problem.force(load)
        n = force.size
        right_hand_side = np.concatenate(
            [formulation.row_scale * force.reshape(-1), np.zeros(len(self.held) - n)]
        )
        given = np.zeros(len(self.held))
        given[:n] = problem.held_unknown(load).reshape(-1) / formulation.column_scale
        if self.method == "elimination":
            solution = given
            solution[~self.held] = self._factors.solve((right_hand_side - self.matrix @ given)[~self.held])
        else:
            imposed = self.alpha * given
            if self.method == "penalty-added":
                imposed = imposed + right_hand_side
            solution = self._factors.solve(np.where(self.held, imposed, right_hand_side))
        x = (solution[:n] * formulation.column_scale).reshape(force.shape)
        step = LinearStep(problem=problem, unknown=x, border=solution[n:], force=force)
        if self.method != "elimination" and step.status.ok:
            held = problem.support.held
            slip = float(np.abs(x[held] - problem.held_unknown(load)[held]).max(initial=0.0))
            largest = float(np.abs(x).max(initial=0.0))
            if slip > HELD_SLIP * largest:
                return replace(step, status=_slipped(slip / largest))
        return step

    def audited(self, load: Load, step: Step) -> tuple[Step, Audit]:
        """The step and its audit; with a penalty at the nodes that it leaves free."""
        return step, audit(self.problem, load, step, self._correction)

    def _correction(self, lacking: Array, open_rows: Array) -> tuple[Array, Array]:
        formulation = self.problem.formulation
        missing = np.concatenate([formulation.row_scale * lacking.reshape(-1), open_rows])
        change = np.zeros(len(missing))
        if self.method == "elimination":
            change[~self.held] = self._factors.solve(missing[~self.held])
        else:
            change = self._factors.solve(missing)
        n = lacking.size
        return (change[:n] * formulation.column_scale).reshape(lacking.shape), change[n:]


def _slipped(share: float) -> Status:
    return Status(
        "inaccurate",
        f"the penalty lets held nodes move by {share:.1e} of the largest displacement",
        "raise the penalty, or leave it out: held nodes are then eliminated exactly",
    )
