"""A body in parts at large displacements: boundary elements with a rotation each, joined at their cuts.

Part e has the stiffness S_e of its own closed surface, which turns with the rotation Q_e that best fits it
(`vdm.peers.bem.BoundaryFormulation`), and a pressure p_e that keeps its volume at nu = 1/2. Small strain within a
part, large rotation between them: the corotational idea (Felippa and Haugen, Comput. Methods Appl. Mech. Engrg.
194, 2005) with boundary elements as elements.

The slope of a part, in its frame, is S_e and what its turning adds. With positions y and levers a X about their
middle, forces f = S_e w less those that turn with it (pressures, contact), e_k the axes:

`K = S + B W + W^T B^T - W^T (Y^T B) W`, `omega = W dy = M^-1 sum a X x dy`, `M = tr(P) I - P`, `P = sum a X y^T`,
`Y_k = e_k x y`, `B_k = e_k x f - S Y_k - (rho g . Y_k) g`, g the gradient of its volume (or area vectors).

That is S and a product U C U^T of rank 6, `U = [W^T, B]`, `C^-1 = [[0, I], [I, Y^T B]]` (the geometric stiffness
of a corotational element): exact but for terms of the order of the strain. Its weight presses the part's closed
surface, so that it does not change where the part moves as one.

S is condensed to the nodes C that parts share. With the part's inner nodes I, `T = S_II^-1 S_IC` once; U and g are
columns of a border E, with unknowns q of which the first is the pressure:

`u_I = S_II^-1 (f_I + E_I q) - T u_C`, `(S_CC - S_CI T) u_C - H q = f_C - T^T f_I`, `H = E_C - T^T E_I`,
`H^T u_C + (E_I^T S_II^-1 E_I + D) q = t - E_I^T S_II^-1 f_I`, with D = C^-1 for U, t the volume that lacks for g.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from solver_common.arrays import Array, Index, Mask
from vdm.boundary.rims import on_edges
from vdm.boundary.tractions import shared as shared_tractions
from vdm.constraints import Load
from vdm.deformed import DeformableSurface, DeformedSurface, best_rotation
from vdm.formulations.base import Factor
from vdm.parts.cut import Cut, along_longest_axis, cut
from vdm.parts.joined import JoinedFormulation
from vdm.parts.part import Nothing, Part, condensed, dofs
from vdm.peers.bem import BoundaryFormulation, DenseFactor, Swelling, moments, turned_back
from vdm.problem import Problem
from vdm.solution import Status
from vdm.solvers.linear import BorderedFactor
from vdm.solvers.nonlinear import NEAR, Balance
from vdm.surface import SurfaceMesh

# rotation within a part [rad] that small strain in its frame bears: half of its square is the strain that it feigns
MOST_TURN = np.radians(10.0)
SAME_TURN = 0.01  # change of a rotation that a correction does not mind: a factor is made anew beyond it
MOST_LEFT = 0.2  # of what lacks: a slope that leaves more is made anew
HALVINGS = 4  # of a body, into pieces that the spread of rotations is read from
FEWEST = 20  # nodes of such a piece: as many as the smallest part has beside those of its caps
# of the surface's area: its strain is below that of the rest, which grows at rims without limit on finer meshes
MOST_AREA = 0.99
LARGEST_STRAIN = 0.1
# (3, 9): v @ TURNED is (3, 3) with e_k x v in column k
TURNED = np.cross(np.eye(3)[None], np.eye(3)[:, None]).transpose(0, 2, 1).reshape(3, 9)
KRYLOV = 15  # products with a slope that its least eigenvalue is found by
SMALL_CHANGE = 1e-6  # sizes of the body, by which the slope of a state is told
BORDER = 7  # unknowns of a part beside displacements: its pressure and what its turning adds, six


@dataclass(frozen=True)
class _Acting:
    """What acts on the parts in a state. Nodes of all parts, one part after another, are n_p.

    Attributes
    ----------
    state : (n_p,) surfaces of all parts
    turns : (m, 3, 3) their rotations
    away : (n_p, 3) displacement in each part's frame
    energy : of the parts [J]
    on_surface : (N, 3) contact on the whole surface [N]
    weight : (n_p,) pressure of the weight, about the middle of each part [Pa]
    rise : (m, 3) its slope [Pa/m]
    datum : (m,) at those middles, above the highest point of the body at rest [Pa]
    gradient : (n_p, 3) of what a pressure changes: of the volumes and what `Swelling` has beyond them
    inward : (n_p, 3) in each part's frame: forces of that, and of its squeeze under its weight [N]
    squeezed : (m + c,) volumes of that squeeze, zero of further ones [m^3]
    filled : (n_p, 3, c) gradient of the volumes of the cavities that a fluid fills, and of what rims bulge
    """

    state: DeformedSurface
    turns: Array
    away: Array
    energy: float
    on_surface: Array
    weight: Array
    rise: Array
    datum: Array
    gradient: Array
    inward: Array
    squeezed: Array
    filled: Array


@dataclass(frozen=True)
class _Slope:
    """The slope of a state, see the head of this file, with q (r,) of all parts and cavities.

    Attributes
    ----------
    turns : (m, 3, 3) of the parts
    inner, joined : (., 3, 3) those of the inner nodes and of the shared nodes of each part
    columns : of each part its places in q
    pushes : of each part E_I (3 n_I, k)
    border : (3 n_C, r) H
    answers : (3n, r) how q moves all nodes
    system : (r, r) what is left for q
    """

    turns: Array
    inner: Array
    joined: Array
    columns: list[Index]
    pushes: list[Array]
    border: Array
    answers: Array
    system: Array


class Parts:
    """The body of a problem of boundary elements, cut into `count` parts; `vdm.solvers.nonlinear.Large`.

    Nodes of the problem's surface come first, those inside after them. One part is the problem's own formulation.
    The pressures are those of the parts, and after them of the cavities that a fluid fills and of the rims.

    Attributes
    ----------
    problem : at small displacements too, that of the parts
    factor : of that problem

    Raises
    ------
    SolverError
        a part that has no factor, or more nodes than one takes.
    """

    has_slope = True

    def __init__(self, problem: Problem, count: int, given: Cut | None = None) -> None:
        whole = problem.formulation
        assert isinstance(whole, BoundaryFormulation)
        surface, held = whole.surface, problem.support.held
        found = given or cut(surface.points, surface.triangles, count, _rim(surface, held))
        self.cut = found if given or len(found.parts) == 1 else found.at_rims(held)
        points = self.cut.points
        n = len(points)
        self.rest = points - problem.body.origin
        self.n_parts = len(self.cut.parts)
        filled = whole.parameters.fluid_in_cavities
        self._n_filled = int(surface.shells.max()) if filled else 0
        self._n_further = self._n_filled + (len(self.cut.ends) > 0)
        self.n_pressures = self.n_parts + self._n_further
        self.free = np.ones(n, np.bool_)
        self.free[: len(held)] = ~held
        fixed = ~self.free
        uses = np.zeros(n, np.int64)
        for triangles in self.cut.parts:
            uses[np.unique(triangles)] += 1
        self._ground = whole.parameters.ground
        shared = uses > 1
        if self._ground is not None:
            shared[np.flatnonzero(np.diff(self._ground.indptr).reshape(-1, 3).any(axis=1))] = True
        shared &= self.free
        place = np.cumsum(shared) - 1
        self._shared, self._n_shared = shared, int(shared.sum())
        self._ground_joining = np.zeros((3 * self._n_shared, 3 * self._n_shared))
        if self._ground is not None:
            sprung = np.flatnonzero(shared[: surface.n_nodes])
            at = dofs(place[sprung])
            self._ground_joining[np.ix_(at, at)] = self._ground[dofs(sprung)][:, dofs(sprung)].toarray()
        # of the part that a node of the surface turns with, where a load follows it
        self.owner = np.zeros(n, np.int64)
        for number, triangles in enumerate(self.cut.parts):
            self.owner[triangles] = number
        self.owner = self.owner[: surface.n_nodes]
        parameters = replace(whole.parameters, ground=None, fluid_in_cavities=False)
        of_shell = np.zeros(n, np.int64)  # nodes of caps are of none, and so are facets with one of them
        of_shell[surface.triangles] = surface.shells[:, None]
        of_shell[n - len(self.cut.ends) :] = of_shell[self.cut.ends].min(axis=1)
        self.problem, block = problem, None
        if self.n_parts == 1:
            self.factor = BorderedFactor(problem)
            block = self.factor.block
        self.parts: list[Part] = []
        on_caps = np.arange(n) >= surface.n_nodes
        on_caps[n - len(self.cut.ends) :] = on_caps[self.cut.ends].any(axis=1)
        tractions = list(self.cut.tractions)
        for number, triangles in enumerate(self.cut.parts):
            nodes, local = np.unique(triangles, return_inverse=True)
            walls = of_shell[triangles].min(axis=1)[:, None] == 1 + np.arange(self._n_filled)
            if self.n_parts == 1:
                form = copy.copy(whole)
                form.parameters = parameters
            else:
                own = SurfaceMesh(points[nodes], local.reshape(-1, 3))
                if number == len(tractions):
                    tractions.append(_tractions(own, fixed[nodes], on_caps[nodes], surface.n_nodes))
                form = BoundaryFormulation(
                    own, parameters, fixed[nodes], surface.n_nodes, tractions=tractions[number]
                )
            form.swelling = Swelling.of(form)
            owns = np.zeros(len(nodes), np.bool_)
            on_surface = nodes < surface.n_nodes
            owns[on_surface] = self.owner[nodes[on_surface]] == number
            inner = self.free[nodes] & ~shared[nodes]
            part = condensed(
                form, nodes, inner, shared[nodes], owns, walls, place[nodes[shared[nodes]]], block
            )
            self.parts.append(part)
        self.cut = given or replace(self.cut, tractions=tuple(tractions))
        # all parts at once, one after another
        self._joint = DeformableSurface.together([part.body for part in self.parts])
        self._nodes = np.concatenate([part.nodes for part in self.parts])
        self._walls = np.concatenate([part.walls for part in self.parts])
        sizes = np.array([len(part.nodes) for part in self.parts], np.int64)
        facets = np.array([len(part.walls) for part in self.parts], np.int64)
        self._part = np.repeat(np.arange(self.n_parts), sizes)
        self._first, self._first_facet = np.cumsum(sizes) - sizes, np.cumsum(facets) - facets
        self._spans = _spans(sizes)
        # inner nodes of all parts, and which of the shared nodes each has
        self._inner = np.concatenate([part.nodes[part.inner] for part in self.parts])
        self._places = np.concatenate([part.places for part in self.parts])
        inner = np.array([part.inner.sum() for part in self.parts])
        joins = np.array([len(part.places) for part in self.parts])
        self._inner_part, self._joined_part = (np.repeat(np.arange(self.n_parts), k) for k in (inner, joins))
        self._unknowns = list(zip(self.parts, _spans(3 * inner), _spans(3 * joins), strict=True))
        self._sum, self._join = _summing(self._nodes, n), _summing(self._places, self._n_shared)
        at_rest = np.zeros((len(self._nodes), 3))
        self.volumes = self._kept(self._joint.at(at_rest), at_rest)[0]
        swellings = [part.swelling for part in self.parts]
        self._beyond = np.concatenate([one.beyond for one in swellings])
        self.give = np.append([one.give for one in swellings], np.zeros(self._n_further))
        # of a unit slope of a part's weight: forces that its squeeze takes (n, 3, 3), and volume (3,)
        self._squeeze = [
            _squeeze(part)
            for part in self.parts
            if part.swelling.give and problem.support.gravity is not None
        ]
        # and forces (n, 3, 3) under its rims, which only one that is not cut has
        self._under_rims = [part.form.pressed_at_rims() for part in self.parts if self.n_parts == 1]
        self.wanted = 1
        self._turns: Array | None = None
        self._slope: _Slope | None = None
        self._lacked = np.inf, np.inf  # at the last two corrections, and under which load
        self._load: Load | None = None
        self._before: Balance | None = None  # that the last correction was for
        self._factor: Factor = Nothing()
        if self.n_parts > 1:
            self._joined_at(np.tile(np.eye(3), (self.n_parts, 1, 1)))
            form = JoinedFormulation(
                whole, self.parts, self._shared, self._factor, has_rims=len(self.cut.ends) > 0
            )
            self.problem = replace(problem, formulation=form)
            self.factor = BorderedFactor(self.problem)

    def balance(self, load: Load, x: Array, pressure: Array) -> Balance:
        """As in `Large`."""
        problem, n_surface = self.problem, self.problem.formulation.surface.n_nodes
        m, state = self.n_parts, self._joint.at(x[self._nodes])
        turns = best_rotation(moments(self._joint.levers, state.positions, self._spans))
        placed = [state.positions[span] @ q.T for span, q in zip(self._spans, turns, strict=True)]
        away = np.concatenate(placed) - self._joint.rest
        forces = np.concatenate([part.form.swollen_force(away[span]) for part, span in self._each()])
        kept, filled = self._kept(state, x[self._nodes])
        volumes, grown = kept[:m], kept - self.volumes
        grown[:m] += np.add.reduceat(np.einsum("nc,nc->n", self._beyond, away), self._first)
        energy = 0.5 * float(np.vdot(away, forces))
        energy += 0.5 * float((grown[:m] ** 2 / np.where(self.give[:m], self.give[:m], np.inf)).sum())
        rise, weight, datum = self._weight(load, state, volumes)
        inward, squeezed = self._inward(pressure, rise, turns)
        gap = (grown + self.give * pressure - squeezed) / self.volumes
        internal = np.asarray(self._sum @ turned_back(forces + inward, turns, state, self._spans))
        pushed = (pressure[self._part] + weight)[:, None] * state.area_vectors
        pushed += filled @ pressure[m:]
        for under_rims in self._under_rims:
            pushed += (under_rims @ (turns[0] @ rise[0])) @ turns[0]
        applied = np.asarray(self._sum @ pushed)
        outer = problem.body.at(x[:n_surface], turns[0] if m == 1 else turns[self.owner])
        on_surface = problem.deformed_force(replace(load, weight=0.0), outer, outer.area_vectors)
        applied[:n_surface] += on_surface
        if load.dead_force is not None:
            on_surface = on_surface - load.dead_force
        if self._ground is not None:
            internal[:n_surface] += (self._ground @ x[:n_surface].reshape(-1)).reshape(-1, 3)
        scale = max(float(np.linalg.norm(force[self.free])) for force in (internal, applied))
        gradient = state.area_vectors
        if self.give.any():
            placed = [self._beyond[span] @ q for span, q in zip(self._spans, turns, strict=True)]
            gradient = gradient + np.concatenate(placed)
        acting = _Acting(
            state, turns, away, energy, on_surface, weight, rise, datum, gradient, inward, squeezed, filled
        )
        return Balance(load, x, pressure, gap, internal - applied, scale, acting)

    def _weight(self, load: Load, state: DeformedSurface, volumes: Array) -> tuple[Array, Array, Array]:
        """Slope, pressure and datum of the weight of a state, see `_Acting`: a part keeps its mass."""
        m, problem = self.n_parts, self.problem
        support = problem.support
        if support.gravity is None:
            return np.zeros((m, 3)), np.zeros(len(self._nodes)), np.zeros(m)
        slope = load.weight * support.density * support.gravity
        sizes = np.diff(np.append(self._first, len(self._nodes)))
        middles = np.add.reduceat(state.positions, self._first) / sizes[:, None]
        rise = slope * (self.volumes[:m] / volumes)[:, None]
        weight = np.einsum("nc,nc->n", state.positions - middles[self._part], rise[self._part])
        places = middles + self._joint.origin[self._first] - problem.body.origin
        return rise, weight, places @ slope - float((problem.body.rest @ slope).min())

    def _inward(self, pressure: Array, rise: Array, turns: Array) -> tuple[Array, Array]:
        """See `_Acting`; and by how much weight alone squeezes the volumes of parts and cavities (m + c,) [m^3]."""
        inward, squeezed = -pressure[self._part][:, None] * self._beyond, np.zeros(len(pressure))
        for e, (pulled, flux) in enumerate(self._squeeze):
            slope = turns[e] @ rise[e]
            inward[self._spans[e]] -= pulled @ slope
            squeezed[e] = flux @ slope
        return inward, squeezed

    def _each(self) -> Iterator[tuple[Part, slice]]:
        """Parts, and where their nodes are among those of all."""
        return zip(self.parts, self._spans, strict=True)

    @property
    def _rows_of_volumes(self) -> Index:
        """(m + c,) rows of the system of all borders: volumes of parts, then of filled cavities and of rims."""
        rows = BORDER * self.n_parts
        return np.append(np.arange(0, rows, BORDER), rows + np.arange(self._n_further))

    def _kept(self, state: DeformedSurface, moved: Array) -> tuple[Array, Array]:
        """(m + c,) volumes that the pressures are of; the gradient (n_p, 3, c) of all but the parts'.

        That of rims is what the parts, of which the nodes `moved` (n_p, 3), have beside those with flat rims, to
        which the body's volume at rest is added: its rims bulge by as much as they sink.
        """
        volumes, (held, filled) = state.volumes(self._first_facet), self._cavities(state)
        kept = np.append(volumes, held)
        if len(self.cut.ends):
            flat = self._joint.at(self._flat @ moved)
            beside = volumes.sum() - flat.volumes(self._first_facet).sum()
            kept = np.append(kept, self.problem.body.surface.volume + beside)
            bulging = state.area_vectors - self._flat.T @ flat.area_vectors
            filled = np.concatenate([filled, bulging[:, :, None]], axis=2)
        return kept, filled

    @cached_property
    def _flat(self) -> sparse.csr_array:
        """(n_p, n_p) that puts the new nodes of rims on the edges that they cut."""
        n = len(self.free)
        placed = on_edges(self.cut.ends, n - len(self.cut.ends))
        whole = sparse.csr_array((placed.data, placed.indices, placed.indptr), shape=(n, n))
        return sparse.block_diag([whole[part.nodes][:, part.nodes] for part in self.parts], format="csr")

    def _cavities(self, state: DeformedSurface) -> tuple[Array, Array]:
        """Volumes (k,) of the filled cavities, and their gradient (n_p, 3, k) at the nodes of all parts.

        Parts add volumes to the rest centroid of the body; their sum is the cavity's.
        """
        if not self._n_filled:
            return np.zeros(0), np.zeros((len(self._nodes), 3, 0))
        vectors = np.where(self._walls[:, :, None], state.facet_vectors.T[:, None], 0.0)
        corner = self._joint.corners[0]
        corners = state.positions[corner] + self._joint.origin[corner] - self.problem.body.origin
        gradient = [self._joint.gather @ np.ascontiguousarray(-vectors[:, k]) for k in range(self._n_filled)]
        return np.einsum("fkc,fc->k", vectors, corners) / -3.0, np.stack(gradient, axis=2)

    def correction(
        self,
        balance: Balance,
        lacking: Array,
        gap: Array,
        turn: Array,  # noqa: ARG002 - each part has a frame of its own
    ) -> tuple[Array, Array]:
        """As in `Large`."""
        change, pushed = self._answer(self._slope_for(balance, lacking, gap), balance, lacking, gap)
        if lacking.any():
            self._before = balance
        return change, pushed

    def stiffness_left(self, balance: Balance) -> float:
        """As in `Large`.

        The least eigenvalue of the state's slope over that of its parts without forces, where volumes are kept: 1
        at rest, 0 at a limit point. By Arnoldi's method, of central differences: those to one side have half of
        what the change stretches a slender part, which withstands that far more than being bent.
        """
        slope = self._slope_at(balance, self._joined_at(balance.parts.turns), forceless=True)
        self._slope = None  # its factor may be that of other rotations
        away = SMALL_CHANGE * float(np.ptp(self.rest, axis=0).max())

        def softened(direction: Array) -> Array:
            step = away / float(np.abs(direction).max())
            on, back = (self._beside(balance, to * step * direction) for to in (1.0, -1.0))
            lacking, gap = (on.lacking - back.lacking) / (2.0 * step), (on.gap - back.gap) / (2.0 * step)
            return -self._answer(slope, balance, lacking, gap)[0].reshape(-1)

        start = np.random.default_rng(0).standard_normal(3 * int(self.free.sum()))
        return least_eigenvalue(softened, start)

    def _beside(self, balance: Balance, change: Array) -> Balance:
        """Of the state that is away by a change (3 n_free,)."""
        x = balance.x.copy()
        x[self.free] += change.reshape(-1, 3)
        return self.balance(balance.load, x, balance.pressure)

    def _answer(self, slope: _Slope, balance: Balance, lacking: Array, gap: Array) -> tuple[Array, Array]:
        """As `correction`, by a slope."""
        kept = self._rows_of_volumes
        target = np.zeros(len(slope.system))
        target[kept] = -gap * self.volumes
        # vectors in rows: v of the world is v @ q.T in the part's frame
        within = np.einsum("nd,ncd->nc", -lacking[self._inner], slope.inner).reshape(-1)
        inside, met = np.empty_like(within), np.empty(3 * len(self._places))
        for (part, i, c), columns, pushes in zip(self._unknowns, slope.columns, slope.pushes, strict=True):
            inside[i] = part.block.solve(within[i])
            target[columns] -= inside[i] @ pushes
            met[c] = within[i] @ part.follows
        joined = self._join @ np.einsum("nc,ncd->nd", met.reshape(-1, 3), slope.joined)
        first = np.asarray(self._factor.solve((-lacking[self._shared] - joined).reshape(-1)))
        push = np.asarray(np.linalg.solve(slope.system, target - first @ slope.border), np.float64)
        moved = self._moved(slope.inner, slope.joined, first[:, None], inside[:, None])[:, 0]
        change = (moved + slope.answers @ push).reshape(-1, 3)
        closing, more = self._closing(slope, balance, change, push[kept], gap)
        return (change + closing)[self.free], push[kept] + more

    def closing(self, balance: Balance, change: Array, pushed: Array) -> tuple[Array, Array]:
        """As in `Large`."""
        moved = np.zeros_like(balance.x)
        moved[self.free] = change
        assert self._slope is not None
        closing, push = self._closing(self._slope, balance, moved, pushed, balance.gap)
        return closing[self.free], push

    def _closing(
        self, slope: _Slope, balance: Balance, change: Array, pushed: Array, gap: Array
    ) -> tuple[Array, Array]:
        """What more (n, 3) and which pressures close gaps by the gradients of the state's own volumes.

        A slope that is kept, and a mixture, close those of other states.
        """
        acting = balance.parts
        at_parts, missed = change[self._nodes], np.zeros(len(slope.system))
        flux = np.add.reduceat(np.einsum("nc,nc->n", acting.gradient, at_parts), self._first)
        kept = self._rows_of_volumes
        missed[kept] = -gap * self.volumes - np.append(flux, np.einsum("nck,nc->k", acting.filled, at_parts))
        missed[kept] -= self.give * pushed
        push = np.linalg.solve(slope.system, missed)
        return (slope.answers @ push).reshape(-1, 3), np.asarray(push[kept])

    def _moved(self, of_inner: Array, of_joined: Array, together: Array, inside: Array) -> Array:
        """(3n, r) by r motions of nodes that are shared (3 n_C, r) and what moves each part's own (3 n_I, r).

        With the rotations of all inner nodes and of the shared ones of each part, as in `_Slope`.
        """
        r = together.shape[1]
        shared = together.reshape(-1, 3, r)
        own = np.einsum("ncd,ndr->ncr", of_joined, shared[self._places]).reshape(-1, r)
        follows = [part.follows @ own[c] for part, _, c in self._unknowns]
        inside = (inside - np.concatenate(follows)).reshape(-1, 3, r)
        change = np.zeros((len(self.free), 3, r))
        change[self._shared] = shared
        change[self._inner] = np.einsum("ncd,ncr->ndr", of_inner, inside)
        return change.reshape(-1, r)

    def _slope_for(self, balance: Balance, lacking: Array, gap: Array) -> _Slope:
        """The slope of a state, or the last one where that serves.

        Far from balance: where parts have hardly turned and `MOST_LEFT` holds. Near it corrections are mixed, what
        the slope misses is learnt, and it serves while two of them gain at all. What another load lacked tells
        nothing of the slope, nor do volumes alone; one that ended far from its balance leaves none.
        """
        turns = balance.parts.turns
        lacks = max(
            float(np.linalg.norm(lacking[self.free])) / (balance.scale or 1.0), float(np.abs(gap).max())
        )
        is_far = lacks >= NEAR
        before, last = self._lacked
        if balance.load is not self._load:
            gains, last = last < NEAR, np.inf
        else:
            gains = lacks <= (MOST_LEFT * last if is_far else before)
        if lacking.any():
            self._lacked, self._load = (last, lacks), balance.load
        slope = self._slope if gains else None
        if slope is None or (is_far and np.abs(turns - slope.turns).max() > SAME_TURN):
            slope = self._slope = self._slope_at(balance, self._joined_at(turns))
        return slope

    def _slope_at(self, balance: Balance, turns: Array, *, forceless: bool = False) -> _Slope:
        """The slope of a state; `forceless` as if nothing acted in it nor on it, which is not negative."""
        n, m, k = self._n_shared, self.n_parts, BORDER
        acting: _Acting = balance.parts
        # of the border those of each part, and after them the pressures of further volumes
        columns = [np.append(k * e + np.arange(k), k * m + np.arange(self._n_further)) for e in range(m)]
        size = k * m + self._n_further
        border, corner = np.zeros((n, 3, size)), np.zeros((size, size))
        away = self._foreseen(balance)
        pushed, inside = list[Array](), np.zeros((3 * len(self._inner), size))
        for e, ((part, i, _), q, at) in enumerate(zip(self._unknowns, turns, columns, strict=True)):
            turning, own = self._turning(e, q, balance, away[self._spans[e]], forceless)
            filled = np.einsum("nck,dc->ndk", acting.filled[self._spans[e]], q)
            pressed = (acting.gradient[self._spans[e]] @ q.T)[:, :, None]
            pushes = np.concatenate([pressed, turning, filled], axis=2)
            within = pushes[part.inner].reshape(-1, len(at))
            pushed.append(within)
            answered = np.asarray(part.block.solve(np.asfortranarray(within)))
            inside[i, at] = answered
            corner[np.ix_(at, at)] += within.T @ answered
            corner[np.ix_(at[1:k], at[1:k])] += own
            corner[k * e, k * e] += self.give[e]
            if not (part.inner | part.shared).any() and not self.give[e]:
                corner[k * e, k * e] = 1.0  # it is held all over, and its pressure is at rest
            joined = pushes[part.shared] - (part.follows.T @ within).reshape(-1, 3, len(at))
            border[part.places[:, None], :, at] += np.einsum("ncj,cd->njd", joined, q)
        flat = border.reshape(3 * n, size)
        together = np.asarray(self._factor.solve(np.asfortranarray(flat)))
        of_nodes = turns[self._inner_part], turns[self._joined_part]
        answers = self._moved(*of_nodes, together, inside)
        return _Slope(turns, *of_nodes, columns, pushed, flat, answers, flat.T @ together + corner)

    def _foreseen(self, balance: Balance) -> Array:
        """(n_p, 3) displacement in the parts' frames that the last correction foresaw of a state.

        To first order. What is added on the way turns, and adding stretches what turns: forces of a stretch that
        the next correction takes off make a slope that leads astray where a body is slender (Magisano, Leonetti and
        Garcea, Comput. Methods Appl. Mech. Engrg. 313, 2017).
        """
        before = self._before
        if before is None or before.load is not balance.load:
            return np.asarray(balance.parts.away)
        away, change = before.parts.away.copy(), (balance.x - before.x)[self._nodes]
        for (part, span), q in zip(self._each(), before.parts.turns, strict=True):
            y = before.parts.state.positions[span] @ q.T
            y, moved = y - part.areas @ y, change[span] @ q.T
            turn = np.einsum("nak,na->k", _turn_of(part.body.levers, y), moved)
            away[span] += moved - np.cross(turn, y)
        return np.asarray(away)

    def _turning(
        self, number: int, q: Array, balance: Balance, away: Array, forceless: bool
    ) -> tuple[Array, Array]:
        """What turning a part adds to its slope, `U C U^T`: U (n, 3, 6) in its frame, and C^-1 (6, 6).

        See the head of this file; `away` (n, 3) is its displacement there. Its weight presses its closed surface,
        so that it turns as one.
        """
        part, acting, span = self.parts[number], balance.parts, self._spans[number]
        levers = part.body.levers
        y = acting.state.positions[span] @ q.T
        y = y - part.areas @ y
        turned = (y @ TURNED).reshape(-1, 3, 3)
        stressed = part.form.swollen_forces(np.concatenate([away[:, :, None], turned], axis=2))
        vectors = acting.state.area_vectors[span] @ q.T
        pushed = (balance.pressure[number] + acting.weight[span])[:, None] * vectors - acting.inward[span]
        own = part.nodes[part.owns]
        pushed[part.owns] += acting.on_surface[own] @ q.T
        pushed += acting.filled[span] @ balance.pressure[self.n_parts :] @ q.T
        slope = -stressed[:, :, 1:]
        if not forceless:
            slope += ((stressed[:, :, 0] - pushed) @ TURNED).reshape(-1, 3, 3)
            slope -= vectors[:, :, None] * ((q @ acting.rise[number]) @ turned)[:, None, :]
        met = turned.reshape(-1, 3).T @ slope.reshape(-1, 3)
        inverse = np.zeros((6, 6))
        inverse[:3, 3:] = inverse[3:, :3] = np.eye(3)
        inverse[3:, 3:] = 0.5 * (met + met.T)
        return np.concatenate([_turn_of(levers, y), slope], axis=2), inverse

    def _joined_at(self, turns: Array) -> Array:
        """(m, 3, 3) rotations for a correction: these, or those of the last factor where no part has left it."""
        if self._turns is not None and np.abs(turns - self._turns).max() < SAME_TURN:
            return self._turns
        matrix = self._ground_joining.copy()
        for part, q in zip(self.parts, turns, strict=True):
            at = dofs(part.places)
            matrix[np.ix_(at, at)] += turned_block(part.carried, q, q)
        if len(matrix):
            self._factor = DenseFactor(matrix, few=True)
        self._turns = turns
        return turns

    def energy(self, balance: Balance) -> float:
        """Elastic energy [J], that of springs to the ground too."""
        total: float = balance.parts.energy
        if self._ground is not None:
            u = balance.x[: self.problem.formulation.surface.n_nodes].reshape(-1)
            total += 0.5 * float(u @ (self._ground @ u))
        return total

    def mean_pressure(self, balance: Balance) -> float:
        """By volume [Pa]: a part's is that of the tractions, as in one that is not swollen."""
        m, acting = self.n_parts, balance.parts
        volumes, shares = self.volumes[:m], 0.0
        for part, span in self._each():
            shares += part.swelling.pressure(acting.away[span]) / 3.0
        # a fluid's pressure is that at the datum; a squeeze by weight is none of the tractions'
        give = self.give[:m]
        above = np.where(give > 0.0, acting.squeezed[:m] / np.where(give > 0.0, give, 1.0), acting.datum)
        return float(((balance.pressure[:m] - above) @ volumes + shares) / volumes.sum())

    def scalars(self, balance: Balance) -> dict[str, float]:
        """`parts`, `part_rotation` the largest between two [rad], `part_strain` the largest within one.

        And of each `rotation_of_part_1` from rest [rad], `strain_of_part_1`, and so on.
        """
        turns = balance.parts.turns
        between = _angles(np.einsum("aij,bij->ab", turns, turns))
        strains = self._strains(balance)
        found = {"parts": self.n_parts, "part_rotation": between.max(), "part_strain": max(strains)}
        each = _angles(np.trace(turns, axis1=1, axis2=2))
        found |= {f"rotation_of_part_{k}": angle for k, angle in enumerate(each, 1)}
        found |= {f"strain_of_part_{k}": strain for k, strain in enumerate(strains, 1)}
        return {name: float(value) for name, value in found.items()}

    def _strains(self, balance: Balance) -> list[float]:
        """Of each part, see `surface_strain`: of its facets as they were, which do not grow finer at rims."""
        positions, ratio = self.rest + balance.x, self.parts[0].form.poisson_ratio
        return [surface_strain(self.rest, positions, t, ratio) for t in self.cut.uncut or self.cut.parts]

    def reserved(self, status: Status, balance: Balance) -> Status:
        """The status, with what the parts do not follow: too few of them, strain within one."""
        if self.n_parts < self.wanted:
            message = f"{self.wanted} parts are called for, and {self.n_parts} made"
            why = f" ({self.cut.refused})" if self.cut.refused else ""
            status = status.telling(message + why, "refine the surface, or use finite elements")
        strain = max(self._strains(balance))
        if strain > LARGEST_STRAIN:
            status = status.telling(
                f"a part is strained by {100 * strain:.0f} %, and follows small strain inside",
                "use finite elements of finite strain where the change of shape matters",
            )
        return status


