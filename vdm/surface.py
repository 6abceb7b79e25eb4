"""A closed, oriented triangle surface: areas, volumes, normals, edges and cotangent weights (equations 1-4)."""

from __future__ import annotations

from functools import cached_property
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from solver_common.arrays import Array, Index, Mask
from solver_common.closed_surfaces import closed_pieces, solid_angles

# A facet whose height is below this share of its longest edge has no usable normal in double precision.
FLAT_FACET = 1e-12
# A node whose area vector is below this share of its scalar area (a knife edge) has no outward normal.
KNIFE_EDGE = 1e-6


class SurfaceError(ValueError):
    """A surface that cannot bound a fluid; the message says what is wrong and what to do."""


class SurfaceMesh:
    """N nodes and F triangles that bound one connected volume, which may have cavities.

    Parameters
    ----------
    points : (N, 3) coordinates [m]
    triangles : (F, 3) indices into `points`, counter-clockwise seen from the empty side; or flat as in
        `pyvista.PolyData.faces`, with a 3 before each
    merge : whether points at exactly the same place become one, in order of first appearance; STL readers may
        give each facet its own corners

    Raises
    ------
    SurfaceError
        open, non-manifold, inconsistently oriented, inverted, degenerate or disconnected surfaces, and nodes
        that no facet uses.
    """

    def __init__(self, points: ArrayLike, triangles: ArrayLike, *, merge: bool = False) -> None:
        self.points: Array = np.array(points, dtype=np.float64, order="C")
        self.triangles: Index = _triangle_array(triangles)
        _check_arrays(self.points, self.triangles)
        if merge:
            self.points, self.triangles = _merged(self.points, self.triangles)
        self.n_nodes = len(self.points)

        corners = self._corners()
        vectors = facet_vectors(*corners)
        self.facet_areas: Array = lengths(vectors)
        _check_facets(corners, self.facet_areas)
        self.edges: NDArray[np.int32]
        self.facet_edges: NDArray[np.int32]
        try:
            self.edges, self.facet_edges = _edges(self.triangles, self.n_nodes)
        except SurfaceError as error:
            raise _with_duplicates(error, self.points) from None

        # V = (1/6) sum of x0 . (x1 x x2), about the centroid: no digits are lost far from the origin
        centred = corners[0] - self.points.mean(axis=0)
        self.volume = float(np.einsum("fi,fi->", centred, vectors)) / 3.0
        if self.volume <= 0.0:
            raise SurfaceError(
                f"the surface is inverted (volume {self.volume:.3g} m^3); reverse each triangle"
            )
        # (F,) the closed piece of each facet: 0 the outer one, 1 to k the walls of cavities
        self.shells: Index = _shells(self.points, self.triangles, centred, vectors)
        self.area = float(self.facet_areas.sum())
        # (N, 3) g_i = (1/3) sum of A_f n_f [m^2], the exact gradient of the polyhedron's volume
        self.area_vectors: Array = np.stack([self._to_nodes(part) for part in vectors.T], axis=1) / 3.0

    def _corners(self) -> tuple[Array, Array, Array]:
        """(F, 3) coordinates of the first, second and third corner of each facet."""
        a, b, c = (np.take(self.points, corner, axis=0) for corner in self.triangles.T)
        return a, b, c

    @property
    def facet_vectors(self) -> Array:
        """(F, 3) facet normal times facet area [m^2]; computed at each call, as only the set-up needs it."""
        return facet_vectors(*self._corners())

    @cached_property
    def nodal_areas(self) -> Array:
        """(N,) A_i [m^2]: a third of every incident facet's area (equation 1)."""
        return self._to_nodes(self.facet_areas) / 3.0

    @cached_property
    def nodal_volumes(self) -> Array:
        """(N,) V_i = A_i V / A [m^3] (equation 3)."""
        return self.nodal_areas * (self.volume / self.area)

    @cached_property
    def normals(self) -> Array:
        """(N, 3) outward unit normals n_i = g_i / |g_i|.

        Raises
        ------
        SurfaceError
            where the facets of a node cancel, so that it has no outward direction.
        """
        length = self.vector_areas
        bad = np.flatnonzero(length < KNIFE_EDGE * self.nodal_areas)
        if bad.size:
            raise SurfaceError(
                f"node {bad[0]} has no outward normal (its facets fold onto each other); remesh around it"
            )
        normals: Array = self.area_vectors / length[:, None]
        return normals

    @cached_property
    def cavity_vectors(self) -> Array:
        """(N, 3, k) gradient of the volume of each of k cavities, minus the area vectors of its wall [m^2]."""
        found = np.zeros((self.n_nodes, 3, int(self.shells.max())))
        vectors = self.facet_vectors
        for k in range(found.shape[2]):
            wall = np.where(self.shells == k + 1, vectors.T, 0.0)
            found[:, :, k] = np.stack([self._to_nodes(part) for part in wall], axis=1) / -3.0
        return found

    @cached_property
    def vector_areas(self) -> Array:
        """(N,) a_i = |g_i| <= A_i [m^2]."""
        return lengths(self.area_vectors)

    @property
    def raw_cotangent_weights(self) -> Array:
        """(E,) (cot a + cot b) / 2 of the two angles opposite each edge; negative where their sum exceeds pi.

        Computed at each call; only the clamped ones are kept.
        """
        a, b, c = self._corners()
        sides = b - a, c - b, a - c
        weights = np.zeros(len(self.edges))
        for k in range(3):
            # from corner k to the next one, and from the previous one to corner k
            cotangent = -np.einsum("fi,fi->f", sides[k], sides[k - 1]) / (2.0 * self.facet_areas)
            # facet_edges[:, k] joins corners k and k + 1, so the edge opposite corner k is number k + 1
            weights += np.bincount(self.facet_edges[:, (k + 1) % 3], 0.5 * cotangent, len(self.edges))
        return weights

    @property
    def cotangent_weights(self) -> Array:
        """(E,) cotangent weights with the negative ones set to zero, which keeps every operator semi-definite."""
        return self._clamped_weights[0]

    @property
    def clamped_edges(self) -> int:
        """How many edges have a negative cotangent weight, set to zero in `cotangent_weights`."""
        return self._clamped_weights[1]

    @cached_property
    def _clamped_weights(self) -> tuple[Array, int]:
        weights = self.raw_cotangent_weights
        negative = weights < 0.0
        weights[negative] = 0.0
        return weights, int(np.count_nonzero(negative))

    @cached_property
    def genus(self) -> int:
        """Number of handles: 0 for a ball, 1 for a torus."""
        return (2 - (self.n_nodes - len(self.edges) + len(self.triangles))) // 2

    @cached_property
    def equivalent_radius(self) -> float:
        """R = 3 V / A [m], the radius of a ball."""
        return 3.0 * self.volume / self.area

    def laplacian(self, weights: Array) -> sparse.csr_array:
        """(N, N) graph Laplacian of (E,) edge weights: row i is sum_j w_ij (x_i - x_j)."""
        # 32 bits: half the index memory, and the factor's library takes them without a copy
        i, j = np.ascontiguousarray(self.edges.T)
        diagonal = np.bincount(i, weights, self.n_nodes) + np.bincount(j, weights, self.n_nodes)
        nodes = np.arange(self.n_nodes, dtype=np.int32)
        rows, columns = np.concatenate([i, j, nodes]), np.concatenate([j, i, nodes])
        values = np.concatenate([-weights, -weights, diagonal])
        return sparse.csr_array((values, (rows, columns)), shape=(self.n_nodes, self.n_nodes))

    def _to_nodes(self, facet_values: Array) -> Array:
        sums = np.bincount(self.triangles.ravel(), np.repeat(facet_values, 3), self.n_nodes)
        return np.asarray(sums, dtype=np.float64)


