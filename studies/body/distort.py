"""Meshes made bad on purpose, by slivers and random shifts of nodes, to study the robustness of models."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from solver_common.arrays import Array, Index, Mask

from ..study.errors import MeshError
from .mesh import Mesh
from .surface_measures import enclosed_volume, facet_area_vectors, facet_areas
from .topology import tetrahedron_sicn, tetrahedron_volumes

SLIVER_SHARE = 0.04  # of the facets that are squeezed, if possible
_SOUND_ASPECT = 12.0  # largest ratio of longest edge to height of a facet beside a sliver
_SOUND_TURN = 0.5  # least cosine of the angle by which such a facet turns
_SOUND_SICN = 0.02  # least value of a tetrahedron outside the slivers
_HALVINGS = 12


def distorted(mesh: Mesh, *, slivers: float | None, perturbation: float | None, seed: int = 0) -> Mesh:
    """The mesh with its nodes moved, first at random, then into slivers; the same numbers give the same mesh.

    Parameters
    ----------
    slivers : ratio of longest edge to height for one facet in twenty-five. The corner that faces the longest edge
        moves within the facet's plane; the tetrahedron is flattened with it. All other facets and tetrahedra stay
        sound.
    perturbation : largest shift of a node in a random direction, as a share of its shortest edge; halved, and
        again, where a tetrahedron or a facet would turn over
    seed : decides directions and facets

    Raises
    ------
    MeshError
        no facet of the mesh can be squeezed, or no shift is small enough.
    """
    random = np.random.default_rng(seed)
    points = mesh.points.copy()
    n_slivers = 0
    if perturbation is not None:
        points = _perturbed(mesh, perturbation, random)
    if slivers is not None:
        n_slivers = _squeeze(points, mesh, slivers, random)
    triangles = mesh.surface_nodes[mesh.triangles]
    figures = {
        "volume": enclosed_volume(points, triangles),
        "area": float(facet_areas(points, triangles).sum()),
        "slivers": float(n_slivers),
        "worst_aspect_ratio": float(aspect_ratios(points, triangles).max()),
    }
    if len(mesh.tetrahedra):
        figures["worst_sicn"] = float(tetrahedron_sicn(points, mesh.tetrahedra).min())
    return replace(mesh, points=points, quality={**mesh.quality, **figures}, moved=None)


def aspect_ratios(points: Array, triangles: Index) -> Array:
    """(F,) longest edge of each facet over its height on it; 1.15 for an equilateral one."""
    p = points[triangles]
    longest = np.linalg.norm(p - np.roll(p, 1, axis=1), axis=2).max(axis=1)
    ratios: Array = longest**2 / (2.0 * facet_areas(points, triangles))
    return ratios


# --- random shifts ---


def _perturbed(mesh: Mesh, share: float, random: np.random.Generator) -> Array:
    points, triangles = mesh.points, mesh.surface_nodes[mesh.triangles]
    cells = mesh.tetrahedra if len(mesh.tetrahedra) else triangles
    direction = random.normal(size=points.shape)
    direction *= random.random(len(points))[:, None] ** (1 / 3) / np.linalg.norm(
        direction, axis=1, keepdims=True
    )
    shift = share * _shortest_edges(points, cells)[:, None] * direction
    normals = facet_area_vectors(points, triangles)
    for _ in range(_HALVINGS):
        moved = points + shift
        along = np.einsum("fi,fi->f", facet_area_vectors(moved, triangles), normals)
        size = facet_areas(moved, triangles) * np.linalg.norm(normals, axis=1)
        turned = [triangles[along <= 0.2 * size]]
        if len(mesh.tetrahedra):
            turned.append(mesh.tetrahedra[tetrahedron_sicn(moved, mesh.tetrahedra) <= _SOUND_SICN])
        nodes = np.unique(np.concatenate([part.ravel() for part in turned]))
        if not len(nodes):
            return moved
        shift[nodes] *= 0.5
    raise MeshError("the mesh is too poor to be perturbed; use another mesh_size")


def _shortest_edges(points: Array, cells: Index) -> Array:
    shortest = np.full(len(points), np.inf)
    for k in range(cells.shape[1]):
        for j in range(k):
            length = np.linalg.norm(points[cells[:, k]] - points[cells[:, j]], axis=1)
            np.minimum.at(shortest, cells[:, k], length)
            np.minimum.at(shortest, cells[:, j], length)
    return shortest


# --- slivers ---


def _squeeze(points: Array, mesh: Mesh, ratio: float, random: np.random.Generator) -> int:
    """Squeeze some facets by moving one corner in `points`; no two share a neighbour. Returns their number."""
    triangles = mesh.surface_nodes[mesh.triangles]
    wanted = max(1, round(SLIVER_SHARE * len(triangles)))
    facets_of = _incidence(triangles, len(points))
    cells_of = _incidence(mesh.tetrahedra, len(points))
    taken = np.zeros(len(points), dtype=bool)
    made = 0
    for facet in random.permutation(len(triangles)):
        node, place = _squeezed(points[triangles[facet]], ratio)
        node = triangles[facet, node]
        around = _row(facets_of, node)
        if taken[triangles[around]].any():
            continue
        others = around[around != facet]
        before = facet_area_vectors(points, triangles[others])
        kept = points[node].copy()
        points[node] = place
        if not (
            _facets_sound(points, triangles[others], before)
            and _cells_sound(points, mesh, cells_of, node, triangles[facet])
        ):
            points[node] = kept
            continue
        taken[triangles[around]] = True
        made += 1
        if made == wanted:
            break
    if not made:
        raise MeshError(
            "no facet of this mesh can be squeezed without turning its neighbours; use a smaller mesh_size"
        )
    return made


def _squeezed(corners: Array, ratio: float) -> tuple[int, Array]:
    """The corner that faces a facet's longest edge, and its new place (3,)."""
    lengths = [float(np.linalg.norm(corners[k - 1] - corners[k - 2])) for k in range(3)]
    k = int(np.argmax(lengths))
    along = (corners[k - 2] - corners[k - 1]) / lengths[k]
    foot = corners[k - 1] + ((corners[k] - corners[k - 1]) @ along) * along
    height = corners[k] - foot
    return k, foot + height * (lengths[k] / ratio / float(np.linalg.norm(height)))


