"""Boundary elements on many nodes: a coarse body, and springs for motion that it does not resolve."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg, sparse
from scipy.linalg import blas

from solver_common.arrays import Array, Mask
from vdm.boundary.rims import Rims
from vdm.formulations.base import Factor, Factorise
from vdm.material import COARSE_NODES, ParameterError, Parameters
from vdm.peers.bem import INDEFINITE, BoundaryFormulation, DenseFactor
from vdm.solution import SolverError, Status
from vdm.solvers.cholesky import Cholesky
from vdm.solvers.single import SingleFactor
from vdm.surface import SurfaceMesh

if TYPE_CHECKING:
    from vdm.boundary.interpolation import Interpolation

# fine nodes per product with the coarse body's dense matrix: bounds the temporary arrays
ROWS = 4096
# largest relative change of a random displacement after applying the operator and the factor
LARGEST_LOSS = 1e-6
NO_MATRIX = Status(
    "too-large",
    "the sparse formulation has no matrix: its coarse body is dense",
    "use the linear, the single or the nonlinear solver",
)


class SparseFormulation(BoundaryFormulation):
    """`E(u) = 1/2 (R u).S (R u) + 1/2 (u - P R u).D (u - P R u)` in place of `bem`'s `1/2 u.S u`.

    S is the stiffness of a coarse body of at most `Parameters.coarse_nodes` nodes by boundary elements. P
    interpolates from its nodes to the surface's. `R = (P^T D P)^-1 P^T D` fits the coarse body to a displacement.
    Springs D resist the remaining displacement, which varies within a coarse facet. A half-space answers a wave
    of wave number k by mu |k| / (1 - nu) per area. The springs take the mean of the two wave numbers pi / h of
    the coarse and the fine mesh. Over all waves between these, under loads of one size, that gives the mean
    compliance. h is the local mesh size, so that a graded mesh has graded springs. The coarse body is finer at
    the rims of held nodes (`vdm.boundary.coarsening`). Nothing is fitted.

    Both parts are positive on every mesh, and rigid motions cost nothing. With all nodes in the coarse body it is
    `bem` itself. Held nodes are held where they are, at the resolution of the fine surface.

    With `G = P^T D P` and `Q = G^-1 (S - G) G^-1` the operator is `D + D P Q P^T D`. Over the free nodes its
    inverse is `D^-1 + P W P^T`, `W = (I - G^-1 S) (S + G_held (I - G^-1 S))^-1`. A frame is one product with a
    dense symmetric matrix of the coarse body, between two sparse ones.
    """

    name = "bem-sparse"
    has_matrix = False
    # interpolation makes similar columns differ; a thousandth of the form's own error
    left_out_far = 1e-4

    @classmethod
    def compile(cls, surface: SurfaceMesh, parameters: Parameters) -> None:
        from vdm.boundary.operators import compile_for

        compile_for(min(surface.n_nodes, parameters.coarse_nodes or COARSE_NODES))

    def _assemble(self, held: Mask) -> None:
        from vdm.boundary.coarsening import coarsened
        from vdm.boundary.interpolation import identity, interpolation

        if self.parameters.ground is not None:
            raise ParameterError(
                "the sparse formulation takes no springs to the ground; use the boundary one"
            )
        surface, count = self.surface, self._most_coarse
        if surface.n_nodes <= count:
            super()._assemble(held)
            self._stand_on(surface, identity(surface.n_nodes), self.matrix)
            return
        self._rims = Rims.of(surface, np.zeros_like(held))
        coarse = coarsened(surface, count, held)
        near = np.asarray(((coarse.shares > 0.0) & held[coarse.corners]).any(axis=1))
        stiffness = self._dense(Rims.of(coarse.surface, np.zeros_like(near)), near)
        self._stand_on(coarse.surface, interpolation(surface, coarse), stiffness)

    def _stand_on(self, body: SurfaceMesh, spread: Interpolation, stiffness: Array) -> None:
        """Take the coarse body (n nodes), its interpolation to the surface, and its stiffness (3n, 3n)."""
        surface = self.surface
        self.coarse, self.cells, self.body = body, spread.cells, stiffness
        n = body.n_nodes
        # both by columns: scipy's product with three vectors then takes half the time
        self.spread = sparse.csc_array(spread.weights)
        self.gather = sparse.csc_array(spread.weights.T)
        coarse_size = np.sqrt(np.bincount(spread.cells, surface.nodal_areas, n))[spread.cells]
        waves = 0.5 * np.pi * (1.0 / coarse_size + 1.0 / np.sqrt(surface.nodal_areas))
        modulus = self.shear_modulus / (1.0 - self.poisson_ratio)
        self.springs: Array = modulus * waves * surface.nodal_areas
        gathered = linalg.cho_factor(self._gathered(self.springs), check_finite=False)
        # T = I - G^-1 S and Q = -T G^-1
        self.rest = np.eye(3 * n) - _solve_blocks(gathered, self.body)
        inner = -_solve_blocks(gathered, self.rest.T)
        self.inner = np.asfortranarray(0.5 * (inner + inner.T))

    @property
    def _most_coarse(self) -> int:
        return self.parameters.coarse_nodes or COARSE_NODES

    @property
    def n_coarse(self) -> int:
        return self.coarse.n_nodes

    def record(self) -> dict[str, float | str]:
        scheme = "whole" if self.n_coarse == self.surface.n_nodes else f"on a body of {self.n_coarse} nodes"
        return {**super().record(), "scheme": scheme, "coarse_nodes": float(self.n_coarse)}

    def elastic_force(self, x: Array) -> Array:
        gathered = (self.gather @ (self.springs[:, None] * x)).reshape(-1)
        fitted = blas.dsymv(1.0, self.inner, gathered, lower=1).reshape(-1, 3)
        force: Array = self.springs[:, None] * (x + self.spread @ fitted)
        return force

    def elastic_forces(self, x: Array) -> Array:
        return np.stack([self.elastic_force(one) for one in np.moveaxis(x, 2, 0)], axis=2)

    def factor(self, free: Mask, factorise: Factorise = Cholesky) -> Factor:
        if factorise not in (Cholesky, SingleFactor):
            raise SolverError(NO_MATRIX)
        if factorise is Cholesky and self.n_coarse == self.surface.n_nodes:
            # no springs: S itself over the free nodes, without the held ones in a frame
            unknowns = np.repeat(free, 3)
            return DenseFactor(self.body[np.ix_(unknowns, unknowns)])
        return SparseInverse(self, free, np.float32 if factorise is SingleFactor else np.float64)

    def stiffness(self) -> sparse.csr_array:
        raise SolverError(NO_MATRIX)

    def diagonal(self) -> Array:
        rows, parts = sparse.csr_array(self.spread), []
        for start in range(0, len(self.springs), ROWS):
            some = rows[start : start + ROWS]
            inner = [some.multiply(some @ self.inner[k::3, k::3]).sum(axis=1) for k in range(3)]
            parts.append(np.stack(inner, axis=1))
        springs = self.springs[:, None]
        return np.asarray(springs + springs**2 * np.concatenate(parts)).reshape(-1)

    def projected(self, spread: sparse.csr_array) -> Array:
        """(m, m) P^T S P of displacements P (3n, m) of the coarse body."""
        return np.asarray(spread.T @ (spread.T @ self.body).T)

    def held_matrix(self, held: Mask) -> Array:
        """(3n, 3n) P^T D P of the springs of held nodes alone."""
        return np.asarray(np.kron(self._gathered(np.where(held, self.springs, 0.0)), np.eye(3)), np.float64)

    def _gathered(self, springs: Array) -> Array:
        return np.asarray((self.gather @ sparse.diags_array(springs) @ self.spread).toarray())


class _OnSprings(SparseFormulation):
    """A coarse body with the fine surface's springs to the ground, which pull at its interpolated motion."""

    def __init__(self, surface: SurfaceMesh, parameters: Parameters, held: Mask | None = None) -> None:
        self._ground = parameters.ground
        super().__init__(surface, replace(parameters, ground=None), held)

    def _stand_on(self, body: SurfaceMesh, spread: Interpolation, stiffness: Array) -> None:
        if self._ground is not None:
            moved = sparse.csr_array(sparse.kron(spread.weights, sparse.eye_array(3)))
            stiffness = stiffness + (moved.T @ self._ground @ moved).toarray()
        super()._stand_on(body, spread, stiffness)


