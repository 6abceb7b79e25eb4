"""Closed triangle surfaces: connected pieces, points inside, and facets that intersect."""

from __future__ import annotations

import numpy as np

from solver_common.arrays import Array, Index, Mask

_ROWS = 512  # places per pass
_ROUNDING = 1e-12  # of the longest edge cubed


def pieces(count: int, first: Index, second: Index) -> Index:
    """(count,) the lowest number in each item's connected component; pairs `first`, `second` (P,) are joined."""
    lowest = np.arange(count)
    while True:
        ends = lowest[first], lowest[second]
        if np.array_equal(*ends):
            return lowest
        np.minimum.at(lowest, np.maximum(*ends), np.minimum(*ends))
        while not np.array_equal(lowest, further := lowest[lowest]):
            lowest = further


def closed_pieces(triangles: Index) -> Index:
    """(F,) connected piece of each facet, numbered consecutively from 0."""
    joined = np.concatenate([triangles[:, :2], triangles[:, 1:]])
    lowest = pieces(int(triangles.max()) + 1, *joined.T)
    return np.unique(lowest[triangles[:, 0]], return_inverse=True)[1].ravel()


def solid_angles(places: Array, points: Array, triangles: Index) -> Array:
    """(n,) solid angle of a closed surface at each place (n, 3), over 4 pi: 1 inside, 0 outside.

    Van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125.
    """
    nodes = points - points.mean(axis=0)  # near the origin, squares lose no digits
    a, b, c = nodes[triangles].transpose(1, 0, 2)
    faces, volumes = np.cross(a, b) + np.cross(b, c) + np.cross(c, a), (a * np.cross(b, c)).sum(axis=1)
    found = np.empty(len(places))
    for start in range(0, len(places), _ROWS):
        x = places[start : start + _ROWS] - points.mean(axis=0)
        square = np.square(x).sum(axis=1)[:, None]
        lengths = np.sqrt(np.maximum(np.square(nodes).sum(axis=1) - 2.0 * (x @ nodes.T) + square, 0.0))
        la, lb, lc = (lengths[:, corner] for corner in triangles.T)
        below = la * lb * lc
        for one, other, length in ((a, b, lc), (b, c, la), (c, a, lb)):
            below += ((one * other).sum(axis=1) - x @ (one + other).T + square) * length
        found[start : start + _ROWS] = np.arctan2(volumes - x @ faces.T, below).sum(axis=1) / (2.0 * np.pi)
    return found


def crossings(points: Array, triangles: Index, since: int = 0) -> Index:
    """Pairs (P, 2) of facets that intersect. At least one facet of each pair has the number `since` or more.

    Candidates are facets whose bounding balls about their centroids touch. A pair counts if an edge of one facet
    passes through the other or its rim.
    """
    first, second = _candidates(points, triangles, since)
    cut = np.zeros(len(first), dtype=bool)
    for one, other in ((first, second), (second, first)):
        a, b, c = np.moveaxis(points[triangles[other]], 1, 0)
        for k in range(3):
            ends = triangles[one][:, [k, k - 2]]
            apart = ~(ends[:, :, None] == triangles[other][:, None, :]).any(axis=(1, 2))
            cut |= apart & _segment_through_triangle(points[ends[:, 0]], points[ends[:, 1]], a, b, c)
    return np.stack([first[cut], second[cut]], axis=1)


def _candidates(points: Array, triangles: Index, since: int) -> tuple[Index, Index]:
    """Facets (P,) and (P,) of the pairs whose bounding balls touch, as in `crossings`."""
    from scipy.spatial import KDTree  # slow to load, and not needed to read a mesh

    corners = points[triangles]
    centroids = corners.mean(axis=1)
    radii = np.linalg.norm(corners - centroids[:, None], axis=2).max(axis=1)
    pairs = KDTree(centroids).query_pairs(2.0 * radii.max(), output_type="ndarray")
    pairs = pairs[pairs.max(axis=1) >= since]
    distance = np.linalg.norm(centroids[pairs[:, 0]] - centroids[pairs[:, 1]], axis=1)
    pairs = pairs[distance <= radii[pairs].sum(axis=1)]
    pairs = pairs[np.lexsort(pairs.T[::-1])].astype(np.int64)
    return pairs[:, 0], pairs[:, 1]


def _segment_through_triangle(p: Array, q: Array, a: Array, b: Array, c: Array) -> Mask:
    """(n,) whether each segment pq passes through triangle abc or its rim from one side to the other.

    Signs of volumes decide. A value below rounding counts as on the rim and as in the plane.
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
