"""The preconditioner of the iterative path: block triangular, with p-multigrid for the displacement block.

Method: P2 is smoothed by Chebyshev iteration on 3x3 block Jacobi and corrected on P1, which is a subspace of P2 on
the same mesh: prolongation is interpolation, restriction its transpose, the coarse matrix their product with the
fine one. P1 is left to one V-cycle of smoothed
aggregation with the rigid motions as near-null space. Order: the iterations hardly grow with size or Poisson ratio.
Source: Elman, Silvester and Wathen, Finite Elements and Fast Iterative Solvers, chapter 4; Vanek, Mandel and
Brezina 1996, doi 10.1007/BF02238511.
"""

from __future__ import annotations

import numpy as np
import pyamg
from numpy.typing import NDArray
from scipy.sparse import bsr_array, bsr_matrix, coo_array, csr_array, eye_array, kron

from fem_reference.loads import rigid_modes
from fem_reference.mesh import TetMesh
from fem_reference.system import LinearSystem, hold_components
from solver_common.arrays import Array, Index
from solver_common.solution import solver_error

_POWER_STEPS = 12
_COARSEST = 50  # nodes of the level that is solved densely
_SMOOTHED_SHARE = 10.0  # the smoother damps eigenvalues down to the largest over this
_MASS_BOUNDS = (0.5, 2.5)  # of the P1 tetrahedral mass matrix over its diagonal (Wathen 1987)


class Chebyshev:
    """A fixed number of Chebyshev steps for D^-1 A on [low, high] (Saad, Iterative Methods, alg. 12.1)."""

    def __init__(self, matrix: csr_array | bsr_array, inverse_diagonal: csr_array, degree: int) -> None:
        self._matrix = matrix
        self._inverse = inverse_diagonal
        self._degree = degree
        self.low, self.high = 0.0, 0.0

    def set_bounds(self, low: float, high: float) -> None:
        """Set the interval that is damped."""
        self.low, self.high = low, high

    def largest_eigenvalue(self) -> float:
        """Estimate of the largest eigenvalue of D^-1 A by power iteration from a fixed start."""
        x = np.random.default_rng(0).standard_normal(self._matrix.shape[0])
        value = 0.0
        for _ in range(_POWER_STEPS):
            x /= np.linalg.norm(x)
            x = self._inverse @ (self._matrix @ x)
            value = float(np.linalg.norm(x))
        return value

    def __call__(self, rhs: Array, x: Array | None = None) -> Array:
        """Improve `x` (None: zero) towards A x = rhs."""
        middle, half = 0.5 * (self.high + self.low), 0.5 * (self.high - self.low)
        residual = rhs if x is None else rhs - self._matrix @ x
        step = (self._inverse @ residual) / middle
        x = step.copy() if x is None else x + step
        ratio = half / middle
        for _ in range(self._degree - 1):
            residual = residual - self._matrix @ step
            following = 1.0 / (2.0 * middle / half - ratio)
            step = following * ratio * step + (2.0 * following / half) * (self._inverse @ residual)
            x += step
            ratio = following
        return np.asarray(x)


class DisplacementPreconditioner:
    """One multigrid cycle for the displacement block of a `LinearSystem`.

    Raises
    ------
    SolverError
        If every vertex is held.
    """

    def __init__(self, system: LinearSystem) -> None:
        mesh = system.mesh
        self._stiffness = system.stiffness
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
            self._smoother = Chebyshev(system.stiffness, _inverse_blocks(system.stiffness), degree=2)
            high = 1.1 * self._smoother.largest_eigenvalue()
            self._smoother.set_bounds(high / _SMOOTHED_SHARE, high)
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
            max_coarse=_COARSEST,
        )
        self._cycle = self.hierarchy.aspreconditioner(cycle="V")

    def __call__(self, residual: Array) -> Array:
        """Approximate solution of A u = residual."""
        if self._levels is None:
            return np.asarray(self._cycle @ residual)
        prolongation, restriction = self._levels
        u = self._smoother(residual)
        coarse = restriction @ (residual - self._stiffness @ u).reshape(-1, 3)
        coarse *= self._free
        correction = (self._cycle @ coarse.ravel()).reshape(-1, 3)
        u += (prolongation @ correction).ravel()
        return self._smoother(residual, u)


class BlockPreconditioner:
    """Upper block triangular: the pressure by its mass matrix first, then the displacement.

    The Schur complement of the pressure is close to a multiple of the mass matrix: a gradient field, which is
    what a pressure drives, meets twice the shear modulus.
    """

    def __init__(self, system: LinearSystem) -> None:
        self._displacement = DisplacementPreconditioner(system)
        self._split = system.n_displacements
        self._system = system
        if system.mass is None:
            return
        diagonal = system.mass.diagonal()
        n = len(diagonal)
        inverse = csr_array((1.0 / diagonal, np.arange(n), np.arange(n + 1)), shape=(n, n))
        self._mass = Chebyshev(system.mass, inverse, degree=5)
        self._mass.set_bounds(*_MASS_BOUNDS)

    def __call__(self, residual: Array) -> Array:
        """Approximate solution of the whole system."""
        top = residual[: self._split]
        gradient = self._system.gradient
        if gradient is None:
            return self._displacement(top)
        pressure = -self._mass(residual[self._split :]) / self._system.schur_factor
        return np.concatenate([self._displacement(top + gradient @ pressure), pressure])


def _inverse_blocks(matrix: bsr_array) -> csr_array:
    n = matrix.shape[0] // 3
    rows = np.repeat(np.arange(n), np.diff(matrix.indptr))
    inverse = np.linalg.inv(matrix.data[matrix.indices == rows])
    return csr_array(bsr_array((inverse, np.arange(n), np.arange(n + 1)), shape=matrix.shape))


def _prolongation(mesh: TetMesh, kept: Index, vertices: Index) -> csr_array:
    """(K, kept vertices) scalar P1 to P2 interpolation."""
    n, ends = mesh.n_vertices, mesh.edge_vertices
    edges = np.repeat(n + np.arange(len(ends)), 2)
    rows = np.concatenate([np.arange(n), edges])
    columns = np.concatenate([np.arange(n), ends.ravel()])
    values = np.concatenate([np.ones(n), np.full(len(edges), 0.5)])
    whole = csr_array(coo_array((values, (rows, columns)), shape=(mesh.n_nodes, n)))
    return csr_array(whole[kept][:, vertices])


def _galerkin(stiffness: bsr_array, prolongation: csr_array, free: NDArray[np.bool_]) -> bsr_matrix:
    """P^T A P with a scalar P for all three components; held ones are identity rows."""
    of_components = bsr_array(kron(prolongation, eye_array(3), format="bsr"))
    matrix = bsr_matrix(of_components.T @ (stiffness @ of_components), blocksize=(3, 3))
    matrix.sort_indices()
    hold_components(matrix, ~free)
    return matrix
