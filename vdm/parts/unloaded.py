"""The rest shape of a body in parts from its shape under a load, with the stiffness of a nearby shape.

This is the inverse of `vdm.parts.body`: the positions y and the forces on them are known, the rest points X are the
unknowns. Part e has the stiffness S of a shape near its rest. In that shape's frame its displacement is
`w = y - X G`; the rotation G best fits X to y. A change d of X G reduces the residual of equilibrium by

`(1 - W Y^T) S (d - Z theta)`, `theta = V^T d`.

theta is the rotation of G that d causes, `Z_k = e_k x X G`, `Y_k = e_k x y`, and W is as in `vdm.parts.body`. With
`tau = Y^T S (d - Z theta)` the system is S, bordered by theta, tau and the pressure, which keeps the volume. If S
is the stiffness of X itself, the body at rest in X sags into y.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from solver_common.arrays import Array
from solver_common.solution import NO_REST_SHAPE
from vdm.constraints import Load
from vdm.deformed import DeformedSurface, best_rotation
from vdm.parts.body import BORDER, TURNED, Parts, turn_of, turned_block
from vdm.parts.cut import Cut
from vdm.parts.part import dofs
from vdm.parts.solve import PartsSolver, inside
from vdm.peers.bem import moments, turned_back
from vdm.solution import SolverError, Status
from vdm.solvers.nonlinear import Balance, DeformedStep, Large, NonlinearSolver

NOT_UNDONE = "beyond {:.0f} % of its weight the scan cannot be undone"
REMEDY = "give a stiffer tissue, or leave out gravity.scanned"


@dataclass(frozen=True)
class _Resting:
    """A trial rest shape. n_p counts the nodes of all parts, one after another.

    Attributes
    ----------
    seen : balance of the known shape under the load
    rest : (n_p,) surfaces of all parts at rest
    turns : (m, 3, 3) G
    placed : (n_p, 3) X G, about each part's mean position
    filled : (n_p, 3, k) gradient at rest of the further volumes, those of the fluid-filled cavities
    """

    seen: Balance
    rest: DeformedSurface
    turns: Array
    placed: Array
    filled: Array


class Unloaded(Parts):
    """Parts whose rest shape is unknown. The unknowns x (n, 3) lead from the loaded shape to the rest shape.

    `parts` have the stiffness of a shape near rest. The attribute `rest` is the shape under the load, where x is
    zero.
    """

    def __init__(self, parts: Parts, seen: Array) -> None:
        """`seen` (n, 3) are the positions of the parts' nodes under the load [m]."""
        vars(self).update(vars(parts))
        self._near, self.rest = parts, seen - parts.problem.body.origin
        self._sag = self.rest - parts.rest
        self._areas = np.concatenate([part.areas for part in parts.parts])[:, None]
        state = self._joint.at(self._sag[self._nodes])
        self.volumes = self._kept(state, self._sag[self._nodes])[0]

    def balance(self, load: Load, x: Array, pressure: Array) -> Balance:
        """As in `Large`."""
        seen = self._near.balance(load, self._sag, pressure)
        state, turns = seen.parts.state, seen.parts.turns
        rest = self._joint.at((self._sag + x)[self._nodes])
        middles = np.add.reduceat(self._areas * rest.positions, self._first)
        about = rest.positions - middles[self._part]
        aim = np.einsum("nj,nij->ni", state.positions, turns[self._part])
        back = best_rotation(moments(self._areas * about, aim, self._spans))
        placed = np.einsum("ni,nij->nj", about, back[self._part])
        further = self._joint.rest - placed
        forces = [part.form.swollen_force(further[span]) for part, span in self._each()]
        lacking = seen.lacking + self._sum @ turned_back(np.concatenate(forces), turns, state, self._spans)
        if self._ground is not None:
            n_surface = self.problem.formulation.surface.n_nodes
            springs = self._ground @ (self._sag + x)[:n_surface].reshape(-1)
            lacking[:n_surface] -= springs.reshape(-1, 3)
        grown, filled = self._kept(rest, (self._sag + x)[self._nodes])
        # the volume constraint of the loaded state, with its sign changed, over the volumes of this rest shape
        beyond = np.einsum("nc,nc->n", self._beyond, seen.parts.away + further)
        grown[: self.n_parts] -= np.add.reduceat(beyond, self._first)
        gap = (grown - self.give * seen.parts.pressure + seen.parts.squeezed) / self.volumes - 1.0
        return Balance(
            load, x, pressure, gap, lacking, seen.scale, _Resting(seen, rest, back, placed, filled)
        )

    def correction(
        self,
        balance: Balance,
        lacking: Array,
        gap: Array,
        turn: Array,  # noqa: ARG002 - each part has a frame of its own
    ) -> tuple[Array, Array]:
        """As in `Large`."""
        m, k, n, resting = self.n_parts, BORDER, self._n_shared, balance.parts
        turns = resting.seen.parts.turns
        size = k * m + self._n_further
        kept = self._rows_of_volumes
        target = np.zeros(size)
        target[kept] = -gap * self.volumes
        matrix, corner = self._ground_joining.copy(), np.zeros((size, size))
        pushes, reads = np.zeros((n, 3, size)), np.zeros((n, 3, size))
        right, inside = lacking[self._shared], list[Array]()
        for e, part in enumerate(self.parts):
            q, g, at = turns[e], resting.turns[e], np.append(k * e + np.arange(k), kept[m:])
            pushing, reading, own = self._border_of(e, balance)
            i, c = part.inner, part.shared
            within = (lacking[part.nodes[i]] @ q.T).reshape(-1, 1)
            columns = np.hstack([within, pushing[i].reshape(-1, len(at))])
            answered = np.asarray(part.block.solve(np.asfortranarray(columns)))
            inside.append(np.zeros((len(within), 1 + size)))
            inside[-1][:, 0], inside[-1][:, 1 + at] = answered[:, 0], answered[:, 1:]
            read = reading[i].reshape(-1, len(at))
            target[at] -= read.T @ answered[:, 0]
            corner[np.ix_(at, at)] += -read.T @ answered[:, 1:]
            corner[np.ix_(at[:k], at[:k])] += own
            follows, there = part.follows.T, dofs(part.places)
            matrix[np.ix_(there, there)] += turned_block(part.carried, q, g.T)
            right[part.places] -= (follows @ within).reshape(-1, 3) @ q
            pushed = pushing[c] - (follows @ columns[:, 1:]).reshape(-1, 3, len(at))
            pushes[part.places[:, None], :, at] += np.einsum("ncj,cd->njd", pushed, q)
            joined = reading[c] - (follows @ read).reshape(-1, 3, len(at))
            reads[part.places[:, None], :, at] += np.einsum("ncj,dc->njd", joined, g)
        read = reads.reshape(3 * n, size)
        together = np.column_stack([right.reshape(-1), pushes.reshape(3 * n, size)])
        if n:
            together = linalg.lu_solve(linalg.lu_factor(matrix, check_finite=False), together)
        system = corner - read.T @ together[:, 1:]
        push = np.asarray(np.linalg.solve(system, target - read.T @ together[:, 0]), np.float64)
        weights = np.append(1.0, -push)
        shared = (together @ weights).reshape(n, 3)
        change = np.zeros_like(balance.x)
        change[self._shared] = shared
        for part, g, answered in zip(self.parts, resting.turns, inside, strict=True):
            moved = answered @ weights - part.follows @ (shared[part.places] @ g).reshape(-1)
            change[part.nodes[part.inner]] = moved.reshape(-1, 3) @ g.T
        return change[self.free], push[kept]

    # a trial rest shape is no equilibrium under a load, and its last correction closes the gaps
    closing, stiffness_left = Large.closing, Large.stiffness_left

    def _border_of(self, number: int, balance: Balance) -> tuple[Array, Array, Array]:
        """Border of a part in its frame: columns (n, 3, k), rows (n, 3, k), and their own block (7, 7).

        The border unknowns are the pressure, theta, tau, and the pressures of the further volumes.
        """
        part, span, resting = self.parts[number], self._spans[number], balance.parts
        acting, g = resting.seen.parts, resting.turns[number]
        q = acting.turns[number]
        y = acting.state.positions[span] @ q.T
        y = y - part.areas @ y
        z = resting.placed[span]
        turned = np.concatenate([(arms @ TURNED).reshape(-1, 3, 3) for arms in (z, y)], axis=2)
        stressed = part.form.swollen_forces(turned)
        follows, turning = turn_of(part.body.levers, y), turn_of(part.areas[:, None] * y, z)
        pressed = (acting.gradient[span] @ q.T)[:, :, None]
        filled = np.einsum("nck,dc->ndk", acting.filled[span], q)
        pushing = np.concatenate([pressed, -stressed[:, :, :3], -follows, filled], axis=2)
        pressed = (resting.rest.area_vectors[span] @ g + self._beyond[span])[:, :, None]
        filled = np.einsum("nck,cd->ndk", resting.filled[span], g)
        reading = np.concatenate([pressed, turning, stressed[:, :, 3:], filled], axis=2)
        own = np.zeros((BORDER, BORDER))
        own[0, 0] = -self.give[number]
        own[1:, 1:] = -np.eye(6)
        own[4:, 1:4] = -np.einsum("nck,ncl->kl", turned[:, :, 3:], stressed[:, :, :3])
        if not (part.inner | part.shared).any() and not self.give[number]:
            own[0, 0] = 1.0  # held all over: no displacement fixes the pressure, so it stays zero
        return pushing, reading, own

    def energy(self, balance: Balance) -> float:
        return self._near.energy(balance.parts.seen)

    def mean_pressure(self, balance: Balance) -> float:
        return self._near.mean_pressure(balance.parts.seen)


