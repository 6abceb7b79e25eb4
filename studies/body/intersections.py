"""Finds where a triangle surface cuts itself, and smooths such places: numpy and scipy only."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csr_array

from solver_common.arrays import Array, Index, Mask
from solver_common.closed_surfaces import crossings

from ..study.errors import MeshError
from .surface_measures import facet_area_vectors
from .topology import facet_pairs, half_edges

_FOLD = -0.98  # cosine between the normals of facets on one edge: below it they lie on each other
_ROUNDS = 30
_RINGS = 2  # how far around a bad facet nodes are moved
_STEPS = 3  # of smoothing in a round
_FARTHEST = 3.0  # mean edge lengths that a node may move: more would be another body


def intersecting_facets(points: Array, triangles: Index) -> Index:
    """Pairs (P, 2) of facets that cut through each other, or share an edge and are folded onto each other.

    The surface must be closed and manifold.
    """
    crossing = crossings(points, triangles)
    normals = facet_area_vectors(points, triangles)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    left, right, _ = facet_pairs(points, triangles)
    folded = np.einsum("ij,ij->i", normals[left], normals[right]) < _FOLD
    return np.concatenate(
        [
            crossing,
            np.sort(np.stack([left[folded], right[folded]], axis=1), axis=1),
        ]
    )


def without_intersections(points: Array, triangles: Index) -> tuple[Array, int]:
    """Points (n, 3) moved so that no facets intersect, and the number of intersecting pairs before.

    Nodes near an intersection move repeatedly to the mean of their neighbours. Raises MeshError if that does not
    help within `_FARTHEST` edges.
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
