"""Galerkin boundary operators of a homogeneous elastic body: V, K, M, D and the surface stiffness S.

On the surface of a body with shear modulus mu = 1 and Poisson's ratio nu, tractions t and displacements u obey

`V t = (1/2 + K) u` and `t = D u + (1/2 + K^T) t`, so that `S = D + (M/2 + K)^T V^-1 (M/2 + K)` gives t's work

(Steinbach, Numerical Approximation Methods for Elliptic Boundary Value Problems, 2008, sections 6.6 and 12.4), with
Kelvin's solution `U = ((3 - 4 nu) I / r + r r / r^3) / (16 pi (1 - nu))` as kernel of V. Displacements are linear
on each facet, tractions constant there, and all is tested with the same functions: S is symmetric as it stands.

With the surface's curl c_k (of components `n x grad`) all else follows from V and Laplace's layers, without another
singular integral (Kupradze 1979; Han, Numer. Math. 68, 1994). With `M_ij = n_j d_i - n_i d_j` and Laplace's
`V_0 = int int 1/r`:

`K = K_0 I + V_0 M / (4 pi) - 2 V M`
`D_ij = delta_ij tr(G) / pi - G_ji / (2 pi) - G_ij / (4 pi) - 4 (M^T V M)_ij`, `G_kl = c_k^T V_0 c_l`

These hold at nu = 1/2 too, where V has the field of normals in its null space: a uniform pressure moves nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg, sparse
from scipy.linalg import blas

from solver_common.arrays import Array, Index
from vdm.boundary.kernels import all_pairs, rules, some_pairs

# Nodes up to which all is in double precision. Single halves the time and the memory of more; what it leaves, 1e-6,
# is less than what quadrature does.
DOUBLE_NODES = 500


@dataclass(frozen=True)
class Facets:
    """F flat facets on N points: what all integrals need of a surface.

    Attributes
    ----------
    points : (N, 3) [m]
    triangles : (F, 3), outward
    areas : (F,) [m^2]
    normals : (F, 3) outward unit normals
    """

    points: Array
    triangles: Index
    areas: Array
    normals: Array

    @classmethod
    def of(cls, points: ArrayLike, triangles: ArrayLike) -> Facets:
        """The facets of a closed surface, whose triangles are outward."""
        x, t = np.ascontiguousarray(points, np.float64), np.ascontiguousarray(triangles, np.int64)
        a, b, c = x[t[:, 0]], x[t[:, 1]], x[t[:, 2]]
        vectors = 0.5 * np.cross(b - a, c - a)
        areas = np.linalg.norm(vectors, axis=1)
        return cls(x, t, areas, vectors / areas[:, None])

    def mesh(self) -> tuple[Array, Index, Array, Array, Array, Array, Array]:
        """What `vdm.boundary.kernels` reads: corners, triangles, normals, areas, centres, radii, how slender."""
        corners = self.points[self.triangles]
        centres = corners.mean(axis=1)
        radii = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
        longest = np.square(corners - np.roll(corners, 1, axis=1)).sum(axis=2).max(axis=1)
        return corners, self.triangles, self.normals, self.areas, centres, radii, longest / (2.0 * self.areas)

    def curls(self) -> Array:
        """(F, 3, 3) `n x grad` of each corner's shape function [1/m]: the opposite edge over twice the area."""
        corners = self.points[self.triangles]
        opposite = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)
        curls: Array = opposite / (2.0 * self.areas[:, None, None])
        return curls


@dataclass(frozen=True)
class Operators:
    """The Galerkin matrices for mu = 1; rows of tractions are facets, those of displacements are nodes.

    Attributes
    ----------
    single : (3F, 3F) V [m^3], symmetric
    jump : (3F, 3N) M/2 + K [m^2]
    hypersingular : (3N, 3N) D [m], symmetric
    """

    single: Array
    jump: Array
    hypersingular: Array


def layers(facets: Facets, nu: float, dtype: type[np.floating[Any]] = np.float64) -> tuple[Array, Array]:
    """(3F, 3F) V of Kelvin's solution for mu = 1 and (F, N) Laplace's K_0, by quadrature over all pairs."""
    n_facets, n_nodes = len(facets.triangles), len(facets.points)
    single = np.empty((3 * n_facets, 3 * n_facets), dtype)
    double = np.zeros((n_facets, n_nodes), dtype)
    of_identity, of_kelvin = kelvin_factors(nu)
    all_pairs(facets.mesh(), rules(), of_identity, of_kelvin, single, double)
    return single, double


def block(facets: Facets, nu: float, rows: ArrayLike, columns: ArrayLike) -> tuple[Array, Array]:
    """Of facets `rows` (m,) with `columns` (n,): V (m, 3, n, 3), and K_0 (m, n, 3) by the latter's corners."""
    first, second = np.ascontiguousarray(rows, np.int64), np.ascontiguousarray(columns, np.int64)
    values = np.empty((len(first), len(second), 9))
    some_pairs(facets.mesh(), first, second, rules(), values)
    of_identity, of_kelvin = kelvin_factors(nu)
    tensor = of_kelvin * values[:, :, [[0, 3, 4], [3, 1, 5], [4, 5, 2]]]
    tensor += of_identity * values[:, :, :3].sum(axis=2)[:, :, None, None] * np.eye(3)
    return tensor.transpose(0, 2, 1, 3), values[:, :, 6:]


