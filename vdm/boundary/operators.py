"""Galerkin boundary operators of a homogeneous elastic body, and the surface stiffness S made of them.

On the surface of a body with shear modulus mu = 1 and Poisson's ratio nu, tractions t and displacements u obey

`V t = (1/2 + K) u` and `t = D u + (1/2 + K^T) t`, so that `S = D + (M/2 + K)^T V^-1 (M/2 + K)` gives t's work

(Steinbach, Numerical Approximation Methods for Elliptic Boundary Value Problems, 2008, sections 6.6 and 12.4).
The kernel of V is Kelvin's solution `U = ((3 - 4 nu) I / r + r r / r^3) / (16 pi (1 - nu))`. Displacements are
linear on each facet. Tractions are constant on one facet or on a pair (`vdm.boundary.tractions`). The test
functions are the same, so that S is symmetric.

With the surface's curl c_k (components of `n x grad`) K and D follow from V and Laplace's layers, without another
singular integral (Kupradze 1979; Han, Numer. Math. 68, 1994). With `M_ij = n_j d_i - n_i d_j` and Laplace's
`V_0 = int int 1/r`:

`K = K_0 I + V_0 M / (4 pi) - 2 V M`
`D_ij = delta_ij tr(G) / pi - G_ji / (2 pi) - G_ij / (4 pi) - 4 (M^T V M)_ij`, `G_kl = c_k^T V_0 c_l`

These hold at nu = 1/2 too, where the field of normals is in the null space of V: a uniform pressure moves
nothing. With P tractions and N nodes, the factor of V and the products after it take half of the time:
`9 P^3 + 27 P^2 N + 27 P N^2` operations.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg, sparse
from scipy.linalg import blas, lapack

from solver_common.arrays import Array, Index
from solver_common.closed_surfaces import closed_pieces
from vdm.boundary.coarsening import coarsened
from vdm.boundary.kernels import (
    add_layers,
    add_own_transposed,
    add_transposed,
    all_pairs,
    mirror,
    rules,
)
from vdm.boundary.quadrature import three_points
from vdm.boundary.refinement import (
    smooth_displacements,
    solved,
    take_over,
    wide_product,
    wide_transposed_product,
)
from vdm.boundary.rims import Rims
from vdm.surface import SurfaceMesh

# Largest number of nodes for double precision and one traction a facet. Larger surfaces use single precision, which
# halves time and memory; `vdm.boundary.refinement` corrects the smooth displacements.
DOUBLE_NODES = 500


@dataclass(frozen=True)
class Facets:
    """F flat facets on N points, as the integrals need them.

    Attributes
    ----------
    points : (N, 3) [m]
    triangles : (F, 3), outward
    areas : (F,) [m^2]
    normals : (F, 3) outward unit normals
    numbers : (F,) number of each facet's traction, which it may share; P different ones
    axes : (F, 3) mean unit normal of the facets that share it
    """

    points: Array
    triangles: Index
    areas: Array
    normals: Array
    numbers: Index
    axes: Array

    @classmethod
    def of(cls, points: ArrayLike, triangles: ArrayLike, numbers: Index | None = None) -> Facets:
        """The facets of a closed surface, whose triangles are outward, with numbered tractions or their own."""
        x, t = np.ascontiguousarray(points, np.float64), np.ascontiguousarray(triangles, np.int64)
        a, b, c = x[t[:, 0]], x[t[:, 1]], x[t[:, 2]]
        vectors = 0.5 * np.cross(b - a, c - a)
        areas = np.linalg.norm(vectors, axis=1)
        normals = vectors / areas[:, None]
        if numbers is None:
            return cls(x, t, areas, normals, np.arange(len(t)), normals)
        sums = np.stack([np.bincount(numbers, part) for part in vectors.T], axis=1)[numbers]
        return cls(x, t, areas, normals, numbers, sums / np.linalg.norm(sums, axis=1)[:, None])

    @property
    def n_tractions(self) -> int:
        return int(self.numbers.max()) + 1

    def tractions(self, dtype: type[np.floating[Any]]) -> tuple[Index, Array, Array]:
        """Numbers, axes m and tilts n - m, which give each facet's traction from a shared c: `c + (n - m) (m . c)`.

        n is the facet's own normal. c = m is then a uniform pressure, which no facet may resist.
        """
        return self.numbers, self.axes.astype(dtype), (self.normals - self.axes).astype(dtype)

    def mesh(self) -> tuple[Array, Index, Array, Array, Array, Array, Array]:
        """Corners, triangles, normals, areas, centres, radii, slenderness, as `vdm.boundary.kernels` reads them."""
        corners = self.points[self.triangles]
        centres = corners.mean(axis=1)
        radii = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
        longest = np.square(corners - np.roll(corners, 1, axis=1)).sum(axis=2).max(axis=1)
        triangles = self.triangles.view()
        triangles.setflags(write=False)  # always read-only: numba compiles for each kind, 10 s each
        return corners, triangles, self.normals, self.areas, centres, radii, longest / (2.0 * self.areas)

    def curls(self) -> Array:
        """(F, 3, 3) `n x grad` of each corner's shape function [1/m]: the opposite edge over twice the area."""
        corners = self.points[self.triangles]
        opposite = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)
        curls: Array = opposite / (2.0 * self.areas[:, None, None])
        return curls


