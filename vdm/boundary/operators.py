"""Galerkin boundary operators of a homogeneous elastic body, and the surface stiffness S that they make.

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

In S all products with V cancel but the one with its inverse. What is left is V, and products of scalar matrices:

`S = C + B^T V^-1 B`, `B_ij = delta_ij L - e_ijk V_0 c_k / (4 pi)`, `L = M/2 + K_0`
`C_ij = G_ji / (2 pi) - G_ij / (4 pi) - 2 e_ijk (c_k^T L - L^T c_k)`

These hold at nu = 1/2 too, where V has the field of normals in its null space: a uniform pressure moves nothing.
Of 2,000 nodes the factor of V and the products after it, 234 N^3 operations, take three quarters of the time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg, sparse
from scipy.linalg import blas, lapack

from solver_common.arrays import Array, Index
from vdm.boundary.kernels import add_square, all_pairs, interleave, mirror, rules
from vdm.boundary.quadrature import three_points
from vdm.boundary.refinement import (
    smooth_displacements,
    solved,
    take_over,
    wide_product,
    wide_transposed_product,
)

# Nodes up to which all is in double precision. Single halves the time and the memory of more; what it leaves in
# smooth displacements is taken out (`vdm.boundary.refinement`).
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
    single : (3F, 3F) V [m^3], symmetric, on and below its diagonal
    moved : (3F, 3N) B [m^2]
    rest : (3N, 3N) C [m], symmetric
    """

    single: Array
    moved: Array
    rest: Array


def layers(
    facets: Facets, nu: float, dtype: type[np.floating[Any]] = np.float64
) -> tuple[Array, Array, Array]:
    """(3F, 3F) V of Kelvin's solution for mu = 1, (F, F) V_0, (F, N) Laplace's K_0: quadrature over all pairs.

    V is filled on and below its diagonal only.
    """
    n_facets, n_nodes = len(facets.triangles), len(facets.points)
    single = np.empty((3 * n_facets, 3 * n_facets), dtype)
    laplace = np.empty((n_facets, n_facets), dtype)
    double = np.zeros((n_facets, n_nodes), dtype)
    corners = facets.points[facets.triangles]
    points = np.ascontiguousarray(np.einsum("ka,fac->kcf", three_points()[0], corners))
    of_identity, of_kelvin = kelvin_factors(nu)
    all_pairs(facets.mesh(), points, rules(), of_identity, of_kelvin, single, laplace, double)
    mirror(laplace, laplace)
    return single, laplace, double


def kelvin_factors(nu: float) -> tuple[float, float]:
    """Factors of I/r and of r r / r^3 in Kelvin's solution for mu = 1."""
    share = 1.0 / (16.0 * np.pi * (1.0 - nu))
    return (3.0 - 4.0 * nu) * share, share


def assembled(facets: Facets, nu: float, dtype: type[np.floating[Any]] = np.float64) -> Operators:
    """V, B and C from the layers."""
    single, laplace, double = layers(facets, nu, dtype)
    n_facets, n_nodes = double.shape
    double += _gathered(facets, np.repeat(facets.areas[:, None] / 6.0, 3, axis=1).astype(dtype)).toarray()
    curls = facets.curls().astype(dtype)
    curl = [_gathered(facets, curls[:, :, k]) for k in range(3)]
    # products with a symmetric matrix, whose transposes have the rows together
    smooth = tuple(np.ascontiguousarray((part.T @ laplace).T) for part in curl)
    del laplace
    moved = np.empty((n_facets, 3, n_nodes, 3), dtype)
    interleave(double, smooth, moved)
    rest = np.zeros((n_nodes, 3, n_nodes, 3), dtype)
    for i in range(3):
        for j in range(i + 1):
            product = np.asarray(curl[j].T @ smooth[i])
            rest[:, i, :, j] += product / (2.0 * np.pi)
            rest[:, j, :, i] -= product / (4.0 * np.pi)
            if i != j:
                rest[:, j, :, i] += product.T / (2.0 * np.pi)
                rest[:, i, :, j] -= product.T / (4.0 * np.pi)
        turned = np.asarray(curl[i].T @ double)
        turned = 2.0 * (turned - turned.T)
        rest[:, (i + 1) % 3, :, (i + 2) % 3] -= turned
        rest[:, (i + 2) % 3, :, (i + 1) % 3] += turned
    return Operators(single, moved.reshape(3 * n_facets, -1), rest.reshape(3 * n_nodes, -1))


