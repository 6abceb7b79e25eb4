"""A deformed surface: current areas, area vectors and the exact volume of the polyhedron."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from scipy import sparse

from solver_common.arrays import Array, Index
from vdm.surface import SurfaceMesh, cross, lengths


class DeformableSurface:
    """Evaluates displaced copies of a surface; holds the data that do not depend on the displacement."""

    def __init__(self, surface: SurfaceMesh) -> None:
        self.surface = surface
        # about the centroid: a body far from the origin then loses no digits of volume
        self.origin: Array = surface.points.mean(axis=0)
        self.rest: Array = surface.points - self.origin
        # (N, 3) a_i X_i about the centroid; they sum to zero, so that positions need no centring
        areas = surface.nodal_areas
        self.levers: Array = areas[:, None] * (surface.points - areas @ surface.points / areas.sum())
        self.corners = np.ascontiguousarray(surface.triangles.T)
        n_facets = len(surface.triangles)
        facets = np.repeat(np.arange(n_facets), 3)
        thirds = np.full(3 * n_facets, 1.0 / 3.0)
        self.gather = sparse.csr_array(
            sparse.coo_array((thirds, (surface.triangles.ravel(), facets)), shape=(surface.n_nodes, n_facets))
        )

    @classmethod
    def together(cls, bodies: Sequence[DeformableSurface]) -> DeformableSurface:
        """Several surfaces in a row, each about its own centroid: `origin` is (N, 3), without a `surface`."""
        joint = cls.__new__(cls)
        sizes = [len(body.rest) for body in bodies]
        before = np.cumsum(sizes) - sizes
        joint.origin = np.repeat([body.origin for body in bodies], sizes, axis=0)
        joint.rest = np.concatenate([body.rest for body in bodies])
        joint.levers = np.concatenate([body.levers for body in bodies])
        joint.corners = np.concatenate(
            [body.corners + first for body, first in zip(bodies, before, strict=True)], axis=1
        )
        joint.gather = sparse.csr_array(sparse.block_diag([body.gather for body in bodies]))
        return joint

    def at(self, displacement: Array, rotation: Array | None = None) -> DeformedSurface:
        """The surface after a displacement (N, 3) [m]; `rotation`, if known, as in `DeformedSurface`."""
        return DeformedSurface(self, self.rest + displacement, rotation)


class DeformedSurface:
    """Positions (N, 3) [m] about the rest centroid, and what follows from them."""

    def __init__(self, body: DeformableSurface, positions: Array, rotation: Array | None = None) -> None:
        self.body = body
        self._rotation = rotation
        self.positions = positions

    @cached_property
    def _corners(self) -> Array:
        """(3, 3, F): with components first, plain products are several times faster than np.cross."""
        return np.take(np.ascontiguousarray(self.positions.T), self.body.corners, axis=1)

    @cached_property
    def facet_vectors(self) -> Array:
        """(3, F) normals times areas [m^2]."""
        a = self._corners[:, 0]
        (px, py, pz), (qx, qy, qz) = self._corners[:, 1] - a, self._corners[:, 2] - a
        return 0.5 * np.stack([py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx])

    @cached_property
    def volume(self) -> float:
        """Volume of the polyhedron [m^3]."""
        return float(np.vdot(self._corners[:, 0], self.facet_vectors)) / 3.0

    def volumes(self, first: Index) -> Array:
        """(m,) volumes [m^3] of bodies that lie one after another; body b has the facets from first[b] on."""
        each = np.einsum("cf,cf->f", self._corners[:, 0], self.facet_vectors)
        return np.asarray(np.add.reduceat(each, first)) / 3.0

    @cached_property
    def area_vectors(self) -> Array:
        """(N, 3) g_i [m^2], the exact gradient of `volume`."""
        return np.asarray(self.body.gather @ np.ascontiguousarray(self.facet_vectors.T))

    @cached_property
    def nodal_areas(self) -> Array:
        """(N,) A_i [m^2] of the deformed facets (1)."""
        return np.asarray(
            self.body.gather @ np.sqrt(np.einsum("cf,cf->f", self.facet_vectors, self.facet_vectors))
        )

    @cached_property
    def rotation(self) -> Array:
        """(3, 3) Q that minimises `sum a_i |x_i - X_i Q|^2`; positions are rows, about their centroids.

        (N, 3, 3) for a body in parts: Q of each node's part.
        """
        return (
            best_rotation(self.body.levers.T @ self.positions) if self._rotation is None else self._rotation
        )


def best_rotation(moment: Array) -> Array:
    """Q (..., 3, 3) that minimises sum w |after - before Q|^2, from the moment sum w before^T after (rows)."""
    left, _, right = np.linalg.svd(moment)
    sign = np.where(np.linalg.det(left @ right) < 0.0, -1.0, 1.0)
    left[..., :, 2] *= sign[..., None]
    rotation: Array = left @ right
    return rotation


def follow(force: Array, rest_vectors: Array, state: DeformedSurface) -> Array:
    """Nodal forces (N, 3) that turn with the body and their nodes, scaled by |g| / |g0|.

    The body's best-fit rotation acts first, then the least rotation that takes g0, so rotated, to g. A body that
    only rotates thus takes its forces along. A force -p g0 becomes -p g exactly. A force at a patch's rim keeps
    its angle to the normal.
    """
    turned = np.zeros_like(force)
    loaded = np.flatnonzero(force.any(axis=1))
    if not len(loaded):
        return turned
    vectors, rest_vectors = state.area_vectors[loaded], rest_vectors[loaded]
    rest_size, size = lengths(rest_vectors)[:, None], lengths(vectors)[:, None]
    turn = state.rotation if state.rotation.ndim == 2 else state.rotation[loaded]
    along = "ni,ij->nj" if turn.ndim == 2 else "ni,nij->nj"
    f, before = (np.einsum(along, rows, turn) for rows in (force[loaded], rest_vectors / rest_size))
    after = vectors / size
    axis = cross(before, after)
    cosine = np.einsum("ic,ic->i", before, after)[:, None]
    once = cross(axis, f)
    # a half turn has no least rotation; such a node is far outside the range of the model
    least = f + once + cross(axis, once) / np.maximum(1.0 + cosine, 1e-12)
    turned[loaded] = least * (size / rest_size)
    return turned
