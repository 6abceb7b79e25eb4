"""A drawing of a scene: the body with its supports, contacts and loads, with arrows and a scale bar.

It needs arrays only, so it serves the page of a run and scenes that are not solved yet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from textwrap import wrap

import numpy as np
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from solver_common.arrays import Array

from ..body.surface_measures import facet_area_vectors, nodal_sum
from ..body.topology import half_edges
from ..verdict.formatting import plain, round_below, scale_of
from .picture import directions, drawn, written
from .plots import INK, STYLE, shortened, svg_of

# kind of a constraint -> (its name, colour); safe for colour-blind readers, on light and dark ground
KINDS = {
    "fixed": ("support", "#4477aa"),
    "contact": ("contact", "#ee6677"),
    "constrained": ("moved", "#c0a82e"),
    "line": ("pulled along a line", "#aa3377"),
    "traction": ("pulled or sheared", "#882255"),
    "elastic": ("springs", "#228833"),
    "indenter": ("indenter", "#ee7733"),
}
PART = "part"
# colours of the parts of a cut body, in turn, readable under a black number (Paul Tol, Colour schemes, "light")
PARTS = ("#77aadd", "#ee8866", "#eedd88", "#ffaabb", "#99ddff", "#44bb99", "#bbcc33", "#aaaa00")
INSIDE = "#5b3a8c"  # outlines inside the body
OTHER = "#666666"  # kinds that have no colour of their own
_ARROWS = {"contact": "#c42842", "constrained": "#8a7410"}  # darker, to be visible on body and ground
BODY, _AMBIENT = "#cfd3d6", 0.72  # much ambient light, so that shading does not change the colours
_PIXELS = 560  # width of the body's drawing
_WIDTH, _MOST_HEIGHT = 4.4, 3.6  # size of the drawing [inches]: as wide as a chart
_LINE = 0.17  # height of a line of text [inches]
_ARROW = 0.2  # length of an arrow over the body's size
_FOOT = 0.62  # height of the strip with scale bar and axes [inches]
_LETTERS = 70  # letters in a line of words
_ELEVATIONS = tuple(np.radians([22.0, 10.0]))
_AZIMUTHS = tuple(np.radians(np.arange(-57.0, 303.0, 15.0)))
_CLEARLY = 1.03  # factor by which a later camera must show more


@dataclass(frozen=True)
class Part:
    """A region of the body and the load or support on it."""

    name: str
    kind: str  # of a constraint: a key of KINDS; or PART, for a part of a body that a model cut
    nodes: np.ndarray  # (N,) mask
    vector: np.ndarray | None = (
        None  # (3,) force on the body or displacement; gives the direction of an arrow
    )
    label: str = ""  # beside the arrow
    number: int = 0  # on a PART

    @property
    def called(self) -> str:
        """The name of its kind."""
        return f"{PART} {self.number}" if self.kind == PART else style_of(self.kind)[0]

    @property
    def colour(self) -> str:
        """The colour of its kind, or of its number."""
        return PARTS[(self.number - 1) % len(PARTS)] if self.kind == PART else style_of(self.kind)[1]


@dataclass(frozen=True)
class Outline:
    """The outline of something inside the body."""

    name: str
    segments: np.ndarray  # (E, 2, 3) end points of lines [m]


def facets_at(nodes: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(F,) mask of the facets with all three nodes in a region (N,); if there are none, of those with one."""
    inside = np.asarray(nodes)[triangles]
    return np.asarray(inside.all(axis=1) if inside.all(axis=1).any() else inside.any(axis=1))


