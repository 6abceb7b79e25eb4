"""The charts, drawn with matplotlib, as inline SVG that takes colours and fonts from the page."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from markupsafe import Markup, escape
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from matplotlib.ticker import (
    FixedFormatter,
    FixedLocator,
    FuncFormatter,
    LogLocator,
    MaxNLocator,
    NullLocator,
)
from matplotlib.transforms import Bbox, blended_transform_factory
from numpy.typing import ArrayLike

from solver_common.arrays import Array

from ..verdict.digest import REFERENCE, Digest
from ..verdict.formatting import listed, plain, span
from ..verdict.palette import COLOURS
from .blocks import Figure
from .picture import written

ID = "\ue001"  # first letter of the ids of curves whose points the page's script describes; no name has it
# placeholder colours: `svg_of` replaces them by the page's
INK, GRID, REFERENCE_COLOUR = "#010203", "#020304", "#030405"
MODELS = tuple(f"#0405{k:02x}" for k in range(COLOURS))
# the markers of the charts, o s ^ D v P X, in a box of 14 by 10 around (7, 5)
MARKER_PATHS = (
    "M7 1.2a3.8 3.8 0 1 1-.01 0Z",
    "M3.4 1.4h7.2v7.2h-7.2Z",
    "M7 .8 11.2 9H2.8Z",
    "M7 .4 11.6 5 7 9.6 2.4 5Z",
    "M7 9.2 2.8 1h8.4Z",
    "M5.6 1h2.8v2.6h2.6v2.8H8.4V9H5.6V6.4H3V3.6h2.6Z",
    "M4.8.8 7 3 9.2.8 11.2 2.8 9 5l2.2 2.2-2 2L7 7 4.8 9.2l-2-2L5 5 2.8 2.8Z",
)
STYLE: Any = {
    "svg.fonttype": "none",
    "font.family": "DejaVu Sans",
    "font.size": 8.3,
    "text.color": INK,
    "text.parse_math": False,
    "axes.unicode_minus": True,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "axes.grid": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "lines.linewidth": 1.6,
    "lines.markersize": 4.5,
}


def svg_of(figure: Canvas, alt: str, salt: str, told: Sequence[Sequence[str]] = ()) -> Markup:
    """A figure, drawn inside `rc_context(STYLE)`, as an <svg> element with the page's colours; CSS sets its size.

    Parameters
    ----------
    alt : what it shows, in words
    salt : makes its ids unique on the page
    told : for each curve the words of its points, which the page's script shows
    """
    with rc_context({"svg.hashsalt": salt}):
        svg = written(figure, "svg", transparent=True).decode()
    # strip lines first: each pattern that begins with white space would take as long as all of these together
    svg = "\n".join(filter(None, map(str.strip, svg[svg.index("<svg") :].split("\n"))))
    head, svg = svg.split(">", 1)
    box = head.split('viewBox="')[1].split('"')[0]
    svg = svg.replace("xlink:href=", "href=")
    used = {*re.findall(r"url\(#([^)]+)\)", svg), *re.findall(r'href="#([^"]+)"', svg)}
    svg = re.sub(rf' id="([^"{ID}]+)"', lambda found: found[0] if found[1] in used else "", svg)
    colours = {INK: "var(--ink)", GRID: "var(--grid)", REFERENCE_COLOUR: "var(--reference)"}
    colours |= {code: f"var(--model-{k})" for k, code in enumerate(MODELS)}
    for code, variable in colours.items():
        svg = svg.replace(code, variable)
    svg = re.sub(r"\n<style.*?</style>", "", svg, flags=re.S)
    svg = re.sub(r" font-family: [^;\"]+;?", "", svg)
    svg = _TAG.sub(lambda tag: _BEYOND_HUNDREDTHS.sub("", tag[0]), svg)  # in tags only, not in texts
    svg = re.sub(r' transform="rotate\(-0 [^"]*"', "", svg)
    for k, words in enumerate(told):
        svg = svg.replace(f'id="{ID}{k}"', f'data-told="{escape(json.dumps(words))}"')
    return Markup(f'<svg viewBox="{box}" role="img" aria-label="{escape(alt)}" class="plot">{svg}\n')


_TAG = re.compile(r"<[^>]*>")
_BEYOND_HUNDREDTHS = re.compile(r"(?<=\d\.\d\d)\d+")


_MOST_TICKS = 16
_MOST_NAMED = 8  # most curves with names beside them; the legend always has all
_LETTER, _HIGH, _GAP = 4.5, 8.5, 4.0  # width of a letter, height of a name, distance from its curve [points]
_MARK = 2.3  # half of a marker [points]
_MOST_MARKED = 25  # most points of a line with markers
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
LINES = ("-", "--", "-.", ":")
_WIDTH, _HEIGHT = 4.4, 3.0  # inches of 72 points: the width of a phone, so that text stays readable there
_ROW = 0.19  # height of a row of the legend below the axes [inches]
# equal for all plots, so that their axes line up on the page; with room for a label and ticks of eight characters
_MARGINS = {"left": 0.19, "right": 0.97, "bottom": 0.155, "top": 0.98}
_LABELS = 0.045, 0.066  # distance of the axes' labels from the left and from the bottom, as shares
_BOTTOM_FOR_SLANTED_NAMES = 0.34


def colour(model: int) -> str:
    """Colour of a model, from its place in the palette; the reference has the place `REFERENCE`."""
    return REFERENCE_COLOUR if model == REFERENCE else MODELS[model % COLOURS]


def shape(model: int) -> int:
    """Index of a model's marker, from its place in the palette."""
    return (model + model // COLOURS) % len(MARKERS)


def look(model: int) -> dict[str, str]:
    """Colour, marker and line style of a model, from its place in the palette.

    Markers tell colours apart for colour-blind readers. Lines are broken only if a colour is used again.
    """
    again = max(model, 0) // COLOURS
    return {
        "color": colour(model),
        "marker": "o" if model == REFERENCE else MARKERS[shape(model)],
        "linestyle": LINES[1 + (again - 1) % 3] if again else LINES[0],
    }


def shortened(text: str, most: int = 22) -> str:
    """A name from a study file as a label: printable characters, at most `most` of them."""
    text = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)
    return text if len(text) <= most else f"{text[: most - 1]}…"


