"""Facets in pairs that share a traction: half the unknowns in the most expensive part of a set-up.

Away from the rim of the held nodes tractions are as smooth as the load, and two neighbours share one. At the rim
they grow as the inverse root of the distance or nearly so, and each facet with a held node of the rim keeps its
own. The method stays a Galerkin method: S is symmetric, and all nodes keep their displacements.
"""

from __future__ import annotations

import numpy as np

from solver_common.arrays import Index, Mask
from vdm.boundary.coarsening import DECIMALS, node_order
from vdm.surface import SurfaceMesh


def shared(surface: SurfaceMesh, held: Mask, among: Mask | None = None) -> Index:
    """(F,) number of each facet's traction; pairs form `among` some facets (F,), by default all, best shape first.

    Facets at the rim of held nodes (N,) stay single.

    The quality of a pair is its area vector over the squares of its four sides: 1/4 for a plane square, less for
    slender or folded pairs. Facets at a right angle or more do not pair. The shape of the body decides between
    equal pairs, not node numbers.
    """
    triangles, points = surface.triangles, surface.points
    # the two facets of each edge
    facets = np.argsort(surface.facet_edges.reshape(-1), kind="stable").reshape(-1, 2) // 3
    sides = np.square(points[triangles] - points[np.roll(triangles, -1, axis=1)]).sum(axis=(1, 2))
    across = np.square(points[surface.edges[:, 0]] - points[surface.edges[:, 1]]).sum(axis=1)
    vectors = surface.facet_vectors[facets]
    areas = np.linalg.norm(vectors.sum(axis=1), axis=1)
    quality = areas / (sides[facets].sum(axis=1) - 2.0 * across)
    places = np.sort(np.argsort(node_order(surface))[surface.edges], axis=1)
    best_first = np.lexsort((*places.T, -np.round(quality, DECIMALS)))
    cosines = np.einsum("ei,ei->e", *vectors.transpose(1, 0, 2)) / surface.facet_areas[facets].prod(axis=1)
    best_first = best_first[np.round(cosines[best_first], DECIMALS) > 0.0]
    start, end = surface.edges.T
    at_rim = np.zeros(surface.n_nodes, np.bool_)
    at_rim[surface.edges[held[start] != held[end]]] = True
    alone = ~np.asarray((at_rim & held)[triangles].any(axis=1))
    if among is not None:
        alone &= among
    numbers, may = np.arange(len(triangles)), alone.tolist()  # a list answers faster than an array
    for first, second in facets[best_first].tolist():
        if may[first] and may[second]:
            may[first] = may[second] = False
            numbers[second] = first
    return np.unique(numbers, return_inverse=True)[1]
