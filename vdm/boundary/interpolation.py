"""Interpolation from the nodes of a coarse surface to those of the fine one; its transpose gathers forces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from solver_common.arrays import Array, Index
from vdm.boundary.coarsening import CoarseSurface, nearest
from vdm.surface import SurfaceMesh

# in a direction where a stencil is flatter than this share of its width, it gets no linear term
FLAT = 1e-6
# largest rounding error of weights and of positions
ROUNDING = 1e-11
# largest sum of absolute weights of a node; a stencil with a larger sum is too flat and grows
LARGEST_SUM = 5.0


@dataclass(frozen=True)
class Interpolation:
    """`weights` (N, n), with rows of sum 1, and `cells` (N,): the coarse node nearest along the surface."""

    weights: sparse.csr_array
    cells: Index


def interpolation(surface: SurfaceMesh, coarse: CoarseSurface) -> Interpolation:
    """Smooth interpolation by r^3 and linear terms over a coarse node and its two rings (Wendland 2005, section 8).

    Rings follow the surface, so that one side of a thin part does not see the other. A stencil gains rings where
    its nodes are flatter than the fine nodes between them, until linear fields, and so rigid motions, are exact.
    """
    n, count = surface.n_nodes, coarse.surface.n_nodes
    cells = nearest(surface, coarse)
    i, j = coarse.surface.edges.T
    ring = sparse.csr_array((np.ones(len(i)), (i, j)), shape=(count, count))
    ring = sparse.csr_array(ring + ring.T + sparse.eye_array(count))
    rings = sparse.csr_array(ring @ ring)
    rings.sort_indices()
    two_rings = np.split(rings.indices.astype(np.int64), rings.indptr[1:-1])
    members = np.split(np.argsort(cells, kind="stable"), np.cumsum(np.bincount(cells, minlength=count))[:-1])
    rows: list[Index] = []
    columns: list[Index] = []
    values: list[Array] = []
    for cell, nodes in enumerate(members):
        if not len(nodes):
            continue
        stencil, weights = _cell(ring, two_rings[cell], coarse.surface.points, surface.points[nodes])
        rows.append(np.repeat(nodes, len(stencil)))
        columns.append(np.tile(stencil, len(nodes)))
        values.append(weights.ravel())
    data = np.concatenate(values)
    # a fine node at the place of a coarse one takes its value alone: the other weights are rounding
    data[np.abs(data) < ROUNDING] = 0.0
    # 32 bits: a product reads a quarter less
    i, j = (np.concatenate(part).astype(np.int32) for part in (rows, columns))
    matrix = sparse.csr_array((data, (i, j)), shape=(n, count))
    matrix.eliminate_zeros()
    return Interpolation(matrix, cells)


def identity(count: int) -> Interpolation:
    """The interpolation of a surface of `count` nodes that is its own coarse surface."""
    return Interpolation(sparse.csr_array(sparse.eye_array(count)), np.arange(count))


def _cell(ring: sparse.csr_array, stencil: Index, coarse: Array, targets: Array) -> tuple[Index, Array]:
    """The stencil (m,) of a coarse node, two rings or more, and its weights (t, m) in the fine nodes `targets`."""
    while True:
        weights = _polyharmonic(coarse[stencil], targets)
        off = np.abs(weights @ coarse[stencil] - targets).max()
        exact = off <= ROUNDING * np.ptp(coarse[stencil], axis=0).max()
        if exact and np.abs(weights).sum(axis=1).max() <= LARGEST_SUM:
            return stencil, weights
        wider = _around(ring, stencil)
        if len(wider) == len(stencil):  # the whole shell of a small cavity: no nodes are left to add
            return stencil, weights
        stencil = wider


def _around(ring: sparse.csr_array, nodes: Index) -> Index:
    """The nodes and their neighbours, in ascending order."""
    return np.unique(ring[nodes].indices).astype(np.int64)


def _polyharmonic(stencil: Array, targets: Array) -> Array:
    """(t, m) weights of the values at m stencil points in the value at each of t targets."""
    centre = stencil.mean(axis=0)
    centred = stencil - centre
    width, axes = np.linalg.svd(centred, full_matrices=False)[1:]
    axes = axes[width > FLAT * width[0]] / width[0]
    here = np.column_stack([np.ones(len(stencil)), centred @ axes.T])
    there = np.column_stack([np.ones(len(targets)), (targets - centre) @ axes.T])
    m, terms = here.shape
    matrix = np.zeros((m + terms, m + terms))
    matrix[:m, :m] = (np.linalg.norm(stencil[:, None] - stencil, axis=2) / width[0]) ** 3
    matrix[:m, m:] = here
    matrix[m:, :m] = here.T
    distance = (np.linalg.norm(targets[:, None] - stencil, axis=2) / width[0]) ** 3
    weights: Array = np.linalg.solve(matrix, np.column_stack([distance, there]).T)[:m].T
    return weights
