"""Measures of a triangle surface and of fields on it: areas, normals, volume, norms, rigid motions."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from solver_common.arrays import Array, Index, Mask
from solver_common.closed_surfaces import closed_pieces

_MOST_NORMALS = 300  # facet normals along which an extent is measured


def facet_area_vectors(points: Array, triangles: Index) -> Array:
    """(F, 3) area times unit normal of each facet [m^2]."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return 0.5 * np.cross(b - a, c - a)


def facet_areas(points: Array, triangles: Index) -> Array:
    """(F,) area of each facet [m^2]."""
    return np.asarray(np.linalg.norm(facet_area_vectors(points, triangles), axis=1))


def corner_sum(per_corner: Array, triangles: Index, n_nodes: int) -> Array:
    """Sum values given per facet corner at the nodes: (F, 3, ...) -> (N, ...)."""
    shape = per_corner.shape[2:]
    nodes = triangles.T.ravel()
    columns = per_corner.swapaxes(0, 1).reshape(len(nodes), int(np.prod(shape))).T
    sums = [np.bincount(nodes, column, n_nodes) for column in columns]  # np.add.at takes five times as long
    return np.stack(sums, axis=-1).reshape(n_nodes, *shape).astype(np.float64, copy=False)


def nodal_sum(per_facet: Array, triangles: Index, n_nodes: int) -> Array:
    """Spread a third of each facet's value to its three nodes: (F, ...) -> (N, ...)."""
    return corner_sum(np.repeat(per_facet[:, None] / 3.0, 3, axis=1), triangles, n_nodes)


def enclosed_volume(points: Array, triangles: Index) -> float:
    """Exact volume of the closed polyhedron, by the divergence theorem [m^3]; positive with outward facets."""
    return float(enclosed_volumes(points[None], triangles)[0])


def enclosed_volumes(points: Array, triangles: Index) -> Array:
    """(S,) exact volumes of polyhedra (S, N, 3) of the same facets [m^3]."""
    components = np.ascontiguousarray(np.moveaxis(points - points[:, :1], -1, 0))  # (3, S, N)
    corners = np.ascontiguousarray(triangles.T)
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = ([x[:, nodes] for x in components] for nodes in corners)
    parts = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    return np.asarray(parts.sum(axis=1) / 6.0)


def shells(points: Array, triangles: Index) -> Index:
    """(F,) the closed piece of each facet of an oriented surface: 0 the outer one, then the walls of cavities."""
    piece = closed_pieces(triangles)
    volumes = piece_volumes(points, triangles, piece, int(piece.max()) + 1)
    place = np.empty(len(volumes), dtype=np.int64)
    place[np.argsort(-np.sign(volumes), kind="stable")] = np.arange(len(volumes))
    return np.asarray(place[piece])


def piece_volumes(points: Array, triangles: Index, piece: Index, count: int) -> Array:
    """(count,) signed volumes of closed pieces, by the piece of each facet."""
    a, b, c = (points[corner] - points[0] for corner in triangles.T)
    return np.bincount(piece, np.einsum("fi,fi->f", a, np.cross(b, c)), count) / 6.0


def rigid_motions(points: Array, weights: Array) -> Array:
    """(6, N, 3) infinitesimal rigid motions, orthonormal by area; zero where one is a multiple of another."""
    x = points - np.average(points, axis=0, weights=weights)
    turns = np.array([np.cross(axis, x) for axis in np.eye(3)])
    shifts = np.broadcast_to(np.eye(3)[:, None, :], turns.shape) / np.sqrt(weights.sum())
    # about the centroid rotations and translations are orthogonal: only rotations need a Gram matrix
    values, vectors = np.linalg.eigh(np.einsum("ani,n,bni->ab", turns, weights, turns))
    proper = values > 1e-14 * values[-1]
    scale = np.where(proper, 1.0 / np.sqrt(np.where(proper, values, 1.0)), 0.0)
    return np.concatenate([shifts, np.einsum("am,m,ani->mni", vectors, scale, turns)])


def turns(points: Array, displacements: Array, weights: Array) -> Array:
    """(S, 3, 3) R - I, R the rotation of each deformed surface (S, N, 3), finite, by weighted least squares.

    Kabsch (1976, doi 10.1107/S0567739476001873): the polar factor of sum_i w_i y_i x_i^T about the centroids.
    Rodrigues' formula of the rotation vector gives R - I without loss of digits for small rotations; below 1e-12
    rad it is zero.
    """
    from scipy.spatial.transform import Rotation  # slow to load

    x = points - np.average(points, axis=0, weights=weights)
    left, _, right = np.linalg.svd(np.einsum("n,sni,nj->sij", weights, x + displacements, x))
    left[:, :, 2] *= np.linalg.det(left @ right)[:, None]  # no reflection
    vectors = Rotation.from_matrix(left @ right).as_rotvec()
    vectors[np.linalg.norm(vectors, axis=1) < 1e-12] = (
        0.0  # near rounding, where a differential rotation is as good
    )
    angles = np.linalg.norm(vectors, axis=1)[:, None, None]
    axes = np.cross(vectors[:, None, :], -np.eye(3)) / np.where(angles > 0.0, angles, 1.0)
    return np.asarray(np.sin(angles) * axes + 2.0 * np.sin(0.5 * angles) ** 2 * axes @ axes)


