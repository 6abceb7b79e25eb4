"""Given forces on the surface, as consistent forces at the nodes: resultant and moment are exact on any mesh.

Each function returns (n_nodes, 3) forces for `Load.forces`; for several, add them up. The shape functions of
straight edges and flat facets reproduce linear functions. The nodal forces thus have the load's resultant and
moment, to rounding. At finite strain they keep size and direction and move with their points.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fem_reference.mesh import TetMesh
from solver_common.arrays import Array
from solver_common.quadrature import facet_quadrature
from solver_common.solution import solver_error


def traction_forces(mesh: TetMesh, traction: ArrayLike) -> Array:
    """Force per undeformed area in any direction, such as shear.

    Parameters
    ----------
    mesh : of a problem
    traction : (F, Q, 3) at the points of `fem_reference.mesh.facet_quadrature`, or what broadcasts to it [Pa]

    Raises
    ------
    SolverError
        For an array of another shape.
    """
    points, weights = facet_quadrature()
    wanted = (len(mesh.triangles), len(weights), 3)
    given = np.asarray(traction, dtype=np.float64)
    try:
        values = np.broadcast_to(given, wanted)
    except ValueError as error:
        raise _bad_load(f"traction has shape {given.shape}", f"give shape {wanted}") from error
    shape = mesh.facet_functions(points)
    local = np.einsum("fq,q,qa,fqi->fai", _areas(mesh), weights, shape, values, optimize=True)
    return mesh.summed(mesh.facet_nodes, local)


def region_forces(mesh: TetMesh, facets: NDArray[np.bool_], force: ArrayLike) -> Array:
    """A resultant over a region, by a uniform traction.

    Parameters
    ----------
    mesh : of a problem
    facets : (F,) the region
    force : (3,) its resultant [N]

    Raises
    ------
    SolverError
        For an empty region.
    """
    mask = np.asarray(facets)
    if mask.shape != (len(mesh.triangles),) or mask.dtype != bool or not mask.any():
        raise _bad_load(
            "a region of given forces has no facet", f"give a mask of shape ({len(mesh.triangles)},)"
        )
    traction = np.asarray(force, dtype=np.float64) / _areas(mesh)[mask].sum()
    return traction_forces(mesh, np.where(mask[:, None, None], traction, 0.0))


def line_forces(mesh: TetMesh, edges: ArrayLike, force: ArrayLike) -> Array:
    """A resultant spread evenly over the length of a line of edges.

    Parameters
    ----------
    mesh : of a problem
    edges : (k, 2) surface nodes at the ends of edges of the surface
    force : (3,) [N]

    Raises
    ------
    SolverError
        For no edge, or a pair of nodes that no triangle joins.
    """
    ends = np.asarray(edges, dtype=np.int64)
    if ends.ndim != 2 or ends.shape[1:] != (2,) or not len(ends):
        raise _bad_load(
            f"a line of given forces has shape {ends.shape}", "give (k, 2) surface nodes, k at least 1"
        )
    count = len(mesh.surface_nodes)
    sides = np.sort(np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=2), axis=2).reshape(
        -1, 2
    )
    keys, first = np.unique(sides[:, 0] * count + sides[:, 1], return_index=True)
    low, high = ends.min(axis=1), ends.max(axis=1)
    wanted = low * count + high
    place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    absent = (keys[place] != wanted) | (low < 0) | (high >= count)
    if absent.any():
        pair = ends[np.argmax(absent)].tolist()
        raise _bad_load(
            f"no triangle joins the surface nodes {pair[0]} and {pair[1]}", "give edges of the surface"
        )
    nodes = mesh.surface_nodes[ends]
    length = np.linalg.norm(mesh.points[nodes[:, 1]] - mesh.points[nodes[:, 0]], axis=1)
    shares = np.array([0.5, 0.5])
    if mesh.order == 2:
        # Simpson's rule is the integral of the quadratic shape functions
        facet, side = np.divmod(first[place], 3)
        nodes = np.column_stack([nodes, mesh.facet_nodes[facet, 3 + side]])
        shares = np.array([1.0, 1.0, 4.0]) / 6.0
    weight = np.outer(length / length.sum(), shares)
    return mesh.summed(nodes, weight[:, :, None] * np.asarray(force, dtype=np.float64))


def _areas(mesh: TetMesh) -> Array:
    """(F, 1) factor that turns a weighted sum over a facet into an integral: its area."""
    return np.asarray(np.linalg.norm(mesh.area_vectors, axis=1)[:, None])


_bad_load = partial(solver_error, "bad-load")