@dataclass(frozen=True)
class Operators:
    """The Galerkin matrices for mu = 1, of P tractions and N nodes.

    Attributes
    ----------
    single : (3P, 3P) V [m^3], symmetric
    jump : (3P, 3N) M/2 + K [m^2]
    hypersingular : (3N, 3N) D [m], symmetric
    """

    single: Array
    jump: Array
    hypersingular: Array


def layers(
    facets: Facets, nu: float, dtype: type[np.floating[Any]] = np.float64
) -> tuple[Array, Array, Array, Array, Array]:
    """V of Kelvin's solution for mu = 1 by quadrature over all pairs, with tractions P and forms M.

    Returns `P^T V P` (3P, 3P), `P^T V M` (3P, 3N), `M^T V M` (3N, 3N), Laplace's V_0 (F, F) and K_0 (F, N).
    """
    n_facets, n_nodes = len(facets.triangles), len(facets.points)
    p, m = 3 * facets.n_tractions, 3 * n_nodes
    sums = tuple(np.zeros(shape, dtype) for shape in ((p, p), (p, m), (m, p), (m, m)))
    laplace = np.empty((n_facets, n_facets), dtype)
    double = np.zeros((n_facets, n_nodes), dtype)
    corners = facets.points[facets.triangles]
    points = np.ascontiguousarray(np.einsum("ka,fac->kcf", three_points()[0], corners))
    curls = facets.curls().astype(dtype)
    tractions = facets.tractions(dtype)
    all_pairs(facets.mesh(), points, rules(), kelvin_factors(nu), curls, tractions, sums, laplace, double)
    single, pulled, pulled_back, turned = sums
    add_own_transposed(single)
    add_transposed(pulled, pulled_back)
    add_own_transposed(turned)
    mirror(laplace)
    return single, pulled, turned, laplace, double


def kelvin_factors(nu: float) -> tuple[float, float]:
    """Factors of I/r and of r r / r^3 in Kelvin's solution for mu = 1."""
    share = 1.0 / (16.0 * np.pi * (1.0 - nu))
    return (3.0 - 4.0 * nu) * share, share


def assembled(facets: Facets, nu: float, dtype: type[np.floating[Any]] = np.float64) -> Operators:
    """V, M/2 + K and D from the `layers`."""
    single, jump, hypersingular, laplace, double = layers(facets, nu, dtype)
    n_nodes = len(facets.points)
    double += _gathered(facets, np.repeat(facets.areas[:, None] / 6.0, 3, axis=1).astype(dtype)).toarray()
    curls = facets.curls().astype(dtype)
    curl = [_gathered(facets, curls[:, :, k]) for k in range(3)]
    # products with the symmetric V_0, transposed so that rows are contiguous
    smooth = tuple(np.ascontiguousarray((part.T @ laplace).T) for part in curl)
    del laplace
    jump *= -2.0
    add_layers(double, smooth, facets.tractions(dtype), jump)
    hypersingular *= -4.0
    rest = hypersingular.reshape(n_nodes, 3, n_nodes, 3)
    for i in range(3):
        for j in range(i + 1):
            product = np.asarray(curl[j].T @ smooth[i])
            rest[:, i, :, j] -= product / (2.0 * np.pi)
            rest[:, j, :, i] -= product / (4.0 * np.pi)
            if i != j:
                rest[:, j, :, i] -= product.T / (2.0 * np.pi)
                rest[:, i, :, j] -= product.T / (4.0 * np.pi)
            else:
                for k in range(3):
                    rest[:, k, :, k] += product / np.pi
    return Operators(single, jump, hypersingular)


