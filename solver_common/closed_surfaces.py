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
    found = np.empty(len(places))
    for start in range(0, len(places), _ROWS):
        arms = points[triangles][None] - places[start : start + _ROWS, None, None]
        a, b, c = arms.transpose(2, 0, 1, 3)
        la, lb, lc = (np.linalg.norm(arm, axis=2) for arm in (a, b, c))
        triple = np.einsum("nfi,nfi->nf", a, np.cross(b, c))
        below = la * lb * lc
        for one, other, length in ((a, b, lc), (b, c, la), (c, a, lb)):
            below += np.einsum("nfi,nfi->nf", one, other) * length
        found[start : start + _ROWS] = np.arctan2(triple, below).sum(axis=1) / (2.0 * np.pi)
    return found