def _facets_sound(points: Array, triangles: Index, before: Array) -> bool:
    after = facet_area_vectors(points, triangles)
    sizes = np.linalg.norm(after, axis=1) * np.linalg.norm(before, axis=1)
    turned = np.einsum("fi,fi->f", after, before) < _SOUND_TURN * sizes
    return not turned.any() and bool((aspect_ratios(points, triangles) <= _SOUND_ASPECT).all())


def _cells_sound(points: Array, mesh: Mesh, cells_of: sparse.csr_array, node: int, facet: Index) -> bool:
    """Whether all tetrahedra at a node are sound; the one on its sliver need only not turn over."""
    cells = mesh.tetrahedra[_row(cells_of, node)]
    flat: Mask = np.isin(cells, facet).sum(axis=1) == 3
    return bool(
        (tetrahedron_sicn(points, cells[~flat]) > _SOUND_SICN).all()
        and (tetrahedron_volumes(points, cells[flat]) > 0.0).all()
    )


def _incidence(cells: Index, n_points: int) -> sparse.csr_array:
    """(n_points, cells): which cells a point belongs to."""
    columns = np.repeat(np.arange(len(cells)), cells.shape[1])
    return sparse.csr_array(
        (np.ones(cells.size, dtype=bool), (cells.ravel(), columns)), shape=(n_points, len(cells))
    )


def _row(matrix: sparse.csr_array, row: int) -> Index:
    found: Index = matrix.indices[matrix.indptr[row] : matrix.indptr[row + 1]].astype(np.int64)
    return found
