"""The preconditioner of the iterative path: block triangular, with p-multigrid for the displacement block.

Method: Chebyshev iteration on 3x3 block Jacobi smooths P2. The correction is on P1, a subspace of P2 on the same
mesh: prolongation is interpolation, restriction its transpose, and the coarse matrix is their product with the
fine one. P1 is solved by one V-cycle of smoothed aggregation with the rigid motions as near-null space. Order:
the number of iterations hardly grows with size or Poisson ratio. Source: Elman, Silvester and Wathen, Finite
Elements and Fast Iterative Solvers, chapter 4; Vanek, Mandel and Brezina 1996, doi 10.1007/BF02238511.
"""

from __future__ import annotations

import numpy as np
import pyamg
from numpy.typing import NDArray
from scipy.sparse import bsr_array, bsr_matrix, coo_array, csr_array

from fem_reference.loads import rigid_modes
from fem_reference.mesh import TetMesh
from fem_reference.system import LinearSystem, hold_components
from solver_common.arrays import Array, Index
from solver_common.jit import compiled
from solver_common.solution import solver_error

_POWER_STEPS = 12
_COARSEST = 50  # nodes of the level that is solved densely
_SMOOTHED_SHARE = 10.0  # the smoother damps eigenvalues down to the largest over this
_MASS_STEPS = 5
_MASS_BOUNDS = (0.5, 2.5)  # of the P1 tetrahedral mass matrix over its diagonal (Wathen 1987)


class BlockSmoother:
    """Chebyshev steps for D^-1 A, D the 3x3 diagonal blocks of A (Saad, Iterative Methods, alg. 12.1).

    Blocks are in single precision, half as much to read. A preconditioner need not be exact, but it must be
    linear: vectors are therefore in double precision.
    """

    def __init__(self, matrix: bsr_array) -> None:
        rows, columns = matrix.indptr, matrix.indices
        of = np.repeat(np.arange(len(rows) - 1), np.diff(rows))
        inverse = np.linalg.inv(matrix.data[columns == of])
        self._matrix = rows, columns, matrix.data.astype(np.float32), inverse.astype(np.float32)
        high = 1.1 * self._largest_eigenvalue(matrix.shape[0])
        self._middle = 0.5 * (high + high / _SMOOTHED_SHARE)
        self._half = 0.5 * (high - high / _SMOOTHED_SHARE)

    def first(self, rhs: Array) -> Array:
        """One step from zero towards A x = rhs; reads no matrix."""
        x = np.zeros_like(rhs)
        _advance(*self._matrix, None, rhs, x, 0.0, 1.0 / self._middle)
        return x

    def improved(self, rhs: Array, start: Array) -> Array:
        """Two steps from `start` towards A x = rhs."""
        x, residual = start.copy(), rhs.copy()
        step = _advance(*self._matrix, start, residual, x, 0.0, 1.0 / self._middle)
        ratio = self._half / self._middle
        following = 1.0 / (2.0 / ratio - ratio)
        _advance(*self._matrix, step, residual, x, following * ratio, 2.0 * following / self._half)
        return x

    def residual(self, rhs: Array, x: Array) -> Array:
        """Rhs - A x."""
        left = rhs.copy()
        _advance(*self._matrix, x, left, np.zeros_like(x), 0.0, 0.0)
        return left

    def _largest_eigenvalue(self, size: int) -> float:
        """Estimate of the largest eigenvalue of D^-1 A by power iteration from a fixed start."""
        x = np.random.default_rng(0).standard_normal(size)
        value = 0.0
        for _ in range(_POWER_STEPS):
            x /= np.linalg.norm(x)
            x = _advance(*self._matrix, x, np.zeros_like(x), np.zeros_like(x), 0.0, -1.0)
            value = float(np.linalg.norm(x))
        return value


