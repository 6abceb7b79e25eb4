"""A checked tetrahedral mesh with scikit-fem's P1 or P2 node numbering and the map to its surface."""

from __future__ import annotations

from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from skfem import Basis, ElementTetP1, ElementTetP2, ElementVector, MeshTet
from skfem.assembly import Dofs

from solver_common.arrays import Array, Index
from solver_common.quadrature import facet_quadrature as facet_quadrature
from solver_common.solution import solver_error

_bad_mesh = partial(solver_error, "bad-mesh")

# A tetrahedron whose volume is below this share of its longest edge cubed is flat to rounding.
_FLAT = 1e-12


def triangle_p2(barycentric: Array) -> Array:
    """P2 shape functions on a triangle: (Q, 6) at (Q, 3) points; vertices, then edges 01, 12, 20."""
    b = barycentric
    edges = [4.0 * b[:, i] * b[:, j] for i, j in ((0, 1), (1, 2), (2, 0))]
    return np.column_stack([*(b[:, i] * (2.0 * b[:, i] - 1.0) for i in range(3)), *edges])


class TetMesh:
    """A tetrahedral mesh, its boundary surface and the nodes of a P1 or P2 element on it.

    Nodes are numbered as scikit-fem does: the vertices first, then (P2) one per edge.

    Parameters
    ----------
    points : (n, 3) coordinates [m], each used by a tetrahedron
    tetrahedra : (m, 4) indices into `points`, positive volume
    surface_nodes : (N,) indices into `points`
    triangles : (F, 3) indices into `surface_nodes`: the whole boundary, outward
    parts : (m,) number of the part of the body that each tetrahedron belongs to, or None for one part

    Attributes
    ----------
    order : 1 or 2
    pressure_elements : (m, 4) numbers of the P1 pressures of each tetrahedron: one per vertex, and one per part
        where parts meet
    pressure_vertices : (n_pressures,) the vertex of each pressure
    element_nodes : (m, 4 or 10) node numbers
    volumes : (m,) [m^3]
    barycentric_gradients : (m, 3, 3), row a the gradient of the coordinate of vertex a + 1 [1/m]
    area_vectors : (F, 3) outward area vectors of the facets [m^2]
    facet_nodes : (F, 3 or 6) node numbers: vertices, then edges 01, 12, 20
    facet_edges : (F, 3 or 0) which boundary edge each edge of a facet is
    surface_edges : (E, 2) surface-node indices of the ends of each boundary edge
    surface_edge_nodes : (E,) node number of each boundary edge; empty for P1

    Raises
    ------
    SolverError
        On arrays of a wrong shape, indices out of range, unused points, flat or inverted tetrahedra,
        and triangles that are not the outward boundary of the tetrahedra.
    """

    def __init__(
        self,
        points: ArrayLike,
        tetrahedra: ArrayLike,
        surface_nodes: ArrayLike,
        triangles: ArrayLike,
        *,
        order: int = 2,
        parts: ArrayLike | None = None,
    ) -> None:
        self.points = np.ascontiguousarray(points, dtype=np.float64)
        self.tetrahedra = np.ascontiguousarray(tetrahedra, dtype=np.int64)
        self.surface_nodes = np.ascontiguousarray(surface_nodes, dtype=np.int64)
        self.triangles = np.ascontiguousarray(triangles, dtype=np.int64)
        self.order = order
        self._check_arrays()
        self.volumes, self.barycentric_gradients = self._affine_maps()
        self.area_vectors = self._area_vectors()
        self.skfem_mesh = MeshTet(
            np.ascontiguousarray(self.points.T), np.ascontiguousarray(self.tetrahedra.T.astype(np.int32))
        )
        self._number_nodes()
        self.pressure_elements, self.pressure_vertices = self._number_pressures(parts)

    @property
    def n_pressures(self) -> int:
        """Number of P1 pressures, n where there is one part."""
        return len(self.pressure_vertices)

    @cached_property
    def pressure_mesh(self) -> MeshTet:
        """scikit-fem's mesh of the same tetrahedra, cut open between parts; its vertices carry the pressures."""
        points, elements = self.points[self.pressure_vertices], self.pressure_elements
        return MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(elements.T.astype(np.int32)))

    @property
    def n_vertices(self) -> int:
        """Number of points n."""
        return len(self.points)

    @property
    def volume(self) -> float:
        """Volume of the body [m^3]."""
        return float(self.volumes.sum())

    @cached_property
    def mean_edge(self) -> float:
        """Mean edge length of the tetrahedra [m]."""
        corners = self.points[self.tetrahedra]
        edges = [corners[:, j] - corners[:, i] for i in range(4) for j in range(i + 1, 4)]
        return float(np.mean([np.linalg.norm(e, axis=1).mean() for e in edges]))

    @cached_property
    def node_points(self) -> Array:
        """(n_nodes, 3) coordinates of all nodes, vertices first [m]."""
        if self.order == 1:
            return self.points
        ends = np.asarray(self.skfem_mesh.edges)
        return np.vstack([self.points, 0.5 * (self.points[ends[0]] + self.points[ends[1]])])

    @cached_property
    def edge_vertices(self) -> Index:
        """(n_edges, 2) vertices at the ends of each edge; node n_vertices + e is the middle of edge e."""
        return np.ascontiguousarray(np.asarray(self.skfem_mesh.edges).T, dtype=np.int64)

    @cached_property
    def components(self) -> tuple[int, Index]:
        """Number of separate bodies and the (n,) body of each vertex."""
        first = np.repeat(self.tetrahedra[:, 0], 3)
        other = self.tetrahedra[:, 1:].ravel()
        n = self.n_vertices
        count, labels = connected_components(
            coo_array((np.ones(len(first), dtype=np.int8), (first, other)), shape=(n, n)), directed=False
        )
        return int(count), np.asarray(labels, dtype=np.int64)

    def bases(self, intorder: int = 2) -> tuple[Basis, Basis]:
        """scikit-fem's bases of displacement and pressure, for custom forms.

        A flat nodal field (n_nodes, 3) is a dof vector of the first; pressures (n_pressures,) are one of the
        second.

        Parameters
        ----------
        intorder : degree to which integrals over a tetrahedron are exact
        """
        element = ElementTetP2() if self.order == 2 else ElementTetP1()
        displacement = Basis(self.skfem_mesh, ElementVector(element), intorder=intorder)
        return displacement, Basis(self.pressure_mesh, ElementTetP1(), intorder=intorder)

    def facet_functions(self, barycentric: Array) -> Array:
        """(Q, 3 or 6) shape functions on a facet at (Q, 3) points."""
        return triangle_p2(barycentric) if self.order == 2 else barycentric

    def summed(self, nodes: Index, local: Array) -> Array:
        """(n_nodes, 3) sums of (k, w, 3) values at (k, w) nodes."""
        out = np.empty((self.n_nodes, 3))
        for i in range(3):
            out[:, i] = np.bincount(nodes.ravel(), weights=local[..., i].ravel(), minlength=self.n_nodes)
        return out

    def _check_arrays(self) -> None:
        for name, array, width in (
            ("points", self.points, 3),
            ("tetrahedra", self.tetrahedra, 4),
            ("triangles", self.triangles, 3),
        ):
            if array.ndim != 2 or array.shape[1] != width or not len(array):
                raise _bad_mesh(f"{name} has shape {array.shape}", f"give an array of shape (count, {width})")
        if not np.isfinite(self.points).all():
            raise _bad_mesh("points has values that are not finite", "repair the mesh")
        for name, index, size in (
            ("tetrahedra", self.tetrahedra, len(self.points)),
            ("surface_nodes", self.surface_nodes, len(self.points)),
            ("triangles", self.triangles, len(self.surface_nodes)),
        ):
            if index.min() < 0 or index.max() >= size:
                raise _bad_mesh(f"{name} has an index outside 0..{size - 1}", "repair the mesh")
        unused = int((np.bincount(self.tetrahedra.ravel(), minlength=len(self.points)) == 0).sum())
        if unused:
            raise _bad_mesh(
                f"{unused} of {len(self.points)} points belong to no tetrahedron", "remove them from the mesh"
            )

    def _affine_maps(self) -> tuple[Array, Array]:
        corners = self.points[self.tetrahedra]
        edges = corners[:, 1:] - corners[:, :1]
        first, second, third = edges[:, 0], edges[:, 1], edges[:, 2]
        cofactors = np.stack(
            [np.cross(second, third), np.cross(third, first), np.cross(first, second)], axis=1
        )
        six_volumes = np.einsum("ij,ij->i", first, cofactors[:, 0])
        lengths = [np.linalg.norm(corners[:, j] - corners[:, i], axis=1) for i in range(4) for j in range(i)]
        size = np.max(lengths, axis=0)
        flat = np.abs(six_volumes) <= _FLAT * size**3
        if flat.any():
            raise _bad_mesh(
                f"{flat.sum()} of {len(flat)} tetrahedra have no volume (the first is number {np.argmax(flat)})",
                "remesh the body",
            )
        inverted = six_volumes < 0
        if inverted.any():
            raise _bad_mesh(
                f"{inverted.sum()} of {len(inverted)} tetrahedra are inverted"
                f" (the first is number {np.argmax(inverted)})",
                "swap two of their vertices or remesh the body",
            )
        return six_volumes / 6.0, cofactors / six_volumes[:, None, None]

    def _area_vectors(self) -> Array:
        corners = self.points[self.surface_nodes[self.triangles]]
        area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        enclosed = np.einsum("fi,fi->", area, corners.mean(axis=1)) / 3.0
        # A closed surface has no net area vector. An outward one encloses the volume of the tetrahedra; that sum
        # is about the origin, so that its tolerance grows with the distance from it.
        total = np.linalg.norm(area, axis=1).sum()
        if np.linalg.norm(area.sum(axis=0)) > 1e-10 * total:
            raise _bad_mesh("the triangles leave a hole", "give the whole boundary of the tetrahedra")
        reach = np.abs(corners).max() * total
        if abs(enclosed - self.volume) > 1e-9 * self.volume + 1e-13 * reach:
            raise _bad_mesh(
                f"the triangles enclose {enclosed:.6g} m^3 but the tetrahedra fill {self.volume:.6g} m^3",
                "give the whole boundary of the tetrahedra with outward triangles",
            )
        return area

    def _number_pressures(self, parts: ArrayLike | None) -> tuple[Index, Index]:
        if parts is None:
            return self.tetrahedra, np.arange(self.n_vertices)
        given = np.asarray(parts)
        if given.shape != self.volumes.shape or not np.issubdtype(given.dtype, np.integer):
            raise _bad_mesh(
                f"parts is an array of {given.dtype} of shape {given.shape}",
                f"give a whole number for each of {len(self.volumes)} tetrahedra",
            )
        label = np.unique(given, return_inverse=True)[1]
        keys, numbers = np.unique(label[:, None] * self.n_vertices + self.tetrahedra, return_inverse=True)
        return numbers.reshape(-1, 4), keys % self.n_vertices

    def _number_nodes(self) -> None:
        dofs = Dofs(self.skfem_mesh, ElementTetP2() if self.order == 2 else ElementTetP1())
        self.element_nodes: Index = np.ascontiguousarray(dofs.element_dofs.T, dtype=np.int64)
        self.n_nodes = int(dofs.N)
        corners = self.surface_nodes[self.triangles]
        self.facet_nodes: Index = corners
        self.facet_edges: Index = np.empty((len(corners), 0), dtype=np.int64)
        self.surface_edges: Index = np.empty((0, 2), dtype=np.int64)
        self.surface_edge_nodes: Index = np.empty(0, dtype=np.int64)
        if self.order == 1:
            return
        pairs = np.stack([self.triangles, np.roll(self.triangles, -1, axis=1)], axis=2).reshape(-1, 2)
        vertex_pairs = self.surface_nodes[pairs]
        n = self.n_vertices
        ends = np.sort(np.asarray(self.skfem_mesh.edges, dtype=np.int64), axis=0)
        keys = ends[0] * n + ends[1]
        by_key = np.argsort(keys)
        wanted = vertex_pairs.min(axis=1) * n + vertex_pairs.max(axis=1)
        place = np.minimum(np.searchsorted(keys[by_key], wanted), len(keys) - 1)
        edges = by_key[place]
        if (keys[edges] != wanted).any():
            raise _bad_mesh(
                "a triangle has an edge that no tetrahedron has", "give the boundary of the tetrahedra"
            )
        edge_nodes = np.asarray(dofs.edge_dofs[0], dtype=np.int64)[edges]
        self.facet_nodes = np.hstack([corners, edge_nodes.reshape(-1, 3)])
        self.surface_edge_nodes, first, facet_edges = np.unique(
            edge_nodes, return_index=True, return_inverse=True
        )
        self.surface_edges = pairs[first]
        self.facet_edges = facet_edges.reshape(-1, 3)