class HalfFormulation(_OnSprings):
    """On half of the nodes, or half of `coarse_nodes` for a large body, with its own integrals."""

    @property
    def _most_coarse(self) -> int:
        return min(self.surface.n_nodes, super()._most_coarse) // 2


class HalvedFormulation(_OnSprings):
    """On about half of a form's nodes, without integrals of its own: S is P^T S P."""

    def __init__(self, form: BoundaryFormulation) -> None:
        self._whole = form
        super().__init__(form.surface, form.parameters)

    def _assemble(self, held: Mask) -> None:
        from vdm.boundary.coarsening import coarsened
        from vdm.boundary.interpolation import Interpolation, interpolation

        whole = self._whole
        self._rims = Rims.of(self.surface, held)  # without cuts
        body = whole.coarse if isinstance(whole, SparseFormulation) else whole.surface
        coarse = coarsened(body, body.n_nodes // 2)
        spread = interpolation(body, coarse)
        stiffness = whole.projected(sparse.csr_array(sparse.kron(spread.weights, sparse.eye_array(3))))
        if isinstance(whole, SparseFormulation):
            weights = sparse.csr_array(sparse.csr_array(whole.spread) @ spread.weights)
            spread = Interpolation(weights, spread.cells[whole.cells])
        self._stand_on(coarse.surface, spread, stiffness)


class SparseInverse:
    """Inverse over the free nodes, `D^-1 + P W P^T`, in 64 or 32 bits.

    Raises
    ------
    SolverError
        where the held nodes leave a motion free.
    """

    def __init__(self, form: SparseFormulation, free: Mask, dtype: type[np.floating]) -> None:
        matrix = form.held_matrix(~free) @ form.rest
        matrix += form.body
        factor = linalg.lu_factor(matrix, overwrite_a=True, check_finite=False)
        response = np.asarray(linalg.lu_solve(factor, form.rest.T, trans=1, check_finite=False)).T
        self._dtype = dtype
        self._response = np.asfortranarray(0.5 * (response + response.T), dtype=dtype)
        self._product = blas.dsymv if dtype is np.float64 else blas.ssymv
        rows = sparse.csr_array(form.spread)
        held = ~free
        self._spread = sparse.csc_array(rows[free], dtype=dtype)
        self._gather = sparse.csc_array(rows[free].T, dtype=dtype)
        self._give = (1.0 / form.springs[free])[:, None].astype(dtype)
        self._held_springs, self._held_spread = form.springs[held], sparse.csc_array(rows[held])
        self._check(form, free)

    def solve(self, right_hand_side: Array) -> Array:
        """Solution of (n_free 3,) or (n_free 3, m) right-hand sides."""
        return self.solve_with_inside(right_hand_side)[0]

    def solve_with_inside(self, right_hand_side: Array) -> tuple[Array, Array]:
        """The solution, and the coarse body's displacement (3n,) or (3n, m) in it."""
        n_free, m = len(self._give), right_hand_side.shape[1:]
        force = np.asarray(right_hand_side.reshape(n_free, 3 * int(np.prod(m))), dtype=self._dtype)
        gathered = (self._gather @ force).reshape(len(self._response), *m)
        inside: Array = np.asarray(
            self._response @ gathered if m else self._product(1.0, self._response, gathered, lower=1)
        )
        moved = self._spread @ inside.reshape(len(inside) // 3, force.shape[1])
        moved += self._give * force
        return moved.reshape(right_hand_side.shape).astype(np.float64, copy=False), inside

    def held_force(self, inside: Array) -> Array:
        """(n_held, 3) elastic force at the held nodes: the coarse body pulls their springs."""
        return -self._held_springs[:, None] * np.asarray(self._held_spread @ inside.reshape(-1, 3))

    def _check(self, form: SparseFormulation, free: Mask) -> None:
        x = np.zeros((len(free), 3))
        x[free] = np.random.default_rng(0).standard_normal((int(free.sum()), 3))
        back = self.solve(form.apply(x)[free].reshape(-1))
        loss = np.abs(back - x[free].reshape(-1)).max()
        if not loss < (LARGEST_LOSS if self._dtype is np.float64 else 1e3 * LARGEST_LOSS):
            raise SolverError(INDEFINITE)


def _solve_blocks(factor: tuple[Array, bool], matrix: Array) -> Array:
    """(G^-1 x I_3) times a matrix (3n, k), with the factor of the scalar G (n, n)."""
    n = len(factor[0])
    solved = linalg.cho_solve(factor, matrix.reshape(n, -1), check_finite=False)
    return np.asarray(solved).reshape(matrix.shape)
