"""Elastic supports: springs between parts of the surface and a rigid ground (a Robin condition).

The spring force on a point with displacement u is -k (u.n) n, or -k u, per area of the undeformed surface with
the outward normal n. Springs do not turn with the body: at finite strain too the force is linear in u.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from fem_reference.assembly import Pattern
from fem_reference.mesh import TetMesh
from solver_common.arrays import Array, Index
from solver_common.quadrature import facet_quadrature
from solver_common.solution import solver_error

DIRECTIONS = ("normal", "full")


@dataclass(frozen=True)
class ElasticSupport:
    """Springs under some facets.

    Attributes
    ----------
    facets : (F,) which facets of the surface
    stiffness : spring constant per area, for all or (F,) for each facet [Pa/m]
    direction : "normal" resists along the normal, "full" in every direction
    """

    facets: NDArray[np.bool_]
    stiffness: ArrayLike
    direction: str = "normal"


class Springs:
    """All elastic supports of a body, scaled as in `fem_reference.system`: lengths in mean edges, stress in moduli.

    Attributes
    ----------
    facets : (f,) supported facets
    tensors : (f, 3, 3) force per area and displacement
    nodes : supported nodes

    Raises
    ------
    SolverError
        For facets of a wrong shape, a direction that is unknown, or a stiffness that is not positive.
    """

    def __init__(self, mesh: TetMesh, supports: Sequence[ElasticSupport], shear_modulus: float) -> None:
        count = len(mesh.triangles)
        normals = mesh.area_vectors / np.linalg.norm(mesh.area_vectors, axis=1)[:, None]
        tensors = np.zeros((count, 3, 3))
        for support in supports:
            chosen = np.flatnonzero(_checked_facets(support, count))
            stiffness = np.broadcast_to(np.asarray(support.stiffness, dtype=np.float64), count)[chosen]
            if not (np.isfinite(stiffness).all() and (stiffness > 0.0).all()):
                raise _bad_support(
                    f"a spring constant is {stiffness.min()}", "give a positive number of Pa/m"
                )
            n = normals[chosen]
            shape = n[:, :, None] * n[:, None] if support.direction == "normal" else np.eye(3)
            tensors[chosen] += stiffness[:, None, None] * shape
        self.facets = np.flatnonzero(tensors.any(axis=(1, 2)))
        self.tensors = tensors[self.facets] * mesh.mean_edge / shear_modulus
        self.nodes = np.unique(mesh.facet_nodes[self.facets])
        rows, columns, values = self._entries(mesh)
        at = np.arange(3)
        where = [
            np.broadcast_to(a, values.shape).ravel()
            for a in (3 * rows[:, None, None] + at[:, None], 3 * columns[:, None, None] + at)
        ]
        size = 3 * mesh.n_nodes
        self._matrix = csr_array((values.ravel(), (where[0], where[1])), shape=(size, size))

    def forces(self, displacement: Array) -> Array:
        """(..., n_nodes, 3) forces on the body for displacements of that shape."""
        flat = displacement.reshape(-1, self._matrix.shape[0]).T
        return np.asarray(-(self._matrix @ flat).T.reshape(displacement.shape))

    def works(self, displacement: Array) -> Array:
        """(S, S) works of the spring forces at one displacement on another, both (S, nodes, 3) at `nodes`."""
        at = (3 * self.nodes[:, None] + np.arange(3)).ravel()
        flat = displacement.reshape(-1, len(at)).T
        return np.asarray(-flat.T @ (self._matrix[at][:, at] @ flat))

    def add_to(self, blocks: Array, mesh: TetMesh, pattern: Pattern) -> None:
        """Add the stiffness to the (pattern.size, 3, 3) blocks of the body with its nodes of either order."""
        rows, columns, values = self._entries(mesh)
        place = np.asarray(pattern.numbered[rows, columns]).ravel()
        np.add.at(blocks, place, values)

    def rigid_rows(self, mesh: TetMesh) -> tuple[Index, Array]:
        """(k,) supported vertices, and (k, 3, 3) the directions of their support, as rows."""
        corners = mesh.facet_nodes[self.facets][:, :3]
        size = np.linalg.norm(self.tensors, axis=(1, 2))[:, None, None]
        return corners.ravel(), np.repeat(self.tensors / size, 3, axis=0)

    def _entries(self, mesh: TetMesh) -> tuple[Index, Index, Array]:
        """(k,) rows and columns of nodes and their (k, 3, 3) stiffness."""
        points, weights = facet_quadrature()
        shape = mesh.facet_functions(points)
        table = shape.T @ (weights[:, None] * shape)
        area = np.linalg.norm(mesh.area_vectors[self.facets], axis=1) / mesh.mean_edge**2
        nodes = mesh.facet_nodes[self.facets]
        width = nodes.shape[1]
        values = np.einsum("f,ab,fij->fabij", area, table, self.tensors)
        return (
            np.repeat(nodes, width, axis=1).ravel(),
            np.tile(nodes, width).ravel(),
            values.reshape(-1, 3, 3),
        )


def make_springs(mesh: TetMesh, supports: Sequence[ElasticSupport], shear_modulus: float) -> Springs | None:
    """The springs of a body, None where there are no supports."""
    return Springs(mesh, supports, shear_modulus) if supports else None


def _checked_facets(support: ElasticSupport, count: int) -> NDArray[np.bool_]:
    facets = np.asarray(support.facets)
    if facets.shape != (count,) or facets.dtype != bool:
        raise _bad_support(
            f"the facets of an elastic support are an array of {facets.dtype} of shape {facets.shape}",
            f"give a mask of shape ({count},)",
        )
    if not facets.any():
        raise _bad_support("an elastic support has no facet", "choose some, or leave the support out")
    if support.direction not in DIRECTIONS:
        raise _bad_support(
            f"direction {support.direction!r} is unknown", f"use one of {', '.join(DIRECTIONS)}"
        )
    return facets


_bad_support = partial(solver_error, "bad-support")
