"""An order of a surface's nodes that its shape decides, not their numbers nor the pose or size of the body."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vdm.surface import SurfaceMesh

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# numbers near 1 that are the same to as many decimals are taken as equal
DECIMALS = 10


def node_order(surface: SurfaceMesh) -> Index:
    """(N,) the nodes in an order that scatters over the surface.

    They are sorted by a number that no rotation, reflection or scaling moves: the distance from the middle squared
    and the quadratic and cubic forms of the nodes' own moments. A fixed shuffle of the places scatters them.
    Nodes that the mesh's own symmetry makes equal go by their coordinates.
    """
    x = surface.points - surface.points.mean(axis=0)
    x = x / np.sqrt(np.square(x).sum(axis=1).mean())
    n = len(x)
    pairs = np.einsum("ni,nj->nij", x, x).reshape(n, 9)
    second, third = x.T @ x / n, pairs.T @ x / n
    # irrational weights: whole ones let the terms cancel on regular meshes
    number = np.square(x).sum(axis=1)
    number += np.sqrt(2.0) * (pairs @ second.reshape(-1)) + np.sqrt(3.0) * ((pairs @ third) * x).sum(axis=1)
    ascending = np.lexsort((*np.round(x, DECIMALS).T, np.round(number, DECIMALS)))
    return np.asarray(ascending[np.random.default_rng(0).permutation(n)], np.int64)


def renumbered(triangles: Index, order: Index) -> Index:
    """(m, 3) triangles by the places of their nodes in `order`, each from its lowest, in ascending order."""
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    corners = place[triangles]
    turns = (np.argmin(corners, axis=1)[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(corners, turns, axis=1)
    return corners[np.lexsort(corners.T[::-1])]
