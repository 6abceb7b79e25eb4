"""Large deformation in total form: current areas and normals, exact volume, load stepping with halving (38)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vdm.constraints import Load
from vdm.deformed import DeformedSurface
from vdm.problem import Problem, Step
from vdm.solution import Status
from vdm.solvers.anderson import Anderson
from vdm.solvers.linear import BorderedFactor

Array = NDArray[np.float64]

MAX_ITERATIONS = 60
HISTORY = 10
FURTHEST = 3.0  # sizes of the body
SMALLEST_SUBSTEP = 1.0 / 64.0
GROWTH_LIMIT = 1e3  # a residual that grew by this much will not come back

NOT_CONVERGED = Status(
    "not-converged",
    "the nonlinear balance was not found, the load step halved six times",
    "use smaller load steps, a smaller load or a stiffer material",
)


@dataclass(frozen=True)
class _Balance:
    """A state and what its balance lacks."""

    x: Array
    pressure: float
    state: DeformedSurface
    column: Array
    row: Array
    lacking: Array
    scale: float


class NonlinearSolver:
    """Finds x and dP with `internal(x) - dP column(x) - force(x) = 0` and V(x) = V0 exactly.

    The rest state's bordered factor, with the current pressure column and volume gradient as border, turns what
    the balance lacks into a correction; Anderson acceleration mixes the corrections. A last shift along the
    response to pressure closes the volume to rounding. A load step starts from the last converged one and is
    halved where it fails; nothing of a failed step is kept.

    Parameters
    ----------
    problem : formulation and supports
    tolerance : of the balance's residual, relative to the larger of the internal and the applied forces
    volume_tolerance : of |V - V0| / V0
    """

    def __init__(self, problem: Problem, tolerance: float = 1e-8, volume_tolerance: float = 1e-13) -> None:
        self.problem = problem
        self.tolerance = tolerance
        self.volume_tolerance = volume_tolerance
        self.factor = BorderedFactor(problem)
        self.free = problem.free
        self.rest_volume = problem.body.at(np.zeros_like(problem.body.rest)).volume
        # a node that leaves the body by several of its sizes will not come back
        self.reach = FURTHEST * float(np.ptp(problem.body.rest, axis=0).max())
        n, d = problem.formulation.surface.n_nodes, problem.formulation.components
        zero = np.zeros((n, d))
        self._unloaded = Load(np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3)))
        self._last: tuple[Load, Array, float] = (self._unloaded, zero, 0.0)

    def step(self, load: Load, previous: Step | None = None) -> Step:
        """Solution of one load, started from the last converged one; without a previous step, from rest."""
        if previous is None:
            self._last = (self._unloaded, np.zeros_like(self._last[1]), 0.0)
        start, x, pressure = self._last
        reached, width, iterations = 0.0, 1.0, 0
        balance: _Balance | None = None
        while reached < 1.0:
            target = min(reached + width, 1.0)
            found, used = self._solve(_between(start, load, target), x, pressure)
            iterations += used
            if found is None:
                width *= 0.5
                if width < SMALLEST_SUBSTEP:
                    return self._failed(x, iterations)
                continue
            balance, x, pressure, reached = found, found.x, found.pressure, target
        if balance is None:
            return self._failed(x, iterations)
        self._last = (load, x, pressure)
        border = np.zeros(self.factor.n_border)
        border[0] = pressure
        energy = self.problem.formulation.deformed_energy(x, balance.state)
        return self.problem.package(x, border, balance.lacking, energy, iterations)

    def _failed(self, x: Array, iterations: int) -> Step:
        lost = np.full_like(x, np.nan)
        border = np.full(self.factor.n_border, np.nan)
        return self.problem.package(lost, border, lost, float("nan"), iterations, NOT_CONVERGED)

    def _balance(self, load: Load, x: Array, pressure: float) -> _Balance:
        problem = self.problem
        state = problem.deformed(x)
        column, row = problem.formulation.deformed_columns(state)
        internal = problem.formulation.deformed_internal_force(x, state)
        applied = problem.deformed_force(load, state, column) + pressure * column
        free = self.free
        scale = max(float(np.linalg.norm(internal[free])), float(np.linalg.norm(applied[free])))
        return _Balance(x, pressure, state, column, row, internal - applied, scale)

    def _solve(self, load: Load, x: Array, pressure: float) -> tuple[_Balance | None, int]:
        free, factor = self.free, self.factor
        held = self.problem.held_unknown(load)
        x = np.where(free[:, None], x, held)
        # the pressure is mixed beside displacements: in units that make its column as long as theirs
        unit = float(np.linalg.norm(factor.response[:, 0]))
        anderson = Anderson(HISTORY)
        smallest = np.inf
        for iteration in range(MAX_ITERATIONS):
            if not np.abs(self.problem.formulation.displacement(x)).max() < self.reach:
                return None, iteration
            balance = self._balance(load, x, pressure)
            residual = float(np.linalg.norm(balance.lacking[free]))
            gap = (balance.state.volume - self.rest_volume) / self.rest_volume
            if not np.isfinite(residual) or residual > GROWTH_LIMIT * max(smallest, balance.scale):
                return None, iteration
            smallest = min(smallest, residual)
            if residual <= self.tolerance * balance.scale and abs(gap) <= self.tolerance:
                return self._close_volume(load, balance), iteration
            target = np.zeros(factor.n_border)
            target[0] = -gap * self.rest_volume
            column, row = balance.column[free].reshape(-1), balance.row[free].reshape(-1)
            change, border = factor.solve_updated(-balance.lacking[free].reshape(-1), target, column, row)
            iterate = np.append(x[free].reshape(-1), pressure * unit)
            mixed = anderson.next(iterate, np.append(change, border[0] * unit))
            x = x.copy()
            x[free] = mixed[:-1].reshape(-1, x.shape[1])
            pressure = float(mixed[-1]) / unit
        return None, MAX_ITERATIONS

    def _close_volume(self, load: Load, balance: _Balance) -> _Balance | None:
        shift = self.factor.response[:, 0].reshape(-1, balance.x.shape[1])
        for _ in range(5):
            gap = balance.state.volume - self.rest_volume
            if abs(gap) <= self.volume_tolerance * self.rest_volume:
                return balance
            amount = -gap / float(np.vdot(balance.row[self.free], shift))
            x = balance.x.copy()
            x[self.free] += amount * shift
            balance = self._balance(load, x, balance.pressure + amount)
        return None


def _between(start: Load, end: Load, share: float) -> Load:
    """The load at a share of the way from one to another."""
    if share == 1.0:
        return end

    def mix(a: Array | None, b: Array | None) -> Array | None:
        if b is None:
            return None
        return share * b if a is None else (1.0 - share) * a + share * b

    pressure = (1.0 - share) * start.contact_pressure + share * end.contact_pressure
    return Load(pressure, mix(start.contact_force, end.contact_force), mix(start.prescribed, end.prescribed))
