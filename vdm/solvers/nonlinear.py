"""Large deformation in total form: current areas and normals, exact volume, load steps that are halved (38)."""

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
HISTORY = 10  # depth of the Anderson acceleration; more iterations than that make a solve a hard one
FURTHEST = 3.0  # largest displacement of a solve that goes on, in sizes of the body
# share of the held nodes' motion that no rigid motion explains: beyond it they do not move as one body
AS_ONE = 0.3
LEAST_TURN = 1e-9  # of the second moment of the held nodes: about axes with less, the body is not turned
MOST_DEGREE = 3  # of the polynomial in the loads that predicts the start of a step
MOST_STATES = 10  # converged states that the prediction uses: ten determine a cubic in two loads
FURTHEST_AHEAD = 2.0 ** (
    MOST_DEGREE + 1
)  # limit of the sum of |weights|; equal steps in line reach it less 1
# share of a load's change that a mixture of loads may miss, and of the last degree's step that the next may add
MISSED = 0.1
SAME = 1e-12  # relative size of squared load changes below which their direction is rounding
# sizes of the body: smaller forces than those that move it so far do not scale the residual
SMALLEST_MOTION = 1e-6
# of the residual, over the larger of the internal and the applied forces, or, if both are smaller, over the force
# of a pressure that moves the body by `SMALLEST_MOTION`
TOLERANCE = 1e-8
VOLUME_TOLERANCE = 1e-13  # of |V - V0| / V0
# relative residual below which Anderson acceleration also mixes the corrections of a body with a tangent
NEAR = 0.02
GROWTH_LIMIT = 1e3  # a residual that grew by this factor will not converge

REMEDY = "use smaller load steps, a smaller load or a stiffer material; a body may snap through there"
UNSTABLE = "the one that was found is not stable"
LEFT = (
    "; the last balance has {:.3g} % of its least stiffness without forces, and none is left at a limit point"
)


@dataclass(frozen=True)
class Balance:
    """A state of n nodes and m pressures, with its residuals: those of equilibrium and of the volume constraints.

    Attributes
    ----------
    load : the load that acts
    x : (n, d) unknowns: displacements, or amplitudes along the normals [m]
    pressure : (m,) Lagrange multipliers of the kept volumes [Pa]
    gap : (m,) residual of each volume constraint, over the volume at rest
    lacking : (n, d) residual of equilibrium: generalised force, internal less applied [N]
    scale : norm of the larger of the internal and the applied forces [N]
    parts : intermediate results that the body's `correction` uses again
    """

    load: Load
    x: Array
    pressure: Array
    gap: Array
    lacking: Array
    scale: float
    parts: Any = field(repr=False)


class Large(Protocol):
    """A body at large displacements with n nodes, the first N of them on the surface, and m kept volumes."""

    rest: Array  # (n, 3) [m]
    free: Mask  # (n,)
    n_pressures: int  # m
    # whether `correction` uses the tangent stiffness of the state, so that Anderson acceleration is not needed
    has_slope: bool

    def balance(self, load: Load, x: Array, pressure: Array) -> Balance:
        """The residuals of a state."""
        ...

    def correction(self, balance: Balance, lacking: Array, gap: Array, turn: Array) -> tuple[Array, Array]:
        """Change of x (n_free, d) and of the pressures (m,) that removes residuals (n, d) and gaps (m,).

        It solves with a stiffness near the tangent of the state. `turn` (3, 3) is the rotation of the supports from
        rest.
        """
        ...

    def closing(self, balance: Balance, change: Array, pushed: Array) -> tuple[Array, Array]:  # noqa: ARG002
        """The further change of x (n_free, d) and of the pressures (m,) that closes the gaps to first order.

        Anderson acceleration mixes corrections, and the mixture does not close the gaps of this state. By default
        nothing is added, and the last correction closes them.
        """
        return np.zeros_like(change), np.zeros_like(balance.gap)

    def stiffness_left(self, balance: Balance) -> float:  # noqa: ARG002
        """The least stiffness of a state, relative to the same state without forces: 1 at rest, 0 at a limit point.

        It is negative for an unstable state, and NaN if the body does not examine stability.
        """
        return np.nan

    def energy(self, balance: Balance) -> float:
        """Elastic energy [J]."""
        ...

    def mean_pressure(self, balance: Balance) -> float:
        """Volume mean of the pressure [Pa]."""
        ...

    def reserved(self, status: Status, balance: Balance) -> Status:  # noqa: ARG002
        """The status of an answer, with warnings about what this kind of body does not model; by default none."""
        return status


