"""A body in parts at large displacements: corotational boundary-element bodies, joined at their cuts.

Part e has the stiffness S_e of its own closed surface (`vdm.peers.bem.BoundaryFormulation`). The stiffness turns
with the rotation Q_e that best fits the part. At nu = 1/2 a pressure p_e, a Lagrange multiplier, keeps the part's
volume. Strain within a part is small, rotation between parts is large: the corotational method (Felippa and Haugen,
Comput. Methods Appl. Mech. Engrg. 194, 2005) with whole boundary-element bodies as elements.

The tangent stiffness of a part, in its frame, is S_e plus terms from its rotation. y are positions and a X the
levers (areas times rest positions), both about their mean; f = S_e w less the forces that turn with the part
(pressures, contact); e_k are the axes:

`K = S + B W + W^T B^T - W^T (Y^T B) W`, `omega = W dy = M^-1 sum a X x dy`, `M = tr(P) I - P`, `P = sum a X y^T`,
`Y_k = e_k x y`, `B_k = e_k x f - S Y_k - (rho g . Y_k) g`, g the gradient of its volume (or area vectors).

That is S plus a term U C U^T of rank 6, `U = [W^T, B]`, `C^-1 = [[0, I], [I, Y^T B]]`: the geometric stiffness of a
corotational element. It neglects terms of the order of the strain. The weight acts as a pressure on the part's
closed surface, so rigid motion of the part does not change it.

S is condensed to the nodes C that parts share. The part's inner nodes are I, and `T = S_II^-1 S_IC` is computed
once. U and g are columns of a border E, with unknowns q, of which the first is the pressure:

`u_I = S_II^-1 (f_I + E_I q) - T u_C`, `(S_CC - S_CI T) u_C - H q = f_C - T^T f_I`, `H = E_C - T^T E_I`,
`H^T u_C + (E_I^T S_II^-1 E_I + D) q = t - E_I^T S_II^-1 f_I`. D is C^-1 for U; t is the missing volume for g.
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
from vdm.deformed import DeformableSurface, DeformedSurface, best_rotation, follow
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

# largest rotation within a part [rad]: in a linear strain it shows as half its square
MOST_TURN = np.radians(10.0)
SAME_TURN = 0.01  # change of a rotation [rad] up to which the factor of the shared nodes is kept
MOST_LEFT = 0.2  # share of the residual: a tangent that leaves more after a correction is assembled anew
HALVINGS = 4  # how often the surface is halved, into pieces whose rotations are compared
FEWEST = 20  # least nodes of such a piece: as many as the smallest part has outside its caps
# share of the area that the strain is reported for: at rims the strain grows without limit on finer meshes
MOST_AREA = 0.99
LARGEST_STRAIN = 0.1
# (3, 9): v @ TURNED is (3, 3) with e_k x v in column k
TURNED = np.cross(np.eye(3)[None], np.eye(3)[:, None]).transpose(0, 2, 1).reshape(3, 9)
KRYLOV = 15  # steps of Arnoldi's method for the least eigenvalue of a tangent
SMALL_CHANGE = 1e-6  # step of the central differences, in sizes of the body
BORDER = 7  # further unknowns of a part: its pressure, and six for the rank of its rotational terms


@dataclass(frozen=True)
class _Acting:
    """The deformed state of the parts and the forces on them. n_p counts the nodes of all parts, one after another.

    Attributes
    ----------
    state : (n_p,) deformed surfaces of all parts
    turns : (m, 3, 3) rotations Q of the parts
    away : (n_p, 3) displacement w in each part's frame [m]
    energy : elastic energy of the parts [J]
    on_surface : (N, 3) forces on the body's surface that turn with it: contact less its level [N]
    weight : (n_p,) pressure of the weight, zero at the mean position of each part [Pa]
    rise : (m, 3) gradient of that pressure [Pa/m]
    datum : (m,) pressure of the weight at those means, zero at the highest point of the body at rest [Pa]
    gradient : (n_p, 3) gradient of the volumes that the pressures keep, with that of `Swelling` [m^2]
    pressure : (m + c,) pressures, those of the parts with the level of the load [Pa]
    inward : (n_p, 3) forces in each part's frame from swelling and from compression by the weight [N]
    squeezed : (m + c,) volume that the weight compresses each part by, zero for other volumes [m^3]
    filled : (n_p, 3, c) gradient of the further volumes: fluid-filled cavities and bulges at rims [m^2]
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
    pressure: Array
    inward: Array
    squeezed: Array
    filled: Array