def precision(n_nodes: int) -> type[np.floating[Any]]:
    """In which the operators of a surface are assembled."""
    return np.float64 if n_nodes <= DOUBLE_NODES else np.float32


def compile_for(n_nodes: int) -> None:
    """Compile the loops that so many nodes need, or read them from the disk: seconds at first, then nothing."""
    corners = np.vstack([np.zeros(3), np.eye(3)])
    surface_stiffness(
        Facets.of(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]), 0.5, precision(n_nodes)
    )


def surface_stiffness(facets: Facets, nu: float, dtype: type[np.floating[Any]] | None = None) -> Array:
    """(3N, 3N) symmetric S [m] for mu = 1: nodal forces, the work of the tractions, of displacements.

    The operators are of the `precision` of as many nodes where no dtype is given.

    At nu = 1/2 a change of volume has no finite stiffness: it is left to a constraint. Here it only must not be
    free, and gets a stiffness of the size of the others.
    """
    dtype = dtype or precision(len(facets.points))
    operators = assembled(facets, nu, dtype)
    if nu == 0.5:
        _stiffen(facets, operators)
    single, moved, rest = operators.single, operators.moved, operators.rest
    refined = dtype is np.float32
    if refined:  # the factor takes the part below the diagonal
        mirror(single, single)
        diagonal = np.diagonal(single).copy()
    # all in place and of one triangle only; rows are columns to LAPACK
    potrf, potrs = lapack.get_lapack_funcs(("potrf", "potrs"), (single,))  # type: ignore[misc]  # the stubs know one
    trsm, syrk = blas.get_blas_funcs(("trsm", "syrk"), (single,))
    factor, failed = potrf(single.T, lower=0, clean=0, overwrite_a=1)
    if failed:
        raise linalg.LinAlgError("the single layer is not positive definite")
    if refined:
        basis = smooth_displacements(facets.points)
        solve = partial(potrs, factor, lower=0)
        tractions = solved(solve, single, diagonal, wide_product(moved, basis))
        forces = wide_product(rest, basis) + wide_transposed_product(moved, tractions)
    half = trsm(1.0, factor, moved.T, side=1, lower=0, overwrite_b=1)
    work = syrk(1.0, half, beta=1.0, c=rest.T, lower=0, overwrite_c=1)
    stiffness = np.empty(work.shape)
    mirror(work.T, stiffness)
    if refined:
        take_over(stiffness, basis, forces)
    return stiffness


def _stiffen(facets: Facets, operators: Operators) -> None:
    """Let S grow by (a . J u)^2, the change of volume; V a = 0 for the forces a of a uniform pressure.

    V + a a^T does it; with b = M^T a, B grows by 2 a b^T and C by -4 b b^T.
    """
    pressure = facets.areas[:, None] * facets.normals
    pressure *= np.sqrt(np.trace(operators.single) / pressure.size) / np.linalg.norm(pressure)
    along = np.zeros_like(facets.points)
    np.add.at(along, facets.triangles, np.cross(pressure[:, None], facets.curls()))
    pushes, along = (part.reshape(-1).astype(operators.single.dtype) for part in (pressure, along))
    add_square(operators.single, pushes)
    ger = blas.get_blas_funcs("ger", (operators.single,))
    ger(2.0, along, pushes, a=operators.moved.T, overwrite_a=1)
    ger(-4.0, along, along, a=operators.rest.T, overwrite_a=1)


def _gathered(facets: Facets, values: Array) -> sparse.csr_array:
    """(F, N) matrix of values (F, 3) at the corners of the facets."""
    rows = np.repeat(np.arange(len(facets.triangles)), 3)
    shape = (len(facets.triangles), len(facets.points))
    return sparse.csr_array(sparse.coo_array((values.ravel(), (rows, facets.triangles.ravel())), shape=shape))
