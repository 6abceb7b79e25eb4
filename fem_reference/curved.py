"""Curved (isoparametric) P2 tetrahedra on a surface whose geometry is known, assembled by scikit-fem.

The middles of boundary edges are moved onto the true surface; the elements that own them become quadratic images of
a straight tetrahedron (Ciarlet and Raviart 1972, doi 10.1016/B978-0-12-068650-6.50020-4). Geometry and displacement
are of one order: a smooth body's answer converges with order 3, on flat facets with order 2. Integrands are
rational there and are integrated to degree 6.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.sparse import csr_array
from skfem import (
    Basis,
    BilinearForm,
    ElementTetP1,
    ElementTetP2,
    ElementVector,
    Functional,
    LinearForm,
    MeshTet,
    MeshTet2,
)
from skfem.helpers import ddot, div, sym_grad, trace
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTet

from solver_common.arrays import Array, Index
from solver_common.solution import SolverError, solver_error

# mypy: allow-untyped-calls, allow-untyped-decorators, allow-untyped-defs

_DEGREE = 6


_bad_mesh = partial(solver_error, "bad-mesh")


class Curved:
    """Operators of one curved mesh; every `weights` is an (m,) factor of each tetrahedron.

    Parameters
    ----------
    mesh : the straight tetrahedra
    points : (n_nodes, 3) their nodes [m]
    edges : (E,) nodes in the middles of boundary edges
    onto : moves (E, 3) points onto the true surface

    Attributes
    ----------
    node_points : (n_nodes, 3) coordinates of all nodes [m]

    Raises
    ------
    SolverError
        If a curved tetrahedron turns inside out, or `onto` returns something else than points.
    """

    def __init__(self, mesh: MeshTet, points: Array, edges: Index, onto: Callable[[Array], Array]) -> None:
        self.node_points = points.copy()
        moved = np.asarray(onto(self.node_points[edges]), dtype=np.float64)
        if moved.shape != (len(edges), 3) or not np.isfinite(moved).all():
            raise _bad_mesh(f"onto gives an array of shape {moved.shape}", f"return ({len(edges)}, 3) points")
        self.node_points[edges] = moved
        curved = replace(MeshTet2.from_mesh(mesh), doflocs=np.ascontiguousarray(self.node_points.T))
        rule = get_quadrature(RefTet, _DEGREE)
        try:
            determinants = curved.mapping().detDF(rule[0])
        except Exception as error:  # of no class of its own: a determinant is exactly zero
            raise _inverted("a tetrahedron") from error
        if determinants.min() <= 0.0:
            worst = int(np.argmin(determinants.min(axis=1)))
            raise _inverted(f"tetrahedron {worst}")
        self._basis = Basis(curved, ElementVector(ElementTetP2()), quadrature=rule)
        self._pressures = self._basis.with_element(ElementTetP1())
        self._scalars = self._basis.with_element(ElementTetP2())

    def bases(self, intorder: int) -> tuple[Basis, Basis]:
        """See `fem_reference.mesh.TetMesh.bases`."""
        displacement = Basis(self._basis.mesh, ElementVector(ElementTetP2()), intorder=intorder)
        return displacement, displacement.with_element(ElementTetP1())

    def elasticity(self, divergence: float, weights: Array | None) -> csr_array:
        """(3 n_nodes, 3 n_nodes) 2 eps(u) : eps(v) + divergence * div u div v, as `elasticity_blocks`."""

        @BilinearForm
        def form(u, v, w):
            return w.g * (2.0 * ddot(sym_grad(u), sym_grad(v)) + divergence * div(u) * div(v))

        return csr_array(form.assemble(self._basis, g=self._each(weights)))

    def divergence(self) -> csr_array:
        """(n, 3 n_nodes) integrals of q div u."""

        @BilinearForm
        def form(u, q, _):
            return q * div(u)

        return csr_array(form.assemble(self._basis, self._pressures))

    def mass(self, weights: Array | None) -> csr_array:
        """(n, n) P1 mass matrix."""

        @BilinearForm
        def form(p, q, w):
            return w.g * p * q

        return csr_array(form.assemble(self._pressures, g=self._each(weights)))

    def shares(self) -> Array:
        """(n_nodes,) integrals of the P2 functions."""

        @LinearForm
        def form(v, _):
            return 1.0 * v

        return np.asarray(form.assemble(self._scalars))

    def mean_stress(self, displacement: Array, pressure: Array, bulk: float, weights: Array | None) -> float:
        """Volume mean of p - bulk * weight * div u."""

        @Functional
        def form(w):
            return w.p - bulk * w.g * trace(w.u.grad)

        fields = {
            "u": self._basis.interpolate(displacement.ravel()),
            "p": self._pressures.interpolate(pressure) if len(pressure) else 0.0,
        }
        total = form.assemble(self._basis, g=self._each(weights), **fields)
        return float(total / self._basis.dx.sum())

    def _each(self, weights: Array | None) -> Array:
        shape = self._basis.dx.shape
        return np.ones(shape) if weights is None else np.broadcast_to(weights[:, None], shape)


def _inverted(what: str) -> SolverError:
    return _bad_mesh(f"{what} turns inside out on the curved surface", "use a finer mesh at the surface")
