"""Large deformation in total form: current areas and normals, exact volume, load stepping with halving (38)."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from solver_common.arrays import Array, Index, Mask
from solver_common.progress import Progress, tell
from solver_common.solution import ENDED, RESIDUAL
from solver_common.substeps import Substeps
from vdm.constraints import Load
from vdm.deformed import best_rotation
from vdm.problem import Problem, Step
from vdm.solution import CONVERGED, Status
from vdm.solvers.anderson import Anderson
from vdm.solvers.audit import ERROR_LIMIT, Audit
from vdm.solvers.linear import BorderedFactor

MAX_ITERATIONS = 60
HISTORY = 10
FURTHEST = 3.0  # sizes of the body
# of the held nodes' motion that no rigid motion explains: beyond it they do not move as one body
AS_ONE = 0.3
LEAST_TURN = 1e-9  # of the second moment of the held nodes: rotations about which they say less are not made
MOST_DEGREE = 3  # of the polynomial in the loads that a start is made by
MOST_STATES = 10  # converged ones that it is made of: so many tell a cubic of two loads
FURTHEST_AHEAD = 2.0 ** (MOST_DEGREE + 1)  # sum of their weights without signs: of equal steps in line
MISSED = (
    0.1  # of a load's change, that a mixture of loads may miss, and of the way, that a degree more may add
)
SAME = 1e-12  # of squares of loads: below it changes do not tell a direction
# sizes of the body; forces that move it less are measured by those that move it so far
SMALLEST_MOTION = 1e-6
# of the balance's residual over the larger of the internal and the applied forces, or over the force of a pressure
# that moves the body by `SMALLEST_MOTION` where both are smaller
TOLERANCE = 1e-8
VOLUME_TOLERANCE = 1e-13  # of |V - V0| / V0
# of that residual: below it the slope of a state has its corrections mixed too
NEAR = 0.02
GROWTH_LIMIT = 1e3  # a residual that grew by this much will not come back

REMEDY = "use smaller load steps, a smaller load or a stiffer material; a body may snap through there"
UNSTABLE = "the one that was found is not stable"
LEFT = (
    "; the last balance has {:.3g} % of its least stiffness without forces, and none is left at a limit point"
)


@dataclass(frozen=True)
class Balance:
    """A state of n nodes, m pressures and what its balance lacks.

    Attributes
    ----------
    load : that acts
    x : (n, d) unknowns
    pressure : (m,) [Pa]
    gap : (m,) change of each volume that is kept, over its size at rest
    lacking : (n, d) generalised force, internal less applied [N]
    scale : the larger of the internal and the applied forces [N]
    parts : of the body, what its own correction reads again
    """

    load: Load
    x: Array
    pressure: Array
    gap: Array
    lacking: Array
    scale: float
    parts: Any = field(repr=False)


class Large(Protocol):
    """A body at large displacements: n nodes, of which the first N are the surface's, and m kept volumes."""

    rest: Array  # (n, 3) [m]
    free: Mask  # (n,)
    n_pressures: int
    # whether `correction` has the slope of the state itself, so that nothing is to be learnt of it
    has_slope: bool

    def balance(self, load: Load, x: Array, pressure: Array) -> Balance:
        """What a state lacks."""
        ...

    def correction(self, balance: Balance, lacking: Array, gap: Array, turn: Array) -> tuple[Array, Array]:
        """Change of x (n_free, d) and of the pressures (m,) that supplies forces (n, d) and closes gaps (m,).

        By a slope near the state; `turn` (3, 3) is how the supports are turned from rest.
        """
        ...

    def closing(self, balance: Balance, change: Array, pushed: Array) -> tuple[Array, Array]:  # noqa: ARG002
        """What closes the gaps of a state to first order after changes that were mixed; here the last one does.

        Of x (n_free, d) and of the pressures (m,).
        """
        return np.zeros_like(change), np.zeros_like(balance.gap)

    def stiffness_left(self, balance: Balance) -> float:  # noqa: ARG002
        """The least stiffness of a state over what it is without forces: 1 at rest, 0 at a limit point.

        Negative where a state is not stable; NaN of a body that does not tell it.
        """
        return np.nan

    def energy(self, balance: Balance) -> float:
        """Elastic energy [J]."""
        ...

    def mean_pressure(self, balance: Balance) -> float:
        """By volume [Pa]."""
        ...

    def reserved(self, status: Status, balance: Balance) -> Status:  # noqa: ARG002
        """The status of an answer, with what the body itself does not follow; one body follows all it knows."""
        return status


