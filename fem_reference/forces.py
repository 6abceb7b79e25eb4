"""Given forces on the surface, as consistent forces at the nodes: resultant and moment are exact on any mesh.

Each function returns (n_nodes, 3) forces for `Load.forces`; add them up for several. The shape functions of
straight edges and flat facets reproduce linear functions, so the sums of the nodal forces and of their moments are
those of the load to rounding. At finite strain they keep size and direction and move with their points.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fem_reference.mesh import TetMesh
from solver_common.arrays import Array
from solver_common.quadrature import facet_quadrature
from solver_common.solution import solver_error

# A region whose points lie this close to one line, in units of its size, cannot take a moment about that line.
_THIN = 1e-9


def traction_forces(mesh: TetMesh, traction: ArrayLike) -> Array:
    """Force per undeformed area in any direction: shear, or anything else.

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


def region_forces(
    mesh: TetMesh,
    facets: NDArray[np.bool_],
    force: ArrayLike,
    moment: ArrayLike | None = None,
    about: ArrayLike = (0.0, 0.0, 0.0),
) -> Array:
    """A resultant over a region, by the traction a + b x (x - c) that has it, c the region's centroid.

    Without a moment the traction is uniform.

    Parameters
    ----------
    mesh : of a problem
    facets : (F,) the region
    force : (3,) its resultant [N]
    moment : (3,) its moment about the point `about` [N m], or None for what a uniform traction has
    about : (3,) [m]

    Raises
    ------
    SolverError
        For no facet, or a moment about the line that a region is as thin as.
    """
    mask = np.asarray(facets)
    if mask.shape != (len(mesh.triangles),) or mask.dtype != bool or not mask.any():
        raise _bad_load(
            "a region of given forces has no facet", f"give a mask of shape ({len(mesh.triangles)},)"
        )
    _, weights = facet_quadrature()
    x = mesh.facet_points
    share = _areas(mesh) * weights * mask[:, None]
    area = share.sum()
    centroid = np.einsum("fq,fqi->i", share, x) / area
    resultant = np.asarray(force, dtype=np.float64)
    traction = np.broadcast_to(resultant / area, x.shape) * mask[:, None, None]
    if moment is not None:
        arm = x - centroid
        squares = np.einsum("fq,fqi,fqj->ij", share, arm, arm)
        inertia = np.trace(squares) * np.eye(3) - squares
        if np.linalg.eigvalsh(inertia)[0] <= _THIN * np.trace(squares):
            raise _bad_load(
                "a region on one line takes no moment about it", "choose more facets, or no moment"
            )
        at_centroid = np.asarray(moment) - np.cross(centroid - np.asarray(about), resultant)
        turn = np.linalg.solve(inertia, at_centroid)
        traction = traction + np.cross(turn, arm) * mask[:, None, None]
    return traction_forces(mesh, traction)


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


def point_forces(mesh: TetMesh, facet: int, barycentric: ArrayLike, force: ArrayLike) -> Array:
    """A force at one point of a facet.

    Under it the exact displacement is infinite: what a mesh makes of it elsewhere converges, there it does not.

    Parameters
    ----------
    mesh : of a problem
    facet : number of the facet
    barycentric : (3,) coordinates of the point in it, not negative, sum 1
    force : (3,) [N]

    Raises
    ------
    SolverError
        For a facet that is none, or a point outside it.
    """
    at = np.asarray(barycentric, dtype=np.float64)
    if not 0 <= facet < len(mesh.triangles):
        raise _bad_load(f"there is no facet {facet}", f"give 0 to {len(mesh.triangles) - 1}")
    if at.shape != (3,) or not (at >= 0.0).all() or abs(at.sum() - 1.0) > 1e-9:
        raise _bad_load(f"barycentric is {at.tolist()}", "give three numbers that are not negative, sum 1")
    local = np.outer(mesh.facet_functions(at[None])[0], np.asarray(force, dtype=np.float64))
    return mesh.summed(mesh.facet_nodes[[facet]], local[None])


def _areas(mesh: TetMesh) -> Array:
    """(F, 1) area by which a weighted sum over a facet is an integral."""
    return np.asarray(np.linalg.norm(mesh.area_vectors, axis=1)[:, None])


_bad_load = partial(solver_error, "bad-load")
