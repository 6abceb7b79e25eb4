"""Even spacing of a coarse surface's nodes in local mesh sizes: they slide on the fine one, and edges flip."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from solver_common.arrays import Array, Index, Mask
from vdm.surface import cross, facet_vectors

ROUNDS = 20
FLIP_ROUNDS = 5
# samples of the fine surface along a mean edge of the coarse one
SAMPLES_PER_EDGE = 6
# nodes slide along directions in which the normals around them have less than this share of their squares
TANGENT = 0.12
# in a round, no facet turns by more than this or falls below this share of an equilateral one
LEAST_COSINE = 0.5
LEAST_QUALITY = 0.2
# edges flip between facets that are as parallel as this, where the two opposite angles exceed pi by more than that
FLAT_COSINE = 0.95
LEAST_GAIN = 1e-6
MOST_NEIGHBOURS = 9


def evenly_spaced(
    fine: Array, triangles: Index, sizes: Array, nodes: Array, facets: Index
) -> tuple[Index, Index, Array]:
    """Facets (m, 3), and the places of nodes that slid to the middle of theirs: fine nodes, shares (n, 3).

    Fine nodes count equally in the middle: where they are dense, so are the coarse ones. On smooth parts nodes
    slide both ways, on sharp edges along the edge, at corners not at all. Every place is one of a fixed grid on
    the fine triangles, so that rounding does not accumulate.

    Parameters
    ----------
    fine : (N, 3) nodes of the fine surface
    triangles : (M, 3) its triangles
    sizes : (N,) of the mesh around its nodes
    nodes : (n, 3) those of the coarse surface, on the fine one
    facets : (m, 3) its triangles
    """
    splits = max(1, int(np.ceil(SAMPLES_PER_EDGE * np.sqrt(len(nodes) / len(fine)))))
    corners, shares = _places(triangles, splits)
    places = np.einsum("sa,sac->sc", shares, fine[corners])
    tree = cKDTree(places)
    place_sizes = np.einsum("sa,sa->s", shares, sizes[corners])
    owner = np.take_along_axis(corners, shares.argmax(axis=1)[:, None], axis=1)[:, 0]
    fine_normals = _unit(_gathered(_area_vectors(fine, triangles), triangles, len(fine)))
    normals = _unit(np.einsum("sa,sac->sc", shares, fine_normals[corners]))
    at = np.asarray(tree.query(nodes)[1])
    nodes = nodes.copy()
    for _ in range(ROUNDS):
        facets = _flipped(nodes, facets)
        goal = nodes + _slide(nodes, facets, place_sizes[at])
        new = np.asarray(tree.query(goal)[1])
        own = _unit(_gathered(_area_vectors(nodes, facets), facets, len(nodes)))
        # do not jump through a thin part to its other side
        may = np.einsum("nc,nc->n", normals[new], own) > LEAST_COSINE
        may = _without_folds(nodes, places[new], facets, may)
        may = _without_sharing(owner[at], owner[new], may)
        if not (may & (new != at)).any():
            break
        nodes[may], at[may] = places[new[may]], new[may]
    return facets, corners[at], shares[at]


def _places(triangles: Index, splits: int) -> tuple[Index, Array]:
    """Places on the triangles with each side in `splits` parts: fine nodes (s, 3), their shares (s, 3)."""
    steps = np.array([(i, j, splits - i - j) for i in range(splits + 1) for j in range(splits + 1 - i)])
    step = np.broadcast_to(steps, (len(triangles), *steps.shape)).reshape(-1, 3)
    # mark corners without a share: a place on an edge then has one key from both sides
    key = np.repeat(triangles, len(steps), axis=0) * (splits + 1) + step
    key = np.sort(np.where(step > 0, key, -1), axis=1)
    key = key[np.lexsort(key.T[::-1])]
    key = key[np.append(True, (key[1:] != key[:-1]).any(axis=1))]
    share = np.where(key < 0, 0, key % (splits + 1)) / splits
    node = key // (splits + 1)
    return np.where(key < 0, node[:, 2:], node), share


def _slide(nodes: Array, facets: Index, sizes: Array) -> Array:
    """(n, 3) steps along each node's free directions, to the middle of its facets by their fine nodes."""
    area_vectors = _area_vectors(nodes, facets)
    areas = np.linalg.norm(area_vectors, axis=1)
    n = len(nodes)
    spread = area_vectors[:, :, None] * area_vectors[:, None, :] / areas[:, None, None]
    squares, axes = np.linalg.eigh(_gathered(spread.reshape(-1, 9), facets, n).reshape(n, 3, 3))
    count = (areas / sizes[facets].mean(axis=1) ** 2)[:, None]
    middles = _gathered(count * nodes[facets].mean(axis=1), facets, n)
    middles /= _gathered(count, facets, n)
    along = np.einsum("nck,nc->nk", axes, middles - nodes)
    along[squares >= TANGENT * squares[:, -1:]] = 0.0
    return np.einsum("nck,nk->nc", axes, along)