@dataclass(frozen=True)
class Curve:
    """The points of one model in a chart.

    Attributes
    ----------
    model : name of the model
    x, y : (K,) coordinates
    cases : (K,) index of each point's case; None if a point stands for several
    look : further properties of the line
    band : least and largest (K,) y of the values that a point stands for; a band, or whiskers without a line
    """

    model: str
    x: ArrayLike
    y: ArrayLike
    cases: Sequence[int] | None = None
    look: Mapping[str, Any] = field(default_factory=dict)
    band: tuple[ArrayLike, ArrayLike] | None = None

    @property
    def joined(self) -> bool:
        """Whether a line joins the points."""
        return self.look.get("linestyle") != "none"

    @property
    def every(self) -> int:
        """Distance of marked points: every `every`-th point has a marker."""
        return max(1, math.ceil(np.size(self.x) / _MOST_MARKED)) if self.joined else 1


def lines(
    digest: Digest,
    curves: Sequence[Curve],
    x_label: str,
    y_label: str,
    title: str,
    salt: str,
    *,
    finish: Callable[[Axes], object] = lambda _: None,
) -> Figure:
    """A chart with one curve for each model; its description has the first and the last point of each curve.

    Parameters
    ----------
    x_label, y_label : labels of the axes; a unit in brackets at the end is also written beside numbers in words
    salt : makes the ids of the drawing unique on the page
    finish : sets scales and adds further lines, after all curves are drawn
    """
    with rc_context(STYLE):
        page = Canvas(figsize=(_WIDTH, _HEIGHT))
        page.subplots_adjust(**_MARGINS)
        page.patch.set_visible(False)
        axes = page.add_subplot()
        axes.patch.set_visible(False)
        axes.set(xlabel=shortened(x_label, 60), ylabel=shortened(y_label, 40))
        for k, curve in enumerate(curves):
            _draw(axes, digest, curve, f"{ID}{k}")
        finish(axes)
        _legend_below(page, axes)
        name_curves(axes)
        words = [_words(axes, digest, curve) for curve in curves]
        ends = listed(f"{curve.model} {_ends(axes, curve)}" for curve in curves)
        return Figure(svg_of(page, f"{title}: {ends}.", salt, words), title)