class Whole(Large):
    """A formulation's body as it is, with the factor at rest for its slope: one fluid, one pressure."""

    n_pressures = 1
    has_slope = False

    def __init__(self, problem: Problem, factor: BorderedFactor) -> None:
        self.problem, self.factor = problem, factor
        self.rest, self.free = problem.body.rest, problem.free
        self._free_nodes = np.flatnonzero(self.free)
        zero = np.zeros((len(self.rest), problem.formulation.components))
        self.rest_volume = problem.formulation.kept_volume(zero, problem.deformed(zero))

    def balance(self, load: Load, x: Array, pressure: Array) -> Balance:
        problem, nodes = self.problem, self._free_nodes
        state = problem.deformed(x)
        column, row = problem.formulation.deformed_columns(state)
        internal = problem.formulation.deformed_internal_force(x, state)
        applied = problem.deformed_force(load, state, column) + float(pressure[0]) * column
        scale = max(float(np.linalg.norm(internal[nodes])), float(np.linalg.norm(applied[nodes])))
        gap = problem.formulation.kept_volume(x, state) / self.rest_volume - 1.0
        return Balance(load, x, pressure, np.array([gap]), internal - applied, scale, (state, column, row))

    def correction(self, balance: Balance, lacking: Array, gap: Array, turn: Array) -> tuple[Array, Array]:
        nodes = self._free_nodes
        target = np.zeros(self.factor.n_border)
        target[0] = -gap[0] * self.rest_volume
        # the pressure's column stays that of the rest state: it moves no balance, only the way there
        force, row = (turned(part[nodes], turn.T).reshape(-1) for part in (-lacking, balance.parts[2]))
        change, border = self.factor.solve_updated(force, target, row)
        return turned(change.reshape(len(nodes), -1), turn), border[:1]

    def energy(self, balance: Balance) -> float:
        return self.problem.formulation.deformed_energy(balance.x, balance.parts[0])

    def mean_pressure(self, balance: Balance) -> float:
        return float(balance.pressure[0])


@dataclass(frozen=True)
class _Converged:
    """A load and its solution."""

    load: Load
    x: Array
    pressure: Array


@dataclass(frozen=True, kw_only=True)
class DeformedStep(Step):
    """A step whose balance is that of the deformed surface.

    Attributes
    ----------
    lacking : (n_held, d) generalised force that the supports give, internal less applied [N]
    stored : elastic energy [J]
    balance : of all nodes of the body, of a failed step the last one on the way to its load; None where a solver
        has none
    reached : share of the way to its load at which that is
    """

    lacking: Array = field(repr=False)
    stored: float
    balance: Balance | None = field(default=None, repr=False)
    reached: float = 1.0

    @property
    def energy(self) -> float:
        """Elastic energy [J]."""
        return self.stored

    def lacking_at_held(self) -> Array:
        """As in `Step`."""
        return self.lacking


