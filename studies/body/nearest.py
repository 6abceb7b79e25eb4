"""The nearest point of a triangle surface, exactly: numpy and scipy only."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from solver_common.arrays import Array, Index

_NEAR = 64  # facets around a node that are measured at rest
# pairs of a node and a facet: small surfaces are searched together, for large ones that is memory for nothing
_MOST_AT_ONCE = 200_000


def nearest_on_surface(queries: Array, points: Array, triangles: Index) -> tuple[Array, Index, Array]:
    """The point of a triangle surface nearest to each of Q queries, exactly.

    Returns
    -------
    distance : (Q,) [m]
    facet : (Q,) index of the facet that holds the nearest point
    weights : (Q, 3) barycentric coordinates of the nearest point in that facet
    """
    facets = _Facets(points, triangles)
    distance = np.full(len(queries), np.inf)
    facet = np.zeros(len(queries), dtype=np.int64)
    weights = np.zeros((len(queries), 3))
    pending = np.arange(len(queries))
    k = min(8, len(triangles))
    while len(pending):
        centre_distance, candidates = facets.by_centroid(queries[pending], k)
        gaps, s, t = facets.nearest(queries[pending], candidates)
        rows, best = np.arange(len(pending)), np.argmin(gaps, axis=1)
        distance[pending] = np.sqrt(gaps[rows, best])
        facet[pending] = candidates[rows, best]
        s, t = s[rows, best], t[rows, best]
        weights[pending] = np.stack([1 - s - t, s, t], axis=1)
        if k == len(triangles):
            break
        # a facet further away than this by its centroid cannot be nearer
        pending = pending[centre_distance[:, -1] < distance[pending] + facets.reach]
        k = min(4 * k, len(triangles))
    return distance, facet, weights


class Neighbourhood:
    """A surface of N nodes and F facets at rest, for the distances between displaced copies of it.

    A node of one copy is mostly nearest to a facet of another at the same node. Only these are looked at where the
    distance at rest to all other facets, less what the displacements can have taken of it, proves that this is so.
    """

    def __init__(self, points: Array, triangles: Index) -> None:
        self.points, self.triangles = points, triangles
        # pairs of a node and a facet at it, by node: the facet's corners, the node first
        pairs = np.concatenate([triangles[:, [k, (k + 1) % 3, (k + 2) % 3]] for k in range(3)])
        # an edge is the second of one facet and the first of its neighbour, but at a border: there it stands alone
        first, second = (pairs[:, 0] * len(points) + pairs[:, k] for k in (1, 2))
        pairs = np.concatenate([pairs, pairs[~np.isin(second, first)][:, [0, 2, 2]]])
        self._pairs = np.ascontiguousarray(pairs[np.argsort(pairs[:, 0], kind="stable")].T)  # (3, P)
        self._ends = np.searchsorted(self._pairs[0], np.arange(len(points) + 1))

    def distances_and_farthest(self, copies: Array, other: Array) -> tuple[Array, Array]:
        """How far B displaced copies (B, N, 3) are from another (N, 3).

        Returns
        -------
        distance : (B, N) of their nodes to the other surface [m]
        farthest : (B,) the largest of these and of the distances of the other's nodes to each [m]
        """
        at_once = max(1, _MOST_AT_ONCE // self._pairs.shape[1])
        starts = range(0, len(copies), at_once)
        copies, other = (np.ascontiguousarray(np.moveaxis(points, -1, 0)) for points in (copies, other))
        nodes = np.arange(len(self.points))
        there = np.concatenate([self._distances(copies[:, k : k + at_once], other, nodes) for k in starts])
        farthest = there.max(axis=1)
        # a node of the other surface is no further from this one than from the node that it corresponds to
        bounds = _lengths(copies - other[:, None])
        for place, bound in enumerate(bounds):
            still = np.flatnonzero(bound > farthest[place])
            if len(still):
                back = self._distances(other[:, None], copies[:, place], still)
                farthest[place] = max(farthest[place], back.max())
        return there, farthest

    def _distances(self, copies: Array, other: Array, nodes: Index) -> Array:
        """(B, n) distances of n nodes of the copies (3, B, N) to another (3, N)."""
        first, last = self._ends[nodes], self._ends[nodes + 1]
        starts = np.cumsum(last - first) - (last - first)
        apart = copies[:, :, nodes] - other[:, None, nodes]
        pairs = np.arange(len(self._pairs[0]))
        if len(nodes) < len(self.points):
            pairs = pairs[: (last - first).sum()] + np.repeat(first - starts, last - first)
        corner, second, third = other[:, self._pairs[:, pairs]].swapaxes(0, 1)
        # a node is as far from the first corner as the copies are apart there
        w = np.repeat(apart, last - first, axis=2)
        gaps, heights = _nearest_in_wedge(w, second - corner, third - corner)
        distance: Array = np.sqrt(np.minimum.reduceat(gaps, starts, axis=1))
        # what is nearest in a wedge is no further from its corner than the point is: then it is in the facet
        in_facet = _dot(apart, apart) < np.minimum.reduceat(heights, starts)
        for row, places in enumerate(
            self._unproven(np.where(in_facet, distance, np.inf), copies, other, nodes)
        ):
            if len(places):
                queries = copies[:, row, nodes[places]]
                distance[row, places] = nearest_on_surface(queries.T, other.T, self.triangles)[0]
        return distance

    def _unproven(self, distance: Array, copies: Array, other: Array, nodes: Index) -> list[Index]:
        """Of each copy the places among n `nodes` to which another facet may be nearer than `distance` (B, n).

        A point of a facet moves by a mean of what its corners move by. So a facet at `a` from a node at rest is no
        nearer to it than `a` less the largest difference between the node's displacement and those of the corners.
        """
        clearance, beyond, around = self._at_rest
        rest = self.points.T
        moved, others = copies[:, :, nodes] - rest[:, None, nodes], other - rest
        middle = 0.5 * (others.min(axis=1) + others.max(axis=1))
        most = _lengths(moved - middle[:, None, None]) + _lengths(others - middle[:, None]).max()
        found = []
        for row, doubtful in enumerate(distance >= np.minimum(clearance, beyond)[nodes] - most):
            places = np.flatnonzero(doubtful)
            if len(places):
                some = nodes[places]  # the displacements around them differ less
                near = _lengths(others[:, around[some]] - moved[:, row, places, None]).max(axis=1)
                bound = np.minimum(clearance[some] - near, beyond[some] - most[row, places])
                places = places[distance[row, places] >= bound]
            found.append(places)
        return found

    @cached_property
    def _at_rest(self) -> tuple[Array, Array, Index]:
        """How far the nodes are from facets that they are no corner of.

        Returns
        -------
        clearance : (N,) distance to the nearest of these facets, if it is among the `_NEAR` nearest by centroid
        beyond : (N,) bound from below of the distance to all further facets
        around : (N, K) corners of the nearest facets, filled up with the node itself
        """
        facets = _Facets(self.points, self.triangles)
        n_nodes, k = len(self.points), min(_NEAR, len(self.triangles))
        clearance, beyond = np.full(n_nodes, np.inf), np.full(n_nodes, np.inf)
        around = np.repeat(np.arange(n_nodes)[:, None], 3 * k, axis=1)
        width = 1
        for first in range(0, n_nodes, _MOST_AT_ONCE // _NEAR):
            nodes = np.arange(n_nodes)[first : first + _MOST_AT_ONCE // _NEAR]
            centre_distance, near = facets.by_centroid(self.points[nodes], k)
            gaps, _, _ = facets.nearest(self.points[nodes], near)
            corners = self.triangles[near]
            own = (corners == nodes[:, None, None]).any(axis=2)
            clearance[nodes] = np.sqrt(np.where(own, np.inf, gaps).min(axis=1))
            if k < len(self.triangles):
                beyond[nodes] = centre_distance[:, -1] - facets.reach
            corners = np.sort(corners.reshape(len(nodes), -1), axis=1)
            place: Index = np.cumsum(np.diff(corners, axis=1, prepend=corners[:, :1]) > 0, axis=1)
            np.put_along_axis(around[first : first + len(nodes)], place, corners, axis=1)
            width = max(width, int(place.max()) + 1)
        return clearance, beyond, around[:, :width].copy()


class _Facets:
    """Triangles as a corner and the edges u and v from it, by component, to be found by centroid."""

    def __init__(self, points: Array, triangles: Index) -> None:
        from scipy.spatial import cKDTree  # slow to load, and reading results needs none

        corners = points[triangles]
        centroids = corners.mean(axis=1)
        self.reach = float(np.linalg.norm(corners - centroids[:, None], axis=2).max())
        self._tree = cKDTree(centroids, balanced_tree=False, compact_nodes=False)  # it is made for one query
        self._corner, second, third = np.ascontiguousarray(corners.transpose(1, 2, 0))
        self._u, self._v = second - self._corner, third - self._corner
        self._squares = _squares(self._u, self._v)

    def by_centroid(self, queries: Array, k: int) -> tuple[Array, Index]:
        """(Q, k) distances of the k nearest centroids, rising, and their facets."""
        distance, facet = self._tree.query(queries, k=k)
        return np.reshape(distance, (-1, k)), np.reshape(facet, (-1, k))

    def nearest(self, queries: Array, candidates: Index) -> tuple[Array, Array, Array]:
        """`_nearest_in` of Q queries (Q, 3) and k candidate facets of each (Q, k)."""
        w = queries.T[:, :, None] - self._corner[:, candidates]
        return _nearest_in(w, self._u[:, candidates], self._v[:, candidates], self._squares[:, candidates])


def _dot(u: Array, v: Array) -> Array:
    """(...,) u.v of vectors (3, ...)."""
    product: Array = u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
    return product


def _lengths(vectors: Array) -> Array:
    """(...,) Euclidean lengths of vectors (3, ...)."""
    return np.sqrt(_dot(vectors, vectors))


def _squares(u: Array, v: Array) -> Array:
    """(3, ...) u.u, u.v and v.v of vectors (3, ...)."""
    return np.stack([_dot(u, u), _dot(u, v), _dot(v, v)])


def _nearest_in_wedge(w: Array, u: Array, v: Array) -> tuple[Array, Array]:
    """For points at w (3, B, P) from the first corner of P triangles with edges u and v (3, P) from it: what is
    nearest to them inside the wedge of the two edges or on its edge u, either without end.

    Returns the squared distance (B, P), and the square of how far from the corner the wedge is the triangle (P,):
    to the line of the third edge; where v is u, which is an edge alone, to its end.
    """
    uu, uv, vv = _squares(u, v)
    normal = np.stack([u[i - 2] * v[i - 1] - u[i - 1] * v[i - 2] for i in range(3)])
    nn, third = _dot(normal, normal), _dot(v - u, v - u)
    d1, d2 = _dot(u, w), _dot(v, w)
    inside = (d1 * vv >= d2 * uv) & (d2 * uu >= d1 * uv) & (nn > 0)
    flat = np.where(inside, _share(_dot(normal, w) ** 2, nn), np.inf)
    x, y, z = w - _share(np.maximum(d1, 0.0), uu) * u[:, None]
    return np.minimum(flat, x**2 + y**2 + z**2), np.where(third > 0, _share(nn, third), uu)


def _nearest_in(w: Array, u: Array, v: Array, squares: Array) -> tuple[Array, Array, Array]:
    """For points at w (3, ...) from a corner of triangles with edges u and v (3, ...): what is nearest to them.

    Returns the squared distance (...,), and s and t of the nearest point, which is at s u + t v from the corner. By
    the regions of the plane that a corner, an edge or the inside is nearest to (Ericson, Real-Time Collision
    Detection, section 5.1.5).
    """
    uu, uv, vv = squares
    d1, d2 = (x[0] * w[0] + x[1] * w[1] + x[2] * w[2] for x in (u, v))
    d3, d4, d5, d6 = d1 - uu, d2 - uv, d1 - uv, d2 - vv
    from_c, from_b, from_a = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    whole = from_a + from_b + from_c
    s, t = _share(from_b, whole), _share(from_c, whole)
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
    x, y, z = (w[i] - s * u[i] - t * v[i] for i in range(3))
    return x**2 + y**2 + z**2, s, t


def _share(part: Array, whole: Array) -> Array:
    """part / whole, 0 where there is nothing to share."""
    return np.divide(part, whole, out=np.zeros_like(part), where=whole != 0)
