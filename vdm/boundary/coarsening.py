"""A coarser surface on a fine one, by edge collapses that keep it closed, its genus and its grading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from solver_common.arrays import Array, Index, Mask
from vdm.boundary.spacing import evenly_spaced
from vdm.surface import SurfaceMesh, cross

# a collapse may not turn a facet by more than this, nor squeeze it below this share of an equilateral one
LEAST_COSINE = 0.5
LEAST_QUALITY = 0.2
MOST_NEIGHBOURS = 9
# a distance from the planes of the facets that vanish counts this many times more than length
OFF_PLANE = 8.0
# the shares of the edges that a round looks at, the shortest, and of the nodes found that it may take, the cheapest
SHARE = 0.2
# numbers near 1 that are the same to as many decimals are taken as equal
DECIMALS = 10


@dataclass(frozen=True)
class CoarseSurface:
    """The coarse surface; its nodes lie at the `shares` (n, 3) of fine nodes, `corners` (n, 3) of a triangle."""

    surface: SurfaceMesh
    corners: Index
    shares: Array


def coarsened(surface: SurfaceMesh, count: int, held: Mask | None = None) -> CoarseSurface:
    """A surface on about `count` points of the given one, or on more where its shape allows no further collapse.

    A node is moved onto a neighbour if the two share just two neighbours (which keeps the topology), no facet
    turns over or degenerates and the new edges are the shortest to be had. Each round takes nodes whose
    neighbourhoods do not touch, all at once. What is left slides over the surface until it is evenly spaced.
    Lengths are in units of the mesh size around: where the mesh is fine, so is the coarse one. At the rim of the
    nodes that are `held` (N,) it is finer, up to half as coarse.
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
    """(N,) the coarse node that is nearest along the edges, and straight over the triangle that it lies on."""
    n, count = surface.n_nodes, coarse.surface.n_nodes
    node, corner = np.nonzero(coarse.shares)
    start = np.concatenate([surface.edges[:, 0], coarse.corners[node, corner]])
    end = np.concatenate([surface.edges[:, 1], n + node])
    points = np.concatenate([surface.points, coarse.surface.points])
    # none is nothing: an entry of zero is no edge
    lengths = np.linalg.norm(points[start] - points[end], axis=1) + np.finfo(np.float64).tiny
    graph = sparse.csr_array((lengths, (start, end)), shape=(n + count, n + count))
    _, _, sources = csgraph.dijkstra(
        graph, directed=False, indices=n + np.arange(count), min_only=True, return_predecessors=True
    )
    return np.asarray(sources[:n] - n, np.int64)


