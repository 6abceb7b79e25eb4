"""Estimate of the discretisation error from a smoothed strain (superconvergent patch recovery)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from skfem import ElementTetP1, ElementTetP2
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTet

from fem_reference.assembly import chunks, reference_gradients, tetrahedron_quadrature
from fem_reference.mesh import TetMesh
from solver_common.arrays import Array

_EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
_NODES = np.vstack([np.eye(4), [[0.5 * (k in edge) for k in range(4)] for edge in _EDGES]])
_CHUNK = 20_000  # elements per pass: bounds the temporary arrays
_WORST_FIT = 1e-4  # smallest over largest eigenvalue of a patch's normal matrix that still determines a fit
_BORROWED = 1e-8  # weight of a fit about a vertex that is not the node's own: counts where there is no other
_SHEAR = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])  # each shear component stands for two entries of the tensor


def displacement_gradient(mesh: TetMesh, displacement: Array, barycentric: Array) -> Array:
    """(m, Q, 3, 3) gradient du_i/dx_j at (Q, 4) barycentric points of each tetrahedron."""
    reference = reference_gradients(mesh.order, barycentric)
    local = displacement[mesh.element_nodes]
    by_coordinate = np.einsum("qna,mni->mqia", reference, local, optimize=True)
    return np.asarray(by_coordinate @ mesh.barycentric_gradients[:, None])


class StrainRecovery:
    """Smoothed strains on one mesh (Zienkiewicz and Zhu 1992, doi 10.1002/nme.1620330702).

    About each vertex a polynomial of the displacement's order is fitted to the strains at four points of each
    tetrahedron around it. A node takes the fit of its vertex, or the mean of those at its edge's ends; a patch
    too small for a fit borrows from the element's other vertices. The strain is the small one or, with `finite`,
    Green and Lagrange's, which a turn of the body leaves alone.
    """

    def __init__(self, mesh: TetMesh, *, finite: bool = False) -> None:
        self._mesh = mesh
        self._strain = _green_lagrange if finite else _strain
        self._width = mesh.element_nodes.shape[1]
        self._points, _ = tetrahedron_quadrature()
        corners = mesh.points[mesh.tetrahedra]
        reach = np.linalg.norm(corners[:, :, None] - corners[:, None], axis=3).max(axis=2)
        self._size = np.zeros(mesh.n_vertices)
        np.maximum.at(self._size, mesh.tetrahedra, reach)
        terms = len(_monomials(np.zeros((1, 3)), mesh.order)[0])
        summed = np.zeros((mesh.n_vertices, terms * terms))
        for part in self._chunks():
            basis = self._basis(part, self._points)
            products = np.einsum("evqa,evqb->evab", basis, basis)
            summed += self._incidence(part) @ products.reshape(-1, terms * terms)
        normal = summed.reshape(-1, terms, terms)
        eigenvalues = np.linalg.eigvalsh(normal)
        self._fitted = eigenvalues[:, 0] > _WORST_FIT * eigenvalues[:, -1]
        self._inverse = np.zeros_like(normal)
        self._inverse[self._fitted] = np.linalg.inv(normal[self._fitted])
        self._mass = _reference_mass(mesh.order)

    def relative_error(self, displacement: Array) -> float:
        """Estimated norm(eps(u) - eps(u_h)) / norm(eps(u_h)) for (n_nodes, 3) displacements.

        L2 norms over the body, with the recovered strain in place of the unknown one. For an incompressible
        material this is the relative error in the energy norm. Zero for a body without strain.
        """
        mesh = self._mesh
        strain = self._strain(displacement_gradient(mesh, displacement, _NODES[: self._width]))
        recovered = self._recover(displacement, strain)
        difference = recovered[mesh.element_nodes] - strain
        error, size = (
            float(np.einsum("m,mak,ab,mbk,k->", mesh.volumes, e, self._mass, e, _SHEAR, optimize=True))
            for e in (difference, strain)
        )
        return float(np.sqrt(error / size)) if size > 0.0 else 0.0

    def _recover(self, displacement: Array, strain: Array) -> Array:
        """(n_nodes, 6) recovered strains; `strain` is (m, nodes, 6), the elements' own at their nodes."""
        mesh = self._mesh
        sampled = self._strain(displacement_gradient(mesh, displacement, self._points))
        moments = np.zeros((mesh.n_vertices, self._inverse.shape[1] * 6))
        for part in self._chunks():
            products = np.einsum("evqa,eqc->evac", self._basis(part, self._points), sampled[part])
            moments += self._incidence(part) @ products.reshape(-1, moments.shape[1])
        fits = self._inverse @ moments.reshape(mesh.n_vertices, -1, 6)

        nodes = _NODES[: self._width]
        own = np.where(nodes.T > 0.0, 1.0, _BORROWED)  # (4, nodes)
        total = np.zeros((mesh.n_nodes, 7))
        for part in self._chunks():
            vertices = mesh.tetrahedra[part]
            weight = own * self._fitted[vertices][:, :, None]
            values = np.einsum("evna,evac->evnc", self._basis(part, nodes), fits[vertices], optimize=True)
            both = np.concatenate([weight[..., None] * values, weight[..., None]], axis=3).sum(axis=1)
            # Where no vertex of an element has a fit, the element's own strain is all there is.
            both += 1e-16 * np.concatenate([strain[part], np.ones((*strain[part].shape[:2], 1))], axis=2)
            entries = both.reshape(-1, 7)
            total += _gather(mesh.element_nodes[part].ravel(), mesh.n_nodes) @ entries
        return np.asarray(total[:, :6] / total[:, 6:])

    def _chunks(self) -> list[slice]:
        return chunks(len(self._mesh.volumes), _CHUNK)

    def _incidence(self, part: slice) -> csr_array:
        return _gather(self._mesh.tetrahedra[part].ravel(), self._mesh.n_vertices)

    def _basis(self, part: slice, barycentric: Array) -> Array:
        """(e, 4, Q, terms) monomials about each of an element's vertices at its (Q, 4) points."""
        mesh = self._mesh
        vertices = mesh.tetrahedra[part]
        corners = mesh.points[vertices]
        points = np.einsum("qa,eai->eqi", barycentric, corners)
        local = points[:, None] - corners[:, :, None]
        return _monomials(local / self._size[vertices][:, :, None, None], mesh.order)


