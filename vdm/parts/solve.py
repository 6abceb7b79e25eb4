"""The nonlinear solver of boundary elements: chooses the number of parts, and compares with twice as many."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from solver_common.arrays import Array, Index
from vdm.constraints import Load
from vdm.material import MOST_PARTS
from vdm.parts.body import LARGEST_STRAIN, Parts, parts_wanted, pieces_of
from vdm.parts.cut import Cut
from vdm.parts.guess import guessed
from vdm.peers.bem import BoundaryFormulation
from vdm.problem import Problem, Step
from vdm.reservations import LIMIT
from vdm.solution import Solution, SolverError
from vdm.solvers.audit import Audit
from vdm.solvers.linear import BorderedFactor, LinearSolver
from vdm.solvers.nonlinear import SMALLEST_MOTION, DeformedStep, NonlinearSolver, carried


class PartsSolver:
    """Solves a history of loads on a body in parts.

    `Parameters.parts` gives the number of parts. Else it follows from the rotations in the linear answer to the
    largest load, and is doubled if the answers need more. If there is more than one part, or the number is given,
    each answer is compared with that of twice as many.

    Parameters
    ----------
    problem : a problem of boundary elements
    cut : a cut to use instead of a new one: for its number of parts, or for more than half of it, as a fork is cut
        into more parts than asked for

    Attributes
    ----------
    least : least number of parts, as former loads needed
    """

    def __init__(self, problem: Problem, cut: Cut | None = None) -> None:
        self._whole, self._cut = problem, cut
        self._solvers: dict[int, NonlinearSolver] = {}
        self._given = problem.formulation.parameters.parts
        self.least = 1
        self._finer: NonlinearSolver | None = None
        self._finer_step: Step | None = None
        self._solver: NonlinearSolver | None = None
        self._known: tuple[Load, Array, float] | None = None

    @property
    def solver(self) -> NonlinearSolver:
        """The solver for as many parts as `prepare` chose; before that, for the number given, or one."""
        if self._solver is None:
            self._solver = self._of(self._given or 1)
        return self._solver

    @property
    def body(self) -> Parts:
        """The body of `solver`."""
        return _parts(self.solver)

    @property
    def problem(self) -> Problem:
        """The problem at small displacements, in as many parts."""
        return self.solver.problem

    @property
    def factor(self) -> BorderedFactor:
        """The factor of that problem."""
        return self.solver.factor

    def prepare(self, loads: Sequence[Load], compared: bool = True, count: int = 0) -> float:
        """Cut the body into `count` parts, or if 0 as many as its loads need; returns the seconds it took.

        `guessed` gives a first number, except for `bem-sparse`; it avoids a set-up of the whole body in one part.
        The linear answer of these parts then decides. Unless answers are `compared`, no body with twice the parts
        is made.
        """
        start = time.perf_counter()
        load = self._unturned(max(loads, key=self._size))
        if given := self._given or count:
            self._solver = self._of(given)
            self.body.wanted = given
        else:
            is_dense = type(self._whole.formulation) is BoundaryFormulation
            guess = self._wanted(guessed(self._whole, load)) if is_dense else 1
            count = min(max(self.least, guess), MOST_PARTS)
            self._solver = self._fitting(count)
            linear = LinearSolver(self.problem, factor=self.factor).step(load)
            needed = max(self.least, self._wanted(linear.displacement))
            if min(needed, MOST_PARTS) != count:
                self._solver = self._fitting(min(needed, MOST_PARTS))
            self.body.wanted = needed
        seconds = time.perf_counter() - start
        self._finer_step = None
        asked = compared and (self._given or self.body.n_parts > 1)
        self._finer = self._twice(self.body) if asked else None
        if self._finer is not None and self._known is not None:
            (known, x, pressure), finer = self._known, _parts(self._finer)
            self._finer.begin_near(known, inside(finer.rest, x), np.full(finer.n_pressures, pressure))
            self._known = None
        return seconds

    def begin_at(self, load: Load, x: Array, pressure: Array) -> None:
        """As in `NonlinearSolver`. After the next `prepare`, twice the parts start near that state too.

        From rest, they would need many steps to a load that strains them far.
        """
        self.solver.begin_at(load, x, pressure)
        self._known = load, x[: self._whole.formulation.surface.n_nodes], float(pressure.mean())

    def doubled(self, solution: Solution) -> bool:
        """Double the number of parts if the answers need it; returns whether it was doubled.

        A failed answer needs it, unless strain is the cause: the last state is strained by more than
        `LARGEST_STRAIN` and turns by less than `MOST_TURN` within its parts. A found answer needs it if it turns by
        more than `MOST_TURN` within a part, which the linear answer did not predict. It also needs it if the error
        of the parts exceeds that of the mesh, and their sum the limit of `vdm.reservations`. Found answers are
        doubled only if twice the parts can be compared with twice as many again.
        """
        if self._given:
            return False
        failed = [not status.ok for status in solution.status]
        answered, scalars = not any(failed), solution.scalars
        if max(self._wanted(self._changed(u)) for u in solution.displacement) <= self.body.n_parts:
            if not answered and scalars["part_strain"][failed.index(True)] > LARGEST_STRAIN:
                return False
            apart, mesh = (scalars.get(name, np.zeros(1)) for name in ("parts_error", "mesh_error"))
            if answered and not ((apart > mesh) & (apart + mesh > LIMIT)).any():
                return False
        finer = self._finer or self._twice(self.body)
        if finer is None or (answered and self._twice(_parts(finer)) is None):
            return False
        body = _parts(finer)
        body.wanted = self.body.wanted
        self._solver, self.least = finer, body.n_parts
        self._finer, self._finer_step = self._twice(body), None
        return True

    def step(self, load: Load, previous: Step | None = None) -> Step:
        """Solution of one load."""
        return self.solver.step(load, previous)

    def audited(self, load: Load, step: Step) -> tuple[Step, Audit]:
        """As in `NonlinearSolver`."""
        return self.solver.audited(load, step)

    @property
    def finer(self) -> Array | None:
        """(N, 3) displacement of twice the parts under the last load of `scalars` [m]; None if it was not found."""
        step = self._finer_step
        return None if step is None or not step.status.ok else step.displacement

    @property
    def part_of_node(self) -> Index | None:
        """(N,) as in `Solution`."""
        return self.body.owner + 1 if self.body.n_parts > 1 else None

    def scalars(self, step: Step) -> dict[str, float]:
        """Further outputs of a step: those of `Parts.scalars`, and `parts_error`.

        `parts_error` is the relative difference from the answer of twice the parts under the load that was reached,
        in displacement or in change of shape. It is NaN if no stable such answer was found, and if nothing acts or
        moves.
        """
        if not isinstance(step, DeformedStep) or step.balance is None:
            return {}
        found = self.body.scalars(step.balance)
        if self._finer is None:
            return found
        if self._size(step.balance.load) == 0.0:
            return {**found, "parts_error": np.nan}
        load = step.balance.load
        self._finer_step = self._finer.audited(load, self._finer.step(load, self._finer_step))[0]
        if not self._finer_step.status.ok:
            return {**found, "parts_error": np.nan}
        return {**found, "parts_error": self._apart(step.displacement, self._finer_step.displacement)}

    def _apart(self, u: Array, finer: Array) -> float:
        """Relative L2 difference of two displacements (N, 3) or of their changes of shape, the larger of the two.

        It is relative to `finer` and NaN if that is zero. A change of shape of the size of rounding is left out.
        """
        areas = self._whole.formulation.surface.nodal_areas

        def size(x: Array) -> float:
            return float(np.sqrt(areas @ np.square(x).sum(axis=1)))

        moved, own, other = size(finer), self._changed(u), self._changed(finer)
        if moved == 0.0:
            return np.nan
        apart, changed = size(u - finer) / moved, size(other)
        return max(apart, size(own - other) / changed) if changed > SMALLEST_MOTION * moved else apart

    def _changed(self, displacement: Array) -> Array:
        """(N, 3) change of shape: a displacement less its best-fit rigid motion, turned back to rest [m]."""
        body, areas = self._whole.body, self._whole.formulation.surface.nodal_areas
        state = body.at(displacement)
        left = state.positions @ state.rotation.T - body.rest
        return np.asarray(left - areas @ left / areas.sum())

    @cached_property
    def _pieces(self) -> list[Index]:
        return pieces_of(self._whole.formulation.surface)

    def _wanted(self, displacement: Array) -> int:
        """How many parts the body needs for a displacement (N, 3)."""
        return parts_wanted(self._whole.formulation.surface, self._pieces, displacement)

    def _size(self, load: Load) -> float:
        """Norm of the forces of a load, plus that of its prescribed motion, to find the largest load.

        The weight counts by its pressure alone: its force in a compressible body needs the matrix.
        """
        problem, support = self._whole, self._whole.support
        force = replace(problem, support=replace(support, hydrostatic=None)).force(load)
        if support.hydrostatic is not None:
            force = force + problem.formulation.pressed * support.hydrostatic[:, None]
        return float(np.linalg.norm(force) + np.linalg.norm(problem.held_unknown(load)))

    def _unturned(self, load: Load) -> Load:
        """The load in the frame of its supports: a rigid motion with them does not bend the body."""
        problem, rest = self._whole, self._whole.body.rest
        held = problem.held_unknown(load)
        if not held.any():
            return load
        nodes = problem.held_nodes
        turn = carried(rest, nodes, np.zeros_like(held), held)[1]
        middle, centre = rest[nodes].mean(axis=0), (rest + held)[nodes].mean(axis=0)
        return replace(load, prescribed=(rest + held - centre) @ turn.T + middle - rest)

    def _twice(self, body: Parts) -> NonlinearSolver | None:
        """The solver for twice the parts; None if the body cannot be cut into more."""
        try:
            finer = self._of(2 * body.n_parts)
        except SolverError:
            return None
        return finer if _parts(finer).n_parts > body.n_parts else None

    def _fitting(self, count: int) -> NonlinearSolver:
        """The solver for `count` parts; the number is doubled while a part has more nodes than a matrix takes."""
        try:
            return self._of(count)
        except SolverError as error:
            if error.status.code != "too-large" or 2 * count > MOST_PARTS:
                raise
        self.least = 2 * count
        return self._fitting(self.least)

    def _of(self, count: int) -> NonlinearSolver:
        if count not in self._solvers:
            made = 0 if self._cut is None else len(self._cut.parts)  # a fork may have more than asked for
            is_cut = made > 0 and (count == self._given or count <= made < 2 * count)
            body = Parts(self._whole, count, self._cut if is_cut else None)
            self._solvers[count] = NonlinearSolver(body.problem, body, body.factor)
        return self._solvers[count]


def _parts(solver: NonlinearSolver) -> Parts:
    assert isinstance(solver.body, Parts)
    return solver.body


def inside(rest: Array, x: Array) -> Array:
    """(n, 3) displacement of all nodes, `rest` (n, 3), from that of the first N, x (N, 3): a biharmonic spline."""
    from scipy.interpolate import RBFInterpolator  # slow to load, and only scans need it

    n = len(x)
    return np.vstack([x, RBFInterpolator(rest[:n], x, kernel="linear")(rest[n:])])
