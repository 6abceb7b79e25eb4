"""Uniform refinement of a mesh, every tetrahedron into eight, with the same body, supports and loads.

Facets of the coarse mesh stay flat. Between levels only the discretisation changes, not the shape or the area of
a support.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from solver_common.arrays import Array, Index, Mask

from .mesh import Mesh
from .topology import half_edges, tetrahedron_volumes


@dataclass(frozen=True)
class Hierarchy:
    """A mesh and its uniform refinements, coarsest first, and each refinement's `parents` from `refine`."""

    meshes: tuple[Mesh, ...]
    parents: tuple[Index, ...] = ()

    @property
    def finest(self) -> Mesh:
        """The finest mesh."""
        return self.meshes[-1]

    def inherit(self, mask: Mask) -> Mask:
        """Nodes of a region on the finest mesh, from those on the coarsest."""
        for mesh, parents in zip(self.meshes, self.parents, strict=False):
            mask = inherit(mask, mesh, parents)
        return mask

    def inherit_line(self, mask: Mask) -> Mask:
        """Nodes of a line on the finest mesh: the coarse nodes, and the middles of the edges between them."""
        for parents in self.parents:
            mask = np.asarray(mask[parents].all(axis=1))
        return mask

    def inherit_inside(self, mask: Mask) -> Mask:
        """(m,) mask of tetrahedra on the finest mesh, from that on the coarsest."""
        for mesh in self.meshes[:-1]:
            fine = _of_skfem(mesh).with_subdomains({"inside": np.flatnonzero(mask)}).refined()
            mask = np.isin(np.arange(fine.nelements), fine.subdomains["inside"])
        return mask

    def restrict(self, force: Array) -> Array:
        """(S, N, 3) nodal forces on the finest mesh -> (S, n, 3) on the coarsest: half of each to either parent."""
        for parents in reversed(self.parents):
            coarser = np.zeros((int(parents.max()) + 1, len(force), force.shape[2]))
            for end in parents.T:  # the parents of an old node are both the node itself
                np.add.at(coarser, end, 0.5 * force.swapaxes(0, 1))
            force = coarser.swapaxes(0, 1)
        return force


def refined(mesh: Mesh, times: int) -> Hierarchy:
    """A mesh refined so many times."""
    hierarchy = Hierarchy((mesh,))
    for _ in range(times):
        finer, parents = refine(hierarchy.finest)
        hierarchy = Hierarchy((*hierarchy.meshes, finer), (*hierarchy.parents, parents))
    return hierarchy


def refine(mesh: Mesh) -> tuple[Mesh, Index]:
    """Split every tetrahedron into eight and every facet into four; facets alone where no model needs the inside.

    Returns
    -------
    mesh : its first surface nodes are those of the coarse mesh, in their order
    parents : (N, 2) for each surface node of the new mesh the two ends of the coarse edge that it halves;
        an old node twice
    """
    # edges of the body may join two surface nodes through the inside: use the edges of facets only
    pairs, number = np.unique(np.sort(half_edges(mesh.triangles), axis=1), axis=0, return_inverse=True)
    ends = mesh.surface_nodes[pairs]
    if len(mesh.tetrahedra):
        points, tetrahedra, middles = _split_inside(mesh, ends)
    else:
        points, tetrahedra = np.concatenate([mesh.points, mesh.points[ends].mean(axis=1)]), mesh.tetrahedra
        middles = len(mesh.points) + np.arange(len(ends))
    order = np.argsort(middles)
    pairs, middles = pairs[order], middles[order]

    old = np.arange(len(mesh.surface_nodes))
    a, b, c = mesh.triangles.T
    ab, bc, ca = (len(old) + np.argsort(order)[number.ravel()]).reshape(-1, 3).T
    corners = [a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca]  # of four facets
    refined = Mesh(
        points=points,
        tetrahedra=tetrahedra,
        surface_nodes=np.concatenate([mesh.surface_nodes, middles]),
        triangles=np.stack(corners, axis=1).reshape(-1, 3),
    )
    return refined, np.concatenate([np.column_stack([old, old]), pairs])


def _split_inside(mesh: Mesh, pairs: Index) -> tuple[Array, Index, Index]:
    """Points, the eight parts of each tetrahedron, and the points that halve the edges `pairs` (k, 2)."""
    coarse = _of_skfem(mesh)
    fine = coarse.refined()
    # the parts of a tetrahedron may have either orientation
    tetrahedra = fine.t.T.astype(np.int64)
    inverted = tetrahedron_volumes(fine.p.T, tetrahedra) < 0
    tetrahedra[inverted, :2] = tetrahedra[inverted, 1::-1]
    # node n + e halves edge e
    edge_of = {tuple(sorted(pair)): edge for edge, pair in enumerate(coarse.edges.T.tolist())}
    middles = np.array([len(mesh.points) + edge_of[tuple(sorted(pair))] for pair in pairs.tolist()])
    return np.ascontiguousarray(fine.p.T), tetrahedra, middles


def _of_skfem(mesh: Mesh) -> Any:
    import skfem  # slow to load, and not needed to plan

    return skfem.MeshTet(mesh.points.T.copy(), mesh.tetrahedra.T.copy())


def inherit(mask: Mask, mesh: Mesh, parents: Index) -> Mask:
    """A region's nodes on the refined mesh: its coarse nodes, and the middles of the edges of its facets.

    Parameters
    ----------
    mask : (n,) nodes on the coarse mesh
    mesh : the coarse mesh
    parents : (N, 2) from `refine`
    """
    inside = np.sort(mesh.triangles[np.all(mask[mesh.triangles], axis=1)], axis=1)
    edges = np.concatenate([inside[:, [i, j]] for i, j in ((0, 1), (1, 2), (0, 2))])
    n_nodes = len(mesh.surface_nodes)
    first, second = parents.T  # the lower number first, as in a sorted facet
    middle = np.isin(first * n_nodes + second, edges[:, 0] * n_nodes + edges[:, 1])
    return np.where(first == second, mask[first], middle)
