"""A body in parts at large displacements: boundary elements with a rotation each, joined at their cuts.

Part e has the stiffness S_e of its own closed surface, which turns with the rotation Q_e that best fits it
(`vdm.peers.bem.BoundaryFormulation`), and a pressure p_e that keeps its volume. Small strain within a part, large
rotation between them: the corotational idea (Felippa and Haugen, Comput. Methods Appl. Mech. Engrg. 194, 2005) with
boundary elements as elements.

The slope for a correction, with Q_e as they are, is condensed to the nodes C that parts
share. With the part's inner nodes I, in its frame, `T = S_II^-1 S_IC` once, and `y = S_II^-1 g_I` of the gradient g
of its volume in each iteration:

`u_I = S_II^-1 f_I - T u_C + y p`, `(S_CC - S_CI T) u_C - h p = f_C - T^T f_I`,
`h . u_C + (g_I . y) p = -gap - g_I . S_II^-1 f_I`, with h = g_C - T^T g_I.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from solver_common.arrays import Array, Index, Mask
from vdm.constraints import Load
from vdm.deformed import DeformableSurface, DeformedSurface
from vdm.formulations.base import Factor
from vdm.parts.cut import cut
from vdm.peers.bem import BoundaryFormulation, DenseFactor
from vdm.problem import Problem
from vdm.solution import Status
from vdm.solvers.nonlinear import Balance
from vdm.surface import SurfaceMesh

# rotation within a part [rad] that small strain in its frame bears: half of its square is the strain that it feigns
MOST_TURN = np.radians(10.0)
SAME_TURN = 0.01  # change of a rotation that a correction does not mind: a factor is made anew beyond it
FINEST = 16  # parts that the spread of rotations is read from
# of the surface's area: its strain is below that of the rest, which grows at rims without limit on finer meshes
MOST_AREA = 0.99
LARGEST_STRAIN = 0.1


@dataclass(frozen=True)
class _Part:
    """One of the parts: n nodes of the body, of which some are inner and free (I), some shared and free (C).

    Attributes
    ----------
    nodes : (n,) of the body
    form : its stiffness
    body : its surface, ready to be deformed
    inner, shared : masks (n,) of I and C
    places : (n_C,) of the shared nodes among all shared ones
    block : factor of S_II
    follows : (3 n_I, 3 n_C) T
    carried : (3 n_C, 3 n_C) S_CC - S_CI T
    """

    nodes: Index
    form: BoundaryFormulation
    body: DeformableSurface
    inner: Mask
    shared: Mask
    places: Index
    block: Factor
    follows: Array
    carried: Array


class Parts:
    """The body of a problem of boundary elements, cut into `count` parts; `vdm.solvers.nonlinear.Large`.

    Nodes of the problem's surface come first, those inside after them. One part is the problem's own formulation.

    Raises
    ------
    SolverError
        a part that has no factor, or more nodes than one takes.
    """

    def __init__(self, problem: Problem, count: int, block: Factor | None = None) -> None:
        self.problem = problem
        whole = problem.formulation
        assert isinstance(whole, BoundaryFormulation)
        surface, held = whole.surface, problem.support.held
        self.cut = cut(surface.points, surface.triangles, count, _rim(surface, held))
        points = self.cut.points
        n = len(points)
        self.rest = points - problem.body.origin
        self.n_pressures = len(self.cut.parts)
        self.free = np.ones(n, np.bool_)
        self.free[: len(held)] = ~held
        fixed = ~self.free
        uses = np.zeros(n, np.int64)
        for triangles in self.cut.parts:
            uses[np.unique(triangles)] += 1
        self._ground = whole.parameters.ground
        joined = uses > 1
        shared = joined.copy()
        if self._ground is not None:
            shared[np.flatnonzero(np.diff(self._ground.indptr).reshape(-1, 3).any(axis=1))] = True
        shared &= self.free
        place = np.cumsum(shared) - 1
        self._shared, self._n_shared = shared, int(shared.sum())
        self._ground_joining = np.zeros((3 * self._n_shared, 3 * self._n_shared))
        if self._ground is not None:
            sprung = np.flatnonzero(shared[: surface.n_nodes])
            at = _dofs(place[sprung])
            self._ground_joining[np.ix_(at, at)] = self._ground[_dofs(sprung)][:, _dofs(sprung)].toarray()
        # of the part that a node of the surface turns with, where a load follows it
        self._owner = np.zeros(surface.n_nodes, np.int64)
        parameters = replace(whole.parameters, ground=None)
        self.parts: list[_Part] = []
        for number, triangles in enumerate(self.cut.parts):
            nodes, local = np.unique(triangles, return_inverse=True)
            self._owner[nodes[nodes < surface.n_nodes]] = number
            if self.n_pressures == 1:
                form = copy.copy(whole)
                form.parameters = parameters
            else:
                own = SurfaceMesh(points[nodes], local.reshape(-1, 3))
                form = BoundaryFormulation(own, parameters, fixed[nodes], joined[nodes])
            inner = self.free[nodes] & ~shared[nodes]
            self.parts.append(_condensed(form, nodes, inner, shared[nodes], place[nodes], block))
        self.volumes = np.array([part.form.surface.volume for part in self.parts])
        self.wanted = 1
        self._turns: Array | None = None
        self._factor = self._ground_joining

    def balance(self, load: Load, x: Array, pressure: Array) -> Balance:
        """As in `Large`."""
        problem, n_surface = self.problem, self.problem.formulation.surface.n_nodes
        internal, applied = np.zeros_like(x), np.zeros_like(x)
        gap = np.empty(self.n_pressures)
        states: list[DeformedSurface] = []
        for number, part in enumerate(self.parts):
            moved = x[part.nodes]
            state = part.body.at(moved)
            internal[part.nodes] += part.form.deformed_internal_force(moved, state)
            applied[part.nodes] += pressure[number] * state.area_vectors
            gap[number] = state.volume / self.volumes[number] - 1.0
            states.append(state)
        turns = np.array([state.rotation for state in states])
        outer = problem.body.at(x[:n_surface], turns[0] if len(turns) == 1 else turns[self._owner])
        applied[:n_surface] += problem.deformed_force(load, outer, outer.area_vectors)
        if self._ground is not None:
            internal[:n_surface] += (self._ground @ x[:n_surface].reshape(-1)).reshape(-1, 3)
        scale = max(float(np.linalg.norm(force[self.free])) for force in (internal, applied))
        return Balance(x, pressure, gap, internal - applied, scale, states)

    def correction(
        self,
        balance: Balance,
        lacking: Array,
        gap: Array,
        turn: Array,  # noqa: ARG002 - each part has a frame of its own
    ) -> tuple[Array, Array]:
        """As in `Large`."""
        n, m = self._n_shared, self.n_pressures
        turns = self._joined_at(np.array([state.rotation for state in balance.parts]))
        right = np.zeros((n, 3, 1 + m))
        right[:, :, 0] = -lacking[self._shared]
        give, target = np.empty(m), -gap * self.volumes
        inside: list[Array] = []
        for e, (part, state, q) in enumerate(zip(self.parts, balance.parts, turns, strict=True)):
            # vectors in rows: v of the world is v @ q.T in the part's frame
            pushes = np.stack([-lacking[part.nodes] @ q.T, state.area_vectors @ q.T], axis=2)
            within = pushes[part.inner].reshape(-1, 2)
            solved = np.asarray(part.block.solve(np.asfortranarray(within)))
            inside.append(solved)
            give[e] = within[:, 1] @ solved[:, 1]
            target[e] -= within[:, 1] @ solved[:, 0]
            if len(part.places):
                passed = (part.follows.T @ within).reshape(-1, 3, 2)
                right[part.places, :, 0] -= passed[:, :, 0] @ q
                right[part.places, :, 1 + e] += (pushes[part.shared][:, :, 1] - passed[:, :, 1]) @ q
        flat = right.reshape(3 * n, 1 + m)
        border = flat[:, 1:].copy()
        if n:
            flat = linalg.cho_solve((self._factor, True), flat, check_finite=False)
        push = np.linalg.solve(border.T @ flat[:, 1:] + np.diag(give), target - border.T @ flat[:, 0])
        joined = (flat[:, 0] + flat[:, 1:] @ push).reshape(-1, 3)
        change = np.zeros((len(self.free), 3))
        change[self._shared] = joined
        for e, (part, q) in enumerate(zip(self.parts, turns, strict=True)):
            moved = inside[e] @ [1.0, push[e]]
            if len(part.places):
                moved = moved - part.follows @ (joined[part.places] @ q.T).reshape(-1)
            change[part.nodes[part.inner]] = moved.reshape(-1, 3) @ q
        return change[self.free], push

    def _joined_at(self, turns: Array) -> Array:
        """(m, 3, 3) rotations for a correction: these, or those of the last factor where no part has left it."""
        if self._turns is not None and np.abs(turns - self._turns).max() < SAME_TURN:
            return self._turns
        matrix = self._ground_joining.copy()
        for part, q in zip(self.parts, turns, strict=True):
            if len(part.places):
                dofs = _dofs(part.places)
                matrix[np.ix_(dofs, dofs)] += _turned_block(part.carried, q)
        if len(matrix):
            self._factor = linalg.cholesky(matrix, lower=True, overwrite_a=True, check_finite=False)
        self._turns = turns
        return turns

    def energy(self, balance: Balance) -> float:
        """Elastic energy [J], that of springs to the ground too."""
        total = sum(
            part.form.deformed_energy(balance.x[part.nodes], state)
            for part, state in zip(self.parts, balance.parts, strict=True)
        )
        if self._ground is not None:
            u = balance.x[: self.problem.formulation.surface.n_nodes].reshape(-1)
            total += 0.5 * float(u @ (self._ground @ u))
        return total

    def mean_pressure(self, pressure: Array) -> float:
        """By volume [Pa]."""
        return float(pressure @ self.volumes / self.volumes.sum())

    def scalars(self, balance: Balance) -> dict[str, float]:
        """`parts`, `part_rotation` the largest between two parts [rad], `part_strain` the largest within one."""
        turns = np.array([state.rotation for state in balance.parts])
        between = np.einsum("aij,bij->ab", turns, turns)
        angle = np.arccos(np.clip((between - 1.0) / 2.0, -1.0, 1.0))
        strain = max(surface_strain(state) for state in balance.parts)
        return {"parts": float(self.n_pressures), "part_rotation": float(angle.max()), "part_strain": strain}

    def reserved(self, status: Status) -> Status:
        """The status, with what the parts do not follow: too few of them."""
        if self.n_pressures >= self.wanted:
            return status
        message = f"the load bends the body: {self.wanted} parts are called for, and {self.n_pressures} made"
        why = f" ({self.cut.refused})" if self.cut.refused else ""
        return replace(
            status,
            message="; ".join(filter(None, (status.message, message + why))),
            remedy="; ".join(filter(None, (status.remedy, "refine the surface, or use finite elements"))),
        )


def _condensed(
    form: BoundaryFormulation, nodes: Index, inner: Mask, shared: Mask, place: Index, block: Factor | None
) -> _Part:
    body = DeformableSurface(form.surface)
    if not shared.any():
        factor = block or form.factor(inner)
        return _Part(
            nodes, form, body, inner, shared, place[shared], factor, np.zeros((0, 0)), np.zeros((0, 0))
        )
    i, c = _dofs(np.flatnonzero(inner)), _dofs(np.flatnonzero(shared))
    own = DenseFactor(form.matrix[np.ix_(i, i)])
    coupling = form.matrix[np.ix_(i, c)]
    follows = np.asarray(own.solve(np.asfortranarray(coupling)))
    carried = form.matrix[np.ix_(c, c)] - coupling.T @ follows
    return _Part(nodes, form, body, inner, shared, place[shared], own, follows, 0.5 * (carried + carried.T))


def _turned_block(matrix: Array, q: Array) -> Array:
    """(3n, 3n) symmetric matrix of a part's frame in the world's: q^T M q node by node."""
    n = len(matrix)
    half = (matrix.reshape(n, -1, 3) @ q).reshape(n, n)
    return (half.T.reshape(n, -1, 3) @ q).reshape(n, n)


def _dofs(nodes: Index) -> Index:
    """(3n,) unknowns of nodes."""
    dofs: Index = (3 * nodes[:, None] + np.arange(3)).reshape(-1)
    return dofs


def _rim(surface: SurfaceMesh, held: Mask) -> Mask | None:
    """(N,) nodes at the rim of what is held, None where there is none."""
    start, end = surface.edges.T
    crossing = surface.edges[held[start] != held[end]]
    rim = np.zeros(surface.n_nodes, np.bool_)
    rim[crossing] = True
    return rim if len(crossing) else None


def parts_wanted(surface: SurfaceMesh, displacement: Array) -> int:
    """How many parts a body needs that moves by (N, 3): 1, or the power of two that leaves `MOST_TURN` in each.

    By the small rotations that best fit `FINEST` pieces of the surface, the largest between two of them.
    """
    pieces = cut(surface.points, surface.triangles, FINEST).parts
    turns = np.array([_small_rotation(surface, nodes, displacement) for nodes in map(np.unique, pieces)])
    spread = float(np.linalg.norm(turns[:, None] - turns[None], axis=2).max())
    return 1 if spread <= MOST_TURN else 2 ** int(np.ceil(np.log2(spread / MOST_TURN)))


def _small_rotation(surface: SurfaceMesh, nodes: Index, displacement: Array) -> Array:
    """(3,) rotation vector that best fits the motion of some nodes, by area; those inside the body are left out."""
    nodes = nodes[nodes < surface.n_nodes]
    area = surface.nodal_areas[nodes][:, None]
    arms = surface.points[nodes] - (area * surface.points[nodes]).sum(axis=0) / area.sum()
    moved = (area * np.cross(arms, displacement[nodes])).sum(axis=0)
    inertia = (area * arms**2).sum() * np.eye(3) - (area * arms).T @ arms
    return np.asarray(np.linalg.solve(inertia, moved))


def surface_strain(state: DeformedSurface) -> float:
    """Largest principal stretch of the facets, less 1, that 99 % of the area stays below.

    Of an incompressible body: the thickness takes what the area loses.
    """
    corners = state.body.surface.triangles
    sides = [
        np.stack([places[corners[:, k]] - places[corners[:, 0]] for k in (1, 2)], axis=1)
        for places in (state.body.rest, state.positions)
    ]
    before, after = (side @ side.transpose(0, 2, 1) for side in sides)
    stretches = np.sqrt(np.clip(np.linalg.eigvals(np.linalg.solve(before, after)).real, 1e-300, None))
    third = 1.0 / stretches.prod(axis=1)
    strain = np.abs(np.column_stack([stretches, third]) - 1.0).max(axis=1)
    order = np.argsort(strain)
    areas = np.cumsum(state.body.surface.facet_areas[order])
    return float(strain[order][np.searchsorted(areas, MOST_AREA * areas[-1])])