def _draw(axes: Axes, digest: Digest, curve: Curve, gid: str) -> None:
    number = digest.colour(curve.model)
    if curve.band is not None and np.any(np.not_equal(*curve.band)):
        if curve.joined:
            axes.fill_between(curve.x, *curve.band, color=colour(number), alpha=0.14, linewidth=0)
        else:
            axes.vlines(curve.x, *curve.band, color=colour(number), alpha=0.6, linewidth=1.0)
    label = f"{shortened(curve.model, 30)}{' (reference)' if curve.model == digest.reference else ''}"
    axes.plot(curve.x, curve.y, markevery=curve.every, label=label, gid=gid, **{**look(number), **curve.look})


def _words(axes: Axes, digest: Digest, curve: Curve) -> list[str]:
    """The words of each marked point: its model, its case and its coordinates."""
    cases = [digest.case_name(digest.cases[k]) for k in curve.cases or ()]
    marked = range(0, np.size(curve.x), curve.every)
    return ["\n".join([curve.model, *cases[k : k + 1], _place(axes, curve, k)]) for k in marked]


def _ends(axes: Axes, curve: Curve) -> str:
    """The first and the last point of a curve, in words."""
    ends = dict.fromkeys(_place(axes, curve, k) for k in (0, -1))
    return f"{'from ' if len(ends) > 1 else ''}{' to '.join(ends)}"


def _place(axes: Axes, curve: Curve, k: int) -> str:
    """A point of a curve in words: `10 % at 0.45`."""
    values = (axes.yaxis, np.asarray(curve.y)[k]), (axes.xaxis, np.asarray(curve.x)[k])
    return " at ".join(filter(None, (_on_axis(axis, float(value)) for axis, value in values)))


def _on_axis(axis: Axis, value: float) -> str:
    """A value in the format of its axis, with the unit of the axis' label; "" on an axis of names."""
    formatter = axis.get_major_formatter()
    if isinstance(formatter, FixedFormatter):
        return ""
    text = formatter(value) if isinstance(formatter, FuncFormatter) else plain(value, 4)
    _, bracket, unit = axis.get_label_text().partition(" [")
    return f"{text} {unit[:-1]}" if bracket else text


