"""A coarser surface on a fine one, by edge collapses that keep it closed, its genus and its grading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from solver_common.arrays import Array, Index, Mask
from vdm.boundary.collapses import costs, usable
from vdm.boundary.spacing import evenly_spaced
from vdm.surface import SurfaceMesh

# share of the edges that a round considers, the shortest, and of the nodes found that it may collapse, the cheapest
SHARE = 0.2
# numbers near 1 that agree to this many decimals count as equal
DECIMALS = 10


@dataclass(frozen=True)
class CoarseSurface:
    """The coarse surface. Its nodes lie on fine triangles, at `shares` (n, 3) of their `corners` (n, 3)."""

    surface: SurfaceMesh
    corners: Index
    shares: Array


def coarsened(surface: SurfaceMesh, count: int, held: Mask | None = None) -> CoarseSurface:
    """A surface on about `count` points of the given one, or on more where no more can collapse.

    A node moves onto a neighbour if the two share just two neighbours (which keeps the topology) and no facet
    turns over or degenerates. The shortest new edges go first. Each round moves all nodes whose neighbourhoods do
    not touch. The remaining nodes then slide over the surface until they are evenly spaced. Lengths are in units
    of the local mesh size, so that the coarse mesh keeps the grading of the fine one. At the rim of the `held`
    nodes (N,) it is finer, by up to half.
    """
    order = node_order(surface)
    sizes = np.sqrt(surface.nodal_areas)
    if held is not None:
        sizes = sizes * _grading(surface, count, held)
    sizes = sizes[order]
    scale = 1.0 / sizes.mean()
    sizes = scale * sizes
    points = scale * (surface.points[order] - surface.points.mean(axis=0))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    fine = triangles = place[surface.triangles]
    n = alive = surface.n_nodes
    random = np.random.default_rng(0)
    while alive > count:
        nodes, onto = _candidates(points, sizes, triangles, SHARE)
        if not len(nodes):
            nodes, onto = _candidates(points, sizes, triangles, 1.0)
        if not len(nodes):
            break
        taken = _independent(triangles, n, nodes, random)[: alive - count]
        target = np.arange(n)
        target[nodes[taken]] = onto[taken]
        moved = target[triangles]
        a, b, c = moved.T
        triangles = moved[(a != b) & (b != c) & (c != a)]
        alive -= len(taken)
    kept, facets = np.unique(triangles, return_inverse=True)
    facets, corners, shares = evenly_spaced(points, fine, sizes, points[kept], facets.reshape(-1, 3))
    corners = order[corners]
    places = np.einsum("na,nac->nc", shares, surface.points[corners])
    return CoarseSurface(SurfaceMesh(places, facets), corners, shares)


def nearest(surface: SurfaceMesh, coarse: CoarseSurface) -> Index:
    """(N,) the nearest coarse node: distances follow the edges, and go straight across its own triangle."""
    n, count = surface.n_nodes, coarse.surface.n_nodes
    node, corner = np.nonzero(coarse.shares)
    start = np.concatenate([surface.edges[:, 0], coarse.corners[node, corner]])
    end = np.concatenate([surface.edges[:, 1], n + node])
    points = np.concatenate([surface.points, coarse.surface.points])
    # a stored zero would be no edge
    lengths = np.linalg.norm(points[start] - points[end], axis=1) + np.finfo(np.float64).tiny
    graph = sparse.csr_array((lengths, (start, end)), shape=(n + count, n + count))
    _, _, sources = csgraph.dijkstra(
        graph, directed=False, indices=n + np.arange(count), min_only=True, return_predecessors=True
    )
    return np.asarray(sources[:n] - n, np.int64)


def _grading(surface: SurfaceMesh, count: int, held: Mask) -> Array:
    """(N,) mesh sizes over those of a uniform coarse mesh of `count` nodes: the root of the distance to the rim.

    Such a mesh resolves a field that grows as this root evenly (`vdm.boundary.rims`). The distance, in coarse
    mesh sizes, is clipped to 1/4 (the first node) and 1 (a uniform mesh).
    """
    i, j = surface.edges.T
    rim = np.unique(surface.edges[held[i] != held[j]])
    if not len(rim):
        return np.ones(surface.n_nodes)
    sizes = np.sqrt(surface.nodal_areas * surface.n_nodes / count)
    lengths = 2.0 * np.linalg.norm(surface.points[i] - surface.points[j], axis=1) / (sizes[i] + sizes[j])
    graph = sparse.csr_array((lengths, (i, j)), shape=(surface.n_nodes, surface.n_nodes))
    distance = csgraph.dijkstra(graph, directed=False, indices=rim, min_only=True)
    return np.asarray(np.sqrt(np.clip(distance, 0.25, 1.0)))


def node_order(surface: SurfaceMesh) -> Index:
    """(N,) the nodes in a scattered order that depends on the shape alone, not on node numbers or pose.

    The sort key is invariant to rotation, reflection and scaling: the squared distance from the middle plus the
    quadratic and cubic forms of the nodes' own moments. A fixed shuffle then scatters the order. Nodes that a
    symmetry of the mesh makes equal are sorted by their coordinates.
    """
    x = surface.points - surface.points.mean(axis=0)
    x = x / np.sqrt(np.square(x).sum(axis=1).mean())
    n = len(x)
    pairs = np.einsum("ni,nj->nij", x, x).reshape(n, 9)
    second, third = x.T @ x / n, pairs.T @ x / n
    # irrational weights: with whole numbers the terms cancel on regular meshes
    number = np.square(x).sum(axis=1)
    number += np.sqrt(2.0) * (pairs @ second.reshape(-1)) + np.sqrt(3.0) * ((pairs @ third) * x).sum(axis=1)
    ascending = np.lexsort((*np.round(x, DECIMALS).T, np.round(number, DECIMALS)))
    return np.asarray(ascending[np.random.default_rng(0).permutation(n)], np.int64)


def _candidates(points: Array, size: Array, triangles: Index, share: float) -> tuple[Index, Index]:
    """Cheapest nodes (k,) that may collapse, and the cheapest neighbour (k,) of each, onto which it moves."""
    # every edge once in each direction
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    by_start = np.argsort(start, kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(start, minlength=len(points)))])
    half = np.flatnonzero(usable(end, by_start, first))
    along = points[end[half]] - points[start[half]]
    square = np.round(np.einsum("hc,hc->h", along, along) / (size[start[half]] * size[end[half]]), DECIMALS)
    half = half[square <= _at_share(square, share)] if len(half) else half
    cost = np.round(costs(points, size, triangles, half, by_start, first), DECIMALS)
    half, cost = half[cost >= 0.0], cost[cost >= 0.0]
    if not len(half):
        return half, half
    by_node = np.lexsort((end[half], cost, start[half]))
    _, best = np.unique(start[half][by_node], return_index=True)
    chosen = by_node[best]
    cheapest = chosen[cost[chosen] <= _at_share(cost[chosen], share)]
    return start[half][cheapest], end[half][cheapest]


def _at_share(values: Array, share: float) -> float:
    """The `share` quantile of values (k,)."""
    k = int(share * (len(values) - 1))
    return float(np.partition(values, k)[k])


def _independent(triangles: Index, n: int, nodes: Index, random: np.random.Generator) -> Index:
    """Positions in `nodes` of some whose closed neighbourhoods share no node.

    The order is random. Cost varies slowly over a surface, so that few nodes would be the cheapest of their
    neighbourhood.
    """
    rank = np.full(n, len(nodes))
    rank[nodes] = random.permutation(len(nodes))
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()

    def least_around(values: Index) -> Index:
        least = values.copy()
        np.minimum.at(least, start, values[end])
        return least

    # a node is taken if it has the least rank within two edges
    return np.flatnonzero(least_around(least_around(rank))[nodes] == rank[nodes])