@compiled
def _advance(
    rows: NDArray[np.int32],
    columns: NDArray[np.int32],
    blocks: NDArray[np.float32],
    inverse: NDArray[np.float32],
    step: Array | None,
    residual: Array,
    x: Array,
    kept: float,
    gain: float,
) -> Array:
    """Update the residual after a step (None for no step), then compute and take the next step.

    The next step is kept * step + gain * D^-1 residual.
    """
    following = np.empty_like(x)
    for row in range(len(rows) - 1):
        first, second, third = residual[3 * row], residual[3 * row + 1], residual[3 * row + 2]
        if step is not None:
            for k in range(rows[row], rows[row + 1]):
                block, at = blocks[k], 3 * columns[k]
                a, b, c = step[at], step[at + 1], step[at + 2]
                first -= block[0, 0] * a + block[0, 1] * b + block[0, 2] * c
                second -= block[1, 0] * a + block[1, 1] * b + block[1, 2] * c
                third -= block[2, 0] * a + block[2, 1] * b + block[2, 2] * c
            residual[3 * row], residual[3 * row + 1], residual[3 * row + 2] = first, second, third
        for i in range(3):
            own = inverse[row, i]
            value = gain * (own[0] * first + own[1] * second + own[2] * third)
            if step is not None:
                value += kept * step[3 * row + i]
            following[3 * row + i] = value
            x[3 * row + i] += value
    return following


class DisplacementPreconditioner:
    """One multigrid cycle for the displacement block of a `LinearSystem`.

    Raises
    ------
    SolverError
        If every vertex is held.
    """

    def __init__(self, system: LinearSystem) -> None:
        mesh = system.mesh
        vertices = system.kept[system.kept < mesh.n_vertices]
        self._free = ~system.held[vertices]
        self._levels: tuple[csr_array, csr_array] | None = None
        if not len(vertices):
            raise solver_error(
                "bad-solver", "every vertex is held, so multigrid has no coarse level", 'use "direct"'
            )
        if mesh.order == 1:
            coarse = bsr_matrix(system.stiffness)
        else:
            self._smoother = BlockSmoother(system.stiffness)
            prolongation = _prolongation(mesh, system.kept, vertices)
            self._levels = (prolongation, csr_array(prolongation.T))
            coarse = _galerkin(system.stiffness, prolongation, self._free)
        x = mesh.points[vertices] - mesh.points[vertices].mean(axis=0)
        modes = rigid_modes(x / mesh.mean_edge) * self._free[:, :, None]
        smoother = ("block_gauss_seidel", {"sweep": "symmetric"})
        self.hierarchy = pyamg.smoothed_aggregation_solver(
            coarse,
            B=modes.reshape(-1, 6),
            strength=("symmetric", {"theta": 0.0}),
            presmoother=smoother,
            postsmoother=smoother,
            # rows over the sums of their absolute values: eigenvalues up to 1, without a random estimate
            smooth=("jacobi", {"omega": 2.0, "weighting": "local"}),
            max_coarse=_COARSEST,
        )
        self._cycle = self.hierarchy.aspreconditioner(cycle="V")

    def __call__(self, residual: Array) -> Array:
        """Approximate solution of A u = residual."""
        if self._levels is None:
            return np.asarray(self._cycle @ residual)
        prolongation, restriction = self._levels
        u = self._smoother.first(residual)
        coarse = restriction @ self._smoother.residual(residual, u).reshape(-1, 3)
        coarse *= self._free
        correction = (self._cycle @ coarse.ravel()).reshape(-1, 3)
        u += (prolongation @ correction).ravel()
        return self._smoother.improved(residual, u)