def _angles(traces: Array) -> Array:
    """Of rotations by their traces [rad]."""
    return np.asarray(np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0)))


def least_eigenvalue(apply: Callable[[Array], Array], start: Array) -> float:
    """The least real part of an eigenvalue of a map (n,) -> (n,), by Arnoldi's method."""
    count = min(KRYLOV, len(start))
    basis, projected = np.zeros((count + 1, len(start))), np.zeros((count + 1, count))
    basis[0] = start / np.linalg.norm(start)
    for k in range(count):
        image = apply(basis[k])
        for _ in range(2):  # once leaves rounding
            shares = basis[: k + 1] @ image
            image = image - shares @ basis[: k + 1]
            projected[: k + 1, k] += shares
        projected[k + 1, k] = np.linalg.norm(image)
        basis[k + 1] = image / (projected[k + 1, k] or 1.0)
    return float(np.linalg.eigvals(projected[:count]).real.min())


def inverse_inertia(stretch: Array) -> Array:
    """(3, 3) by what couples arms turn a part, from the sum (3, 3) of the products of its arms and positions."""
    return np.asarray(np.linalg.inv(np.trace(stretch) * np.eye(3) - stretch))


def _turn_of(levers: Array, y: Array) -> Array:
    """(n, 3, 3) W: how nodes that move turn a part with arms and positions (n, 3); the turn is sum W^T dy."""
    return np.einsum("kb,nab->nak", inverse_inertia(levers.T @ y), (levers @ TURNED).reshape(-1, 3, 3))