def deformations(points: Array, displacements: Array, weights: Array) -> Array:
    """(S, N, 3) displacements less the best-fit rigid motion, in a frame that moves with the body [m].

    The rotation is finite, see `turns`. To first order this is `without_motions`, which then removes the
    rotation's rounding.
    """
    x = points - np.average(points, axis=0, weights=weights)
    back = np.swapaxes(turns(points, displacements, weights), 1, 2)
    moved = displacements - np.average(displacements, axis=1, weights=weights)[:, None]
    found = np.einsum("sij,nj->sni", back, x) + moved + np.einsum("sij,snj->sni", back, moved)
    return without_motions(rigid_motions(points, weights), found, weights)


def rigid_parts(points: Array, displacements: Array, weights: Array) -> Array:
    """(S, N, 3) best-fit rigid motion of displacements (S, N, 3), with a finite rotation [m]."""
    x = points - np.average(points, axis=0, weights=weights)
    shift = np.average(displacements, axis=1, weights=weights)[:, None]
    turned = turns(points, displacements, weights)
    found = shift + np.einsum("sij,nj->sni", turned, x)
    still = ~turned.any(axis=(1, 2))
    tiny = displacements[still]
    found[still] = tiny - without_motions(rigid_motions(points, weights), tiny, weights)
    return np.asarray(found)


def without_motions(motions: Array, displacements: Array, weights: Array) -> Array:
    """(S, N, 3) displacements less their components along orthonormal infinitesimal motions (6, N, 3)."""
    shares = np.tensordot(displacements * weights[:, None], motions, axes=((1, 2), (1, 2)))
    return displacements - np.tensordot(shares, motions, axes=1)


def weighted_norm(values: Array, weights: Array) -> float:
    """sqrt(sum_i w_i |v_i|^2) of (N, 3) values."""
    return float(weighted_norms(values[None], weights)[0])


def weighted_norms(values: Array, weights: Array) -> Array:
    """(S,) `weighted_norm` of each step of (S, N, K) values."""
    return np.sqrt(np.einsum("sni,sni->sn", values, values) @ weights)


def relative_l2(values: Array, reference: Array, weights: Array) -> float:
    """||values - reference|| / ||reference||; NaN where the reference is zero."""
    return float(relative_l2_steps(values[None], reference[None], weights)[0])


def relative_l2_steps(values: Array, reference: Array, weights: Array) -> Array:
    """(S,) `relative_l2` of each step of (S, N, K) fields."""
    return ratio(weighted_norms(values - reference, weights), weighted_norms(reference, weights))


def ratio(part: Array, whole: Array) -> Array:
    """(S,) part / whole, NaN where the whole is zero."""
    return np.divide(part, whole, out=np.full(len(whole), np.nan), where=whole > 0)


def weighted_quantiles(values: Array, weights: Array, quantile: float) -> Array:
    """(S,) weighted quantile of each row (S, N): at least `quantile` of the weight is at or below this value."""
    order = np.argsort(values, axis=1)
    cumulative = np.cumsum(weights[order], axis=1)
    below = cumulative < quantile * cumulative[:, -1:] * (1 - 1e-12)
    position = np.minimum(below.sum(axis=1, keepdims=True), order.shape[1] - 1)
    return np.take_along_axis(values, np.take_along_axis(order, position, axis=1), axis=1)[:, 0]


@dataclass(frozen=True)
class Surface:
    """The undeformed surface with its measures."""

    points: Array
    triangles: Index
    contact: Mask = field(default_factory=lambda: np.zeros(0, dtype=bool))  # (N,) nodes under contact
    contact_force: Array = field(default_factory=lambda: np.zeros((0, 3)))  # (N, 3) at load factor 1
    sags: bool = False  # whether a weight displaces it at load factor 0 too

    @cached_property
    def areas(self) -> Array:
        """(N,) nodal areas A_i [m^2] (eq. 1)."""
        return nodal_sum(facet_areas(self.points, self.triangles), self.triangles, len(self.points))

    @cached_property
    def volume_gradient(self) -> Array:
        """(N, 3) exact gradient g_i of the enclosed volume [m^2]."""
        return nodal_sum(facet_area_vectors(self.points, self.triangles), self.triangles, len(self.points))

    @cached_property
    def normals(self) -> Array:
        """(N, 3) outward unit normals g_i/|g_i|."""
        return self.volume_gradient / np.linalg.norm(self.volume_gradient, axis=1, keepdims=True)

    @cached_property
    def rigid_motions(self) -> Array:
        """(6, N, 3), see `rigid_motions`."""
        return rigid_motions(self.points, self.areas)

    @cached_property
    def smallest_extent(self) -> float:
        """Least extent along normals of facets and the principal axes of inertia [m].

        At most `_MOST_NORMALS` normals are tried. Unlike an edge of the bounding box, it turns with the body.
        """
        vectors = facet_area_vectors(self.points, self.triangles)
        normals = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
        _, first = np.unique(normals.round(6), axis=0, return_index=True)
        some = np.sort(first)[:: 1 + len(first) // _MOST_NORMALS]
        x = self.points - np.average(self.points, axis=0, weights=self.areas)
        _, axes = np.linalg.eigh(np.einsum("n,ni,nj->ij", self.areas, x, x))
        return float(np.ptp(np.vstack([normals[some], axes.T]) @ x.T, axis=1).min())

    @cached_property
    def volume(self) -> float:
        """Enclosed volume [m^3]."""
        return enclosed_volume(self.points, self.triangles)
