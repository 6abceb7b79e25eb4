"""Linear analysis (equations 27-32): one factorisation, then one pair of triangular solves per load."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np

from solver_common.arrays import Array
from vdm.constraints import Load
from vdm.formulations.base import Factorise, ReactingFactor
from vdm.problem import HeldForce, LinearStep, Problem, Step
from vdm.solution import SolverError, Status
from vdm.solvers.audit import SINGLE_LIMIT, Audit, audit, refined
from vdm.solvers.cholesky import SINGULAR, Cholesky
from vdm.solvers.single import SINGULAR as SINGLE_SINGULAR
from vdm.solvers.single import SingleFactor

Precision = Literal["single", "double"]

# smallest singular value of the scaled border system, below which it counts as singular
BORDER_TOLERANCE = 1e-11
# the same for a factor in single precision, which cannot detect its own errors: of a singular border rounding
# leaves 2e-6 at 2,500 nodes, growing as their root
SINGLE_BORDER_TOLERANCE = 5e-5


class BorderedFactor:
    """`[K -G; R^T D]` over the free nodes: K factored once, the m border unknowns by an m x m system.

    `x = K^-1 f + Y s` with Y = K^-1 G, and `(R^T Y + D) s = r - R^T K^-1 f`. Only the volume row of R is stored.
    Any other rows equal their columns and K is symmetric, so that R^T K^-1 f = Y^T f.
    """

    def __init__(self, problem: Problem, factorise: Factorise = Cholesky) -> None:
        formulation = problem.formulation
        self.free = problem.free
        # a mask of unknowns selects and assigns three times as fast as node numbers
        self.unknowns = np.repeat(self.free, formulation.components)
        self.n_border = formulation.columns.count
        self.block = formulation.factor(self.free, factorise)
        self.volume_row = formulation.rows.first[self.free].reshape(-1)
        columns = formulation.columns.at(self.free)
        self.response = formulation.response(self.block, columns)
        self._reacting = self.block if isinstance(self.block, ReactingFactor) else None
        if self._reacting is not None:
            pushes = columns.dense().reshape(-1, self.n_border)
            self._response_inside = self._reacting.solve_with_inside(pushes)[1]
        answers = self.response.dense().reshape(-1, self.n_border)
        self.schur = formulation.rows.at(self.free).dotted(answers) + formulation.corner
        self.corner = formulation.corner
        if factorise is SingleFactor:
            check_border(self.schur, self.corner, SINGLE_BORDER_TOLERANCE, SINGLE_SINGULAR)
        else:
            check_border(self.schur, self.corner)

    def solve_updated(self, force: Array, target: Array, row: Array) -> tuple[Array, Array]:
        """The same with another volume row (n_free d,), without factoring K or solving for the columns again."""
        schur = self.schur.copy()
        schur[0] = self.response.dotted(row) + self.corner[0]
        return self._solve(force, target, row, schur)[:2]

    def solve(self, force: Array, target: Array) -> tuple[Array, Array]:
        """Free unknowns (n_free d,) and border unknowns (m,) under a force (n_free d,) and border values (m,).

        For k forces at once: (n_free d, k) and (m, k).
        """
        return self._solve(force, target, self.volume_row, self.schur)[:2]

    def solve_with_held(self, force: Array, target: Array) -> tuple[Array, Array, HeldForce | None]:
        """The same, and a function for K x at the held nodes where the block's factor knows it, else None."""
        return self._solve(force, target, self.volume_row, self.schur)

    def correction(self, lacking: Array, open_rows: Array) -> tuple[Array, Array]:
        """Change of x (N, d) and border (m,) for missing forces (N, d) at free nodes and border values (m,)."""
        change = np.zeros_like(lacking)
        moved, border = self.solve(lacking.reshape(-1)[self.unknowns], open_rows)
        change.reshape(-1)[self.unknowns] = moved
        return change, border

    def _solve(
        self, force: Array, target: Array, row: Array, schur: Array
    ) -> tuple[Array, Array, HeldForce | None]:
        inside = None
        if self._reacting is None:
            first = self.block.solve(force)
        else:
            first, inside = self._reacting.solve_with_inside(force)
        met = self.response.dotted(force)
        met[0] = row @ first  # keeps the volume to rounding, however ill-conditioned K is
        border = np.asarray(np.linalg.solve(schur, target - met), dtype=np.float64)
        first += self.response.times(border).reshape(first.shape)
        if self._reacting is None or inside is None:
            return first, border, None
        inside += self._response_inside @ border
        return first, border, partial(self._reacting.held_force, inside)


def check_border(
    schur: Array, corner: Array, tolerance: float = BORDER_TOLERANCE, status: Status = SINGULAR
) -> None:
    """Refuse a singular border system `schur` (m, m), of which `corner` (m, m) does not come from the block.

    Raises
    ------
    SolverError
        with the given status.
    """
    # each border unknown in its own unit: the sum is compared with its two terms
    size = np.sqrt(np.maximum(np.abs(corner).diagonal(), np.abs(schur - corner).diagonal()))
    scaled = schur / np.outer(size, size)
    if not np.isfinite(scaled).all() or np.linalg.svd(scaled, compute_uv=False)[-1] < tolerance:
        raise SolverError(status)


class LinearSolver:
    """Eliminates fixed and constrained nodes exactly, in the volume row too.

    Parameters
    ----------
    problem : formulation and supports
    precision : of the factor of K; the border is in double precision always
    refine : whether the audit of a history refines by residuals in double precision, where they show a gain
    factor : of the problem, where there is one

    Raises
    ------
    SolverError
        where the operator is singular.
    """

    def __init__(
        self,
        problem: Problem,
        precision: Precision = "double",
        refine: bool = True,
        factor: BorderedFactor | None = None,
    ) -> None:
        self.problem = problem
        self.precision = precision
        self.refine = refine
        self.factor = factor or BorderedFactor(problem, SingleFactor if precision == "single" else Cholesky)

    def step(self, load: Load, previous: Step | None = None) -> Step:  # noqa: ARG002 - one interface for all solvers
        """Solution of one load; the previous step has no effect."""
        problem, factor = self.problem, self.factor
        force = problem.force(load)
        x = problem.held_unknown(load)
        right_hand_side, lifted = force, None
        target = np.zeros(factor.n_border)
        if load.prescribed is not None and x.any():
            lifted = problem.formulation.apply(x)
            right_hand_side = force - lifted
            target = -problem.formulation.rows.dotted(x.reshape(-1))
        pushed = right_hand_side.reshape(-1)[factor.unknowns]
        free_x, border, held = factor.solve_with_held(pushed, target)
        x.reshape(-1)[factor.unknowns] = free_x
        if held is not None and lifted is not None:
            held = partial(_sum, held, lifted[problem.held_nodes])
        return LinearStep(problem=problem, unknown=x, border=border, force=force, held_force=held)

    def audited(self, load: Load, step: Step) -> tuple[Step, Audit]:
        """The step, refined where that pays, and its audit."""
        if self.refine:
            return refined(self.problem, load, step, self.factor.correction)
        found = audit(self.problem, load, step, self.factor.correction)
        return step, replace(found, limit=SINGLE_LIMIT) if self.precision == "single" else found


def _sum(held: HeldForce, lifted: Array) -> Array:
    return held() + lifted