class Unloading:
    """Finds the rest shape of a body in parts from its surface under a load, with the stiffness of the last trial.

    Parameters
    ----------
    seen : (N, 3) surface nodes under the load [m]
    load : the load

    Attributes
    ----------
    open : how far the rest shape depends on the place of the cut [m]; 0 if it does not. It starts as the largest
        step of a node when the search began to keep its cut
    """

    def __init__(self, seen: Array, load: Load) -> None:
        self._seen, self._load = seen, load
        self._balance: Balance | None = None
        self._body: Parts | None = None  # of that balance
        self.begin(0)

    def begin(self, count: int) -> None:
        """Continue with `count` parts, or if 0 with as many as the next body needs."""
        self._count, self._steps = count, (np.inf, np.inf)
        self._kept: Cut | None = None
        self.open = 0.0

    def stiffness_left(self) -> float:
        """`Large.stiffness_left` of the last body found, under the load."""
        assert self._body is not None
        assert self._balance is not None
        return self._body.stiffness_left(self._balance.parts.seen)

    def doubt(self, error: Array) -> None:
        """Raise `open` to an error (N, 3) of the sag [m], if adding or subtracting the error changes the cut."""
        body = self._body
        assert body is not None
        if self.open > 0.0 or not (body.is_cut_alike(error) and body.is_cut_alike(-error)):
            self.open = max(self.open, float(np.linalg.norm(error, axis=1).max()))

    def cut(self, points: Array) -> Cut | None:
        """The cut to use for surface nodes (N, 3); None for a new one.

        Cuts are made anew until a step is no shorter than the last but one: two shapes may alternate, each with the
        cut of the other. From then on the last cut is kept.
        """
        if self._kept is None:
            return None
        return replace(self._kept, points=np.vstack([points, self._kept.points[len(points) :]]))

    def rest(self, solver: PartsSolver) -> Array:
        """(N, 3) surface nodes at rest [m], with the stiffness of a solver's body, in as many parts as at `begin`.

        The first body has the loaded shape; later ones are near rest. The loaded positions of their inner nodes are
        those of the body under the load.

        Raises
        ------
        SolverError
            no equilibrium is found. The message has the share of the load that was undone.
        """
        self._body = None  # two at once would take twice the memory
        solver.prepare([self._load], compared=False, count=self._count)
        body, n = solver.body, len(self._seen)
        self._count = body.n_parts
        seen = points = body.cut.points
        back = NonlinearSolver(solver.problem, Unloaded(body, seen), solver.factor)
        if self._balance is not None:
            x = inside(body.rest, self._seen - points[:n])
            pressure = np.full(body.n_pressures, self._balance.pressure.mean())
            solver.solver.begin_near(self._load, x, pressure)
            sagged = solver.step(self._load)
            assert isinstance(sagged, DeformedStep)
            if sagged.balance is not None and sagged.status.ok:
                x, pressure = sagged.balance.x, sagged.balance.pressure
                solver.begin_at(self._load, x, pressure)
            seen = np.vstack([self._seen, (points + x)[n:]])
            back.body = Unloaded(body, seen)
            back.begin_near(self._load, points - seen, pressure)
        step = back.step(self._load)
        assert isinstance(step, DeformedStep)
        if step.balance is None or not step.status.ok:
            raise SolverError(Status(NO_REST_SHAPE, NOT_UNDONE.format(100 * step.reached), REMEDY))
        self._body, self._balance = body, step.balance
        rest = seen + self._balance.x
        far = float(np.abs(rest - points)[:n].max())
        if self._kept is None and body.n_parts > 1 and far >= self._steps[0]:
            self.open = float(np.linalg.norm((rest - points)[:n], axis=1).max())
        if self.open > 0.0:
            self._kept = replace(body.cut, points=rest)
        self._steps = self._steps[1], far
        return np.asarray(rest[:n])