def kelvin_factors(nu: float) -> tuple[float, float]:
    """Factors of I/r and of r r / r^3 in Kelvin's solution for mu = 1."""
    share = 1.0 / (16.0 * np.pi * (1.0 - nu))
    return (3.0 - 4.0 * nu) * share, share


def assembled(facets: Facets, nu: float, dtype: type[np.floating[Any]] = np.float64) -> Operators:
    """V, M/2 + K and D from the two layers."""
    single, double = layers(facets, nu, dtype)
    n_facets, n_nodes = len(facets.triangles), len(facets.points)
    of_identity, of_kelvin = kelvin_factors(nu)
    # the trace of V is a multiple of Laplace's single layer
    blocks = single.reshape(n_facets, 3, n_facets, 3)
    laplace = blocks[:, 0, :, 0] + blocks[:, 1, :, 1]
    laplace += blocks[:, 2, :, 2]
    laplace /= 3.0 * of_identity + of_kelvin
    curls = facets.curls().astype(dtype)
    curl = [_gathered(facets, curls[:, :, k]) for k in range(3)]
    turned = _guenter(facets, curls)
    # transposed products with symmetric matrices: rows are nodes
    moved = np.ascontiguousarray(turned.T @ single)
    smooth = [np.asarray(part.T @ laplace) for part in curl]

    both = -4.0 * np.asarray(turned.T @ moved.T)
    hypersingular = both.reshape(n_nodes, 3, n_nodes, 3)
    for k in range(3):
        for m in range(3):
            product = np.asarray(curl[k].T @ smooth[m].T)
            hypersingular[:, m, :, k] -= product / (2.0 * np.pi)
            hypersingular[:, k, :, m] -= product / (4.0 * np.pi)
            if k == m:
                for i in range(3):
                    hypersingular[:, i, :, i] += product / np.pi

    moved *= -2.0
    jump = moved.reshape(n_nodes, 3, n_facets, 3)
    double += _gathered(facets, np.repeat(facets.areas[:, None] / 6.0, 3, axis=1).astype(dtype)).toarray()
    for k in range(3):
        jump[:, k, :, k] += double.T
        # M_ij = -e_ijk c_k
        i, j = (k + 1) % 3, (k + 2) % 3
        jump[:, j, :, i] -= smooth[k] / (4.0 * np.pi)
        jump[:, i, :, j] += smooth[k] / (4.0 * np.pi)
    return Operators(single, moved.T, both)


def surface_stiffness(facets: Facets, nu: float) -> Array:
    """(3N, 3N) symmetric S [m] for mu = 1: nodal forces, the work of the tractions, of displacements.

    At nu = 1/2 a change of volume has no finite stiffness: it is left to a constraint. Here it only must not be
    free, and gets a stiffness of the size of the others.
    """
    dtype = np.float64 if len(facets.points) <= DOUBLE_NODES else np.float32
    operators = assembled(facets, nu, dtype)
    if nu == 0.5:
        # V a = 0 for the forces a of a uniform pressure; S grows by (a . J u)^2, the change of volume
        pressure = (facets.areas[:, None] * facets.normals).reshape(-1)
        pressure *= np.sqrt(np.trace(operators.single) / (len(pressure) * (pressure @ pressure)))
        _add_square(operators.single, pressure.astype(dtype))
    trsm, syrk = blas.get_blas_funcs(("trsm", "syrk"), (operators.single,))
    # symmetric matrices are their own transposes, which are in the order that LAPACK works in place with
    factor = linalg.cholesky(operators.single.T, lower=True, overwrite_a=True, check_finite=False)
    half = trsm(1.0, factor, operators.jump, lower=1, overwrite_b=1)
    work = syrk(1.0, half, beta=1.0, c=operators.hypersingular.T, trans=1, lower=1, overwrite_c=1)
    stiffness = np.tril(work).astype(np.float64)
    stiffness += np.tril(stiffness, -1).T
    return stiffness


def _add_square(matrix: Array, vector: Array) -> None:
    """Add v v^T to a large matrix without another one."""
    for start in range(0, len(vector), 256):
        matrix[start : start + 256] += vector[start : start + 256, None] * vector


def _gathered(facets: Facets, values: Array) -> sparse.csr_array:
    """(F, N) matrix of values (F, 3) at the corners of the facets."""
    rows = np.repeat(np.arange(len(facets.triangles)), 3)
    shape = (len(facets.triangles), len(facets.points))
    return sparse.csr_array(sparse.coo_array((values.ravel(), (rows, facets.triangles.ravel())), shape=shape))


def _guenter(facets: Facets, curls: Array) -> sparse.csr_array:
    """(3F, 3N) M_ij = n_j d_i - n_i d_j = -e_ijk c_k on each facet."""
    n_facets = len(facets.triangles)
    rows, columns, values = [], [], []
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        for row, column, sign in ((i, j, -1.0), (j, i, 1.0)):
            rows.append(np.repeat(3 * np.arange(n_facets) + row, 3))
            columns.append(3 * facets.triangles.ravel() + column)
            values.append(sign * curls[:, :, k].ravel())
    shape = (3 * n_facets, 3 * len(facets.points))
    places = (np.concatenate(rows), np.concatenate(columns))
    return sparse.csr_array(sparse.coo_array((np.concatenate(values), places), shape=shape))
