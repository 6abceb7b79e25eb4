"""Quasi-linear analysis (equations 33-37): the block is constant, only the volume row follows the surface."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from solver_common.arrays import Array
from vdm.constraints import Load
from vdm.problem import LinearStep, Problem, Step
from vdm.solvers.audit import Audit, audit
from vdm.solvers.linear import BorderedFactor

VolumeRow = Literal["corrected", "printed"]
VOLUME_ROWS: tuple[VolumeRow, ...] = get_args(VolumeRow)


class QuasiLinearSolver:
    """One load step is one solve with the volume row of the surface after the last step.

    The block K is factored once; a new row only changes the m x m border system. In exact arithmetic this is the
    Sherman-Morrison update (`sherman_morrison`) without its dense inverse.

    An answer depends on the steps on the way to its load, through the volume error of the last one. A shift along
    the response to pressure closes that error. It is what smaller steps would change, and the audit reports its
    size.

    Parameters
    ----------
    problem : formulation and supports
    volume_row : "corrected": the gradient of the formulation's volume. The step closes the last one's volume
        error, `row . (x - x_last) = -(V_last - V0)`, and drifts by second order in the increment. "printed"
        (equation 33 with its total displacement): `sum A_i L_i = 0` with the updated A_i. It drifts by second
        order in the displacement itself, however small the steps.
    """

    def __init__(self, problem: Problem, volume_row: VolumeRow = "corrected") -> None:
        self.problem = problem
        self.volume_row = volume_row
        self.factor = BorderedFactor(problem)
        self.rest_volume = problem.body.at(np.zeros_like(problem.body.rest)).volume
        self._largest = 0.0  # displacement of the history so far

    def step(self, load: Load, previous: Step | None = None) -> Step:
        """Solution of one load, with the volume row of the previous step's surface."""
        problem, factor, formulation = self.problem, self.factor, self.problem.formulation
        free = factor.free
        if previous is None:
            self._largest = 0.0
        force = problem.force(load)
        x = problem.held_unknown(load)
        last = np.zeros_like(x) if previous is None else previous.unknown
        state = problem.deformed(last)
        target = -formulation.rows.dotted(x.reshape(-1)) if x.any() else np.zeros(factor.n_border)
        if self.volume_row == "corrected":
            row = formulation.deformed_columns(state)[1]
            target[0] = float(np.vdot(row, last)) - (formulation.kept_volume(last, state) - self.rest_volume)
        else:
            row = formulation.printed_volume_row(state)
            target[0] = 0.0
        target[0] -= float(np.vdot(row[~free], x[~free]))
        right_hand_side = force - formulation.apply(x) if x.any() else force
        free_x, border = factor.solve_updated(
            right_hand_side[free].reshape(-1), target, row[free].reshape(-1)
        )
        x[free] = free_x.reshape(-1, x.shape[1])
        return LinearStep(problem=problem, unknown=x, border=border, force=force)

    def audited(self, load: Load, step: Step) -> tuple[Step, Audit]:
        """The step with its audit and path error.

        The volume row belongs to an earlier surface and is not audited. The printed row's drift does not depend
        on the steps: it has no path error.
        """
        found = audit(self.problem, load, step, self.factor.correction, border=False)
        if self.volume_row == "printed" or not np.isfinite(step.unknown).all():
            return step, found
        return step, replace(found, path=self._path_error(load, step))

    def _path_error(self, load: Load, step: Step) -> float:
        """The shift that closes the volume, over the largest displacement: the whole effect of the path.

        Under one load the free unknowns are `K^-1 f + Y s`. The other border rows hold exactly, so that the
        volume alone determines s, on any path.
        """
        factor, formulation = self.factor, self.problem.formulation
        state = self.problem.deformed(step.unknown)
        row = formulation.deformed_columns(state)[1][factor.free].reshape(-1)
        target = np.zeros(factor.n_border)
        target[0] = self.rest_volume - formulation.kept_volume(step.unknown, state)
        shift = np.zeros_like(step.unknown)
        change = factor.solve_updated(np.zeros_like(row), target, row)[0]
        shift[factor.free] = change.reshape(-1, shift.shape[1])
        self._largest = max(self._largest, float(np.abs(step.displacement).max()))
        moved = float(np.abs(formulation.displacement(shift)).max())
        # under a pressure from all sides forces cancel, and the displacement is rounding
        acting = np.maximum(np.abs(self.problem.force(load)), np.abs(formulation.columns.times(step.border)))
        own = formulation.displacement(self.problem.own_motion(acting))
        largest = max(self._largest, float(np.abs(own).max()))
        return moved / largest if largest > 0.0 else 0.0


def sherman_morrison(inverse: Array, change_of_row: Array) -> Array:
    """Inverse of K + u v^T, u = e_n: the last row of K changed by v (n,) (equations 34-37).

    `K^-1 - (z w^T) / (1 + lambda)`, z = K^-1 u, w = K^-T v, lambda = v . z. The paper prints a plus sign and a
    vector in the denominator; neither inverts K + u v^T. Dense, O(n^2) a step: a reference for
    `QuasiLinearSolver`.

    Raises
    ------
    ValueError
        where the changed matrix is singular.
    """
    z = inverse[:, -1]
    w = inverse.T @ change_of_row
    denominator = 1.0 + float(change_of_row @ z)
    if abs(denominator) < np.finfo(np.float64).eps * (1.0 + float(np.abs(change_of_row) @ np.abs(z))):
        raise ValueError(
            "the updated matrix is singular; the new volume row does not see the pressure's response"
        )
    updated: Array = inverse - np.outer(z, w) / denominator
    return updated
