"""The nearest point of a triangle surface: VTK's locator, exact to rounding."""

from __future__ import annotations

from typing import Any

import numpy as np

from solver_common.arrays import Array, Index


def nearest_on_surface(queries: Array, points: Array, triangles: Index) -> tuple[Array, Index, Array]:
    """The point of a triangle surface nearest to each of Q queries.

    Returns
    -------
    distance : (Q,) [m]
    facet : (Q,) index of the facet that holds the nearest point
    weights : (Q, 3) barycentric coordinates of the nearest point in that facet
    """
    facet, nearest = _found(queries, points, triangles)
    corners = points[triangles[facet]]
    u, v, w = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], nearest - corners[:, 0]
    pairs = (u, u), (u, v), (v, v), (w, u), (w, v)
    uu, uv, vv, wu, wv = (np.einsum("qi,qi->q", a, b) for a, b in pairs)
    square = uu * vv - uv**2  # of twice the area
    s, t = (wu * vv - wv * uv) / square, (wv * uu - wu * uv) / square
    return np.linalg.norm(nearest - queries, axis=1), facet, np.stack([1.0 - s - t, s, t], axis=1)


def distances_and_farthest(points: Array, other: Array, triangles: Index) -> tuple[Array, float]:
    """Distances between two displaced copies (N, 3) of a surface.

    Returns
    -------
    distance : (N,) distance of the nodes to the other surface [m]
    farthest : largest distance of a node of either copy to the other surface [m]
    """
    there = _distances(points, other, triangles)
    farthest = float(there.max())
    # a node of the other surface is at most as far from this one as from its own copy
    doubtful = np.linalg.norm(points - other, axis=1) > farthest
    if doubtful.any():
        farthest = max(farthest, float(_distances(other[doubtful], points, triangles).max()))
    return there, farthest


def _distances(queries: Array, points: Array, triangles: Index) -> Array:
    return np.asarray(np.linalg.norm(_found(queries, points, triangles)[1] - queries, axis=1))


def _found(queries: Array, points: Array, triangles: Index) -> tuple[Index, Array]:
    """(Q,) facets and (Q, 3) the nearest points in them; facets without area are skipped."""
    # slow to load, and reading results needs none
    from vtkmodules.util import numpy_support
    from vtkmodules.vtkCommonCore import reference, vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkGenericCell, vtkPolyData, vtkStaticCellLocator

    as_vtk: Any = numpy_support.numpy_to_vtk  # untyped
    as_ids: Any = numpy_support.numpy_to_vtkIdTypeArray
    middle = points.mean(axis=0)  # centring loses fewer digits
    places, corners, surface = vtkPoints(), vtkCellArray(), vtkPolyData()
    places.SetData(as_vtk(np.ascontiguousarray(points - middle)))
    corners.SetData(3, as_ids(np.ascontiguousarray(triangles, dtype=np.int64).ravel()))
    surface.SetPoints(places)
    surface.SetPolys(corners)
    locator, cell = vtkStaticCellLocator(), vtkGenericCell()
    locator.SetDataSet(surface)
    locator.BuildLocator()
    facets, nearest = np.empty(len(queries), dtype=np.int64), np.empty((len(queries), 3))
    facet: Any = reference(0)  # VTK's stubs type it as a number
    part: Any = reference(0)
    square: Any = reference(0.0)
    spot = [0.0, 0.0, 0.0]
    for row, query in enumerate((queries - middle).tolist()):
        locator.FindClosestPoint(query, spot, cell, facet, part, square)
        facets[row], nearest[row] = int(facet), spot
    return facets, nearest + middle