def rigid_motions(surface: SurfaceMesh, nodes: Mask) -> Array:
    """(n, 3, 6) at `nodes` (N,): unit translations, and rotations about the centroid over the body's radius."""
    return motions_of((surface.points[nodes] - surface.points.mean(axis=0)) / surface.equivalent_radius)


def motions_of(arms: Array) -> Array:
    """(n, 3, 6) unit translations, and unit rotations about the origin of `arms` (n, 3)."""
    motions = np.empty((len(arms), 3, 6))
    motions[:, :, :3] = np.eye(3)
    # column k is e_k x arm
    motions[:, :, 3:] = np.cross(np.eye(3), arms[:, None]).transpose(0, 2, 1)
    return motions


def rigid_basis(surface: SurfaceMesh) -> Array:
    """(3N, 6) orthonormal basis of the infinitesimal rigid motions."""
    motions = rigid_motions(surface, np.ones(surface.n_nodes, np.bool_))
    basis: Array = np.linalg.qr(motions.reshape(-1, 6))[0]
    return basis


def _triangle_array(triangles: ArrayLike) -> Index:
    array = np.asarray(triangles)
    if array.dtype.kind not in "iu":
        raise SurfaceError(f"triangles must be integers, not {array.dtype}; pass node indices")
    if array.ndim == 1 and array.size and array.size % 4 == 0:
        array = array.reshape(-1, 4)
        if not (array[:, 0] == 3).all():
            raise SurfaceError("a flat array of faces must have a 3 before each triangle; cut polygons first")
        array = array[:, 1:]
    return np.ascontiguousarray(array, dtype=np.int64)