@dataclass(frozen=True)
class _Slope:
    """The tangent stiffness of a state, as at the head of this file; q (r,) are the border unknowns of all parts.

    Attributes
    ----------
    turns : (m, 3, 3) rotations of the parts
    inner, joined : (., 3, 3) those rotations for the inner nodes, and for the shared nodes of each part
    columns : for each part the indices of its unknowns in q
    pushes : for each part E_I (3 n_I, k)
    border : (3 n_C, r) H
    answers : (3n, r) displacement of all nodes for unit q
    system : (r, r) Schur complement for q
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
    """A boundary-element body, cut into `count` parts; a `vdm.solvers.nonlinear.Large`.

    The nodes of the problem's surface come first, then those inside. A single part is the problem's own
    formulation. The pressures are those of the parts less the level of the load (`_levelled`), then those of the
    fluid-filled cavities, then that of the rims.

    Parameters
    ----------
    problem : a problem of boundary elements
    count : number of parts; a fork may get more
    given : the cut to use; None for a new one

    Attributes
    ----------
    problem : the problem at small displacements, with the stiffness of the parts
    factor : the factor of that problem
    rest : (n, 3) rest positions of all nodes, relative to the body's origin [m]
    free : (n,) mask of the nodes without supports
    n_parts, n_pressures : number of parts, and of kept volumes
    owner : (N,) part that the load on each surface node turns with
    volumes : (n_pressures,) kept volumes at rest [m^3]
    give : (n_pressures,) compressibility: change of volume over pressure [m^3/Pa]
    wanted : number of parts that the loads call for

    Raises
    ------
    SolverError
        a part cannot be factorised, or has more nodes than allowed.
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
        uses, owner = np.zeros(n, np.int64), np.zeros(n, np.int64)
        for number, triangles in enumerate(self.cut.parts):
            uses[np.unique(triangles)] += 1
            owner[triangles] = number
        self.owner = owner[: surface.n_nodes]
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
        parameters = replace(whole.parameters, ground=None, fluid_in_cavities=False)
        of_shell = np.zeros(n, np.int64)  # 0 for nodes of caps, so that facets of caps are no cavity walls
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
            owns = (nodes < surface.n_nodes) & (owner[nodes] == number)
            inner = self.free[nodes] & ~shared[nodes]
            part = condensed(
                form, nodes, inner, shared[nodes], owns, walls, place[nodes[shared[nodes]]], block
            )
            self.parts.append(part)
        self.cut = given or replace(self.cut, tractions=tuple(tractions))
        # arrays of all parts, one part after another
        self._joint = DeformableSurface.together([part.body for part in self.parts])
        self._nodes = np.concatenate([part.nodes for part in self.parts])
        self._walls = np.concatenate([part.walls for part in self.parts])
        sizes = np.array([len(part.nodes) for part in self.parts], np.int64)
        facets = np.array([len(part.walls) for part in self.parts], np.int64)
        self._part = np.repeat(np.arange(self.n_parts), sizes)
        self._first, self._first_facet = np.cumsum(sizes) - sizes, np.cumsum(facets) - facets
        self._spans = _spans(sizes)
        # inner nodes of all parts, and the positions of each part's shared nodes
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
        # compression of each part by a unit pressure gradient of its weight, see `_squeeze`
        self._squeeze = [
            _squeeze(part)
            for part in self.parts
            if part.swelling.give and problem.support.gravity is not None
        ]
        # forces (n, 3, 3) under the rims for that gradient; a body that is cut has nodes at its rims instead
        self._under_rims = [part.form.pressed_at_rims() for part in self.parts if self.n_parts == 1]
        self.wanted = 1
        self._turns: Array | None = None
        self._slope: _Slope | None = None
        self._lacked = np.inf, np.inf  # relative residuals of the last two corrections; below, their load
        self._load: Load | None = None
        self._before: Balance | None = None  # state of the last correction
        self._factor: Factor = Nothing()
        if self.n_parts > 1:
            self._joined_at(np.tile(np.eye(3), (self.n_parts, 1, 1)))
            form = JoinedFormulation(
                whole, self.parts, self._shared, self._factor, has_rims=len(self.cut.ends) > 0
            )
            self.problem = replace(problem, formulation=form)
            self.factor = BorderedFactor(self.problem)

    def is_cut_alike(self, moved: Array) -> bool:
        """Whether a cut gives the same parts, apart from caps, after the body's nodes moved by (N, 3) [m]."""
        whole = self.problem.formulation
        surface, n = whole.surface, whole.surface.n_nodes
        rim = _rim(surface, self.problem.support.held)
        other = cut(surface.points + moved, surface.triangles, self.n_parts, rim).parts
        own, others = (
            [part[(part < n).all(axis=1)] for part in parts]
            for parts in (self.cut.uncut or self.cut.parts, other)
        )
        return len(own) == len(others) and all(map(np.array_equal, own, others))

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
        level, contact = self._levelled(load)
        inside = pressure + level * (np.arange(len(pressure)) < m)
        inward, squeezed = self._inward(inside, rise, turns)
        gap = (grown + self.give * inside - squeezed) / self.volumes
        internal = np.asarray(self._sum @ turned_back(forces + inward, turns, state, self._spans))
        pushed = (pressure[self._part] + weight)[:, None] * state.area_vectors
        pushed += filled @ pressure[m:]
        for under_rims in self._under_rims:
            pushed += (under_rims @ (turns[0] @ rise[0])) @ turns[0]
        applied = np.asarray(self._sum @ pushed)
        outer = problem.body.at(x[:n_surface], turns[0] if m == 1 else turns[self.owner])
        on_surface = follow(contact, problem.formulation.surface.area_vectors, outer)
        applied[:n_surface] += on_surface
        if load.dead_force is not None:
            applied[:n_surface] += load.dead_force
        if self._ground is not None:
            internal[:n_surface] += (self._ground @ x[:n_surface].reshape(-1)).reshape(-1, 3)
        scale = max(float(np.linalg.norm(force[self.free])) for force in (internal, applied))
        gradient = state.area_vectors
        if self.give.any():
            placed = [self._beyond[span] @ q for span, q in zip(self._spans, turns, strict=True)]
            gradient = gradient + np.concatenate(placed)
        acting = _Acting(
            state,
            turns,
            away,
            energy,
            on_surface,
            weight,
            rise,
            datum,
            gradient,
            inside,
            inward,
            squeezed,
            filled,
        )
        return Balance(load, x, pressure, gap, internal - applied, scale, acting)

    def _levelled(self, load: Load) -> tuple[float, Array]:
        """Level of a load [Pa] and its contact forces (N, 3) at rest without it [N].

        The level is the least pressure, or tension, that all free nodes have in common. It is equivalent to the
        same pressure in all parts, less that of the rims, so both leave it out. Else its forces at the cuts would
        cancel to rounding only, and enter the tangent, which is inexact there once a pressure exceeds the modulus.
        """
        form = self.problem.formulation
        vectors, contact = form.surface.area_vectors, form.contact_force(self.problem.support.signed(load))
        along, squares = (np.einsum("nc,nc->n", vectors, other) for other in (contact, vectors))
        pressure = -(along / squares)[self.free[: len(vectors)]]
        level = max(float(pressure.min()), 0.0) + min(float(pressure.max()), 0.0)
        return level, contact + level * vectors

    def _weight(self, load: Load, state: DeformedSurface, volumes: Array) -> tuple[Array, Array, Array]:
        """`rise`, `weight` and `datum` of `_Acting`; a part keeps its mass, so its density follows its volume."""
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
        """`inward` and `squeezed` of `_Acting`."""
        inward, squeezed = -pressure[self._part][:, None] * self._beyond, np.zeros(len(pressure))
        for e, (pulled, flux) in enumerate(self._squeeze):
            slope = turns[e] @ rise[e]
            inward[self._spans[e]] -= pulled @ slope
            squeezed[e] = flux @ slope
        return inward, squeezed

    def _each(self) -> Iterator[tuple[Part, slice]]:
        """Each part with the slice of its nodes among those of all parts."""
        return zip(self.parts, self._spans, strict=True)

    @property
    def _rows_of_volumes(self) -> Index:
        """(m + c,) rows of the kept volumes in the border system: parts, then filled cavities, then rims."""
        rows = BORDER * self.n_parts
        return np.append(np.arange(0, rows, BORDER), rows + np.arange(self._n_further))

    def _kept(self, state: DeformedSurface, moved: Array) -> tuple[Array, Array]:
        """(m + c,) kept volumes [m^3], and the gradient (n_p, 3, c) of all but the parts' volumes.

        `moved` (n_p, 3) is the displacement of the nodes. The volume of rims is the volume of the parts less that
        of parts with flat rims. The body's volume at rest is added, so that relative changes are those of the body.
        Keeping this volume makes rims bulge by as much as they sink.
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
        """(n_p, n_p) interpolation that puts the new nodes at rims on the edges that they cut."""
        n = len(self.free)
        placed = on_edges(self.cut.ends, n - len(self.cut.ends))
        whole = sparse.csr_array((placed.data, placed.indices, placed.indptr), shape=(n, n))
        return sparse.block_diag([whole[part.nodes][:, part.nodes] for part in self.parts], format="csr")

    def _cavities(self, state: DeformedSurface) -> tuple[Array, Array]:
        """Volumes (k,) of the filled cavities, and their gradient (n_p, 3, k) at the nodes of all parts.

        Each wall facet spans a tetrahedron with the body's centroid at rest; a cavity's volume is the sum over its
        walls in all parts.
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

        The least eigenvalue of the tangent stiffness, preconditioned by the tangent without forces, among changes
        that keep the volumes: 1 at rest, 0 at a limit point. Arnoldi's method finds it. Products with the tangent
        are central differences: one-sided ones would add axial stretch to the bending of a slender part, which is
        far stiffer.
        """
        slope = self._slope_at(balance, self._joined_at(balance.parts.turns), forceless=True)
        self._slope = None  # `_joined_at` may have replaced the factor that it belongs to
        away = SMALL_CHANGE * float(np.ptp(self.rest, axis=0).max())

        def softened(direction: Array) -> Array:
            step = away / float(np.abs(direction).max())
            on, back = (self._beside(balance, to * step * direction) for to in (1.0, -1.0))
            lacking, gap = (on.lacking - back.lacking) / (2.0 * step), (on.gap - back.gap) / (2.0 * step)
            return -self._answer(slope, balance, lacking, gap)[0].reshape(-1)

        start = np.random.default_rng(0).standard_normal(3 * int(self.free.sum()))
        return least_eigenvalue(softened, start)

    def _beside(self, balance: Balance, change: Array) -> Balance:
        """The balance of a state whose displacement differs by a change (3 n_free,)."""
        x = balance.x.copy()
        x[self.free] += change.reshape(-1, 3)
        return self.balance(balance.load, x, balance.pressure)

    def _answer(self, slope: _Slope, balance: Balance, lacking: Array, gap: Array) -> tuple[Array, Array]:
        """As `correction`, by the given tangent stiffness."""
        kept = self._rows_of_volumes
        target = np.zeros(len(slope.system))
        target[kept] = -gap * self.volumes
        # row vectors: v in the world frame is v @ q.T in the part's frame
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
        """The further change (n, 3) and pressures that close the gaps by the volume gradients of this state.

        A tangent that is kept, or a mixture of corrections, closes the gaps of other states.
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
        """(3n, r) displacement of all nodes, in the world frame.

        Parameters
        ----------
        of_inner, of_joined : `inner` and `joined` rotations of `_Slope`
        together : (3 n_C, r) displacement of the shared nodes, in the world frame
        inside : (3 n_I, r) displacement of the inner nodes with the shared ones held, in the parts' frames
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
        """The tangent stiffness of a state, or the last one if it still serves.

        Far from equilibrium it serves if the parts have hardly turned and the residual fell to `MOST_LEFT`. Near
        it, Anderson acceleration learns what the tangent misses, so it serves as long as two corrections reduce the
        residual. Residuals under another load do not count, nor do corrections of volumes alone. If the solve of
        the last load ended far from equilibrium, the tangent is assembled anew.
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
        """The tangent stiffness of a state; `forceless` leaves out stress and load: it is never negative."""
        n, m, k = self._n_shared, self.n_parts, BORDER
        acting: _Acting = balance.parts
        # border unknowns: those of each part, then the pressures of the further volumes
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
                corner[k * e, k * e] = (
                    1.0  # held all over: no displacement fixes the pressure, so it stays zero
                )
            joined = pushes[part.shared] - (part.follows.T @ within).reshape(-1, 3, len(at))
            border[part.places[:, None], :, at] += np.einsum("ncj,cd->njd", joined, q)
        flat = border.reshape(3 * n, size)
        together = np.asarray(self._factor.solve(np.asfortranarray(flat)))
        of_nodes = turns[self._inner_part], turns[self._joined_part]
        answers = self._moved(*of_nodes, together, inside)
        return _Slope(turns, *of_nodes, columns, pushed, flat, answers, flat.T @ together + corner)

    def _foreseen(self, balance: Balance) -> Array:
        """(n_p, 3) displacement in the parts' frames that the last correction predicted for a state.

        The prediction is of first order. The state itself has a further stretch, as adding a displacement to a part
        that turns stretches it. The next correction removes that stretch, but its forces would spoil the tangent of
        a slender body (Magisano, Leonetti and Garcea, Comput. Methods Appl. Mech. Engrg. 313, 2017).
        """
        before = self._before
        if before is None or before.load is not balance.load:
            return np.asarray(balance.parts.away)
        away, change = before.parts.away.copy(), (balance.x - before.x)[self._nodes]
        for (part, span), q in zip(self._each(), before.parts.turns, strict=True):
            y = before.parts.state.positions[span] @ q.T
            y, moved = y - part.areas @ y, change[span] @ q.T
            turn = np.einsum("nak,na->k", turn_of(part.body.levers, y), moved)
            away[span] += moved - np.cross(turn, y)
        return np.asarray(away)

    def _turning(
        self, number: int, q: Array, balance: Balance, away: Array, forceless: bool
    ) -> tuple[Array, Array]:
        """The rotational terms of a part's tangent, `U C U^T`: U (n, 3, 6) in its frame, and C^-1 (6, 6).

        See the head of this file. `away` (n, 3) is the displacement in the part's frame.
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
        return np.concatenate([turn_of(levers, y), slope], axis=2), inverse

    def _joined_at(self, turns: Array) -> Array:
        """Factorise the shared nodes' stiffness at rotations (m, 3, 3); returns the rotations that the factor has.

        If no part has turned by `SAME_TURN` since the last factor, that one is kept.
        """
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
        """Elastic energy of the parts and of the springs to the ground [J]."""
        total: float = balance.parts.energy
        if self._ground is not None:
            u = balance.x[: self.problem.formulation.surface.n_nodes].reshape(-1)
            total += 0.5 * float(u @ (self._ground @ u))
        return total

    def mean_pressure(self, balance: Balance) -> float:
        """Volume mean of the pressure [Pa]; a part's is that of its tractions, without the swelling."""
        m, acting = self.n_parts, balance.parts
        volumes, shares = self.volumes[:m], 0.0
        for part, span in self._each():
            shares += part.swelling.pressure(acting.away[span]) / 3.0
        # an incompressible part's pressure is that at the datum; compression by the weight is not in the
        # tractions
        give = self.give[:m]
        above = np.where(give > 0.0, acting.squeezed[:m] / np.where(give > 0.0, give, 1.0), acting.datum)
        return float(((acting.pressure[:m] - above) @ volumes + shares) / volumes.sum())

    def scalars(self, balance: Balance) -> dict[str, float]:
        """Outputs by name.

        `parts` is their number, `part_rotation` the largest rotation between two [rad], `part_strain` the largest
        strain within one. `rotation_of_part_1` is the rotation of part 1 from rest [rad], `strain_of_part_1` its
        strain, and so on.
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
        """`surface_strain` of each part, on its facets before the cut along rims, which makes finer ones."""
        positions, ratio = self.rest + balance.x, self.parts[0].form.poisson_ratio
        return [surface_strain(self.rest, positions, t, ratio) for t in self.cut.uncut or self.cut.parts]

    def reserved(self, status: Status, balance: Balance) -> Status:
        """The status, with a warning if there are too few parts or the strain within one is too large."""
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
    """Angles of rotations [rad], from the traces of their matrices."""
    return np.asarray(np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0)))


def least_eigenvalue(apply: Callable[[Array], Array], start: Array) -> float:
    """The least real part of an eigenvalue of a linear map (n,) -> (n,), by Arnoldi's method."""
    count = min(KRYLOV, len(start))
    basis, projected = np.zeros((count + 1, len(start))), np.zeros((count + 1, count))
    basis[0] = start / np.linalg.norm(start)
    for k in range(count):
        image = apply(basis[k])
        for _ in range(2):  # one Gram-Schmidt pass leaves rounding
            shares = basis[: k + 1] @ image
            image = image - shares @ basis[: k + 1]
            projected[: k + 1, k] += shares
        projected[k + 1, k] = np.linalg.norm(image)
        basis[k + 1] = image / (projected[k + 1, k] or 1.0)
    return float(np.linalg.eigvals(projected[:count]).real.min())