class Whole(Large):
    """A body with one pressure and no parts; its corrections use the factor of the stiffness at rest."""

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
        # the pressure's column stays that at rest: this changes the path of the iteration, not its result
        force, row = (turned(part[nodes], turn.T).reshape(-1) for part in (-lacking, balance.parts[2]))
        change, border = self.factor.solve_updated(force, target, row)
        return turned(change.reshape(len(nodes), -1), turn), border[:1]

    def energy(self, balance: Balance) -> float:
        return self.problem.formulation.deformed_energy(balance.x, balance.parts[0])

    def mean_pressure(self, balance: Balance) -> float:
        return float(balance.pressure[0])


@dataclass(frozen=True)
class _Converged:
    """A load and its converged solution."""

    load: Load
    x: Array
    pressure: Array


@dataclass(frozen=True, kw_only=True)
class DeformedStep(Step):
    """A step in equilibrium on the deformed surface.

    Attributes
    ----------
    lacking : (n_held, d) generalised force of the supports, internal less applied [N]
    stored : elastic energy [J]
    balance : equilibrium of all nodes of the body; for a failed step the last one before the failure; None if the
        solver has none
    reached : share of the load step at which that equilibrium was found
    left : `Large.stiffness_left` of that equilibrium, NaN if it was not examined
    """

    lacking: Array = field(repr=False)
    stored: float
    balance: Balance | None = field(default=None, repr=False)
    reached: float = 1.0
    left: float = np.nan

    @property
    def energy(self) -> float:
        """Elastic energy [J]."""
        return self.stored

    def lacking_at_held(self) -> Array:
        """As in `Step`."""
        return self.lacking