def _gather(rows: NDArray[np.int64], count: int) -> csr_array:
    """(count, len(rows)) matrix that sums entries into their rows."""
    order = np.argsort(rows, kind="stable")
    indptr = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=count))])
    return csr_array((np.ones(len(rows)), order, indptr), shape=(count, len(rows)))


def _monomials(x: Array, order: int) -> Array:
    x0, x1, x2 = x[..., 0], x[..., 1], x[..., 2]
    terms = [np.ones_like(x0), x0, x1, x2]
    if order == 2:
        # The root of two makes a rotation of the axes an orthogonal mix of the terms: which patches are good
        # enough for a fit does not depend on how the body lies.
        root = np.sqrt(2.0)
        terms += [x0 * x0, x1 * x1, x2 * x2, root * x1 * x2, root * x0 * x2, root * x0 * x1]
    return np.stack(terms, axis=-1)


def _strain(gradient: Array) -> Array:
    """(..., 6) symmetric part of (..., 3, 3): xx, yy, zz, yz, xz, xy."""
    symmetric = 0.5 * (gradient + np.swapaxes(gradient, -1, -2))
    return np.asarray(symmetric[..., [0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]])


def _green_lagrange(gradient: Array) -> Array:
    """(..., 6) (H + H^T + H^T H) / 2 of displacement gradients H, in the order of `_strain`."""
    return _strain(gradient + 0.5 * np.swapaxes(gradient, -1, -2) @ gradient)


def _reference_mass(order: int) -> Array:
    """Mass matrix of the shape functions on a tetrahedron of volume one."""
    points, weights = get_quadrature(RefTet, 2 * order)
    element = ElementTetP2() if order == 2 else ElementTetP1()
    values = np.array([element.lbasis(points, i)[0] for i in range(10 if order == 2 else 4)])
    return np.asarray(6.0 * (values * weights) @ values.T)