def turned_block(matrix: Array, q: Array, p: Array) -> Array:
    """(3n, 3n) symmetric matrix between a part's frame and the world's: q^T M p node by node."""
    n = len(matrix)
    half = (matrix.reshape(n, n // 3, 3) @ q).reshape(n, n)
    return (half.T.reshape(n, n // 3, 3) @ p).reshape(n, n)


def _squeeze(part: Part) -> tuple[Array, Array]:
    """What the squeeze of a part under the pressures x, y, z about its nodes' mean takes, over their slopes.

    Forces (n, 3, 3) [N/(Pa/m)] without its swelling, and the volume (3,) [m^3/(Pa/m)].
    """
    moved = part.form.squeezed()
    swells = part.swelling.beyond + part.form.surface.area_vectors
    return part.form.swollen_forces(moved), np.einsum("nc,nck->k", swells, moved)


def _spans(sizes: Index) -> list[slice]:
    """Where things of such sizes are that lie one after another."""
    ends = np.cumsum(sizes)
    return list(map(slice, (ends - sizes).tolist(), ends.tolist()))


def _summing(places: Index, count: int) -> sparse.csr_array:
    """(count, k) sums what has these places (k,)."""
    ones, every = np.ones(len(places)), np.arange(len(places))
    return sparse.csr_array(sparse.coo_array((ones, (places, every)), shape=(count, len(places))))


def _tractions(surface: SurfaceMesh, held: Mask, on_caps: Mask, n_body: int) -> Index:
    """Of a part's facets: those with nodes (N,) on caps share them in pairs, of a large body all.

    With one of each facet the few nodes of a cap would follow tractions that they do not resolve, and stiffen it.
    """
    from vdm.boundary.operators import precision  # numba takes a third of a second to import

    of_caps: Mask = np.asarray(on_caps[surface.triangles].any(axis=1))
    return shared_tractions(surface, held, None if precision(n_body) is np.float32 else of_caps)


def _rim(surface: SurfaceMesh, held: Mask) -> Mask | None:
    """(N,) nodes at the rim of what is held, None where there is none."""
    start, end = surface.edges.T
    crossing = surface.edges[held[start] != held[end]]
    rim = np.zeros(surface.n_nodes, np.bool_)
    rim[crossing] = True
    return rim if len(crossing) else None


def pieces_of(surface: SurfaceMesh) -> list[Index]:
    """Nodes of pieces of a surface: halves by area across their longest axes, of these again, and so on."""
    pieces = [np.arange(surface.n_nodes)]
    for _ in range(HALVINGS):
        pieces = [half for nodes in pieces for half in _halves(surface, nodes)]
    return pieces


def _halves(surface: SurfaceMesh, nodes: Index) -> list[Index]:
    areas = surface.nodal_areas[nodes]
    along = np.argsort(along_longest_axis(surface.points[nodes], areas)[0])
    middle = int(np.searchsorted(np.cumsum(areas[along]), 0.5 * areas.sum()))
    few = min(middle, len(nodes) - middle) < FEWEST
    return [nodes] if few else [nodes[along[:middle]], nodes[along[middle:]]]


def parts_wanted(surface: SurfaceMesh, pieces: list[Index], displacement: Array) -> int:
    """How many parts a body needs that moves by (N, 3): 1, or the power of two that leaves `MOST_TURN` in each.

    By the small rotations that best fit its `pieces_of`, the largest between two of them.
    """
    turns = np.array([_small_rotation(surface, nodes, displacement) for nodes in pieces])
    spread = float(np.linalg.norm(turns[:, None] - turns[None], axis=2).max())
    return 1 if spread <= MOST_TURN else 2 ** int(np.ceil(np.log2(spread / MOST_TURN)))


def _small_rotation(surface: SurfaceMesh, nodes: Index, displacement: Array) -> Array:
    """(3,) rotation vector that best fits the motion of some nodes, by area."""
    area = surface.nodal_areas[nodes][:, None]
    arms = surface.points[nodes] - (area * surface.points[nodes]).sum(axis=0) / area.sum()
    moved = (area * np.cross(arms, displacement[nodes])).sum(axis=0)
    inertia = (area * arms**2).sum() * np.eye(3) - (area * arms).T @ arms
    return np.asarray(np.linalg.solve(inertia, moved))


def surface_strain(rest: Array, positions: Array, corners: Index, poisson_ratio: float) -> float:
    """Largest principal stretch of facets (F, 3), less 1, that 99 % of the area stays below.

    Under a surface without load the thickness takes what Poisson's ratio says, at 1/2 what the area loses.
    """
    sides = [
        np.stack([places[corners[:, k]] - places[corners[:, 0]] for k in (1, 2)], axis=1)
        for places in (rest, positions)
    ]
    before, after = (side @ side.transpose(0, 2, 1) for side in sides)
    stretches = np.sqrt(np.clip(np.linalg.eigvals(np.linalg.solve(before, after)).real, 1e-300, None))
    third = stretches.prod(axis=1) ** (-poisson_ratio / (1.0 - poisson_ratio))
    strain = np.abs(np.column_stack([stretches, third]) - 1.0).max(axis=1)
    order = np.argsort(strain)
    areas = np.cumsum(np.sqrt(np.linalg.det(before))[order])
    return float(strain[order][np.searchsorted(areas, MOST_AREA * areas[-1])])