class Stage:
    """A scene with the camera that shows its parts best; the same arrays give the same drawing.

    Parameters
    ----------
    points : (N, 3) [m]
    triangles : (F, 3), outward
    parts : regions with loads or supports
    outlines : outlines of what is inside the body
    """

    def __init__(
        self,
        points: Array,
        triangles: np.ndarray,
        parts: Sequence[Part],
        outlines: Sequence[Outline] = (),
    ) -> None:
        self.points, self.triangles, self.parts, self.outlines = points, triangles, parts, outlines
        self.size = max(float(np.linalg.norm(np.ptp(points, axis=0))), 1e-12)
        self.arrows = [arrow for part in parts for arrow in self._arrows(part)]
        self.azimuth, elevation = self._camera()
        self.axes = directions(self.azimuth, elevation)
        self.seen = points @ self.axes.T

    @cached_property
    def area_vectors(self) -> Array:
        """(F, 3) outward area vectors of the facets [m^2]."""
        return facet_area_vectors(self.points, self.triangles)

    def facets(self, part: Part) -> np.ndarray:
        """(F,) mask of the facets with all three nodes in a part."""
        return np.asarray(part.nodes)[self.triangles].all(axis=1)

    def _arrows(self, part: Part) -> list[tuple[Array, Array, Part]]:
        """(tail, tip, part) of a part's arrow, which lies outside the body and ends or starts on its surface."""
        nodes = np.asarray(part.nodes)
        if part.vector is None or not nodes.any() or not np.any(part.vector):
            return []
        along = _ARROW * self.size * np.asarray(part.vector) / np.linalg.norm(part.vector)
        centre = self.points[nodes].mean(axis=0)
        inward = -self.area_vectors[facets_at(nodes, self.triangles)].sum(axis=0)
        # the part's node nearest to its centroid
        node = self.points[nodes][np.argmin(np.linalg.norm(self.points[nodes] - centre, axis=1))]
        tail, tip = (node - along, node) if inward @ along > 0 else (node, node + along)
        return [(tail, tip, part)]

    def _camera(self) -> tuple[float, float]:
        """Azimuth and elevation [rad] of the camera that shows most; a later one must show `_CLEARLY` more."""
        best, most = (_AZIMUTHS[0], _ELEVATIONS[0]), -1.0
        for camera in ((azimuth, elevation) for elevation in _ELEVATIONS for azimuth in _AZIMUTHS):
            shown = self._shown(directions(*camera))
            if shown > _CLEARLY * most:
                best, most = camera, shown
        return float(best[0]), float(best[1])

    def _shown(self, camera: Array) -> float:
        """How much a camera shows: roots of each part's visible share, and lengths of arrows, summed."""
        faces = np.clip(self.area_vectors @ camera[2], 0.0, None)
        areas = np.linalg.norm(self.area_vectors, axis=1)
        shown = 0.0
        for part in self.parts:
            inside = self.facets(part)
            if inside.any():
                shown += float(np.sqrt(faces[inside].sum() / max(areas[inside].sum(), 1e-300)))
        lengths = [np.linalg.norm(camera[:2] @ (tip - tail)) / self.size for tail, tip, _ in self.arrows]
        return shown + float(sum(lengths)) / _ARROW

    def outline(self, part: Part) -> tuple[Array, np.ndarray]:
        """(E, 2, 2) drawn edges around a part's facets, and (E,) whether they face the viewer."""
        edges = np.sort(half_edges(self.triangles[self.facets(part)]), axis=1)
        pairs, times = np.unique(edges, axis=0, return_counts=True)
        rim, normals = pairs[times == 1], nodal_sum(self.area_vectors, self.triangles, len(self.points))
        facing = (normals[rim] @ self.axes[2]).sum(axis=1) > 0
        return self.seen[rim][:, :, :2], facing

    def lone(self, part: Part) -> np.ndarray:
        """(N,) mask of a part's nodes that are in none of its facets."""
        lone = np.array(part.nodes, dtype=bool)
        lone[self.triangles[self.facets(part)].ravel()] = False
        return lone

    @cached_property
    def frame(self) -> tuple[Array, Array]:
        """Lower left (2,) and upper right (2,) corner of the drawing: body, arrows and a margin [m]."""
        ends = [end @ self.axes.T for tail, tip, _ in self.arrows for end in (tail, tip)]
        everything = np.concatenate([self.seen, *(end[None] for end in ends)])[:, :2]
        margin = 0.04 * self.size
        return everything.min(axis=0) - margin, everything.max(axis=0) + margin


def scene_png(stage: Stage, lines: Sequence[str] = (), *, title: str = "", dpi: int = 200) -> bytes:
    """`scene_figure` as a PNG file on white ground."""
    with rc_context(STYLE):
        return written(scene_figure(stage, lines, title), "png", dpi=dpi)


def scene_svg(stage: Stage, *, alt: str, salt: str, title: str = "") -> Markup:
    """`scene_figure` as an <svg> element in the colours of the page; `alt` describes it in words."""
    with rc_context(STYLE):
        return svg_of(scene_figure(stage, title=title), alt, salt)


