"""Where a triangle surface cuts itself, and how such places are smoothed out: numpy and scipy only."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csr_array

from solver_common.arrays import Array, Index, Mask

from ..study.errors import MeshError
from .surface_measures import facet_area_vectors
from .topology import facet_pairs, half_edges

_FOLD = -0.98  # cosine between the normals of facets on one edge: below it they lie on each other
_ROUNDING = 1e-12  # of the longest edge cubed
_ROUNDS = 30
_RINGS = 2  # how far around a bad facet nodes are moved
_STEPS = 3  # of smoothing in a round
_FARTHEST = 3.0  # mean edge lengths that a node may move: more would be another body


def intersecting_facets(points: Array, triangles: Index) -> Index:
    """Pairs (P, 2) of facets that cut through each other, or share an edge and are folded onto each other.

    Candidates are facets whose circumscribed balls about their centroids touch; a pair counts where an edge
    of one passes through the other or its rim. The surface must be closed and manifold.
    """
    first, second = _candidates(points, triangles)
    cut = np.zeros(len(first), dtype=bool)
    for one, other in ((first, second), (second, first)):
        a, b, c = np.moveaxis(points[triangles[other]], 1, 0)
        for k in range(3):
            ends = triangles[one][:, [k, k - 2]]
            apart = ~(ends[:, :, None] == triangles[other][:, None, :]).any(axis=(1, 2))
            cut |= apart & _segment_through_triangle(points[ends[:, 0]], points[ends[:, 1]], a, b, c)
    normals = facet_area_vectors(points, triangles)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    left, right, _ = facet_pairs(points, triangles)
    folded = np.einsum("ij,ij->i", normals[left], normals[right]) < _FOLD
    return np.concatenate(
        [
            np.stack([first[cut], second[cut]], axis=1),
            np.sort(np.stack([left[folded], right[folded]], axis=1), axis=1),
        ]
    )


def without_intersections(points: Array, triangles: Index) -> tuple[Array, int]:
    """Points (n, 3) moved so that no facets intersect, and how many pairs did before.

    Nodes about the bad places are drawn to the mean of their neighbours, over and over. Raises MeshError
    where that does not help within `_FARTHEST` edges.
    """
    bad = intersecting_facets(points, triangles)
    found = len(bad)
    if not found:
        return points, 0
    before, edges = points, half_edges(triangles)
    reach = _FARTHEST * np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1).mean()
    average = _neighbour_average(triangles, len(points))
    moving = np.zeros(len(points), dtype=bool)
    for _ in range(_ROUNDS):
        moving |= _around(triangles[np.unique(bad)], average, len(points))
        points = points.copy()
        for _ in range(_STEPS):
            points[moving] = 0.5 * (points + average @ points)[moving]
        if np.linalg.norm(points - before, axis=1).max() > reach:
            break
        bad = intersecting_facets(points, triangles)
        if not len(bad):
            return points, found
    raise MeshError(
        f"the surface cuts through itself at {found} pairs of facets and smoothing does not free it; "
        "mend it, or use another mesh_size"
    )


def _candidates(points: Array, triangles: Index) -> tuple[Index, Index]:
    from scipy.spatial import KDTree  # slow to load: only where a surface was made anew

    corners = points[triangles]
    centroids = corners.mean(axis=1)
    radii = np.linalg.norm(corners - centroids[:, None], axis=2).max(axis=1)
    pairs = KDTree(centroids).query_pairs(2.0 * radii.max(), output_type="ndarray")
    distance = np.linalg.norm(centroids[pairs[:, 0]] - centroids[pairs[:, 1]], axis=1)
    pairs = pairs[distance <= radii[pairs].sum(axis=1)]
    pairs = pairs[np.lexsort(pairs.T[::-1])].astype(np.int64)
    return pairs[:, 0], pairs[:, 1]


def _segment_through_triangle(p: Array, q: Array, a: Array, b: Array, c: Array) -> Mask:
    """Whether each segment pq passes through triangle abc or its rim from one side to the other.

    By signs of volumes; what is smaller than rounding counts as on the rim, and as not off the plane.
    """
    normal, direction = np.cross(b - a, c - a), q - p
    rounding = _ROUNDING * float(max(np.abs(direction).max(initial=0.0), np.abs(c - a).max(initial=0.0))) ** 3
    start = np.einsum("ij,ij->i", normal, p - a)
    end = np.einsum("ij,ij->i", normal, q - a)
    separated = (np.minimum(start, end) < -rounding) & (np.maximum(start, end) > rounding)
    sides = np.stack(
        [np.einsum("ij,ij->i", direction, np.cross(u - p, v - p)) for u, v in ((a, b), (b, c), (c, a))]
    )
    inside = (sides >= -rounding).all(axis=0) | (sides <= rounding).all(axis=0)
    through: Mask = separated & inside
    return through


def _neighbour_average(triangles: Index, n_points: int) -> csr_array:
    """The sparse matrix that replaces each node's value by the mean of its neighbours'."""
    edges = half_edges(triangles)
    ones = np.ones(len(edges))
    adjacency = coo_array((ones, (edges[:, 0], edges[:, 1])), shape=(n_points, n_points)).tocsr()
    return csr_array(adjacency.multiply(1.0 / np.bincount(edges[:, 0])[:, None]))


def _around(facets: Index, average: csr_array, n_points: int) -> Mask:
    """Nodes of the facets and those within `_RINGS` edges of them."""
    near = np.zeros(n_points)
    near[np.unique(facets)] = 1.0
    for _ in range(_RINGS):
        near = near + average @ near
    mask: Mask = near > 0
    return mask
