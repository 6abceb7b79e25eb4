"""Facets cut along the rim of what is held, by nodes of their own that are eliminated.

There displacements grow as the root of the distance r to what is held, tractions as its inverse or nearly so, and
there most of a uniform mesh's error is made. Every edge from a held node to a free one gets a node at a quarter of
its length: between the places r = 0, 1/4 and 1 a root is linear in the root of r (quarter points: Henshell and Shaw
1975; Barsoum 1976). Across the rim the mesh is as fine as a root needs; along it it stays as it is.

Of a new node's motion the part w beyond that of its edge is unknown (a hierarchical basis: Yserentant 1986),

`u_new = 3/4 u_held + 1/4 u_free + w`,

and follows from the nodes that there were, without a force of its own: `w = -A S_wb u`. What is left,
`S_bb - S_bw A S_wb`, has their size (Guyan 1965). The volume stays that between these nodes, to which the new ones
add nothing in sum: with a their area vectors, `a . w = 0`, so that
`A = S_ww^-1 - S_ww^-1 a a^T S_ww^-1 / (a . S_ww^-1 a)`. A rim that bulges all around, as under weight, stays as
stiff as its mesh without cuts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, sparse

from solver_common.arrays import Array, Index, Mask
from vdm.surface import SurfaceMesh

# of the way from the held end of an edge to its free one
PLACE = 0.25
# one length over another that is the same to rounding
SHORTER = 1.0 - 1e-9
# of a large matrix, at once
ROWS = 256


@dataclass(frozen=True)
class Rims:
    """A surface of N nodes, cut along the rims of what is held.

    Attributes
    ----------
    surface : of N + k nodes, the new ones last
    shares : (N + k, N) of the nodes that there were, in the place of each
    follows : (3k, 3N) A S_wb, zero until a stiffness was condensed
    """

    surface: SurfaceMesh
    shares: sparse.csr_array
    follows: Array

    @classmethod
    def of(cls, surface: SurfaceMesh, held: Mask) -> Rims:
        """The surface with its facets between held nodes (N,) and free ones cut in three."""
        n = surface.n_nodes
        edges = surface.edges
        is_cut = held[edges[:, 0]] != held[edges[:, 1]]
        ends = np.where(held[edges[is_cut, :1]], edges[is_cut], edges[is_cut, ::-1])
        k = len(ends)
        places = sparse.csr_array(
            (np.tile([1.0 - PLACE, PLACE], k), ends.reshape(-1), np.arange(0, 2 * k + 1, 2)), shape=(k, n)
        )
        shares = sparse.csr_array(sparse.vstack([sparse.eye_array(n), places]))
        follows = np.zeros((3 * k, 3 * n))
        if not k:
            return cls(surface, shares, follows)
        new = np.full(len(edges), -1)
        new[is_cut] = n + np.arange(k)
        points = np.asarray(shares @ surface.points)
        cut = _cut(surface.triangles, new[surface.facet_edges], points)
        return cls(SurfaceMesh(points, cut), shares, follows)

    def condensed(self, matrix: Array) -> tuple[Array, Rims]:
        """(3N, 3N) stiffness of one (3(N + k), 3(N + k)), which is used up, and how the new nodes follow."""
        all_nodes, old = self.shares.shape
        if all_nodes == old:
            return matrix, self
        # a new node's place in its edge, for the few nodes that have a cut edge
        ends = np.unique(self.shares.indices[self.shares.indptr[old] :])
        shares = sparse.csr_array(sparse.kron(self.shares[old:][:, ends].T, np.eye(3)))
        dofs, old = (3 * ends[:, None] + np.arange(3)).reshape(-1), 3 * old
        carried, coupling = matrix[:old, :old], matrix[old:, :old]
        moved = shares @ coupling
        coupling[:, dofs] += (shares @ matrix[old:, old:]).T
        carried[dofs] += shares @ coupling
        carried[:, dofs] += moved.T
        factor = linalg.cholesky(matrix[old:, old:], lower=True, check_finite=False)
        half, pressed = (
            linalg.solve_triangular(factor, part, lower=True, check_finite=False)
            for part in (coupling, self.surface.area_vectors[old // 3 :].reshape(-1))
        )
        half -= np.outer(pressed, pressed @ half / (pressed @ pressed))
        for start in range(0, old, ROWS):
            rows = slice(start, start + ROWS)
            carried[rows] -= half[:, rows].T @ half
        follows = linalg.solve_triangular(factor, half, lower=True, trans=1, check_finite=False)
        return np.ascontiguousarray(carried), replace(self, follows=follows)

    def carried(self, force: Array) -> Array:
        """(N, 3) forces at the nodes that there were, with the answer of forces (N + k, 3) at all of them."""
        own = force[self.shares.shape[1] :].reshape(-1)
        carried: Array = np.asarray(self.shares.T @ force) - (own @ self.follows).reshape(-1, 3)
        return carried


def _cut(triangles: Index, new: Index, points: Array) -> Index:
    """The facets, those with new nodes on two sides (F, 3; -1 for none) in three: a corner and the rest."""
    is_cut = (new >= 0).any(axis=1)
    # side 0 is after corner 0; the corner between the two sides comes first
    turned = (np.argmin(new[is_cut], axis=1)[:, None] + 2 + np.arange(3)) % 3
    a, b, c = np.take_along_axis(triangles[is_cut], turned, axis=1).T
    ab, _, ca = np.take_along_axis(new[is_cut], turned, axis=1).T
    # the shorter diagonal of what is left; rounding does not decide between equal ones
    lengths = np.linalg.norm(points[[ab, b]] - points[[c, ca]], axis=2)
    third, second = np.where(lengths[0] < SHORTER * lengths[1], [ab, c], [b, ca])
    thirds = [(a, ab, ca), (ab, b, second), (third, c, ca)]
    return np.concatenate([triangles[~is_cut], *(np.stack(part, axis=1) for part in thirds)])