def _without_folds(nodes: Array, new: Array, facets: Index, may: Mask) -> Mask:
    """The nodes (n,) whose move leaves no facet turned or squeezed, out of those that may move."""
    may = may.copy()
    before = _area_vectors(nodes, facets)
    while True:
        moved = np.where(may[:, None], new, nodes)
        after = _area_vectors(moved, facets)
        corners = moved[facets]
        sides = np.square(corners - np.roll(corners, 1, axis=1)).sum(axis=(1, 2))
        size = np.linalg.norm(after, axis=1)
        bad = np.einsum("mc,mc->m", before, after) <= LEAST_COSINE * size * np.linalg.norm(before, axis=1)
        bad |= 4.0 * np.sqrt(3.0) * size <= LEAST_QUALITY * sides
        bad &= may[facets].any(axis=1)
        if not bad.any():
            return may
        may[facets[bad]] = False


def _without_sharing(here: Index, there: Index, may: Mask) -> Mask:
    """The nodes (n,) that may move without sharing a fine node with another: coarse nodes stay distinct."""
    may = may.copy()
    while True:
        _, first, counts = np.unique(np.where(may, there, here), return_inverse=True, return_counts=True)
        shared = may & (counts[first] > 1)
        if not shared.any():
            return may
        may[shared] = False


def _flipped(nodes: Array, facets: Index) -> Index:
    """The facets after flipping edges whose two facets do not satisfy Delaunay's criterion."""
    facets, n = facets.copy(), len(nodes)
    for _ in range(FLIP_ROUNDS):
        start, end = facets.ravel(), np.roll(facets, -1, axis=1).ravel()
        code = start * n + end
        order = np.argsort(code)
        ascending = code[order]
        one = np.flatnonzero(start < end)
        two = order[np.searchsorted(ascending, (end * n + start)[one])]
        third = np.roll(facets, -2, axis=1).ravel()
        corners = np.stack([start[one], end[one], third[one], third[two]])
        a, b, c, d = corners
        p, q, r, s = nodes[corners]
        gain = -_cotangent(p - r, q - r) - _cotangent(p - s, q - s)
        valence = np.bincount(start, minlength=n)
        good = (gain > LEAST_GAIN) & (ascending[np.searchsorted(ascending[:-1], c * n + d)] != c * n + d)
        good &= (np.minimum(valence[a], valence[b]) > 4) & (
            np.maximum(valence[c], valence[d]) < MOST_NEIGHBOURS
        )
        pairs = np.stack([cross(q - p, r - p), cross(p - q, s - q), cross(s - r, q - r), cross(r - s, p - s)])
        pairs /= np.maximum(np.linalg.norm(pairs, axis=2, keepdims=True), np.finfo(np.float64).tiny)
        good &= np.einsum("ec,ec->e", pairs[0], pairs[1]) > FLAT_COSINE
        good &= np.einsum("kec,ec->ke", pairs[2:], pairs[0] + pairs[1]).min(axis=0) > FLAT_COSINE
        if not good.any():
            break
        a, b, c, d = corners = corners[:, good]
        one, two = one[good], two[good]
        # the largest gains first, none beside another
        rank = np.empty(len(a), np.int64)
        rank[np.lexsort((b, a, -np.round(gain[good], 9)))] = np.arange(len(a))
        least = np.full(n, len(a))
        for corner in corners:
            np.minimum.at(least, corner, rank)
        first = (least[corners] == rank).all(axis=0)
        facets[one[first] // 3] = np.stack([c, d, b], axis=1)[first]
        facets[two[first] // 3] = np.stack([d, c, a], axis=1)[first]
    return facets


def _gathered(values: Array, facets: Index, n: int) -> Array:
    """(n, k) sums at the nodes of values (m, k) of the facets."""
    corners = facets.T.ravel()
    return np.stack([np.bincount(corners, np.tile(column, 3), n) for column in values.T], axis=1)


def _area_vectors(points: Array, triangles: Index) -> Array:
    """(m, 3) normals of the triangles, as long as their areas."""
    return facet_vectors(*points[triangles].transpose(1, 0, 2))


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _cotangent(u: Array, v: Array) -> Array:
    """(k,) cotangents of the angles between vectors (k, 3)."""
    return np.asarray(np.einsum("kc,kc->k", u, v) / np.linalg.norm(cross(u, v), axis=1))