def _grading(surface: SurfaceMesh, count: int, held: Mask) -> Array:
    """(N,) mesh sizes over those of a uniform coarse mesh of `count` nodes: the root of the distance to the rim.

    A field that grows as this root is evenly resolved so (`vdm.boundary.rims`). The distance is in coarse mesh
    sizes; beyond one the mesh is uniform, below a quarter the first node is reached.
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
    """(N,) the nodes in an order that scatters over the surface, by its shape: not by their numbers nor its pose.

    They are sorted by a number that no rotation, reflection or scaling moves: the distance from the middle squared
    and the quadratic and cubic forms of the nodes' own moments. A fixed shuffle of the places scatters them.
    Nodes that the mesh's own symmetry makes equal go by their coordinates.
    """
    x = surface.points - surface.points.mean(axis=0)
    x = x / np.sqrt(np.square(x).sum(axis=1).mean())
    n = len(x)
    pairs = np.einsum("ni,nj->nij", x, x).reshape(n, 9)
    second, third = x.T @ x / n, pairs.T @ x / n
    # irrational weights: whole ones let the terms cancel on regular meshes
    number = np.square(x).sum(axis=1)
    number += np.sqrt(2.0) * (pairs @ second.reshape(-1)) + np.sqrt(3.0) * ((pairs @ third) * x).sum(axis=1)
    ascending = np.lexsort((*np.round(x, DECIMALS).T, np.round(number, DECIMALS)))
    return np.asarray(ascending[np.random.default_rng(0).permutation(n)], np.int64)


def _candidates(points: Array, size: Array, triangles: Index, share: float) -> tuple[Index, Index]:
    """Nodes (k,) that may go, the cheapest ones, each onto its cheapest neighbour (k,)."""
    n = len(points)
    # every edge once in each direction
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    adjacent = sparse.csr_array((np.ones(len(start), dtype=np.int32), (start, end)), shape=(n, n))
    shared = np.asarray((adjacent @ adjacent)[start, end]).ravel()
    valence = np.diff(adjacent.indptr)
    left = valence[start] + valence[end] - 4
    # two are left of a tetrahedron: a shell, as of a small cavity, keeps four nodes
    usable = (shared == 2) & (left >= 3) & (left <= MOST_NEIGHBOURS)
    along = points[end] - points[start]
    square = np.round(np.einsum("hc,hc->h", along, along) / (size[start] * size[end]), DECIMALS)
    half = np.flatnonzero(usable)
    half = half[square[half] <= np.quantile(square[half], share)] if len(half) else half
    if not len(half):
        return half, half
    # every pair of such a half-edge start -> end and a facet of its start, whose other corners are b and c
    order = np.argsort(start, kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(start, minlength=n))])
    repeats = valence[start[half]]
    starts = np.cumsum(repeats) - repeats
    pair = np.repeat(np.arange(len(half)), repeats)
    corner = order[first[start[half]][pair] + np.arange(len(pair)) - starts[pair]]
    b, c = end[corner], np.roll(triangles, -2, axis=1).ravel()[corner]
    gone, onto = start[half][pair], end[half][pair]
    vanishes = (b == onto) | (c == onto)
    x, y, z, moved = points[gone], points[b], points[c], points[onto]
    before, after = cross(y - x, z - x), cross(y - moved, z - moved)
    area, new_area = (np.sqrt(np.einsum("pc,pc->p", v, v)) for v in (before, after))
    sides = [np.einsum("pc,pc->p", v, v) for v in (y - moved, z - moved, z - y)]
    good = np.einsum("pc,pc->p", before, after) > LEAST_COSINE * area * new_area
    good &= 2.0 * np.sqrt(3.0) * new_area > LEAST_QUALITY * (sides[0] + sides[1] + sides[2])
    good |= vanishes
    off_plane = np.abs(np.einsum("pc,pc->p", before, moved - x)) / (area * size[onto])
    own = size[onto]
    longest = np.maximum(sides[0] / (own * size[b]), sides[1] / (own * size[c]))
    length = np.sqrt(np.where(vanishes, 0.0, longest))
    allowed = np.logical_and.reduceat(good, starts)
    cost = np.maximum.reduceat(length, starts) + OFF_PLANE * np.maximum.reduceat(off_plane, starts)
    cost = np.round(cost, DECIMALS)
    half, cost = half[allowed], cost[allowed]
    if not len(half):
        return half, half
    by_node = np.lexsort((end[half], cost, start[half]))
    _, best = np.unique(start[half][by_node], return_index=True)
    chosen = by_node[best]
    cheapest = chosen[cost[chosen] <= np.quantile(cost[chosen], share)]
    return start[half][cheapest], end[half][cheapest]


def _independent(triangles: Index, n: int, nodes: Index, random: np.random.Generator) -> Index:
    """Positions in `nodes` of some whose closed neighbourhoods share no node.

    The order is random: by cost, which varies slowly over a surface, few nodes would be the cheapest around.
    """
    rank = np.full(n, len(nodes))
    rank[nodes] = random.permutation(len(nodes))
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()

    def least_around(values: Index) -> Index:
        least = values.copy()
        np.minimum.at(least, start, values[end])
        return least

    # the least rank within two edges: whoever holds it wins
    return np.flatnonzero(least_around(least_around(rank))[nodes] == rank[nodes])