def _legend_below(page: Canvas, axes: Axes) -> None:
    """Add a legend below the axes, and enlarge the page so that the axes keep their size."""
    handles, names = axes.get_legend_handles_labels()
    below, now = _ROW * -(-len(names) // 2), page.subplotpars
    whole = _HEIGHT + below
    bottom, top = ((below + _HEIGHT * share) / whole for share in (now.bottom, now.top))
    page.set_size_inches(_WIDTH, whole)
    page.subplots_adjust(bottom=bottom, top=top)
    # axis labels at fixed distances from the margins, so that those of all charts line up
    down = (below + _LABELS[1] * _HEIGHT) / whole
    axes.xaxis.set_label_coords(0.5, down, blended_transform_factory(axes.transAxes, page.transFigure))
    axes.yaxis.set_label_coords(_LABELS[0], 0.5, blended_transform_factory(page.transFigure, axes.transAxes))
    place: Any = {"loc": "lower left", "bbox_to_anchor": (_MARGINS["left"], 0.0), "borderaxespad": 0.0}
    page.legend(handles, names, ncols=2, frameon=False, columnspacing=1.2, borderpad=0.0, **place)


def level_line(axes: Axes, at: float, name: str, style: str, axis: str = "y") -> None:
    """A named line across the chart at a value of one axis; none if the value is NaN or not positive."""
    if at > 0.0:
        looks: Any = {"va": "bottom", "ha": "right", "fontsize": 7.0, "color": colour(REFERENCE)}
        if axis == "y":
            axes.axhline(at, linestyle=style, color=colour(REFERENCE), linewidth=1.0)
            axes.text(0.995, at, name, transform=axes.get_yaxis_transform(), **looks)
        else:
            axes.axvline(at, linestyle=style, color=colour(REFERENCE), linewidth=1.0)
            looks |= {"va": "top", "rotation": 90}
            beside: Any = {"xytext": (-1.5, 0.0), "textcoords": "offset points", **looks}
            axes.annotate(name, (at, 0.99), xycoords=axes.get_xaxis_transform(), **beside)


def from_origin(axes: Axes) -> None:
    """Both axes begin at zero, or below if curves do."""
    axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))


def percent_axis(axes: Axes, values: ArrayLike) -> None:
    """The y axis shows ratios as percentages: linear from zero, or logarithmic if they span more than a decade."""
    ratios = np.asarray(values, dtype=np.float64)
    finite = ratios[np.isfinite(ratios)]
    if len(finite) and finite.min() > 0 and finite.max() > 10 * finite.min():
        axes.set_yscale("log")
        axes.set_ylim(finite.min() / 1.5, 1.5 * finite.max())
        log_axis(axes, "y")
    else:
        top = float(finite.max()) if len(finite) else 0.0
        axes.set_ylim(0.0, 1.08 * top if top > 0 else 1.0)
        axes.yaxis.set_major_locator(MaxNLocator(6))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{plain(value * 100)} %"))


def time_axis(axes: Axes) -> None:
    """Seconds on a logarithmic x axis, named with their prefix."""
    log_axis(axes, "x")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: span([value], "s", 3)))


def log_axis(axes: Axes, which: str) -> None:
    """A logarithmic axis with ticks at decades, and between them if there are fewer than three decades."""
    axes.set(**{f"{which}scale": "log"})
    axis = axes.xaxis if which == "x" else axes.yaxis
    low, high = axis.get_view_interval()
    subdivisions = (1.0, 2.0, 5.0) if high < 30 * low else (1.0, 3.0) if high < 1000 * low else (1.0,)
    axis.set_major_locator(LogLocator(subs=subdivisions, numticks=8))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))


def place(values: Sequence[float]) -> tuple[str, dict[float, float]]:
    """The layout of a parameter's values on an axis: ("linear" | "log" | "even", value -> position).

    Values are evenly spaced if neither scale keeps neighbours apart, as for Poisson's ratios that approach 1/2.
    """
    distinct = sorted(set(values))
    as_is = {value: value for value in distinct}
    if len(distinct) < 3 or _spacing(np.array(distinct)) <= 12.0:
        return "linear", as_is
    if distinct[0] > 0 and (_spacing(np.log(distinct)) <= 12.0 or len(distinct) > 12):
        return ("log", as_is) if distinct[-1] > 8 * distinct[0] else ("linear", as_is)
    if len(distinct) > 12:
        return "linear", as_is
    return "even", {value: float(k) for k, value in enumerate(distinct)}


def _spacing(values: Array) -> float:
    gaps = np.diff(values)
    return float(gaps.max() / gaps.min())


