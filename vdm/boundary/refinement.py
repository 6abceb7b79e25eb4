"""Corrects the surface stiffness for single precision, in the smooth displacements.

A factor in 32 bits has an error of 1e-6 of the largest stiffness. Smooth displacements, which make up the
answers, have the smallest stiffness. Uncorrected, an answer is wrong by 1e-5, and by 1e-3 on a slender body or
one with slivers. Iterative refinement with sums in 64 bits computes their forces S U. S then takes these over
(the symmetric update of Powell):

`S <- S + E U^T + U E^T - U (U^T E) U^T, E = (S U in 64 bits) - S U`, U orthonormal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product

import numpy as np
from scipy.linalg import blas

from solver_common.arrays import Array, Index

# degree of the polynomials in x, y, z that represent smooth displacements: 60 columns
DEGREE = 3
# rows and columns of a block that is converted to 64 bits at once
TILE = 256


def smooth_displacements(points: Array) -> Array:
    """(3N, k) orthonormal polynomials up to `DEGREE` in each component, on points (N, 3); with rigid motions."""
    centred = points - points.mean(axis=0)
    centred /= np.abs(centred).max()
    basis: Array = np.kron(np.linalg.qr(monomials(centred, DEGREE)[1].T)[0], np.eye(3))
    return basis


def monomials(points: Array, degree: int) -> tuple[Index, Array]:
    """Powers (k, 3) of x, y, z in each monomial up to a degree, and the values (k, N) of these at points (N, 3)."""
    of_each = np.array([one for one in product(range(degree + 1), repeat=3) if sum(one) <= degree])
    return of_each, powers(points.T, degree)[of_each.T, np.arange(3)[:, None]].prod(axis=0)


def powers(values: Array, most: int) -> Array:
    """(most + 1, ...) powers of some values, from the zeroth on."""
    found = np.ones((most + 1, *values.shape))
    for k in range(most):
        np.multiply(found[k], values, out=found[k + 1])
    return found


def wide_product(matrix: Array, right: Array) -> Array:
    """A (n, m) in 32 bits times (m, k), in 64 bits."""
    total = np.zeros((matrix.shape[0], right.shape[1]))
    for rows, columns, tile in _wide_tiles(matrix):
        total[rows] += tile @ right[columns]
    return total


def wide_transposed_product(matrix: Array, right: Array) -> Array:
    """The transpose of A (n, m) in 32 bits times (n, k), in 64 bits."""
    total = np.zeros((matrix.shape[1], right.shape[1]))
    for rows, columns, tile in _wide_tiles(matrix):
        total[columns] += tile.T @ right[rows]
    return total


def symmetric_product(above: Array, diagonal: Array, right: Array) -> Array:
    """Symmetric A (n, n) in 32 bits times (n, k), in 64 bits; A is `above` and on its `diagonal`."""
    total = diagonal.astype(np.float64)[:, None] * right
    for rows, columns, tile in _wide_tiles(above, symmetric=True):
        if columns.start == rows.start:
            tile = np.triu(tile, 1)
        total[rows] += tile @ right[columns]
        total[columns] += tile.T @ right[rows]
    return total


def _wide_tiles(matrix: Array, symmetric: bool = False) -> Iterator[tuple[slice, slice, Array]]:
    """Yield rows, columns and values in 64 bits of each block of a matrix (n, m); blocks reuse one array.

    Of a symmetric matrix: only the blocks on and above the diagonal.
    """
    n, m = matrix.shape
    place = np.empty((TILE, TILE))
    for a, b in product(range(0, n, TILE), range(0, m, TILE)):
        if symmetric and b < a:
            continue
        rows, columns = slice(a, min(a + TILE, n)), slice(b, min(b + TILE, m))
        tile = place[: rows.stop - a, : columns.stop - b]
        np.copyto(tile, matrix[rows, columns])
        yield rows, columns, tile


def solved(solve: Callable[[Array], tuple[Array, int]], above: Array, diagonal: Array, right: Array) -> Array:
    """V^-1 times `right` (n, k) in 64 bits, by LAPACK's solve with a factor of V; V as in `symmetric_product`."""
    answer = np.zeros_like(right)
    left = right
    for sweep in range(2):
        if sweep:
            left = right - symmetric_product(above, diagonal, answer)
        answer += solve(left.astype(above.dtype))[0]
    return answer


def take_over(stiffness: Array, basis: Array, forces: Array) -> None:
    """Update a symmetric S (n, n) in place: an orthonormal `basis` (n, k) then has the given forces (n, k)."""
    lacking = forces - stiffness @ basis
    lacking -= 0.5 * basis @ (basis.T @ lacking)
    left, right = np.hstack([lacking, basis]), np.hstack([basis, lacking])
    # in place; rows are columns to BLAS
    gemm = blas.get_blas_funcs("gemm", (stiffness,))
    gemm(1.0, right, left, beta=1.0, c=stiffness.T, trans_b=1, overwrite_c=1)
