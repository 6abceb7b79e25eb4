"""Stokes layer potentials on a triangle surface: the incompressible body seen from its surface alone.

An incompressible elastic body of shear modulus mu obeys u/2 = (1/mu) V t + D u on its surface (Pozrikidis 1992,
Boundary Integral and Singularity Methods, section 2.3), with the tractions t and, r = y - x,

`G = (I / r + r r / r^3) / (8 pi)` (single layer V) and `(3 / (4 pi)) r r (r . n) / r^5` (double layer D).

V of the normal field is zero: a uniform pressure moves nothing, which is Pascal's principle, and its range holds
no change of volume. Collocation at the nodes, displacements and tractions linear on every facet.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from vdm.surface import SurfaceMesh

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# facets nearer than this many of their own longest edges are integrated on nine sub-triangles
NEAR = 2.5
NEAR_SPLIT = 3
# Gauss points in each direction of the map that takes the pole out of a facet with the collocation node
POLE_ORDER = 6


def layer_potentials(surface: SurfaceMesh) -> tuple[Array, Array]:
    """(3N, 3N) V for mu = 1, and (3N, 3N) I/2 - D, whose rows annul a translation exactly.

    The diagonal blocks of the second follow from that; they hold the solid angle of the node too.
    """
    points, triangles, areas = surface.points, surface.triangles, surface.facet_areas
    n_nodes = surface.n_nodes
    corners = points[triangles]
    normals = surface.facet_vectors / areas[:, None]
    centres = corners.mean(axis=1)
    size = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    far = _Rule(surface, *_dunavant())
    near_points, near_weights = _split_rule(NEAR_SPLIT)
    pole_points, pole_weights = _pole_rule()
    near_shares, pole_shares = near_weights[:, None] * near_points, pole_weights[:, None] * pole_points
    near_samples = corners.transpose(2, 0, 1) @ near_points.T
    both = np.zeros((n_nodes, n_nodes, 12))
    for node, point in enumerate(points):
        own = (triangles == node).any(axis=1)
        close = (np.linalg.norm(centres - point, axis=1) < NEAR * size) & ~own
        row = far.integrate(point, own | close)
        facets = np.flatnonzero(close)
        kernel = _kernels(point, near_samples[:, facets], normals[facets].T[:, :, None])
        np.add.at(row, triangles[facets], _to_corners(kernel, areas[facets], near_shares))
        # own facets, the node turned to their first corner; r . n = 0 there: the single layer alone has a share
        facets = np.flatnonzero(own)
        first = np.argmax(triangles[facets] == node, axis=1)
        turned = triangles[facets][np.arange(len(facets))[:, None], (first[:, None] + np.arange(3)) % 3]
        samples = points[turned].transpose(2, 0, 1) @ pole_points.T
        kernel = _kernels(point, samples, normals[facets].T[:, :, None])[:6]
        np.add.at(row[:, :6], turned, _to_corners(kernel, areas[facets], pole_shares))
        both[node] = row
    nodes = np.arange(n_nodes)
    both[nodes, nodes, 6:] = 0.0
    both[nodes, nodes, 6:] = -both[:, :, 6:].sum(axis=1)
    return _as_matrix(both[:, :, :6]), -_as_matrix(both[:, :, 6:])


def _to_corners(kernel: Array, areas: Array, shares: Array) -> Array:
    """(f, 3, s) integrals against the corners' shape functions of kernels (s, f, q) on facets (f,)."""
    integrals: Array = (kernel @ shares) * areas[:, None]
    return integrals.transpose(1, 2, 0)


def mass_matrix(surface: SurfaceMesh) -> sparse.csr_array:
    """(N, N) integrals of products of the linear shape functions [m^2]."""
    local = (np.ones((3, 3)) + np.eye(3)) / 12.0
    values = surface.facet_areas[:, None, None] * local
    rows = np.repeat(surface.triangles, 3, axis=1).ravel()
    columns = np.tile(surface.triangles, (1, 3)).ravel()
    shape = (surface.n_nodes, surface.n_nodes)
    return sparse.csr_array(sparse.coo_array((values.ravel(), (rows, columns)), shape=shape))