class NonlinearSolver:
    """Finds x and the pressures with `internal(x) - sum p column(x) - force(x) = 0` and each V(x) = V0.

    V is the volume that the body keeps: that of the polyhedron, except in the printed form. A part with nu < 1/2
    changes its volume by its pressure over kappa (`vdm.parts.body`).

    Each iteration solves for a correction of the residual (`Large.correction`). If that does not use the tangent of
    the state, or near equilibrium, Anderson acceleration mixes the corrections, with those of the last loads. A
    last correction closes the volumes to rounding.

    A load step starts from the last converged ones. A step that fails is tried again with all corrections mixed,
    then halved (`solver_common.substeps`). A failed step holds the last equilibrium before the failure, and the
    next step starts where it started. If the held nodes move, the body starts with the rigid motion that best fits
    theirs.

    Parameters
    ----------
    problem : formulation and supports
    body : the body to solve; None for a `Whole`
    factor : factor of the problem; None to make one
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
        # a node that is several sizes of the body away will not converge
        size = float(np.ptp(problem.body.rest, axis=0).max())
        self.reach = FURTHEST * size
        n, d = problem.formulation.surface.n_nodes, problem.formulation.components
        answer = np.zeros((n, d))
        pressed = problem.formulation.pressed[problem.free]
        answer[problem.free] = self.factor.block.solve(pressed.reshape(-1)).reshape(pressed.shape)
        # Anderson acceleration mixes pressures with displacements: this unit makes their norms alike
        self._unit = float(np.linalg.norm(answer))
        moved = float(np.abs(problem.formulation.displacement(answer)).max())
        push = float(np.linalg.norm(pressed))
        self.smallest_force = SMALLEST_MOTION * size / moved * push
        self._rounding = self._moved_by_rounding(size)
        unloaded = Load(np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3)), weight=0.0)
        self._rest = _Converged(unloaded, np.zeros((len(self.free), d)), np.zeros(self.body.n_pressures))
        self._starts = [self._rest]
        self._path = self._starts  # the last converged states of a history
        self._largest, self._number = 0.0, 0  # largest displacement [m] and step of a history

    def begin_at(self, load: Load, x: Array, pressure: Array) -> None:
        """Start all histories from a known equilibrium under a load: x (n, d) and pressures (m,) [Pa]."""
        self._starts = [self._rest, _Converged(load, x, pressure)]

    def begin_near(self, load: Load, x: Array, pressure: Array) -> None:
        """Start all histories from the equilibrium near a state under a load, if one is found."""
        found, _, _ = self._solve(load, x, pressure, (0.0, 1.0), mixes=not self.body.has_slope)
        if found is not None:
            self.begin_at(load, found.x, found.pressure)

    def step(self, load: Load, previous: Step | None = None) -> Step:
        """Solution of one load; with a previous step, the start is extrapolated from the last converged ones.

        The start and the memory of the Anderson acceleration change the number of iterations, not the result.
        """
        self._number += 1
        if previous is None:
            self._number, self._path, self._largest = 0, self._starts, 0.0
            self._anderson = Anderson(HISTORY)
        return self._stepped(load)

    def _stepped(self, load: Load, *, is_doubted: bool = False) -> DeformedStep:
        """The next step. It checks stability after substeps that took long, and after all if `is_doubted`."""
        last = self._path[-1]
        x, pressure = self._ahead(load)
        substeps, iterations, used, why, mixes = Substeps(), 0, 0, "", not self.body.has_slope
        balance: Balance | None = None
        left = np.nan
        while (reached := substeps.reached) < 1.0:
            target = substeps.target
            found, used, why = self._solve(
                _between(last.load, load, target), x, pressure, (reached, target), mixes
            )
            iterations += used
            if found is None or used > HISTORY:  # on so curved a path, these corrections mislead later ones
                self._anderson = Anderson(HISTORY)
            if found is None and not mixes:  # the tangent neglects terms of the strain within a part
                mixes = True
                continue
            mixes = not self.body.has_slope
            # corrections also find unstable equilibria beyond a limit point
            looked_at = is_doubted or used > HISTORY
            found_left = self.body.stiffness_left(found) if found is not None and looked_at else np.nan
            if found_left < 0.0:
                found, why = None, UNSTABLE
            if found is None:
                if reached == 0.0:
                    x, pressure = last.x, last.pressure
                if not substeps.failed():
                    break
                continue
            balance, left, x, pressure = found, found_left, found.x, found.pressure
            substeps.found(used <= HISTORY)
        if balance is None:
            balance = self.body.balance(last.load, last.x, last.pressure)
        status = CONVERGED
        if reached < 1.0:
            told = ENDED.format("the nonlinear balance was not found", reached, self._number + 1, used, why)
            if np.isnan(left):
                left = self.body.stiffness_left(balance)
            if np.isfinite(left):
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
            left=left,
        )

    def audited(self, load: Load, step: Step) -> tuple[Step, Audit]:
        """The step and its residual on the deformed surface, under the load that was reached.

        If the equilibrium is unstable, the step, which must be the last one, is solved again through stable ones.
        """
        if not isinstance(step, DeformedStep) or step.balance is None:
            return step, Audit(np.nan)
        # a copy keeps the tangent
        left = copy(self.body).stiffness_left(step.balance) if np.isnan(step.left) else step.left
        if left < 0.0:
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
        # forces that cancel, as pressure from all sides does, move the body no more than their rounding does
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
        """How far the forces of rounding in positions of magnitude `size` [m] move the body [m]."""
        formulation = self.problem.formulation
        random = np.random.default_rng(0)
        signs = random.choice([-1.0, 1.0], (2, formulation.surface.n_nodes, formulation.components))
        # a product with random signs has the size of the rows; new signs, as no displacement has such forces
        forces = np.finfo(np.float64).eps * size * np.abs(formulation.apply(signs[0])) * signs[1]
        change = self.factor.correction(forces, np.zeros(self.factor.n_border))[0]
        return float(np.abs(formulation.displacement(change)).max())

    def _ahead(self, load: Load) -> tuple[Array, Array]:
        """Predicted x (n, d) and pressures (m,) under a load, extrapolated from the last converged states.

        The prediction is a polynomial in the loads, from as few of the last states as determine it. Under one
        growing load, two states determine a line and three a parabola; under two independent loads, three states
        determine the linear terms. The degree rises as long as each degree adds at most `MISSED` of what the last
        one could. If the last states do not determine the load, the prediction is the last state.
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
            further = (
                np.tensordot(weights, [state.x for state in path[-count:]], 1),
                np.tensordot(weights, [state.pressure for state in path[-count:]], 1),
            )
            added = float(np.linalg.norm(further[0] - found[0]))
            if added > most:
                break
            if degree == 1:
                most = max(added, float(np.linalg.norm(last.x - path[-2].x)))
            found, most = further, MISSED * most
        return found

    def _held(self, load: Load) -> Array:
        """(n, d) prescribed x of the held nodes, zero at other nodes."""
        held = np.zeros_like(self._rest.x)
        held[: self.problem.formulation.surface.n_nodes] = self.problem.held_unknown(load)
        return held

    def carried(self, x: Array, held: Array) -> tuple[Array, Array]:
        """`carried` for the nodes of this body."""
        return carried(self.body.rest, self.problem.held_nodes, x, held)

    def _solve(
        self, load: Load, x: Array, pressure: Array, shares: tuple[float, float], mixes: bool
    ) -> tuple[Balance | None, int, str]:
        """The equilibrium, None if not found; the number of iterations; and their last residual in words.

        Parameters
        ----------
        shares : shares of the load step at which the substep starts and ends, for progress
        mixes : whether to mix all corrections, not only those near equilibrium
        """
        nodes, body, unit = self._free_nodes, self.body, self._unit
        held = self._held(load)
        x = self.carried(x, held)[0]
        turn = self.carried(np.zeros_like(x), held)[1]
        # corrections of the last load step are nearly valid here
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
    """x (n, d) with the supports' rigid motion added, and their rotation (3, 3).

    The held `nodes` get their prescribed values, `held` (n, d). If they move as one body and d = 3, the rigid
    motion that best fits theirs carries the other nodes along; else these stay. `rest` (n, 3) are the positions at
    rest [m].
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
    # held nodes on a line or at a point leave rotations undetermined: the added moment sets these to zero
    turn = best_rotation(moment + LEAST_TURN * np.linalg.norm(before - middle) ** 2 * np.eye(3))
    missed = np.linalg.norm((before - middle) @ turn + centre - after)
    if missed > AS_ONE * np.linalg.norm(after - before):
        return left
    return np.where(is_held, held, (rest + x - middle) @ turn + centre - rest), turn


def turned(vectors: Array, turn: Array) -> Array:
    """Row vectors (n, 3) after a rotation; unknowns along the normals, (n, 1), stay."""
    return vectors @ turn if vectors.shape[1] == 3 else vectors


def _hidden(rounding: float, moved: float) -> Status:
    return Status(
        "too-small",
        f"rounding of the coordinates moves the body by {rounding:.1e} m, and the load by {moved:.1e} m",
        "use the linear solver, which such a load does not tell from this one, or a wider support, or load it more",
    )


def _products(path: Sequence[Load], load: Load) -> Array:
    """(k, k) inner products of load changes: from the last of k loads to each before it, and to `load`."""
    total = np.zeros((len(path), len(path)))
    for part in ("contact_pressure", "contact_force", "prescribed", "dead_force", "weight"):
        values = [getattr(state, part) for state in (*path, load)]
        size = max(0 if value is None else np.size(value) for value in values)
        each = np.stack([np.zeros(size) if value is None else np.ravel(value) for value in values])
        changes = np.delete(each, -2, axis=0) - each[-2]
        total += changes @ changes.T / (np.vdot(each, each) or 1.0)  # each kind of load has its own unit
    return total


def _weights(products: Array, degree: int) -> Array:
    """(k,) weights of k loads that reproduce the powers of another load up to a degree; NaN if none do.

    `products` (k, k) are those of `_products`.
    """
    powers = np.arange(1, degree + 1)[:, None]
    products = products / (products.diagonal().max() or 1.0)
    own, aim = products[:-1, :-1] ** powers[:, :, None], products[:-1, -1] ** powers
    size = products[-1, -1] ** powers[:, 0]
    shares = np.linalg.lstsq(own.reshape(-1, own.shape[2]), aim.reshape(-1), rcond=SAME)[0]
    if (size - 2.0 * aim @ shares + (own @ shares) @ shares > MISSED**2 * size).any():
        return np.full(len(products), np.nan)
    return np.append(shares, 1.0 - shares.sum())


def _between(start: Load, end: Load, share: float) -> Load:
    """A new load, interpolated between two at this share."""

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
