"""Caps: triangles that fill the loops of a cut and keep the loops' edges."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve
from scipy.spatial import Delaunay

from solver_common.arrays import Array, Index, Mask
from solver_common.closed_surfaces import closed_pieces

# least distance of inner nodes from the loops, over the mesh size
CLEAR = 0.6
SMOOTHINGS = 4
# area over squared mesh size, below which a triangle counts as a line
FLAT = 1e-9
# mesh sizes of a cap over the loops' mean edge; a finer one is tried if a piece of the cap has no inner node
FINER = np.array([1.0, 0.5, 0.25])


class CutError(ValueError):
    """No cap fills the loops, or no plane cuts the part; the message says why."""


def cap(points: Array, loops: list[Index], normal: Array) -> tuple[Array, Index]:
    """New nodes (k, 3), and facets (C, 3) that close loops of `points` (N, 3); new node j has the number N + j.

    A facet's edge on a loop runs against the loop. Seen along `normal` (3,), the cap fills what lies inside an odd
    number of loops. New nodes form a triangular lattice with the loops' mean edge, or a finer one in narrow caps.
    Their heights over the plane are a discrete harmonic function of the loops' heights.

    Raises
    ------
    CutError
        seen along the normal, the loops intersect, run in contradictory directions, or leave no room for a node.
    """
    # the first axis follows the first loop: an axis of space could tie with another one
    first = np.cross(normal, points[loops[0][len(loops[0]) // 2]] - points[loops[0][0]])
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(normal, first)], axis=1)
    nodes = np.concatenate(loops)
    starts = np.cumsum([0, *map(len, loops)])
    follower = np.concatenate([np.roll(np.arange(a, b), -1) for a, b in pairwise(starts)])
    edges = np.stack([np.arange(len(nodes)), follower], axis=1)
    border = points[nodes] @ axes
    size = float(np.linalg.norm(border[edges[:, 1]] - border[edges[:, 0]], axis=1).mean())
    for width in size * FINER:
        inner, triangles = _filled(border, edges, width)
        # a piece of a cap needs an inner node: without one, the volumes of the two parts would depend on each
        # other
        if np.bincount(closed_pieces(triangles), (triangles >= len(border)).any(axis=1)).all():
            break
    else:
        raise CutError("a cap of the cut has no room for a node")
    heights = _harmonic(triangles, points[nodes] @ normal, len(border) + len(inner))
    lifted = inner @ axes.T + heights[len(border) :, None] * normal
    numbers = np.concatenate([nodes, len(points) + np.arange(len(inner))])
    return lifted, numbers[triangles]


def _filled(border: Array, edges: Index, size: float) -> tuple[Array, Index]:
    """Nodes (k, 2) at this mesh size inside the loops of `border` (n, 2), and triangles (C, 3) of all n + k."""
    inner = _lattice(border, edges, size)
    for _ in range(SMOOTHINGS):
        if not len(inner):
            break
        links = _links(_delaunay(np.vstack([border, inner])), len(border) + len(inner))
        means = (links @ np.vstack([border, inner])) / links.sum(axis=1)[:, None]
        moved = means[len(border) :]
        inner = moved[_clear(moved, border, edges, CLEAR * size)]
    flat = np.vstack([border, inner])
    triangles = _constrained(flat, _delaunay(flat), edges)
    # collinear nodes of a loop give a triangle without area, whose centroid is on the loop
    wide = np.abs(_area(*flat[triangles].transpose(1, 0, 2))) > FLAT * size**2
    triangles = triangles[wide & _inside(flat[triangles].mean(axis=1), border, edges)]
    triangles = _against(triangles, edges)
    triangles = triangles[np.lexsort(np.sort(triangles, axis=1).T)]
    used = np.unique(triangles)
    if len(used) != len(flat):  # a node that no facet of the cap uses
        raise CutError("loops of the cut cannot be paired")
    return inner, triangles


def _lattice(border: Array, edges: Index, size: float) -> Array:
    """(k, 2) points of a triangular lattice inside the loops and clear of them."""
    low, high = border.min(axis=0), border.max(axis=0)
    rise = size * np.sqrt(0.75)
    reach = np.ceil(0.5 * (high - low) / [size, rise]).astype(int) + 1
    i, j = np.meshgrid(*(np.arange(-k, k + 1) for k in reach), indexing="ij")
    grid = np.stack([(i + 0.5 * (j % 2)) * size, j * rise], axis=-1).reshape(-1, 2) + 0.5 * (low + high)
    return grid[_clear(grid, border, edges, CLEAR * size)]


def _clear(places: Array, border: Array, edges: Index, distance: float) -> Mask:
    """(n,) whether places (n, 2) lie inside the loops, farther than `distance` from their edges."""
    start, side = border[edges[:, 0]], border[edges[:, 1]] - border[edges[:, 0]]
    arms = places[:, None] - start
    along = np.clip(np.einsum("nec,ec->ne", arms, side) / np.einsum("ec,ec->e", side, side), 0.0, 1.0)
    gap = np.linalg.norm(arms - along[:, :, None] * side, axis=2).min(axis=1, initial=np.inf)
    return _inside(places, border, edges) & (gap > distance)


def _inside(places: Array, border: Array, edges: Index) -> Mask:
    """(n,) whether places (n, 2) lie inside an odd number of loops."""
    (x1, y1), (x2, y2) = border[edges[:, 0]].T, border[edges[:, 1]].T
    x, y = places[:, :1], places[:, 1:]
    spans = (y1 > y) != (y2 > y)
    rise = np.where(y2 == y1, 1.0, y2 - y1)
    crossed = spans & (x < x1 + (x2 - x1) * (y - y1) / rise)
    return np.asarray(crossed.sum(axis=1) % 2 == 1)


def _delaunay(flat: Array) -> Index:
    """(T, 3) Delaunay triangles of points (n, 2)."""
    return np.asarray(Delaunay(flat).simplices, np.int64)


def _links(triangles: Index, n: int) -> sparse.csr_array:
    """(n, n) adjacency matrix of the nodes."""
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    rows, columns = np.concatenate([pairs, pairs[:, ::-1]]).T
    links = sparse.csr_array(sparse.coo_array((np.ones(len(rows)), (rows, columns)), shape=(n, n)))
    links.data[:] = 1.0
    return links


def _constrained(flat: Array, triangles: Index, edges: Index) -> Index:
    """The triangulation after flips that insert all `edges` (Sloan, Computers & Structures 47 (1993) 441)."""
    triangles = triangles.copy()
    turn = _area(*flat[triangles].transpose(1, 0, 2)) < 0.0
    triangles[turn] = triangles[turn][:, ::-1]
    owner = {}
    for number, (a, b, c) in enumerate(triangles.tolist()):
        owner[a, b], owner[b, c], owner[c, a] = number, number, number

    def crosses(p: int, q: int, a: int, b: int) -> bool:
        if len({p, q, a, b}) < 4:
            return False
        x = flat[[p, q, a, b]]
        return (_area(x[0], x[1], x[2]) > 0.0) != (_area(x[0], x[1], x[3]) > 0.0) and (
            _area(x[2], x[3], x[0]) > 0.0
        ) != (_area(x[2], x[3], x[1]) > 0.0)

    for a, b in edges.tolist():
        if (a, b) in owner or (b, a) in owner:
            continue
        crossing = [(p, q) for p, q in owner if p < q and (q, p) in owner and crosses(p, q, a, b)]
        for _ in range(100 * (len(crossing) + 1)):
            if not crossing:
                break
            p, q = crossing.pop(0)
            one, two = owner[p, q], owner[q, p]
            r, s = int(triangles[one].sum() - p - q), int(triangles[two].sum() - p - q)
            if not (_area(*flat[[r, s, q]]) > 0.0 and _area(*flat[[s, r, p]]) > 0.0):
                crossing.append((p, q))  # not convex yet
                continue
            del owner[p, q], owner[q, p]
            triangles[one], triangles[two] = (r, s, q), (s, r, p)
            for number, (i, j, k) in ((one, (r, s, q)), (two, (s, r, p))):
                owner[i, j], owner[j, k], owner[k, i] = number, number, number
            if crosses(r, s, a, b):
                crossing.append((min(r, s), max(r, s)))
        if (a, b) not in owner and (b, a) not in owner:
            raise CutError("loops of the cut cross each other, seen along the cut's normal")
    return triangles


def _area(a: Array, b: Array, c: Array) -> Array:
    """Twice the area of triangles, positive if their corners run counterclockwise."""
    u, v = b - a, c - a
    return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])


def _against(triangles: Index, edges: Index) -> Index:
    """The triangles, oriented so that their open edges are the loops' edges (a, b), reversed as (b, a)."""
    halves = [pair for t in triangles.tolist() for pair in ((t[0], t[1]), (t[1], t[2]), (t[2], t[0]))]
    once = set(halves)
    open_ones = {(b, a) for a, b in once} - once
    loops = set(map(tuple, edges.tolist()))
    if len(once) == len(halves) and open_ones == loops:
        return triangles
    if len(once) == len(halves) and open_ones == {(b, a) for a, b in loops}:
        return np.ascontiguousarray(triangles[:, ::-1])
    raise CutError("loops of the cut cannot be paired")


def _harmonic(triangles: Index, heights: Array, n: int) -> Array:
    """(n,) discrete harmonic function: `heights` at the first nodes, the mean of the neighbours at the others."""
    known, links = len(heights), _links(triangles, n)
    laplacian = sparse.csr_array(sparse.diags_array(links.sum(axis=1)) - links)
    right = -(laplacian[known:, :known] @ heights)
    return np.append(heights, spsolve(sparse.csc_array(laplacian[known:, known:]), right))
