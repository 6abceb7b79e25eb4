"""Other supports without another set-up: the factor at hand, corrected by a small dense system (capacitance).

Of nodes r that a model holds and that are let go, and nodes a that it leaves free and that are held, the answer is

`u = u_0 + X v + Y f`,

u_0 that of the model itself, X its answers to unit motions of r without load, Y those to unit forces at a. The
motions v and forces f follow from what is asked: no reaction at r, the prescribed displacement at a. This is exact;
James and Pai (SIGGRAPH 1999) use it for contacts that change. Its price is a column of the size of an answer for
every unknown of r and a, once, and their square in a frame: for a few hundred nodes at most.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import linalg

from solver_common.arrays import Array, Mask
from vdm.constraints import Load, node_mask
from vdm.problem import LinearStep, Problem, check_held
from vdm.solution import SolverError
from vdm.solvers.cholesky import SINGULAR
from vdm.solvers.linear import LinearSolver

# smallest pivot of the small system, in units of its diagonal, that is told from a singular one
PIVOT_TOLERANCE = 1e-11


class ChangedSupport:
    """A linear model held at other nodes than those it was set up with.

    Parameters
    ----------
    solver : of the model; its factor is used and left as it is
    fixed, constrained : (N,) masks of the nodes that are held now, or moved by `Load.prescribed`

    Raises
    ------
    ConstraintError
        masks that do not fit, or no free node.
    SolverError
        supports that leave a motion free.
    """

    def __init__(self, solver: LinearSolver, fixed: Mask, constrained: Mask | None = None) -> None:
        base = solver.problem
        form = base.formulation
        n = form.surface.n_nodes
        support = replace(
            base.support,
            fixed=node_mask(fixed, "fixed", n),
            constrained=node_mask(constrained, "constrained", n),
        )
        check_held(type(form), form.surface, form.parameters, support.held)
        self.problem = Problem(form, support)
        self.factor = solver.factor
        self._released = np.repeat(~base.free & ~support.held, form.components)
        self._added = np.repeat(base.free & support.held, form.components)
        motions, borders = self._motions()
        forces, more = self._forces()
        self._columns, self._borders = np.hstack([motions, forces]), np.hstack([borders, more])
        lacking = self._lacking(self._columns, self._borders)
        system = np.vstack([lacking[self._released], self._columns[self._added]])
        # each unknown in its own unit: motions beside forces
        self._unit = 1.0 / np.sqrt(np.abs(np.diagonal(system)))
        self._factors = None
        if len(system):
            self._factors = linalg.lu_factor(self._unit[:, None] * system * self._unit)
            pivots = np.abs(np.diagonal(self._factors[0]))
            if not pivots.min() > PIVOT_TOLERANCE:
                raise SolverError(SINGULAR)

    def step(self, load: Load) -> LinearStep:
        """Solution of one load under the supports as they are now; reactions and energy come from the operator."""
        problem, factor = self.problem, self.factor
        force = problem.force(load)
        given = problem.held_unknown(load)
        x = np.where(np.repeat(factor.free, given.shape[1]).reshape(given.shape), 0.0, given)
        right, target = force, np.zeros(factor.n_border)
        if x.any():
            right = force - problem.formulation.apply(x)
            target = -problem.formulation.rows.dotted(x.reshape(-1))
        free_x, border = factor.solve(right.reshape(-1)[factor.unknowns], target)
        x.reshape(-1)[factor.unknowns] = free_x
        if self._factors is not None:
            lacking = self._lacking(x.reshape(-1, 1), border[:, None])[:, 0] - force.reshape(-1)
            wanted = np.concatenate([-lacking[self._released], (given - x).reshape(-1)[self._added]])
            change = self._unit * linalg.lu_solve(self._factors, self._unit * wanted)
            x += (self._columns @ change).reshape(x.shape)
            border = border + self._borders @ change
            # to the last digit: the held stay where they are
            x.reshape(-1)[self._added] = given.reshape(-1)[self._added]
        return LinearStep(problem=problem, unknown=x, border=border, force=force)

    def _motions(self) -> tuple[Array, Array]:
        """(N d, r) answers to unit motions of the released, all others held as before, and their border (m, r)."""
        form, factor = self.problem.formulation, self.factor
        moved = np.flatnonzero(self._released)
        x = np.zeros((len(self._released), len(moved)))
        x[moved, np.arange(len(moved))] = 1.0
        answer, border = factor.solve(-self._pulled(x)[factor.unknowns], -form.rows.dotted(x))
        x[factor.unknowns] = answer
        return x, border

    def _forces(self) -> tuple[Array, Array]:
        """(N d, a) answers to unit forces at the nodes that are held now, and their border (m, a)."""
        factor, pushed = self.factor, np.flatnonzero(self._added)
        force = np.zeros((len(self._added), len(pushed)))
        force[pushed, np.arange(len(pushed))] = 1.0
        answer, border = factor.solve(force[factor.unknowns], np.zeros((factor.n_border, len(pushed))))
        x = np.zeros_like(force)
        x[factor.unknowns] = answer
        return x, border

    def _lacking(self, x: Array, border: Array) -> Array:
        """(N d, k) what holds displacements (N d, k) without load: K x less the border's forces."""
        return self._pulled(x) - self.problem.formulation.columns.times(border).reshape(x.shape)

    def _pulled(self, x: Array) -> Array:
        """(N d, k) K x of displacements (N d, k)."""
        form, pulled = self.problem.formulation, np.empty_like(x)
        for k in range(x.shape[1]):
            pulled[:, k] = form.apply(x[:, k].reshape(-1, form.components)).reshape(-1)
        return pulled