def _merged(points: Array, triangles: Index) -> tuple[Array, Index]:
    """One node for each place, in the order of first appearance."""
    _, first, place = np.unique(points, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    number = np.empty_like(order)
    number[order] = np.arange(len(order))
    return points[first[order]], np.ascontiguousarray(number[place.ravel()][triangles])


def _with_duplicates(error: SurfaceError, points: Array) -> SurfaceError:
    """The same error, with a hint where points share their place: that may be its only cause."""
    _, first, count = np.unique(points, axis=0, return_index=True, return_counts=True)
    extra = len(points) - len(count)
    if not extra:
        return error
    example = int(first[count > 1].min())
    return SurfaceError(
        f"{error}; {extra} points stand where another one stands (first: {example}): merge them, by merge=True"
    )


def _check_arrays(points: Array, triangles: Index) -> None:
    if points.ndim != 2 or points.shape[1] != 3:
        raise SurfaceError(f"points must have shape (N, 3), not {points.shape}")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or len(triangles) < 4:
        raise SurfaceError(f"triangles must have shape (F, 3) with F >= 4, not {triangles.shape}")
    if not np.isfinite(points).all():
        raise SurfaceError("points contain nan or inf; check the mesh file")
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise SurfaceError(f"triangles refer to nodes outside 0..{len(points) - 1}")
    orphans = np.flatnonzero(np.bincount(triangles.ravel(), minlength=len(points)) == 0)
    if orphans.size:
        raise SurfaceError(f"{orphans.size} nodes belong to no facet (first: {orphans[0]}); remove them")


def cross(u: Array, v: Array) -> Array:
    """(n, 3) u x v, by components: several times faster than np.cross."""
    (ux, uy, uz), (vx, vy, vz) = u.T, v.T
    return np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx], axis=1)


def facet_vectors(a: Array, b: Array, c: Array) -> Array:
    """(F, 3) normal times area of facets, by their corners (F, 3): half of (b - a) x (c - a)."""
    return 0.5 * cross(b - a, c - a)


def lengths(vectors: Array) -> Array:
    """(n,) lengths of vectors (n, 3)."""
    return np.asarray(np.sqrt(np.einsum("nc,nc->n", vectors, vectors)))


def _check_facets(corners: tuple[Array, Array, Array], areas: Array) -> None:
    a, b, c = corners
    longest = np.maximum(np.maximum(lengths(b - a), lengths(c - b)), lengths(a - c))
    flat = np.flatnonzero(2.0 * areas <= FLAT_FACET * longest**2)
    if flat.size:
        raise SurfaceError(f"{flat.size} facets have no area (first: {flat[0]}); clean or remesh the surface")