def precision(n_nodes: int) -> type[np.floating[Any]]:
    """Number type in which the operators of a surface are assembled."""
    return np.float64 if n_nodes <= DOUBLE_NODES else np.float32


@cache
def compile_for(n_nodes: int) -> None:
    """Compile the loops for so many nodes, or load them from the disk: seconds at first, then no time."""
    least = SurfaceMesh(np.vstack([np.zeros(3), np.eye(3)]), [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    surface_stiffness(Facets.of(least.points, least.triangles), 0.5, precision(n_nodes))
    coarsened(least, 3)


def surface_stiffness(
    facets: Facets, nu: float, dtype: type[np.floating[Any]] | None = None, rims: Rims | None = None
) -> Array:
    """(3N, 3N) symmetric S [m] for mu = 1: from displacements to nodal forces, the work of the tractions.

    Without `dtype` the operators have the `precision` of as many nodes. `facets` may be those of the cut surface
    of `rims`; S then has the nodes of the body before the cut. Quadrature leaves forces of rigid motions of 1e-5
    of S, which would push a body that its supports carry far: with `rims` they are removed, and reactions balance
    the load.

    At nu = 1/2 a change of volume has no finite stiffness: a constraint keeps the volume. S gives it a stiffness
    of the size of the others, so that it is not free.
    """
    dtype = dtype or precision(len(facets.points))
    operators = assembled(facets, nu, dtype)
    single, jump, rest = operators.single, operators.jump, operators.hypersingular
    if nu == 0.5:
        _stiffen(single, facets)
    refined = dtype is np.float32
    diagonal = np.diagonal(single).copy()
    # all in place and on one triangle only; the rows of an array are columns to LAPACK
    potrf, potrs = lapack.get_lapack_funcs(("potrf", "potrs"), (single,))  # type: ignore[misc]  # the stubs know one
    trsm, syrk = blas.get_blas_funcs(("trsm", "syrk"), (single,))
    factor, failed = potrf(single.T, lower=0, clean=0, overwrite_a=1)
    if failed:
        raise linalg.LinAlgError("the single layer is not positive definite")
    if refined:
        basis = smooth_displacements(rims.body.points if rims else facets.points)
        moved = rims.spread(basis) if rims else basis
        solve = partial(potrs, factor, lower=0)
        pushes = solved(solve, single, diagonal, wide_product(jump, moved))
        forces = wide_product(rest, moved) + wide_transposed_product(jump, pushes)
    half = trsm(1.0, factor, jump.T, side=1, lower=0, overwrite_b=1)
    work = syrk(1.0, half, beta=1.0, c=rest.T, lower=0, overwrite_c=1).T
    mirror(work)
    stiffness = rims.condensed(work) if rims else work.astype(np.float64)
    if refined:
        take_over(stiffness, basis, rims.smooth(basis, forces) if rims else forces)
    return stiffness


def _stiffen(single: Array, facets: Facets) -> None:
    """Add a a^T to V for each closed surface, so that S sees a change of volume.

    a approximates the pressure on that surface, which V does not see. A pressure on one surface moves nothing
    around another surface: S stays blind to that.
    """
    ger = blas.get_blas_funcs("ger", (single,))
    pieces = closed_pieces(facets.triangles)
    for one in range(pieces.max() + 1):
        pressure = np.zeros((facets.n_tractions, 3))
        on = pieces == one
        np.add.at(pressure, facets.numbers[on], (facets.areas[:, None] * facets.normals)[on])
        pressure *= np.sqrt(np.trace(single) / pressure.size) / np.linalg.norm(pressure)
        pushes = pressure.reshape(-1).astype(single.dtype)
        ger(1.0, pushes, pushes, a=single.T, overwrite_a=1)


def _gathered(facets: Facets, values: Array) -> sparse.csr_array:
    """(F, N) matrix of values (F, 3) at the corners of the facets."""
    shape, ends = (len(facets.triangles), len(facets.points)), np.arange(0, facets.triangles.size + 1, 3)
    return sparse.csr_array((values.ravel(), facets.triangles.ravel(), ends), shape=shape)
