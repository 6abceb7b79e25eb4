"""Sparsity patterns that all blocks of a mesh share, scikit-fem's tables of an element, and its simple operators.

Method: Galerkin. Order: exact, the integrands are of degree 2. Source: scikit-fem's forms and element tables.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from skfem import Basis, BilinearForm, ElementTetP1, ElementTetP2, LinearForm

from fem_reference.mesh import TetMesh
from solver_common.arrays import Array, Index


def tetrahedron_quadrature() -> tuple[Array, Array]:
    """Four points exact to degree 2: (4, 4) barycentric coordinates and (4,) weights summing to one."""
    a = (5.0 - np.sqrt(5.0)) / 20.0
    return np.full((4, 4), a) + (1.0 - 4.0 * a) * np.eye(4), np.full(4, 0.25)


def reference_gradients(order: int, barycentric: Array) -> Array:
    """Reference gradients of scikit-fem's P1 or P2 basis: (Q, nodes, 3) at (Q, 4) barycentric points."""
    element = ElementTetP2() if order == 2 else ElementTetP1()
    points = barycentric[:, 1:].T
    zero = np.zeros(points.shape[1])
    nodes = 10 if order == 2 else 4
    # basis functions may return scalars or integers: adding zeros gives all one shape
    gradients = [[component + zero for component in element.lbasis(points, i)[1]] for i in range(nodes)]
    return np.asarray(gradients, dtype=np.float64).transpose(2, 0, 1)


@dataclass(frozen=True)
class Pattern:
    """The scalar sparsity pattern of rows and nodes that share an element; rows are nodes or P1 pressures.

    Attributes
    ----------
    indptr, indices : CSR pattern with sorted columns, 32-bit
    place : (m, rows * nodes) position of each element entry (row major) in `indices`
    columns : number of nodes
    """

    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    place: Index
    columns: int

    @property
    def size(self) -> int:
        """Number of stored entries."""
        return len(self.indices)

    @cached_property
    def numbered(self) -> csr_array:
        """The pattern as a matrix whose entries are their own positions, for cutting out blocks."""
        shape = (len(self.indptr) - 1, self.columns)
        return csr_array((np.arange(self.size), self.indices, self.indptr), shape=shape)

    @cached_property
    def mirror(self) -> Index:
        """(size,) position of the transposed entry, where rows are nodes."""
        return csr_array(self.numbered.T).data

    def places(self, nodes: Index) -> Index:
        """(k * w * w,) positions of all pairs of the w nodes in each of k rows, row major."""
        width = nodes.shape[1]
        rows, columns = np.repeat(nodes, width, axis=1).ravel(), np.tile(nodes, (1, width)).ravel()
        return np.asarray(self.numbered[rows, columns]).ravel()


def scalar_pattern(mesh: TetMesh) -> Pattern:
    """The pattern of all node pairs that share an element, found by the node-to-element incidence.

    Sorting then happens within rows only.
    """
    nodes = mesh.element_nodes
    m, width = nodes.shape
    incidence = csr_array(
        coo_array(
            (np.arange(m * width), (nodes.ravel(), np.arange(m).repeat(width))), shape=(mesh.n_nodes, m)
        )
    )
    gathered = csr_array(
        (
            (incidence.data[:, None] * width + np.arange(width)).ravel(),
            nodes[incidence.indices].ravel().astype(np.int32),
            incidence.indptr.astype(np.int64) * width,
        ),
        shape=(mesh.n_nodes, mesh.n_nodes),
    )
    gathered.sort_indices()
    starts = np.zeros(len(gathered.indices), dtype=bool)
    starts[1:] = gathered.indices[1:] != gathered.indices[:-1]
    starts[gathered.indptr[:-1]] = True
    entry = np.cumsum(starts) - 1
    place = np.empty(m * width * width, dtype=np.int64)
    place[gathered.data] = entry
    indices = gathered.indices[starts].astype(np.int32)
    indptr = np.append(entry[gathered.indptr[:-1]], len(indices)).astype(np.int32)
    return Pattern(indptr, indices, place.reshape(m, width * width), mesh.n_nodes)


def coupling_pattern(mesh: TetMesh, pattern: Pattern) -> Pattern:
    """The pattern of all pairs of a pressure and a node that share an element."""
    m, width = mesh.element_nodes.shape
    if mesh.pressure_elements is mesh.tetrahedra:  # the vertices are the first nodes
        indptr = pattern.indptr[: mesh.n_vertices + 1]
        place = pattern.place[:, : 4 * width]
        return Pattern(indptr, pattern.indices[: indptr[-1]], place, mesh.n_nodes)
    keys = mesh.pressure_elements[:, :, None] * mesh.n_nodes + mesh.element_nodes[:, None, :]
    entries, place = np.unique(keys, return_inverse=True)
    counts = np.bincount(entries // mesh.n_nodes, minlength=mesh.n_pressures)
    indptr = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    columns = (entries % mesh.n_nodes).astype(np.int32)
    return Pattern(indptr, columns, place.reshape(m, 4 * width), mesh.n_nodes)


def mass_matrix(mesh: TetMesh, weights: Array | None = None) -> csr_array:
    """Mass matrix (n, n) of the P1 pressures, weighted by tetrahedron (m,), from scikit-fem [m^3]."""
    basis = Basis(mesh.pressure_mesh, ElementTetP1(), intorder=2, disable_doflocs=True)
    scale = np.ones((1, 1)) if weights is None else weights[:, None]
    return csr_array(BilinearForm(lambda p, q, w: w.scale * p * q).assemble(basis, scale=scale))


def gravity_weights(mesh: TetMesh) -> Array:
    """(n_nodes,) integrals of the shape functions, by scikit-fem [m^3]."""
    element = ElementTetP2() if mesh.order == 2 else ElementTetP1()
    basis = Basis(mesh.skfem_mesh, element, intorder=mesh.order, disable_doflocs=True)
    return np.asarray(LinearForm(lambda v, _: 1.0 * v).assemble(basis))


def chunks(count: int, most: int) -> list[slice]:
    """Slices of at most `most` items that cover `count`."""
    return [slice(start, min(start + most, count)) for start in range(0, count, most)]
