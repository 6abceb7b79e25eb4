"""The nonlinear solver of a body of boundary elements: as many parts as it needs, and what twice as many say."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from solver_common.arrays import Index
from vdm.constraints import Load
from vdm.material import MOST_PARTS
from vdm.parts.body import Parts, parts_wanted
from vdm.problem import Problem, Step
from vdm.solution import SolverError
from vdm.solvers.audit import Audit
from vdm.solvers.linear import BorderedFactor, LinearSolver
from vdm.solvers.nonlinear import DeformedStep, NonlinearSolver, carried


class PartsSolver:
    """Solves a history of loads on a body in parts.

    How many is `Parameters.parts`, or follows from the small rotations of the linear answer to the largest load.
    Where there is more than one, or the number is given, each answer is compared with that of twice as many.

    Parameters
    ----------
    problem : of boundary elements
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.factor = BorderedFactor(problem)
        self._linear = LinearSolver(problem, factor=self.factor)
        self._solvers: dict[int, NonlinearSolver] = {}
        self._given = problem.formulation.parameters.parts
        self._finer: NonlinearSolver | None = None
        self._finer_step: Step | None = None
        self._solver = self._of(self._given or 1)

    def prepare(self, loads: Sequence[Load]) -> float:
        """Cut the body as its loads need; the seconds that this took."""
        start = time.perf_counter()
        surface, load = self.problem.formulation.surface, self._unturned(self._largest(loads))
        wanted = parts_wanted(surface, self._linear.step(load).displacement)
        count = self._given or min(wanted, MOST_PARTS)
        self._solver = self._of(count)
        body = self._solver.body
        assert isinstance(body, Parts)
        body.wanted = 1 if self._given else wanted
        seconds = time.perf_counter() - start
        self._finer = self._finer_step = None
        if self._given or body.n_parts > 1:
            try:
                self._finer = self._of(2 * body.n_parts)
            except SolverError:
                self._finer = None
        return seconds

    def step(self, load: Load, previous: Step | None = None) -> Step:
        """Solution of one load."""
        return self._solver.step(load, previous)

    def audited(self, load: Load, step: Step) -> tuple[Step, Audit]:
        """The step and what its balance on the deformed surface lacks."""
        return self._solver.audited(load, step)

    @property
    def part_of_node(self) -> Index | None:
        """See `Solution.part_of_node`."""
        body = self._solver.body
        assert isinstance(body, Parts)
        return body.owner + 1 if body.n_parts > 1 else None

    def scalars(self, load: Load, step: Step) -> dict[str, float]:
        """What is told of a step beside its displacement: see `Parts.scalars`, and `parts_error`.

        That is the distance to the answer of twice the parts, over its size, by area; NaN where there is none.
        """
        if not isinstance(step, DeformedStep) or step.balance is None:
            return {}
        found = self._solver.body.scalars(step.balance)
        if self._finer is None or self._finer.body.n_pressures == self._solver.body.n_pressures:
            return found
        self._finer_step = self._finer.step(load, self._finer_step)
        area = self.problem.formulation.surface.nodal_areas[:, None]
        other = self._finer_step.displacement
        size = float(np.sqrt((area * other**2).sum()))
        apart = float(np.sqrt((area * (other - step.displacement) ** 2).sum()))
        return {**found, "parts_error": apart / size if size > 0.0 else 0.0}

    def _largest(self, loads: Sequence[Load]) -> Load:
        def size(load: Load) -> float:
            return float(
                np.linalg.norm(self.problem.force(load)) + np.linalg.norm(self.problem.held_unknown(load))
            )

        return max(loads, key=size)

    def _unturned(self, load: Load) -> Load:
        """The load in the frame of its supports: what turns with them does not bend the body."""
        problem, rest = self.problem, self.problem.body.rest
        held = problem.held_unknown(load)
        if not held.any():
            return load
        nodes = problem.held_nodes
        turn = carried(rest, nodes, np.zeros_like(held), held)[1]
        middle, centre = rest[nodes].mean(axis=0), (rest + held)[nodes].mean(axis=0)
        return replace(load, prescribed=(rest + held - centre) @ turn.T + middle - rest)

    def _of(self, count: int) -> NonlinearSolver:
        if count not in self._solvers:
            body = Parts(self.problem, count, self.factor.block)
            self._solvers[count] = NonlinearSolver(self.problem, body, self.factor)
        return self._solvers[count]