class NonlinearSolver:
    """Finds x and the pressures with `internal(x) - sum p column(x) - force(x) = 0` and each V(x) = V0.

    V is the volume that the body keeps: the polyhedron's, but of the printed form. A part with nu < 1/2 gives
    way by its pressure over kappa (`vdm.parts.body`).

    The body's slope (`Large.correction`) turns what the balance lacks into a correction. Where that is not the
    slope of the state itself, or near the balance, Anderson acceleration mixes the corrections, also by what the
    last loads told of the slope. A last shift closes the volumes to rounding. A load step starts from the last
    converged one. Where it fails it is tried again with all corrections mixed, then halved
    (`solver_common.substeps`). One that failed holds the last balance on the way to its load, and the next step
    starts where it did. Where the held nodes are moved, the body starts carried along as they are, best fit by a
    rigid motion.

    Parameters
    ----------
    problem : formulation and supports
    body : what is solved, None for the formulation's body as it is
    factor : of the problem, where there is one
    """

    def __init__(
        self, problem: Problem, body: Large | None = None, factor: BorderedFactor | None = None
    ) -> None:
        self.problem = problem
        self.factor = factor or BorderedFactor(problem)
        self.body: Large = body or Whole(problem, self.factor)
        self.free = self.body.free
        self._free_nodes = np.flatnonzero(self.free)
        self._anderson = Anderson(HISTORY)
        # a node that leaves the body by several of its sizes will not come back
        size = float(np.ptp(problem.body.rest, axis=0).max())
        self.reach = FURTHEST * size
        n, d = problem.formulation.surface.n_nodes, problem.formulation.components
        answer = np.zeros((n, d))
        pressed = problem.formulation.pressed[problem.free]
        answer[problem.free] = self.factor.block.solve(pressed.reshape(-1)).reshape(pressed.shape)
        # the pressure is mixed beside displacements: in units that make its column as long as theirs
        self._unit = float(np.linalg.norm(answer))
        moved = float(np.abs(problem.formulation.displacement(answer)).max())
        push = float(np.linalg.norm(pressed))
        self.smallest_force = SMALLEST_MOTION * size / moved * push
        self._rounding = self._moved_by_rounding(size)
        unloaded = Load(np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3)), weight=0.0)
        self._rest = _Converged(unloaded, np.zeros((len(self.free), d)), np.zeros(self.body.n_pressures))
        self._starts = [self._rest]
        self._path = self._starts  # the last few
        self._largest, self._number = 0.0, 0  # of steps since the body was at rest

    def begin_at(self, load: Load, x: Array, pressure: Array) -> None:
        """Start histories from a balance that is known, x (n, d) and pressures (m,) [Pa] under a load."""
        self._starts = [self._rest, _Converged(load, x, pressure)]

    def begin_near(self, load: Load, x: Array, pressure: Array) -> None:
        """Start histories from the balance under a load that is found from a state near it, if one is."""
        found, _, _ = self._solve(load, x, pressure, (0.0, 1.0), mixes=not self.body.has_slope)
        if found is not None:
            self.begin_at(load, found.x, found.pressure)

    def step(self, load: Load, previous: Step | None = None) -> Step:
        """Solution of one load; with a previous step, started where the last converged ones point to.

        A start and what is known of the slope change the number of iterations, not what they converge to.
        """
        self._number += 1
        if previous is None:
            self._number, self._path, self._largest = 0, self._starts, 0.0
            self._anderson = Anderson(HISTORY)
        return self._stepped(load)

    def _stepped(self, load: Load, *, is_doubted: bool = False) -> DeformedStep:
        """The next step; one that `is_doubted` keeps stable balances alone, not only where they took long."""
        last = self._path[-1]
        x, pressure = self._ahead(load)
        substeps, iterations, used, why, mixes = Substeps(), 0, 0, "", not self.body.has_slope
        balance: Balance | None = None
        while (reached := substeps.reached) < 1.0:
            target = substeps.target
            found, used, why = self._solve(
                _between(last.load, load, target), x, pressure, (reached, target), mixes
            )
            iterations += used
            if found is None or used > HISTORY:  # on so bent a path the slopes of here mislead further on
                self._anderson = Anderson(HISTORY)
            if found is None and not mixes:  # a slope misses what strains within a part
                mixes = True
                continue
            mixes = not self.body.has_slope
            # corrections find balances beyond a limit point too, which a body does not stay in
            looked_at = is_doubted or used > HISTORY
            if found is not None and looked_at and self.body.stiffness_left(found) < 0.0:
                found, why = None, UNSTABLE
            if found is None:
                if reached == 0.0:
                    x, pressure = last.x, last.pressure
                if not substeps.failed():
                    break
                continue
            balance, x, pressure = found, found.x, found.pressure
            substeps.found(used <= HISTORY)
        if balance is None:
            balance = self.body.balance(last.load, last.x, last.pressure)
        status = CONVERGED
        if reached < 1.0:
            told = ENDED.format("the nonlinear balance was not found", reached, self._number + 1, used, why)
            if np.isfinite(left := self.body.stiffness_left(balance)):
                told += LEFT.format(100.0 * left)
            status = Status("not-converged", told, REMEDY)
        else:
            self._path = [*self._path[1 - MOST_STATES :], _Converged(load, x, pressure)]
        border = np.zeros(self.factor.n_border)
        border[0] = self.body.mean_pressure(balance)
        return DeformedStep(
            problem=self.problem,
            unknown=balance.x[: self.problem.formulation.surface.n_nodes].copy(),
            border=border,
            iterations=iterations,
            status=status,
            lacking=balance.lacking[self.problem.held_nodes],
            stored=self.body.energy(balance),
            balance=balance,
            reached=reached,
        )

    def audited(self, load: Load, step: Step) -> tuple[Step, Audit]:
        """The step and what its balance on the deformed surface lacks, under the load that was reached.

        Where that is not stable the step, the last one, failed or not, is taken anew by balances that are.
        """
        if not isinstance(step, DeformedStep) or step.balance is None:
            return step, Audit(np.nan)
        if copy(self.body).stiffness_left(step.balance) < 0.0:  # which keeps its slope
            self._path = self._path[:-1] if step.status.ok else self._path
            step = self._stepped(load, is_doubted=True)
        assert step.balance is not None
        problem, n = self.problem, len(step.unknown)
        displaced = problem.formulation.displacement
        load = step.balance.load
        balance = self.body.balance(load, step.balance.x, step.balance.pressure)
        residual = float(np.linalg.norm(balance.lacking[self._free_nodes]))
        moved = float(np.abs(displaced(step.unknown)).max())
        self._largest = max(self._largest, moved)
        found = Audit(
            max(residual / max(balance.scale, self.smallest_force), float(np.abs(balance.gap).max()))
        )
        if not step.status.ok:
            return replace(step, status=self.body.reserved(step.status, balance)), found
        if not problem.force(load).any() and not problem.held_unknown(load).any():
            return step, found
        step = replace(step, status=self.body.reserved(step.status, balance))
        # forces that cancel, as a pressure from all sides, move no more than their rounding, however large they are
        column = problem.formulation.columns.first
        acting = np.abs(problem.force(load)) + abs(step.pressure_change) * np.abs(column)
        largest = max(self._largest, float(np.abs(displaced(problem.own_motion(acting))).max()))
        if self._rounding > ERROR_LIMIT * largest:
            return replace(step, status=_hidden(self._rounding, moved)), found
        turn = self.carried(np.zeros_like(balance.x), balance.x)[1]
        change = self.body.correction(balance, balance.lacking, np.zeros_like(balance.gap), turn)[0]
        far = np.zeros_like(balance.x)
        far[self._free_nodes] = change
        return step, replace(found, error=float(np.abs(displaced(far[:n])).max()) / largest)

    def _moved_by_rounding(self, size: float) -> float:
        """How far the rounding of positions `size` large moves the body [m], by the forces that it makes."""
        formulation = self.problem.formulation
        random = np.random.default_rng(0)
        signs = random.choice([-1.0, 1.0], (2, formulation.surface.n_nodes, formulation.components))
        # a product with random signs is as large as the rows are; other signs, and no motion has these forces
        forces = np.finfo(np.float64).eps * size * np.abs(formulation.apply(signs[0])) * signs[1]
        change = self.factor.correction(forces, np.zeros(self.factor.n_border))[0]
        return float(np.abs(formulation.displacement(change)).max())

    def _ahead(self, load: Load) -> tuple[Array, Array]:
        """Where converged steps point to under a load that goes on as they went.

        By the polynomial in the loads that the fewest of the last steps tell: of a load that grows two tell a line
        and three a parabola, of two that change apart three tell what is linear in both. Of the last step, where
        loads go elsewhere, and of a degree while each adds a tenth of the way at most that the last one may.
        """
        path, last = self._path, self._path[-1]
        products = _products([state.load for state in path], load)
        found, most, count = (last.x, last.pressure), np.inf, 1
        for degree in range(1, MOST_DEGREE + 1):
            for count in range(count + 1, len(path) + 1):  # noqa: B020 - a higher degree needs more than this one
                weights = _weights(products[-count:, -count:], degree)
                if np.abs(weights).sum() <= FURTHEST_AHEAD:
                    break
            else:
                break
            further = _mixed(path[-count:], weights)
            added = float(np.linalg.norm(further[0] - found[0]))
            if added > most:
                break
            if degree == 1:
                most = max(added, float(np.linalg.norm(last.x - path[-2].x)))
            found, most = further, MISSED * most
        return found

    def _held(self, load: Load) -> Array:
        """(n, d) x of the held nodes of the body, zero elsewhere."""
        held = np.zeros_like(self._rest.x)
        held[: self.problem.formulation.surface.n_nodes] = self.problem.held_unknown(load)
        return held

    def carried(self, x: Array, held: Array) -> tuple[Array, Array]:
        """As `carried`, of the body's nodes."""
        return carried(self.body.rest, self.problem.held_nodes, x, held)

    def _solve(
        self, load: Load, x: Array, pressure: Array, shares: tuple[float, float], mixes: bool
    ) -> tuple[Balance | None, int, str]:
        """The balance if it was found, iterations, and where they had come to.

        mixes : whether all corrections are mixed, not only those near the balance
        """
        nodes, body, unit = self._free_nodes, self.body, self._unit
        held = self._held(load)
        x = self.carried(x, held)[0]
        turn = self.carried(np.zeros_like(x), held)[1]
        # what the last load step learnt of the slope holds here too, nearly
        anderson = self._anderson
        anderson.begin()
        smallest, left = np.inf, ""
        for iteration in range(MAX_ITERATIONS):
            if (
                not np.abs(self.problem.formulation.displacement(x[: len(self.problem.free)])).max()
                < self.reach
            ):
                return None, iteration, f"a node was {FURTHEST:g} sizes of the body from its place"
            balance = body.balance(load, x, pressure)
            residual = float(np.linalg.norm(balance.lacking[nodes]))
            scale = max(balance.scale, self.smallest_force)
            left = RESIDUAL.format(residual / scale)
            if not np.isfinite(residual) or residual > GROWTH_LIMIT * max(smallest, balance.scale):
                return None, iteration, left
            smallest = min(smallest, residual)
            tell(Progress(self._number, 0, *shares, iteration, residual / scale))
            if residual <= TOLERANCE * scale and (np.abs(balance.gap).max() <= TOLERANCE):
                return self._close_volume(load, balance, turn), iteration, left
            change, pushed = body.correction(balance, balance.lacking, balance.gap, turn)
            x = x.copy()
            if mixes or residual < NEAR * balance.scale:
                iterate = np.append(turned(x[nodes], turn.T).reshape(-1), pressure * unit)
                mixed = anderson.next(iterate, np.append(turned(change, turn.T).reshape(-1), pushed * unit))
                change = turned(mixed[: -len(pressure)].reshape(-1, x.shape[1]), turn) - x[nodes]
                pushed = mixed[-len(pressure) :] / unit - pressure
                closing, more = body.closing(balance, change, pushed)
                x[nodes] += change + closing
                pressure = pressure + pushed + more
                continue
            x[nodes] += change
            pressure = pressure + pushed
        return None, MAX_ITERATIONS, left

    def _close_volume(self, load: Load, balance: Balance, turn: Array) -> Balance | None:
        for _ in range(5):
            if np.abs(balance.gap).max() <= VOLUME_TOLERANCE:
                return balance
            change, pushed = self.body.correction(balance, np.zeros_like(balance.lacking), balance.gap, turn)
            x = balance.x.copy()
            x[self._free_nodes] += change
            balance = self.body.balance(load, x, balance.pressure + pushed)
        return None