def _edges(triangles: Index, n_nodes: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """(E, 2) edges with the smaller node first, in ascending order, and (F, 3) the edges of each facet.

    Edge k of a facet starts at its corner k. On a closed, oriented manifold each edge is a pair of halves: one
    rises to the larger node, the other falls to the smaller one.
    """
    start, end = (c.ravel().astype(np.int32) for c in (triangles, np.roll(triangles, -1, axis=1)))
    rising, falling = (np.flatnonzero(way).astype(np.int32) for way in (start < end, start > end))
    shape = (n_nodes, n_nodes)
    # counting sort, row by row; duplicate halves would be added into one entry
    up = sparse.csr_array((rising, (start[rising], end[rising])), shape=shape)
    down = sparse.csr_array((falling, (end[falling], start[falling])), shape=shape)
    if not (
        up.nnz == len(rising)
        and down.nnz == len(falling)
        and np.array_equal(up.indptr, down.indptr)
        and np.array_equal(up.indices, down.indices)
    ):
        _refuse_edges(start, end, n_nodes)
    opposite = np.empty_like(start)
    opposite[up.data], opposite[down.data] = down.data, up.data
    _check_fans(triangles, opposite, n_nodes)
    numbers = np.arange(up.nnz, dtype=np.int32)
    facet_edges = np.empty_like(start)
    facet_edges[up.data], facet_edges[down.data] = numbers, numbers
    nodes = np.arange(n_nodes, dtype=np.int32)
    return np.stack([np.repeat(nodes, np.diff(up.indptr)), up.indices], axis=1), facet_edges.reshape(-1, 3)


def _shells(points: Array, triangles: Index, corners: Array, vectors: Array) -> Index:
    """(F,) the closed piece of each facet: 0 the outer one, the others walls of cavities within it.

    `corners` (F, 3) is each facet's first corner; `vectors` (F, 3) its normal times its area.

    Raises
    ------
    SurfaceError
        a piece that is not within the outer one alone, or not oriented into its cavity.
    """
    piece = closed_pieces(triangles)
    count = int(piece.max()) + 1
    if count == 1:
        return piece
    volumes = np.bincount(piece, np.einsum("fi,fi->f", corners, vectors), count)
    outer = int(np.argmax(volumes))
    for k in np.flatnonzero(np.arange(count) != outer):
        place = points[triangles[np.argmax(piece == k), :1]]
        if volumes[k] > 0.0 or np.round(solid_angles(place, points, triangles[piece != k]))[0] != 1.0:
            raise SurfaceError(
                f"the surface has {count} components that do not bound one body; keep one, or turn the facets of "
                "cavities towards their inside"
            )
    return np.asarray(np.where(piece == outer, 0, piece + (piece < outer)))


def _refuse_edges(start: NDArray[np.int32], end: NDArray[np.int32], n_nodes: int) -> NoReturn:
    """Raise an error that describes the first half edge without a counterpart."""
    keys = np.minimum(start, end) * np.int64(n_nodes) + np.maximum(start, end)
    unique, inverse, use = np.unique(keys, return_inverse=True, return_counts=True)
    balance = np.bincount(inverse, np.where(start < end, 1.0, -1.0))

    def first(bad: NDArray[np.bool_]) -> str:
        i, j = divmod(int(unique[bad][0]), n_nodes)
        return f"{i}-{j}"

    if np.any(use == 1):
        raise SurfaceError(
            f"the surface is open: {np.count_nonzero(use == 1)} edges have one facet (first: nodes "
            f"{first(use == 1)}); close the holes"
        )
    if np.any(use > 2):
        raise SurfaceError(
            f"the surface is not manifold: more than two facets meet at edge {first(use > 2)}; "
            "remove duplicate or inner facets"
        )
    raise SurfaceError(
        f"neighbouring facets are oriented against each other at edge {first(balance != 0.0)}; orient all outward"
    )


def _check_fans(triangles: Index, opposite: NDArray[np.int32], n_nodes: int) -> None:
    """Check that every node has a single fan of facets: a walk round it from one corner must pass them all.

    `opposite` (3F,): the other half of the half edge that starts at each corner.
    """
    # the half edge that ends at a corner starts there as seen from the next facet
    around = np.roll(opposite.reshape(-1, 3), 1, axis=1).ravel()
    nodes = triangles.ravel()
    first = np.empty(n_nodes, dtype=np.int32)
    first[nodes] = np.arange(len(nodes), dtype=np.int32)
    unseen = np.bincount(nodes) - 1
    walking, here = np.arange(n_nodes), around[first]
    while walking.size:
        on = here != first[walking]
        walking, here = walking[on], around[here[on]]
        unseen[walking] -= 1
    pinched = np.count_nonzero(unseen)
    if pinched:
        raise SurfaceError(
            f"the surface touches itself at {pinched} nodes (two fans of facets share a node); split them"
        )
