"""The nearest point of a triangle surface, exactly: numpy and scipy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

_MOST_AT_ONCE = (
    10_000  # nodes: small surfaces are searched together, for large ones that is memory for nothing
)


def nearest_on_surface(queries: Array, points: Array, triangles: Index) -> tuple[Array, Index, Array]:
    """The point of a triangle surface nearest to each of Q queries, exactly.

    Returns
    -------
    distance : (Q,) [m]
    facet : (Q,) index of the facet that holds the nearest point
    weights : (Q, 3) barycentric coordinates of the nearest point in that facet
    """
    distance, facet, weights = _nearest(queries[None], points[None], triangles)
    return distance[0], facet[0], weights[0]


def distances_and_farthest(surfaces: Array, reference: Array, triangles: Index) -> tuple[Array, Array]:
    """How far B surfaces (B, N, 3) are from another of the same facets (N, 3).

    Returns
    -------
    distance : (B, N) of their nodes to the other surface [m]
    farthest : (B,) the largest of these and of the distances of the other's nodes to each [m]
    """
    at_once = max(1, _MOST_AT_ONCE // len(reference))
    parts, largest = [], []
    for first in range(0, len(surfaces), at_once):
        some = surfaces[first : first + at_once]
        others = np.broadcast_to(reference, some.shape)
        there = _nearest(some, others, triangles)[0]
        farthest = there.max(axis=1)
        # a node of the other surface is no further from this one than from the node that it corresponds to
        open_to = np.linalg.norm(some - others, axis=2) > farthest[:, None]
        back = _nearest(others, some, triangles, open_to)[0]
        parts.append(there)
        largest.append(np.maximum(farthest, np.where(open_to, back, 0.0).max(axis=1)))
    return np.concatenate(parts), np.concatenate(largest)


def _nearest(
    queries: Array, points: Array, triangles: Index, wanted: Mask | None = None
) -> tuple[Array, Index, Array]:
    """`nearest_on_surface` of queries (B, Q, 3), or those of them that are `wanted`, on B surfaces (B, N, 3)."""
    from scipy.spatial import cKDTree  # slow to load, and reading results needs none

    corners = points[:, triangles]
    centroids = corners.mean(axis=2)
    reach = np.linalg.norm(corners - centroids[:, :, None], axis=3).max(axis=(1, 2))
    # each tree is made for one query
    trees = [cKDTree(centres, balanced_tree=False, compact_nodes=False) for centres in centroids]
    facets = _Facets(corners.reshape(-1, 3, 3))
    n_surfaces, n_queries = queries.shape[:2]
    n_facets = len(triangles)
    flat = queries.reshape(-1, 3)
    distance = np.full(len(flat), np.inf)
    facet = np.zeros(len(flat), dtype=np.int64)
    weights = np.zeros((len(flat), 3))
    pending = np.arange(len(flat)) if wanted is None else np.flatnonzero(wanted)
    k = min(8, n_facets)
    while len(pending):
        of = pending // n_queries
        ends = np.searchsorted(of, np.arange(n_surfaces + 1))
        centre_distance, candidates = np.empty((len(pending), k)), np.empty((len(pending), k), dtype=np.int64)
        for tree, first, end in zip(trees, ends, ends[1:], strict=False):
            found = tree.query(flat[pending[first:end]], k=k)
            centre_distance[first:end], candidates[first:end] = (np.reshape(part, (-1, k)) for part in found)
        gaps, along_u, along_v = facets.nearest(flat[pending], candidates + n_facets * of[:, None])
        rows, best = np.arange(len(pending)), np.argmin(gaps, axis=1)
        distance[pending] = np.sqrt(gaps[rows, best])
        facet[pending] = candidates[rows, best]
        u, v = along_u[rows, best], along_v[rows, best]
        weights[pending] = np.stack([1 - u - v, u, v], axis=1)
        if k == n_facets:
            break
        # a facet further away than this by its centroid cannot be nearer
        pending = pending[centre_distance[:, -1] < distance[pending] + reach[of]]
        k = min(4 * k, n_facets)
    shape = (n_surfaces, n_queries)
    return distance.reshape(shape), facet.reshape(shape), weights.reshape(*shape, 3)


class _Facets:
    """Triangles as a corner a and the edges u = b - a and v = c - a, component by component."""

    def __init__(self, corners: Array) -> None:
        self.a, b, c = (np.ascontiguousarray(corners[:, i].T) for i in range(3))
        self.u, self.v = b - self.a, c - self.a
        self.uu, self.uv, self.vv = (
            np.einsum("if,if->f", x, y) for x, y in ((self.u, self.u), (self.u, self.v), (self.v, self.v))
        )

    def nearest(self, queries: Array, candidates: Index) -> tuple[Array, Array, Array]:
        """For Q queries (Q, 3) and facets (Q, k): squared distance, and s and t of the nearest point a + s u + t v.

        By the regions of the plane that a corner, an edge or the inside is nearest to (Ericson, Real-Time Collision
        Detection, section 5.1.5).
        """
        w = [queries[:, i, None] - self.a[i][candidates] for i in range(3)]
        u, v = ([edge[i][candidates] for i in range(3)] for edge in (self.u, self.v))
        uu, uv, vv = (part[candidates] for part in (self.uu, self.uv, self.vv))
        d1, d2 = (x[0] * w[0] + x[1] * w[1] + x[2] * w[2] for x in (u, v))
        d3, d4, d5, d6 = d1 - uu, d2 - uv, d1 - uv, d2 - vv
        from_c, from_b, from_a = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
        s, t = _share(from_b, from_a + from_b + from_c), _share(from_c, from_a + from_b + from_c)
        beyond_b, beyond_c = d4 - d3, d5 - d6
        # the regions, the strongest condition last; an edge without length is no region
        bc = (from_a <= 0) & (beyond_b >= 0) & (beyond_c >= 0)
        along = _share(beyond_b, beyond_b + beyond_c)
        s, t = np.where(bc, 1 - along, s), np.where(bc, along, t)
        ac = (from_b <= 0) & (d2 >= 0) & (d6 <= 0) & (vv > 0)
        s, t = np.where(ac, 0.0, s), np.where(ac, _share(d2, d2 - d6), t)
        at_c = (d6 >= 0) & (d5 <= d6)
        s, t = np.where(at_c, 0.0, s), np.where(at_c, 1.0, t)
        ab = (from_c <= 0) & (d1 >= 0) & (d3 <= 0) & (uu > 0)
        s, t = np.where(ab, _share(d1, d1 - d3), s), np.where(ab, 0.0, t)
        at_b = (d3 >= 0) & (d4 <= d3)
        s, t = np.where(at_b, 1.0, s), np.where(at_b, 0.0, t)
        at_a = (d1 <= 0) & (d2 <= 0)
        s, t = np.where(at_a, 0.0, s), np.where(at_a, 0.0, t)
        gap = [w[i] - s * u[i] - t * v[i] for i in range(3)]
        return gap[0] ** 2 + gap[1] ** 2 + gap[2] ** 2, s, t


def _share(part: Array, whole: Array) -> Array:
    """part / whole, 0 where there is nothing to share."""
    return np.divide(part, whole, out=np.zeros_like(part), where=whole != 0)
