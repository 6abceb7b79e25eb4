"""Facets cut along the rim of held nodes; the new nodes are eliminated.

At a rim displacements grow as the root of the distance r to the held nodes, and tractions as its inverse or
nearly so. Most of a uniform mesh's error is made there. Every edge from a held node to a free one gets a node at
a quarter of its length: the places r = 0, 1/4 and 1 are evenly spaced in the root of r (quarter points: Henshell
and Shaw 1975; Barsoum 1976). The mesh is then fine enough for a root across the rim, and unchanged along it.

The unknown of a new node is its motion w beyond that of its edge (a hierarchical basis: Yserentant 1986),

`u_new = 3/4 u_held + 1/4 u_free + w`.

It carries no force, so that the old nodes determine it: `w = -A S_wb u`. The condensed stiffness
`S_bb - S_bw A S_wb` has the size of the old nodes (Guyan 1965). The new nodes add no volume in sum: with their
area vectors a, `a . w = 0`, so that `A = S_ww^-1 - S_ww^-1 a a^T S_ww^-1 / (a . S_ww^-1 a)`. A rim that bulges
all around, as under weight, is therefore as stiff as on the uncut mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse
from scipy.linalg import blas

from solver_common.arrays import Array, Index, Mask
from vdm.boundary.refinement import take_over
from vdm.surface import SurfaceMesh, rigid_basis

# place of a new node, as a share of its edge from the held end
PLACE = 0.25
# steps of the walks that tell nodes apart by the mesh around them, which a change of shape does not alter
RINGS = 8
# a ratio of two lengths above this is equality: to rounding; of mirror images, to what a search for the rest shape
# leaves open
SHORTER, ALIKE = 1.0 - 1e-9, 0.99
# rows of a large matrix that are handled at once
ROWS = 256


@dataclass(frozen=True)
class Rims:
    """A surface of N nodes, cut along the rims of what is held.

    Attributes
    ----------
    body : the surface before the cut
    surface : the cut surface, of N + k nodes, the new ones last
    shares : (N + k, N) weights of the old nodes in the place of each node
    follows : (3k, 3N) A S_wb, zero until a stiffness is condensed
    """

    body: SurfaceMesh
    surface: SurfaceMesh
    shares: sparse.csr_array
    follows: Array

    @classmethod
    def of(cls, surface: SurfaceMesh, held: Mask) -> Rims:
        """The surface with its facets between held nodes (N,) and free ones cut in three."""
        n = surface.n_nodes
        points, (triangles,), ends = cut_at_rims(surface.points, [surface.triangles], held)
        shares, follows = on_edges(ends, n), np.zeros((3 * len(ends), 3 * n))
        if not len(ends):
            return cls(surface, surface, shares, follows)
        return cls(surface, SurfaceMesh(points, triangles), shares, follows)

    def condensed(self, matrix: Array) -> Array:
        """(3N, 3N) stiffness in 64 bits, condensed from a matrix (3(N + k), 3(N + k)); sets `follows`.

        The matrix is overwritten. The result has no forces of rigid motions, to the rounding of the matrix.
        """
        n = self.body.n_nodes
        rigid = rigid_basis(self.surface).astype(matrix.dtype)
        take_over(matrix, rigid, np.zeros_like(rigid))
        carried, coupling = np.vsplit(matrix[:, : 3 * n], [3 * n])
        own = matrix[3 * n :, 3 * n :]
        if len(own):
            # transpose of a new node's place in its edge, for the few nodes with a cut edge
            ends = np.unique(self.shares.indices[self.shares.indptr[n] :])
            shares = sparse.csr_array(sparse.kron(self.shares[n:][:, ends].T, np.eye(3))).astype(matrix.dtype)
            dofs = (3 * ends[:, None] + np.arange(3)).reshape(-1)
            moved = shares @ coupling
            coupling[:, dofs] += (shares @ own).T
            carried[dofs] += shares @ coupling
            carried[:, dofs] += moved.T
            coupling = _without(coupling.astype(np.float64).T, rigid_basis(self.body)).T
            factor = linalg.cholesky(own.astype(np.float64), lower=True, check_finite=False)
            pressed = self.surface.area_vectors[n:].reshape(-1)
            pressed = linalg.solve_triangular(factor, pressed, lower=True, check_finite=False)
            half = blas.dtrsm(1.0, factor, coupling.T, side=1, lower=1, trans_a=1, overwrite_b=1).T
            half -= np.outer(pressed, pressed @ half / (pressed @ pressed))
            self.follows[:] = blas.dtrsm(1.0, factor, half.T, side=1, lower=1).T
            half = half.astype(matrix.dtype)
        whole = np.empty((3 * n, 3 * n))
        for start in range(0, 3 * n, ROWS):
            end = min(start + ROWS, 3 * n)
            rows, square = whole[start:end], whole[start:end, start:end]
            rows[:, :end] = carried[start:end, :end]
            if len(own):
                rows[:, :end] -= half[:, start:end].T @ half[:, :end]
            square[:] = 0.5 * (square + square.T)
            whole[:start, start:end] = rows[:, :start].T
        return whole

    def spread(self, displacements: Array) -> Array:
        """(3(N + k), m) displacements of (3N, m), linear along the cut edges."""
        m = displacements.shape[1]
        return np.asarray(self.shares @ displacements.reshape(-1, 3 * m)).reshape(-1, m)

    def smooth(self, basis: Array, forces: Array) -> Array:
        """(3N, m) forces of (3(N + k), m), under an orthonormal basis (3N, m), without forces of rigid motions."""
        m = basis.shape[1]
        rigid = rigid_basis(self.body)
        carried = self.carried(forces.reshape(-1, 3, m)).reshape(-1, m)
        return _without(_without(carried, rigid).T, basis.T @ rigid).T

    def carried(self, force: Array) -> Array:
        """(N, 3, ...) forces at the old nodes that are equivalent to (N + k, 3, ...) at all of them."""
        shape = (self.body.n_nodes, *force.shape[1:])
        own = force[shape[0] :].reshape(len(self.follows), *force.shape[2:])
        moved = np.asarray(self.shares.T @ force.reshape(len(force), -1))
        carried: Array = moved.reshape(shape) - (self.follows.T @ own).reshape(shape)
        return carried


def _without(vectors: Array, basis: Array) -> Array:
    """Vectors (n, m) less their projection on an orthonormal basis (n, k)."""
    return vectors - basis @ (basis.T @ vectors)


def on_edges(ends: Index, n: int) -> sparse.csr_array:
    """(n + k, n) places of n old nodes and of k new ones on the edges (k, 2), as weights of the old nodes."""
    k = len(ends)
    data = np.concatenate([np.ones(n), np.tile([1.0 - PLACE, PLACE], k)])
    rows = np.concatenate([np.arange(n), np.arange(n, n + 2 * k + 1, 2)])
    return sparse.csr_array((data, np.concatenate([np.arange(n), ends.reshape(-1)]), rows), shape=(n + k, n))


def cut_at_rims(points: Array, bodies: Sequence[Index], held: Mask) -> tuple[Array, list[Index], Index]:
    """Points (N + k, 3), facets of all bodies and ends (k, 2) of the cut edges.

    Every edge between a held node (N,) and a free one is cut. Its held end comes first. Edge i has the
    node `N + i` in every body. A facet of two bodies is cut alike in both.
    """
    n = len(points)
    facets = np.concatenate(bodies)
    sides = np.stack([facets, np.roll(facets, -1, axis=1)], axis=2)
    keys = np.where(
        held[sides[:, :, 0]] != held[sides[:, :, 1]], sides.min(axis=2) * n + sides.max(axis=2), -1
    )
    found, numbers = np.unique(keys, return_inverse=True)
    is_first = int(found[0] < 0)  # sides that are not cut
    found, numbers = found[is_first:], numbers.reshape(-1, 3) - is_first
    ends = np.stack(np.divmod(found, n), axis=1)
    ends = np.where(held[ends[:, :1]], ends, ends[:, ::-1])
    if not len(ends):
        return points, list(bodies), ends
    grown = np.asarray(on_edges(ends, n) @ points)
    new = np.where(numbers < 0, -1, n + numbers)
    met = _met(sides.reshape(-1, 2), held)
    _, of, uses = np.unique(np.sort(facets, axis=1), axis=0, return_inverse=True, return_counts=True)
    # both sides of a facet are cut as the facet with ascending nodes, up to a cyclic shift
    a, b, c = facets.T
    turned = (uses[of.reshape(-1)] > 1) & ((a - b) * (b - c) * (c - a) < 0)
    pieces, start = list[Index](), 0
    for body in bodies:
        span = slice(start, start + len(body))
        t, at, back = facets[span], new[span], turned[span]
        mirrored = _cut(t[back][:, ::-1], at[back][:, [1, 0, 2]], grown, met)[:, ::-1]
        pieces.append(np.concatenate([_cut(t[~back], at[~back], grown, met), mirrored]))
        start += len(body)
    return grown, pieces, ends


def _cut(triangles: Index, new: Index, points: Array, met: Index) -> Index:
    """Cut each facet with new nodes on two sides (F, 3; -1 for none) in three: a corner, and the rest in two.

    The diagonal of the rest depends on the mesh, and in a tie of `_met` (n, 2) on lengths, if these are unequal:
    a body that sags keeps its diagonals, and is led back to rest with them.
    """
    is_cut = (new >= 0).any(axis=1)
    # the corner between the two sides comes first; side 0 is after corner 0
    turned = (np.argmin(new[is_cut], axis=1)[:, None] + 2 + np.arange(3)) % 3
    a, b, c = np.take_along_axis(triangles[is_cut], turned, axis=1).T
    ab, _, ca = np.take_along_axis(new[is_cut], turned, axis=1).T
    # the diagonal at the node with more walks; in a tie the shorter diagonal
    ab_c, b_ca = np.linalg.norm(points[[ab, b]] - points[[c, ca]], axis=2)
    tied, mirrored = (met[b] == met[c]).T
    is_shorter = ab_c < np.where(mirrored, ALIKE, SHORTER) * b_ca
    is_first = np.where(tied, is_shorter, met[b, 0] < met[c, 0])
    third, second = np.where(is_first, [ab, c], [b, ca])
    thirds = [(a, ab, ca), (ab, b, second), (third, c, ca)]
    return np.concatenate([triangles[~is_cut], *(np.stack(part, axis=1) for part in thirds)])


def _met(edges: Index, held: Mask) -> Index:
    """(n, 2) number of walks of `RINGS` steps from each node, and of those that end at held nodes (n,).

    A step stays or follows an edge (k, 2).
    """
    n = len(held)
    beside = sparse.csr_array((np.ones(len(edges), np.int64), edges.T), shape=(n, n))
    beside.data[:] = 1  # an edge of two bodies counts once
    met = np.stack([np.ones_like(held), held], axis=1).astype(np.int64)
    for _ in range(RINGS):
        met = met + beside @ met
    return met