class BlockPreconditioner:
    """Upper block triangular: first the pressure by its mass matrix, then the displacement.

    The pressure's Schur complement is close to a multiple of the mass matrix: a pressure drives a gradient field,
    which meets twice the shear modulus.
    """

    def __init__(self, system: LinearSystem) -> None:
        self._displacement = DisplacementPreconditioner(system)
        self._split = system.n_displacements
        self._gradient, self._mass, self._schur_factor = system.gradient, system.mass, system.schur_factor
        if system.mass is None:
            return
        self._inverse_diagonal = 1.0 / system.mass.diagonal()

    def __call__(self, residual: Array) -> Array:
        """Approximate solution of the whole system."""
        top = residual[: self._split]
        if self._gradient is None or self._mass is None:
            return self._displacement(top)
        pressure = -self._over_mass(self._mass, residual[self._split :]) / self._schur_factor
        return np.concatenate([self._displacement(top + self._gradient @ pressure), pressure])

    def _over_mass(self, mass: csr_array, rhs: Array) -> Array:
        """M^-1 rhs by Chebyshev steps for the mass matrix over its diagonal."""
        low, high = _MASS_BOUNDS
        middle, half = 0.5 * (high + low), 0.5 * (high - low)
        ratio = half / middle
        residual, step = rhs, self._inverse_diagonal * rhs / middle
        x = step.copy()
        for _ in range(_MASS_STEPS - 1):
            residual = residual - mass @ step
            following = 1.0 / (2.0 * middle / half - ratio)
            step = following * ratio * step + (2.0 * following / half) * (self._inverse_diagonal * residual)
            x += step
            ratio = following
        return np.asarray(x)


def _prolongation(mesh: TetMesh, kept: Index, vertices: Index) -> csr_array:
    """(K, kept vertices) scalar interpolation from P1 to P2."""
    n, ends = mesh.n_vertices, mesh.edge_vertices
    edges = np.repeat(n + np.arange(len(ends)), 2)
    rows = np.concatenate([np.arange(n), edges])
    columns = np.concatenate([np.arange(n), ends.ravel()])
    values = np.concatenate([np.ones(n), np.full(len(edges), 0.5)])
    whole = csr_array(coo_array((values, (rows, columns)), shape=(mesh.n_nodes, n)))
    return csr_array(whole[kept][:, vertices])


def _galerkin(stiffness: bsr_array, prolongation: csr_array, free: NDArray[np.bool_]) -> bsr_matrix:
    """P^T A P with a scalar P for all three components; held ones are identity rows."""
    size = len(stiffness.indptr) - 1
    sharing = csr_array((np.ones(len(stiffness.indices)), stiffness.indices, stiffness.indptr), (size, size))
    pattern = csr_array(prolongation.T @ (sharing @ prolongation))
    pattern.sort_indices()
    blocks = np.zeros((pattern.nnz, 3, 3))
    fine, coarse = (stiffness.indptr, stiffness.indices), (pattern.indptr, pattern.indices)
    _add_restricted(
        blocks, *coarse, stiffness.data, *fine, prolongation.data, prolongation.indptr, prolongation.indices
    )
    matrix = bsr_matrix((blocks, pattern.indices, pattern.indptr))
    hold_components(matrix, ~free)
    return matrix


@compiled
def _add_restricted(
    sums: Array,
    sum_rows: NDArray[np.int32],
    sum_columns: NDArray[np.int32],
    blocks: Array,
    rows: NDArray[np.int32],
    columns: NDArray[np.int32],
    weights: Array,
    parents_from: NDArray[np.int32],
    parents: NDArray[np.int32],
) -> None:
    """Add the (k, 3, 3) blocks of A to P^T A P, three times as fast as by products of block matrices."""
    where = np.zeros(len(sum_rows) - 1, dtype=np.int64)  # place of each column in one row of the sums
    for row in range(len(rows) - 1):
        for a in range(parents_from[row], parents_from[row + 1]):
            for place in range(sum_rows[parents[a]], sum_rows[parents[a] + 1]):
                where[sum_columns[place]] = place
            for k in range(rows[row], rows[row + 1]):
                block = blocks[k]
                for b in range(parents_from[columns[k]], parents_from[columns[k] + 1]):
                    at, weight = sums[where[parents[b]]], weights[a] * weights[b]
                    for i in range(3):
                        for j in range(3):
                            at[i, j] += weight * block[i, j]