class _Rule:
    """One quadrature rule on all facets: kernels at all points, gathered to the nodes by one sparse product."""

    def __init__(self, surface: SurfaceMesh, barycentric: Array, weights: Array) -> None:
        n_facets, n_points = len(surface.triangles), len(weights)
        self.per_facet = n_points
        corners = surface.points[surface.triangles]
        self.samples: Array = np.einsum("qk,fkc->cfq", barycentric, corners).reshape(3, -1)
        normals = surface.facet_vectors / surface.facet_areas[:, None]
        self.normals = np.repeat(normals.T, n_points, axis=1)
        values = surface.facet_areas[:, None, None] * (weights[:, None] * barycentric)
        rows = np.repeat(surface.triangles[:, None, :], n_points, axis=1).ravel()
        columns = np.repeat(np.arange(n_facets * n_points), 3)
        shape = (surface.n_nodes, n_facets * n_points)
        self.gather = sparse.csr_array(sparse.coo_array((values.ravel(), (rows, columns)), shape=shape))

    def integrate(self, point: Array, left_out: Mask) -> Array:
        """(N, 12) six components of either layer, without the facets that are left out."""
        kernel = _kernels(point, self.samples, self.normals)
        kernel[:, np.repeat(left_out, self.per_facet)] = 0.0
        return np.asarray(self.gather @ np.ascontiguousarray(kernel.T))


def _kernels(point: Array, samples: Array, normals: Array) -> Array:
    """(12, ...) components xx, yy, zz, xy, xz, yz of the single and of the double layer at samples (3, ...)."""
    x, y, z = samples - point.reshape(3, *[1] * (samples.ndim - 1))
    square = x * x + y * y + z * z
    inverse = 1.0 / np.sqrt(square)
    single = inverse / (8.0 * np.pi * square)
    double = (0.75 / np.pi) * (x * normals[0] + y * normals[1] + z * normals[2]) * inverse / square**2
    kernel = np.empty((12, *square.shape))
    for k, (a, b) in enumerate(((x, x), (y, y), (z, z), (x, y), (x, z), (y, z))):
        product = a * b
        np.multiply(product, single, out=kernel[k])
        np.multiply(product, double, out=kernel[6 + k])
    kernel[:3] += inverse / (8.0 * np.pi)
    return kernel


def _dunavant() -> tuple[Array, Array]:
    """Barycentric points (7, 3) and weights (7,) of degree 5 (Dunavant 1985), weights summing to 1."""
    a, b = (6.0 - np.sqrt(15.0)) / 21.0, (6.0 + np.sqrt(15.0)) / 21.0
    points = [[1.0 / 3.0] * 3]
    for c in (a, b):
        points += [list(np.roll([1.0 - 2.0 * c, c, c], k)) for k in range(3)]
    weights = [9.0 / 40.0, *[(155.0 - np.sqrt(15.0)) / 1200.0] * 3, *[(155.0 + np.sqrt(15.0)) / 1200.0] * 3]
    return np.array(points), np.array(weights)


def _split_rule(parts: int) -> tuple[Array, Array]:
    """The same rule on parts^2 equal sub-triangles."""
    points, weights = _dunavant()
    corners = []
    for i in range(parts):
        for j in range(parts - i):
            corners.append([(i, j), (i + 1, j), (i, j + 1)])
            if i + j < parts - 1:
                corners.append([(i + 1, j), (i + 1, j + 1), (i, j + 1)])
    grid = np.array(corners, dtype=np.float64) / parts
    barycentric = np.concatenate([1.0 - grid.sum(axis=2, keepdims=True), grid], axis=2)
    return (points @ barycentric).reshape(-1, 3), np.tile(weights / parts**2, len(corners))


def _pole_rule() -> tuple[Array, Array]:
    """Gauss points collapsed onto the first corner (Duffy 1982): takes a 1/r pole out of the integrand there."""
    x, w = np.polynomial.legendre.leggauss(POLE_ORDER)
    x, w = 0.5 * (x + 1.0), 0.5 * w
    u, v = np.meshgrid(x, x, indexing="ij")
    weights = 2.0 * np.outer(w, w) * u
    barycentric = np.stack([1.0 - u, u * (1.0 - v), u * v], axis=2).reshape(-1, 3)
    return barycentric, weights.ravel()


def _as_matrix(components: Array) -> Array:
    """(3N, 3N) of (N, N, 6) symmetric blocks."""
    n = len(components)
    blocks = components[:, :, [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(n, n, 3, 3)
    return blocks.transpose(0, 2, 1, 3).reshape(3 * n, 3 * n)