def carried(rest: Array, nodes: Index, x: Array, held: Array) -> tuple[Array, Array]:
    """x (n, d) with held `nodes` where `held` has them and the others carried along, and the rotation (3, 3).

    Only where the held nodes move as one body, and not along the normals alone, d = 1. `rest` (n, 3): positions.
    """
    is_held = np.zeros((len(rest), 1), np.bool_)
    is_held[nodes] = True
    left = np.where(is_held, held, x), np.eye(3)
    start, end = x[nodes], held[nodes]
    if x.shape[1] != 3 or np.array_equal(start, end):
        return left
    before, after = rest[nodes] + start, rest[nodes] + end
    middle, centre = before.mean(axis=0), after.mean(axis=0)
    moment = (before - middle).T @ (after - centre)
    # what the held nodes leave open, on one line or at one point, is not turned
    turn = best_rotation(moment + LEAST_TURN * np.linalg.norm(before - middle) ** 2 * np.eye(3))
    missed = np.linalg.norm((before - middle) @ turn + centre - after)
    if missed > AS_ONE * np.linalg.norm(after - before):
        return left
    return np.where(is_held, held, (rest + x - middle) @ turn + centre - rest), turn


def turned(vectors: Array, turn: Array) -> Array:
    """Vectors (n, 3) in rows after a rotation; unknowns along the normals (n, 1) stay."""
    return vectors @ turn if vectors.shape[1] == 3 else vectors


