"""Cuts a closed surface into closed parts along its own edges.

A plane across the longest axis of inertia labels the facets on its two sides. Labels are smoothed until their
border is a set of simple loops, which a cap fills (`vdm.parts.caps`). Surface nodes do not move; caps have new
nodes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from solver_common.arrays import Array, Index, Mask
from solver_common.closed_surfaces import closed_pieces, crossings, solid_angles
from vdm.boundary.rims import cut_at_rims
from vdm.parts.caps import CutError, cap

# positions of the plane that are tried: offsets from the median, as shares of the area
SHIFTS = (0.0, 0.04, -0.04, 0.08, -0.08, 0.12, -0.12, 0.18, -0.18)
SWEEPS = 50
# least facets of a part: with fewer, its caps are most of its surface
SMALLEST = 60
# least distance of a cap's nodes from the surface, over the median edge of the loops
ROOM = 0.3
# number of edges that a cut keeps away from marked nodes, if it can
AWAY = 3


@dataclass(frozen=True)
class Cut:
    """The parts of a body with N nodes.

    Attributes
    ----------
    points : (N + k, 3) nodes of the body, then of the caps, then at rims [m]
    parts : facets (F_e, 3) of each part's closed surface, outward
    refused : why there are fewer parts than asked for; empty if there are as many
    ends : (r, 2) end nodes of the edges that the last r nodes cut, at rims
    uncut : the parts before the cut along rims; empty without that cut
    tractions : for each part the number (F_e,) of its facets' tractions, which facets may share; empty until
        `vdm.parts.body.Parts` sets them
    """

    points: Array
    parts: tuple[Index, ...]
    refused: str = ""
    ends: Index = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    uncut: tuple[Index, ...] = ()
    tractions: tuple[Index, ...] = ()

    def at_rims(self, held: Mask) -> Cut:
        """The parts, also cut along the rims of the body's held nodes (N,), through caps too (`vdm.boundary.rims`).

        The new nodes are free unknowns. So one constraint keeps the sum of the bulges at all rims, as in the whole
        body. If each part kept its own, it would be stiffer.
        """
        known = np.append(held, np.zeros(len(self.points) - len(held), np.bool_))
        points, parts, ends = cut_at_rims(self.points, self.parts, known)
        return Cut(points, tuple(parts), self.refused, ends, self.parts)


def cut(points: Array, triangles: Index, count: int, apart: Mask | None = None) -> Cut:
    """Cut a closed surface, points (N, 3) and triangles (F, 3), into `count` parts or more, the largest first.

    A cut through a fork may give more parts. If no plane can cut, there are fewer, and `Cut.refused` says why.
    `apart` (N,) marks nodes, the rims of supports, that cuts keep `AWAY` edges from, or as far as the planes allow.
    """
    parts, refused = [triangles], ""
    surface = np.asarray(points, np.float64)
    final: set[int] = set()
    while len(parts) < count:
        order = sorted(range(len(parts)), key=lambda k: -len(parts[k]))
        for largest in (k for k in order if k not in final):
            try:
                surface, pieces = _halved(surface, parts[largest], apart)
            except CutError as error:
                refused = f"{error}"
                parts[largest], final = parts[largest], final | {largest}
                continue
            final = set()
            parts[largest : largest + 1] = pieces
            break
        else:
            return Cut(surface, tuple(parts), refused)
    return Cut(surface, tuple(parts))


def _halved(points: Array, triangles: Index, apart: Mask | None) -> tuple[Array, list[Index]]:
    """One part cut across its longest axis: the points with those of the caps, and the facets of the pieces.

    Raises
    ------
    CutError
        no plane cuts it. The message is that of the first plane.
    """
    if len(triangles) < 2 * SMALLEST:
        raise CutError(f"a part of {len(triangles)} facets is too small to be cut")
    corners = points[triangles]
    centres = corners.mean(axis=1)
    areas = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    places, normal = along_longest_axis(centres, areas)
    # rounding must decide neither which side comes first nor the side of a facet: the plane passes through a gap
    places, normal = (places, normal) if places[0] < 0.0 else (-places, -normal)
    order = np.argsort(places)
    share = (np.cumsum(areas[order]) - 0.5 * areas[order]) / areas.sum()
    gaps, between = np.diff(places[order]), 0.5 * (places[order][1:] + places[order][:-1])
    near, refused = list[tuple[int, list[Index], Mask]](), list[CutError]()

    def borders() -> Iterator[tuple[list[Index], Mask]]:
        """Loops and labels of each plane: those `AWAY` from marked nodes, then the others, the furthest first."""
        for shift in SHIFTS:
            plane = between[np.argmax(gaps - np.abs(between - np.interp(0.5 + shift, share, places[order])))]
            try:
                loops, labels = _loops(triangles, places > plane, len(points))
            except CutError as error:
                refused.append(error)
                continue
            edges = AWAY if apart is None else _edges_to(triangles, loops, apart, len(points))
            if edges < AWAY:
                near.append((edges, loops, labels))
            else:
                yield loops, labels
        for _, loops, labels in sorted(near, key=lambda border: -border[0]):
            yield loops, labels

    for loops, labels in borders():
        try:
            return _closed(points, triangles, labels, loops, normal)
        except CutError as error:
            refused.append(error)
    raise refused[0]


def along_longest_axis(points: Array, areas: Array) -> tuple[Array, Array]:
    """Coordinates (n,) of points (n, 3) along their longest principal axis, from their mean, and the axis (3,)."""
    arms = points - areas @ points / areas.sum()
    axis = np.linalg.eigh((arms * areas[:, None]).T @ arms)[1][:, 2]
    return arms @ axis, axis


def _edges_to(triangles: Index, loops: list[Index], apart: Mask, n: int) -> int:
    """Number of edges from the loops to the nearest marked node, at most `AWAY`."""
    reached = np.zeros(n, np.bool_)
    reached[np.concatenate(loops)] = True
    for edges in range(AWAY):
        if (reached[: len(apart)] & apart).any():
            return edges
        reached[triangles[reached[triangles].any(axis=1)]] = True
    return AWAY


def _closed(
    points: Array, triangles: Index, labels: Mask, loops: list[Index], normal: Array
) -> tuple[Array, list[Index]]:
    """The points with those of the caps, and the closed pieces on the two sides; raises `CutError`."""
    new, facets = cap(points, loops, normal)
    grown = np.vstack([points, new])
    border = np.concatenate([np.stack([loop, np.roll(loop, -1)], axis=1) for loop in loops])
    n = len(points)
    if (_keys(facets, n) - _keys(border, n)) & _keys(triangles, n):
        raise CutError("caps of the cut have an edge of the surface")
    _check_inside(grown, triangles, border, facets, n)
    sides = (np.vstack([triangles[~labels], facets]), np.vstack([triangles[labels], facets[:, ::-1]]))
    pieces = [piece for side in sides for piece in _bodies(grown, side)]
    if min(map(len, pieces)) < SMALLEST:
        raise CutError("a cut would leave a part of a few facets")
    return grown, pieces


def _check_inside(points: Array, triangles: Index, border: Index, facets: Index, n: int) -> None:
    """Raise `CutError` if a cap on the edges `border` (k, 2) leaves the part or nearly touches its surface."""
    centres = points[facets].mean(axis=1)
    one_of_each = np.unique(closed_pieces(facets), return_index=True)[1]
    inside = solid_angles(centres[one_of_each], points, triangles) > 0.5
    crossing = crossings(points, np.vstack([triangles, facets]), since=len(triangles))
    if len(crossing) or not inside.all():
        raise CutError("caps of the cut cross the surface")
    inner = points[np.unique(facets[facets >= n])]
    apart = ROOM * np.median(np.linalg.norm(points[border[:, 0]] - points[border[:, 1]], axis=1))
    pieces = closed_pieces(triangles)
    whole = ~np.isin(
        pieces, pieces[np.isin(triangles, border).any(axis=1)]
    )  # walls that the cut leaves whole
    for nodes, places in ((triangles, inner), (triangles[whole], np.vstack([inner, centres]))):
        if len(nodes) and (cKDTree(points[np.unique(nodes)]).query(places)[0] < apart).any():
            raise CutError("caps of the cut touch the surface")


def _keys(rings: Index, n: int) -> set[int]:
    """A key for each edge between nodes below n, in rings (k, m) of nodes."""
    start, end = rings.ravel(), np.roll(rings, -1, axis=1).ravel()
    old = (start < n) & (end < n)
    return set((np.minimum(start, end)[old] * n + np.maximum(start, end)[old]).tolist())


def _loops(triangles: Index, labels: Mask, n: int) -> tuple[list[Index], Mask]:
    """The border of the labels (F,) as loops of nodes, and the smoothed labels.

    Loops run as the edges of the facets labelled False do.
    """
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    facet = np.repeat(np.arange(len(triangles)), 3)
    neighbour = np.empty(len(start), np.int64)
    neighbour[np.argsort(start * n + end)] = facet[np.argsort(end * n + start)]
    around = neighbour.reshape(-1, 3)
    labels = labels.copy()
    for _ in range(SWEEPS):
        for _ in range(SWEEPS):  # a facet takes the label of two neighbours that differ from it
            lone = np.flatnonzero((labels[around] != labels[:, None]).sum(axis=1) >= 2)
            if not len(lone):
                break
            for f in lone:
                if (labels[around[f]] != labels[f]).sum() >= 2:
                    labels[f] = not labels[f]
        border = (labels[facet] != labels[neighbour]) & ~labels[facet]
        pinched = np.bincount(start[border], minlength=n) > 1
        if not pinched.any():
            break
        for node in np.flatnonzero(pinched):
            star = np.flatnonzero((triangles == node).any(axis=1))
            labels[star] = 2 * np.count_nonzero(labels[star]) > len(star)
    else:
        raise CutError("the border of a cut touches itself")
    if not border.any():
        raise CutError("a plane leaves all facets on one side")
    follower = dict(zip(start[border].tolist(), end[border].tolist(), strict=True))
    loops = []
    while follower:
        loop = [next(iter(follower))]
        while (node := follower.pop(loop[-1])) != loop[0]:
            loop.append(node)
        loops.append(np.array(loop))
    return loops, labels


def _bodies(points: Array, triangles: Index) -> list[Index]:
    """The facets (F, 3) of each body: a closed outer surface with the walls of the cavities inside it."""
    of = closed_pieces(triangles)
    pieces = [triangles[of == k] for k in range(of.max() + 1)]
    if len(pieces) == 1:
        return pieces
    bodies = [piece for piece in pieces if volume(points, piece) > 0.0]
    for wall in (piece for piece in pieces if volume(points, piece) <= 0.0):
        around = [
            k for k, body in enumerate(bodies) if solid_angles(points[wall[0]], points, body).min() > 0.5
        ]
        if len(around) != 1:
            raise CutError("caps of the cut cross the surface")
        bodies[around[0]] = np.vstack([bodies[around[0]], wall])
    return bodies


def volume(points: Array, triangles: Index) -> float:
    """Volume of a closed surface [m^3], negative if its facets face inward."""
    a, b, c = (points[triangles] - points[triangles].mean(axis=(0, 1))).transpose(1, 0, 2)
    return float(np.einsum("fi,fi->", a, np.cross(b, c))) / 6.0