def name_ticks(axes: Axes, ticks: Sequence[tuple[float, str]]) -> None:
    """Named ticks (position, name) on the x axis: thinned if there are many, slanted if they would collide."""
    ticks = ticks[:: max(1, -(-len(ticks) // _MOST_TICKS))]
    names = [shortened(name, 16) for _, name in ticks]
    axes.xaxis.set_major_locator(FixedLocator([x for x, _ in ticks]))
    axes.xaxis.set_major_formatter(FixedFormatter(names))
    axes.xaxis.set_minor_locator(NullLocator())
    if sum(len(name) for name in names) > 34:
        axes.figure.subplots_adjust(bottom=_BOTTOM_FOR_SLANTED_NAMES)
        for label in axes.get_xticklabels():
            label.set_rotation(30)
            label.set_horizontalalignment("right")


# --- names beside curves ---


def name_curves(axes: Axes) -> None:
    """Write the names of curves above or below their last points, if nothing else is drawn there."""
    named = [curve for curve in axes.lines if not str(curve.get_label()).startswith("_")]
    axes.apply_aspect()
    _move_level_names(axes)
    curves = [curve for curve in named if curve.get_linestyle() != "None"]
    if not 1 < len(curves) <= _MOST_NAMED:
        return
    pixels = axes.figure.dpi / 72.0  # per point
    taken: list[Bbox] = [text.get_window_extent() for text in axes.texts]  # names of level lines
    drawn = _drawn(axes.lines)
    for curve in curves:
        _, own = _drawn([curve])
        if not len(own):
            continue
        right, middle = own[np.argmax(own[:, 0])]
        width, height = pixels * _LETTER * len(str(curve.get_label())), pixels * _HIGH
        for up in (True, False):
            low = middle + (pixels * _GAP if up else -pixels * _GAP - height)
            box = Bbox.from_bounds(right - width, low, width, height)
            if _is_free(axes, box, taken, *drawn):
                taken.append(box)
                at = axes.transData.inverted().transform((right, middle))
                look: Any = {"ha": "right", "va": "bottom" if up else "top", "fontsize": 7.4}
                name, shift = str(curve.get_label()), (0, _GAP if up else -_GAP)
                axes.annotate(name, tuple(at), xytext=shift, textcoords="offset points", **look)
                break


def _move_level_names(axes: Axes) -> None:
    """Move the names of horizontal level lines to a free end and side of their line, if there is one."""
    places: Any = [(x, ha, va) for va in ("bottom", "top") for x, ha in ((0.995, "right"), (0.005, "left"))]
    taken: list[Bbox] = []
    levels = [str(line.get_label()).startswith("_") and not np.ptp(line.get_ydata()) for line in axes.lines]
    drawn = _drawn([line for line, level in zip(axes.lines, levels, strict=True) if not level])
    for text in (text for text in axes.texts if not text.get_rotation()):
        for x, ha, va in (*places, places[0]):
            text.set(x=x, ha=ha, va=va)
            if _is_free(axes, text.get_window_extent(), taken, *drawn):
                break
        taken.append(text.get_window_extent())


def _is_free(axes: Axes, box: Bbox, taken: Sequence[Bbox], drawn: Array, points: Array) -> bool:
    """Whether a box of pixels has room for a name: inside the axes, without other names, lines or markers."""
    frame, marker = axes.get_window_extent(), box.padded(axes.figure.dpi / 72.0 * _MARK)
    inside = frame.x0 <= box.x0 and frame.y0 <= box.y0 and box.y1 <= frame.y1
    return inside and not (
        box.count_overlaps(taken) or box.count_contains(drawn) or marker.count_contains(points)
    )


def _drawn(curves: Sequence[Line2D]) -> tuple[Array, Array]:
    """(K, 2) pixels along curves, with their lines if they have one; and (L, 2) pixels of their points."""
    drawn, points = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for curve in curves:
        path = curve.get_transform().transform_path(curve.get_path())
        points.append(np.asarray(path.vertices))
        if curve.get_linestyle() != "None" and len(path) > 1:
            path = path.interpolated(60)
        drawn.append(np.asarray(path.vertices))
    found = [np.concatenate(parts) for parts in (drawn, points)]
    drawn_at, points_at = (places[np.isfinite(places).all(axis=1)] for places in found)
    return drawn_at, points_at