def turn_of(levers: Array, y: Array) -> Array:
    """(n, 3, 3) W of the head of this file: nodes that move by dy turn the part by sum W^T dy."""
    stretch = levers.T @ y
    inverse = np.linalg.inv(np.trace(stretch) * np.eye(3) - stretch)
    return np.einsum("kb,nab->nak", inverse, (levers @ TURNED).reshape(-1, 3, 3))


def turned_block(matrix: Array, q: Array, p: Array) -> Array:
    """(3n, 3n) a symmetric matrix M, turned from a part's frame: q^T M p for each pair of nodes."""
    n = len(matrix)
    half = (matrix.reshape(n, n // 3, 3) @ q).reshape(n, n)
    return (half.T.reshape(n, n // 3, 3) @ p).reshape(n, n)


def _squeeze(part: Part) -> tuple[Array, Array]:
    """Compression of a part under unit pressure gradients along x, y and z, zero at the mean of its nodes.

    Returns
    -------
    forces : (n, 3, 3) elastic forces of it, without those of the swelling [N/(Pa/m)]
    volumes : (3,) change of volume [m^3/(Pa/m)]
    """
    moved = part.form.squeezed()
    swells = part.swelling.beyond + part.form.surface.area_vectors
    return part.form.swollen_forces(moved), np.einsum("nc,nck->k", swells, moved)


def _spans(sizes: Index) -> list[slice]:
    """Slices of consecutive blocks of these sizes."""
    ends = np.cumsum(sizes)
    return list(map(slice, (ends - sizes).tolist(), ends.tolist()))


def _summing(places: Index, count: int) -> sparse.csr_array:
    """(count, k) matrix that sums entries with the same place (k,)."""
    ones, every = np.ones(len(places)), np.arange(len(places))
    return sparse.csr_array(sparse.coo_array((ones, (places, every)), shape=(count, len(places))))


def _tractions(surface: SurfaceMesh, held: Mask, on_caps: Mask, n_body: int) -> Index:
    """(F,) number of the traction of each facet; pairs of facets share one at caps, or all over a large body.

    With one traction for each facet, the few nodes of a cap would have to follow tractions that they do not
    resolve, and the cap would be too stiff.
    """
    from vdm.boundary.operators import precision  # numba takes a third of a second to import

    of_caps: Mask = np.asarray(on_caps[surface.triangles].any(axis=1))
    return shared_tractions(surface, held, None if precision(n_body) is np.float32 else of_caps)


def _rim(surface: SurfaceMesh, held: Mask) -> Mask | None:
    """(N,) mask of the nodes at the rims of supports; None if there are no rims."""
    start, end = surface.edges.T
    crossing = surface.edges[held[start] != held[end]]
    rim = np.zeros(surface.n_nodes, np.bool_)
    rim[crossing] = True
    return rim if len(crossing) else None


def pieces_of(surface: SurfaceMesh) -> list[Index]:
    """Nodes of pieces of a surface, halved by area across the longest axis `HALVINGS` times."""
    pieces = [np.arange(surface.n_nodes)]
    for _ in range(HALVINGS):
        pieces = [half for nodes in pieces for half in _halves(surface, nodes)]
    return pieces


def _halves(surface: SurfaceMesh, nodes: Index) -> list[Index]:
    """The nodes in two halves by area; undivided if one half would have fewer than `FEWEST`."""
    areas = surface.nodal_areas[nodes]
    along = np.argsort(along_longest_axis(surface.points[nodes], areas)[0])
    middle = int(np.searchsorted(np.cumsum(areas[along]), 0.5 * areas.sum()))
    few = min(middle, len(nodes) - middle) < FEWEST
    return [nodes] if few else [nodes[along[:middle]], nodes[along[middle:]]]


def parts_wanted(surface: SurfaceMesh, pieces: list[Index], displacement: Array) -> int:
    """How many parts a body needs for a displacement (N, 3): 1, or a power of two.

    Each of its `pieces_of` has a best-fit small rotation. The largest difference between two of them is spread over
    the parts, at most `MOST_TURN` in each.
    """
    turns = np.array([_small_rotation(surface, nodes, displacement) for nodes in pieces])
    spread = float(np.linalg.norm(turns[:, None] - turns[None], axis=2).max())
    return 1 if spread <= MOST_TURN else 2 ** int(np.ceil(np.log2(spread / MOST_TURN)))


def _small_rotation(surface: SurfaceMesh, nodes: Index, displacement: Array) -> Array:
    """(3,) rotation vector [rad] that best fits the displacement of some nodes, weighted by area."""
    area = surface.nodal_areas[nodes][:, None]
    arms = surface.points[nodes] - (area * surface.points[nodes]).sum(axis=0) / area.sum()
    moved = (area * np.cross(arms, displacement[nodes])).sum(axis=0)
    inertia = (area * arms**2).sum() * np.eye(3) - (area * arms).T @ arms
    return np.asarray(np.linalg.solve(inertia, moved))


def surface_strain(rest: Array, positions: Array, corners: Index, poisson_ratio: float) -> float:
    """Largest principal strain, |stretch - 1|, of facets `corners` (F, 3), not exceeded on 99 % of the area.

    The stretch along the normal follows from Poisson's ratio, as under a surface without load: at nu = 1/2 it keeps
    the volume. `rest` and `positions` (n, 3) are the nodes [m].
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
