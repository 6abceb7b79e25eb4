"""Many nodes on the boundary integrals of few: a skin of springs on a coarse body.

With z the motion of the coarse body's nodes, P the interpolation to the skin and D a spring of every skin node,

`E(u) = min_z 1/2 z.B z + 1/2 (u - P z).D (u - P z)`, `B = (S^-1 - G^-1)^-1`, `G = P^T D P`.

S is the coarse body's stiffness by boundary integrals. The springs' own give under a smooth load, G^-1, is taken
off the coarse body's, so that E(P z) = 1/2 z.S z: what the coarse nodes can follow answers as if there were no
springs, and what lies between them answers by the springs alone. Their stiffness per area is proportional to
mu / h, h the coarse mesh size, as an incompressible half-space's is to mu / (wave length), and as small as keeps
B positive: nothing is fitted. Held nodes are held at the skin's own resolution.

Every operator is exact to rounding: u = D^-1 f + P W P^T f is the inverse at the free nodes, W = (B + G_held)^-1,
and D (u - P z) the force, with z = (B + G)^-1 P^T D u.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.linalg import blas, lapack
from scipy.sparse import linalg as sparse_linalg

from vdm.formulations.coarse_surface import coarsened
from vdm.formulations.interpolation import interpolation
from vdm.solution import SolverError, Status
from vdm.surface import SurfaceMesh

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Stiffness = Callable[[SurfaceMesh, Array], Array]

# largest ratio of the coarse body's stiffness to the springs'; 0.5 to 0.9 give errors within a tenth of each other
LARGEST_RATIO = 0.75
# of that ratio: the springs, and with them the answer, may not depend on the pose of the body
TOLERANCE = 1e-10
# fine nodes that are multiplied with the dense matrix of the coarse body at once: bounds the temporary arrays
ROWS = 4096
# smallest over largest pivot of a factor that is told from a singular one
PIVOT_TOLERANCE = 1e-6
INDEFINITE = Status(
    "singular",
    "the boundary formulation's stiffness is not positive definite",
    "hold at least three nodes that are not on one line, refine a surface or a coarse body that is thinner than its"
    " mesh is coarse, and remesh slivers and folds",
)


class Skin:
    """Elastic operator (3N, 3N) of a fine surface on a coarse one.

    Parameters
    ----------
    surface : the fine surface, N nodes
    count : nodes of the coarse one
    stiffness : of a surface and its volume gradient (n, 3): (3n, 3n), symmetric, semi-definite
    """

    def __init__(self, surface: SurfaceMesh, count: int, stiffness: Stiffness) -> None:
        coarse = coarsened(surface, count)
        spread = interpolation(surface, coarse)
        self.n_nodes = n = coarse.surface.n_nodes
        # both by columns: scipy's product with three vectors is then half as long, as no sum waits for itself
        self.spread = sparse.csc_array(spread.weights)
        self.gather = sparse.csc_array(spread.weights.T)
        cell_areas = np.bincount(spread.cells, surface.nodal_areas, n)
        springs = surface.nodal_areas / np.sqrt(cell_areas[spread.cells])
        matrix = stiffness(coarse.surface, self.gather @ surface.area_vectors)
        factor = linalg.cho_factor(self._gathered(springs))
        ratio = _solve_blocks(factor, matrix)
        scale = _largest_eigenvalue(ratio) / LARGEST_RATIO
        self.springs: Array = scale * springs
        ratio /= scale
        # B = S (I - G^-1 S)^-1 and (B + G)^-1 = (I - G^-1 S) G^-1
        rest = np.eye(3 * n) - ratio
        self.body = _symmetric(linalg.solve(rest.T, matrix, check_finite=False))
        self.inner = _symmetric(_solve_blocks(factor, rest.T) / scale)

    def apply(self, x: Array) -> Array:
        """(N, 3) elastic force of displacements (N, 3)."""
        gathered = (self.gather @ (self.springs[:, None] * x)).reshape(-1)
        z = blas.dsymv(1.0, self.inner, gathered, lower=1).reshape(-1, 3)
        force: Array = self.springs[:, None] * (x - self.spread @ z)
        return force

    def diagonal(self) -> Array:
        """(3N,) of the operator."""
        rows, parts = sparse.csr_array(self.spread), []
        for start in range(0, len(self.springs), ROWS):
            some = rows[start : start + ROWS]
            inner = [some.multiply(some @ self.inner[k::3, k::3]).sum(axis=1) for k in range(3)]
            parts.append(np.stack(inner, axis=1))
        springs = self.springs[:, None]
        return np.asarray(springs - springs**2 * np.concatenate(parts)).reshape(-1)

    def factor(self, free: Mask, scale: float) -> SkinFactor:
        """The inverse of its multiple over the free nodes."""
        return SkinFactor(self, free, scale)

    def held_matrix(self, held: Mask) -> Array:
        """(3n, 3n) G of the springs of held nodes alone."""
        return np.asarray(np.kron(self._gathered(np.where(held, self.springs, 0.0)), np.eye(3)), np.float64)

    def _gathered(self, springs: Array) -> Array:
        return np.asarray((self.gather @ sparse.diags_array(springs) @ self.spread).toarray())


class SkinFactor:
    """Inverse of a multiple of a skin over its free nodes, by one dense matrix of the coarse body.

    Raises
    ------
    SolverError
        where the held nodes leave a motion free.
    """

    def __init__(self, skin: Skin, free: Mask, scale: float) -> None:
        matrix = np.asfortranarray(skin.body + skin.held_matrix(~free))
        factor, info = lapack.dpotrf(matrix, lower=1, overwrite_a=1)
        if info:
            raise SolverError(INDEFINITE)
        pivots = np.diagonal(factor)
        if pivots.min() < PIVOT_TOLERANCE * pivots.max():
            raise SolverError(INDEFINITE)
        self._response = lapack.dpotri(factor, lower=1, overwrite_c=1)[0]
        self._response /= scale
        rows = sparse.csr_array(skin.spread)
        self._spread, self._gather = sparse.csc_array(rows[free]), sparse.csc_array(rows[free].T)
        self._give = np.repeat(1.0 / (scale * skin.springs[free]), 3)
        self._held_springs = scale * skin.springs[~free]
        self._held_spread = sparse.csc_array(rows[~free])

    def solve(self, right_hand_side: Array) -> Array:
        """Solution of (n_free 3,) or (n_free 3, m) right-hand sides."""
        return self.solve_with_inside(right_hand_side)[0]

    def solve_with_inside(self, right_hand_side: Array) -> tuple[Array, Array]:
        """Solution, and the motion of the coarse body (3n,) or (3n, m)."""
        shape, n_free = right_hand_side.shape, len(self._give) // 3
        gathered = (self._gather @ right_hand_side.reshape(n_free, -1)).reshape(-1, *shape[1:])
        product = blas.dsymv if len(shape) == 1 else blas.dsymm
        inside = np.asarray(product(1.0, self._response, gathered, lower=1))
        moved = (self._spread @ inside.reshape(len(inside) // 3, -1)).reshape(shape)
        moved += self._give.reshape(-1, *(1,) * (len(shape) - 1)) * right_hand_side
        return moved, inside

    def held_force(self, inside: Array) -> Array:
        """(n_held, 3) elastic force at the held nodes: their springs pulled by the coarse body."""
        return -self._held_springs[:, None] * np.asarray(self._held_spread @ inside.reshape(-1, 3))


def _solve_blocks(factor: tuple[Array, bool], matrix: Array) -> Array:
    """(G^-1 x I_3) times a matrix (3n, k), by the factor of the scalar G (n, n)."""
    n = len(factor[0])
    solved = linalg.cho_solve(factor, matrix.reshape(n, -1), check_finite=False)
    return np.asarray(solved).reshape(matrix.shape)


def _symmetric(matrix: Array) -> Array:
    return np.asfortranarray(0.5 * (matrix + matrix.T))


def _largest_eigenvalue(matrix: Array) -> float:
    start = np.random.default_rng(0).standard_normal(len(matrix))
    found = sparse_linalg.eigs(matrix, k=1, v0=start, tol=TOLERANCE, return_eigenvectors=False)
    return float(np.abs(found[0]))