def scene_figure(stage: Stage, lines: Sequence[str] = (), title: str = "") -> Figure:
    """The scene with `lines` of words below; call it inside `rc_context(STYLE)`.

    Dots show nodes of a part that are in none of its facets. Outlines on the far side are dotted.
    """
    words = [row for line in lines for row in wrap(line, _LETTERS)]
    rows = -(-(len(stage.parts) + len(stage.outlines)) // 2)
    low, high = stage.frame
    width, height = np.maximum(high - low, 1e-12)
    below, above = _LINE * (len(words) + rows + 0.8), _LINE * (2 if title else 0)
    drawing = min(_WIDTH * height / width, _MOST_HEIGHT)
    total = below + _FOOT + drawing + above
    figure = Figure((_WIDTH, total))
    axes = figure.add_axes((0.0, (below + _FOOT) / total, 1.0, drawing / total))
    axes.set_aspect("equal", anchor="C")
    axes.set_axis_off()
    _draw_body(axes, stage)
    for arrow in stage.arrows:
        _draw_arrow(axes, stage, *arrow)
    metres = max(width, height * _WIDTH / drawing) / _WIDTH  # per inch
    foot = figure.add_axes((0.0, below / total, 1.0, _FOOT / total))
    foot.set_xlim(0.0, _WIDTH)
    foot.set_ylim(0.0, _FOOT)
    foot.set_axis_off()
    _draw_scale(foot, metres)
    _draw_triad(foot, stage.axes)
    if stage.parts or stage.outlines:
        handles = [Patch(color=part.colour, label=_legend(part)) for part in stage.parts]
        handles += [
            Patch(color=INSIDE, label=f"inside: {shortened(outline.name, 25)}") for outline in stage.outlines
        ]
        figure.legend(
            handles=handles,
            ncols=2,
            frameon=False,
            handlelength=1.0,
            handleheight=1.0,
            loc="upper left",
            bbox_to_anchor=(0.01, below / total),
            borderaxespad=0.0,
        )
    for k, row in enumerate(reversed(words)):
        figure.text(0.03, _LINE * (k + 0.4) / total, row)
    if title:
        figure.text(0.03, 1 - _LINE * 1.2 / total, title, fontsize="large")
    return figure


def style_of(kind: str) -> tuple[str, str]:
    """The name and the colour of a kind of constraint."""
    return KINDS.get(kind, (kind, OTHER))


def _legend(part: Part) -> str:
    name = shortened(part.name, 25)
    return f"{part.called}: {name}" if name and name != part.called else part.called


def _draw_body(axes: Axes, stage: Stage) -> None:
    low, high = stage.frame
    colours = np.tile(to_rgba(BODY), (len(stage.triangles), 3, 1))
    for part in stage.parts:
        colours[stage.facets(part)] = to_rgba(part.colour)
    pixels = drawn(stage.seen, stage.triangles, colours, low, high - low, _PIXELS, _AMBIENT)
    axes.imshow(pixels, extent=(low[0], high[0], low[1], high[1]), interpolation="nearest", aspect="equal")
    for part in stage.parts:
        edges, facing = stage.outline(part)
        axes.add_collection(
            LineCollection(list(edges[~facing]), colors=part.colour, linewidths=1.0, linestyles=":")
        )
        axes.add_collection(LineCollection(list(edges[facing]), colors=part.colour, linewidths=1.2))
        dots = stage.seen[stage.lone(part)]
        axes.plot(dots[:, 0], dots[:, 1], "o", color=part.colour, markersize=3.0, markeredgewidth=0)
        shown = stage.facets(part) & (stage.area_vectors @ stage.axes[2] > 0)
        if part.kind == PART and shown.any():
            x, y, _ = stage.seen[stage.triangles[shown]].mean(axis=(0, 1))
            axes.text(x, y, f"{part.number}", color="black", ha="center", va="center")
    for outline in stage.outlines:
        seen = (outline.segments @ stage.axes.T)[:, :, :2]
        axes.add_collection(LineCollection(list(seen), colors=INSIDE, linewidths=1.2, linestyles="--"))
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])


def _draw_arrow(axes: Axes, stage: Stage, tail: Array, tip: Array, part: Part) -> None:
    start, end = ((stage.axes @ place)[:2] for place in (tail, tip))
    _arrow(axes, start, end, "-|>", 1.8, _ARROWS.get(part.kind, INK))
    low, high = stage.frame
    middle = (low + high) / 2
    nodes = stage.points[np.asarray(part.nodes)]
    touches = np.linalg.norm(nodes - tail, axis=1).min() <= np.linalg.norm(nodes - tip, axis=1).min()
    x, y = end if touches else start  # the end away from the body
    upright = abs(end - start)[1] > abs(end - start)[0]
    right, low_end = x > middle[0], y < (start + end)[1] / 2
    axes.annotate(
        part.label,
        (x, y),
        xytext=(5, -3) if upright else (0, -14 if low_end else 7),  # beside the arrow's outer end
        textcoords="offset points",
        ha="right" if right and not upright else "left",
        fontweight="bold",
    )


def _arrow(axes: Axes, start: Array, end: Array, style: str, width: float, colour: str = INK) -> None:
    look = {"arrowstyle": style, "color": colour, "linewidth": width, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (end[0], end[1]), (start[0], start[1]), arrowprops=look)


def _draw_scale(foot: Axes, metres: float) -> None:
    """A scale bar of a round length, near an inch; an inch of the drawing stands for `metres`."""
    length = round_below(metres)
    factor, unit = scale_of("m", [length])
    left, base = 0.15, 0.14
    foot.plot([left, left + length / metres], [base, base], color=INK, linewidth=2.4, solid_capstyle="butt")
    foot.text(left, base + 0.07, f"{plain(length / factor)} {unit}")


def _draw_triad(foot: Axes, camera: Array) -> None:
    """The directions of x, y and z at the right, from the farthest to the nearest to the viewer."""
    origin, size = np.array([_WIDTH - 0.55, 0.2]), 0.3
    for k in np.argsort(camera[2], kind="stable"):
        ahead = size * camera[:2, k]
        _arrow(foot, origin, origin + ahead, "->", 1.0)
        x, y = origin + 1.3 * ahead
        foot.text(x, y, "xyz"[k], ha="center", va="center")