def _hidden(rounding: float, moved: float) -> Status:
    return Status(
        "too-small",
        f"rounding of the coordinates moves the body by {rounding:.1e} m, and the load by {moved:.1e} m",
        "use the linear solver, which such a load does not tell from this one, or a wider support, or load it more",
    )


def _mixed(path: Sequence[_Converged], weights: Array) -> tuple[Array, Array]:
    """Unknowns and pressures of converged states, mixed."""
    unknowns, pressures = [state.x for state in path], [state.pressure for state in path]
    return np.tensordot(weights, unknowns, 1), np.tensordot(weights, pressures, 1)


def _products(path: Sequence[Load], load: Load) -> Array:
    """(k, k) of the changes from the last of k loads to those before it, and to another, with each other."""
    total = np.zeros((len(path), len(path)))
    for part in ("contact_pressure", "contact_force", "prescribed", "dead_force", "weight"):
        values = [getattr(state, part) for state in (*path, load)]
        size = max(0 if value is None else np.size(value) for value in values)
        each = np.stack([np.zeros(size) if value is None else np.ravel(value) for value in values])
        changes = np.delete(each, -2, axis=0) - each[-2]
        total += changes @ changes.T / (np.vdot(each, each) or 1.0)  # parts have units of their own
    return total


def _weights(products: Array, degree: int) -> Array:
    """(k,) of k loads, see `_products`, by which all powers of another are mixed up to a degree; else NaN."""
    powers = np.arange(1, degree + 1)[:, None]
    products = products / (products.diagonal().max() or 1.0)
    own, aim = products[:-1, :-1] ** powers[:, :, None], products[:-1, -1] ** powers
    size = products[-1, -1] ** powers[:, 0]
    shares = np.linalg.lstsq(own.reshape(-1, own.shape[2]), aim.reshape(-1), rcond=SAME)[0]
    if (size - 2.0 * aim @ shares + (own @ shares) @ shares > MISSED**2 * size).any():
        return np.full(len(products), np.nan)
    return np.append(shares, 1.0 - shares.sum())


def _between(start: Load, end: Load, share: float) -> Load:
    """The load at a share of the way from one to another: one of its own for each attempt."""

    def mix(a: Array | None, b: Array | None) -> Array | None:
        if b is None:
            return None
        return share * b if a is None else (1.0 - share) * a + share * b

    pressure = (1.0 - share) * start.contact_pressure + share * end.contact_pressure
    return Load(
        pressure,
        mix(start.contact_force, end.contact_force),
        mix(start.prescribed, end.prescribed),
        mix(start.dead_force, end.dead_force),
        (1.0 - share) * start.weight + share * end.weight,
    )
