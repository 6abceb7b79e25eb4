"""The pieces of a closed surface, and whether a place lies inside it."""

from __future__ import annotations

import numpy as np

from solver_common.arrays import Array, Index

_ROWS = 512  # of places, taken at once


def closed_pieces(triangles: Index) -> Index:
    """(F,) the connected piece of each facet, numbered from 0 without a gap."""
    from scipy import sparse  # slow to load, and who only reads a mesh finds no pieces here
    from scipy.sparse.csgraph import connected_components

    nodes, local = np.unique(triangles, return_inverse=True)
    local = local.reshape(-1, 3)
    ends = local[:, :2].ravel(), local[:, 1:].ravel()
    links = sparse.coo_array((np.ones(len(ends[0])), ends), shape=(len(nodes),) * 2)
    return np.asarray(connected_components(links, directed=False)[1][local[:, 0]], np.int64)


def solid_angles(places: Array, points: Array, triangles: Index) -> Array:
    """(n,) share of the full solid angle that a closed surface takes at each place (n, 3): 1 inside, 0 outside.

    Van Oosterom and Strackee 1983.
    """
    nodes = points - points.mean(axis=0)  # near the middle, squares lose nothing to rounding
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
