"""The quadrature rule for pressures on facets."""

from __future__ import annotations

import numpy as np

from solver_common.arrays import Array


def facet_quadrature() -> tuple[Array, Array]:
    """Quadrature on a triangle, exact to degree 4 (Dunavant 1985, doi 10.1002/nme.1620210612, rule 4).

    Returns
    -------
    points : (6, 3) barycentric coordinates
    weights : (6,) with sum one; an integral is the facet's area times the weighted sum
    """
    # closed form of the two orbits: exact to rounding, not to printed digits
    root = np.sqrt(10.0)
    inner = np.sqrt(38.0 - 44.0 * np.sqrt(0.4))
    near = (8.0 - root + inner) / 18.0
    far = (8.0 - root - inner) / 18.0
    weight = np.sqrt(213125.0 - 53320.0 * root)
    weights = np.repeat([(620.0 + weight) / 3720.0, (620.0 - weight) / 3720.0], 3)
    points = np.empty((6, 3))
    for orbit, value in enumerate((near, far)):
        rows = slice(3 * orbit, 3 * orbit + 3)
        points[rows] = value
        points[rows][np.diag_indices(3)] = 1.0 - 2.0 * value
    return points, weights
