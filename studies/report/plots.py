"""The charts: panels drawn with matplotlib, as inline SVG that takes its colours and fonts from the page."""

from __future__ import annotations

import io
import math
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import quote

import numpy as np
from markupsafe import Markup, escape
from matplotlib import rc_context
from matplotlib.axes import Axes
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
from ..verdict.formatting import listed, plain, quantity, short_percent
from ..verdict.palette import COLOURS
from .blocks import Figure

ID = "told:"  # how the id of a curve begins whose words the page's script shows
# drawn in these, shown in the page's
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
    "svg.hashsalt": "sheet",
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


def svg_of(figure: Canvas) -> str:
    """The SVG file of a figure, to be drawn inside `rc_context(STYLE)`."""
    out = io.StringIO()
    metadata = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with warnings.catch_warnings():
        # a glyph that matplotlib's own font lacks is drawn by the browser's
        warnings.filterwarnings("ignore", "Glyph .* missing", UserWarning)
        figure.savefig(out, format="svg", metadata=metadata, transparent=True)
    return out.getvalue()


def for_the_page(svg: str, alt: str, salt: str, attributes: str = "") -> Markup:
    """The <svg> element of a drawing with the page's colours, sized by CSS, ids unique on the page.

    `alt` says in words what it shows; `attributes` are further ones for scripts. Matplotlib has escaped the
    texts of the drawing.
    """
    # bare lines first: of patterns that begin with white space each takes as long as all of these together
    svg = "\n".join(filter(None, map(str.strip, svg[svg.index("<svg") :].split("\n"))))
    view_box = re.search(r'viewBox="([^"]+)"', svg)
    box = view_box.group(1) if view_box else ""
    svg = svg[svg.index(">") + 1 :]
    svg = svg.replace("xlink:href=", "href=")
    told = re.findall(rf' id="{ID}([^"]*)"', svg)
    svg = re.sub(rf' id="{ID}[^"]*"', f" {_TOLD}", svg)
    names = dict.fromkeys(re.findall(r' id="([^"]+)"', svg))
    used = {*re.findall(r"url\(#([^)]+)\)", svg), *re.findall(r'href="#([^"]+)"', svg)}
    short = {name: f"{salt}-{k}" for k, name in enumerate(n for n in names if n in used)}
    svg = re.sub(r' id="([^"]+)"', lambda m: f' id="{short[m[1]]}"' if m[1] in short else "", svg)
    svg = re.sub(r"url\(#([^)]+)\)", lambda m: f"url(#{short[m[1]]})", svg)
    svg = re.sub(r'href="#([^"]+)"', lambda m: f'href="#{short[m[1]]}"', svg)
    colours = {INK: "var(--ink)", GRID: "var(--grid)", REFERENCE_COLOUR: "var(--reference)"}
    colours |= {code: f"var(--model-{k})" for k, code in enumerate(MODELS)}
    for code, variable in colours.items():
        svg = svg.replace(code, variable)
    svg = re.sub(r"\n<style.*?</style>", "", svg, flags=re.S)
    svg = re.sub(r" font-family: [^;\"]+;?", "", svg)
    svg = _TAG.sub(lambda tag: _BEYOND_HUNDREDTHS.sub("", tag[0]), svg)  # not in its texts
    svg = re.sub(r' transform="rotate\(-0 [^"]*"', "", svg)
    for text in told:
        svg = svg.replace(_TOLD, f'data-told="{text}"', 1)
    return Markup(
        f'<svg viewBox="{box}" role="img" aria-label="{escape(alt)}" class="plot"{attributes}>{svg}\n'
    )


_TOLD = "\ue001"  # where a curve's words come back
_TAG = re.compile(r"<[^>]*>")
_BEYOND_HUNDREDTHS = re.compile(r"(?<=\d\.\d\d)\d+")


_MOST_TICKS = 16
_MOST_NAMED = 8  # curves of a chart; of more the legend tells
_LETTER, _HIGH, _GAP = 4.5, 8.5, 4.0  # points: of a name, and how far it is from its point
_MOST_MARKED = 25  # points of a line
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
LINES = ("-", "--", "-.", ":")
_WIDTH, _HEIGHT = 4.4, 3.0  # inches of 72 points: as wide as a phone, so that text stays readable there
# the same for all plots, so that their axes line up on the page; room for a label and ticks of eight characters
_MARGINS = {"left": 0.19, "right": 0.97, "bottom": 0.155, "top": 0.98}
_LABELS = 0.045, 0.066  # how far the axes' labels are from the left and from the bottom
_BOTTOM_FOR_SLANTED_NAMES = 0.34


def colour(model: int) -> str:
    """Colour of a model by its place in the palette; the reference is `REFERENCE`."""
    return REFERENCE_COLOUR if model == REFERENCE else MODELS[model % COLOURS]


def marker(model: int) -> str:
    """Marker of a model: differs where colours may not be told apart, and where models share one."""
    return "o" if model == REFERENCE else MARKERS[shape(model)]


def shape(model: int) -> int:
    """Which of the markers a model has."""
    return (model + model // COLOURS) % len(MARKERS)


def line(model: int) -> str:
    """Line style of a model: solid for as long as the palette lasts."""
    again = max(model, 0) // COLOURS
    return LINES[1 + (again - 1) % 3] if again else LINES[0]


def shortened(text: str, most: int = 22) -> str:
    """A name from a study file as a label: one line, no control characters, not too long."""
    text = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)
    return text if len(text) <= most else f"{text[: most - 1]}…"


def panel(x_label: str, y_label: str) -> tuple[Canvas, Axes]:
    """An empty panel and its axes, with labels at the margins, where those of all panels line up."""
    page = Canvas(figsize=(_WIDTH, _HEIGHT))
    page.subplots_adjust(**_MARGINS)
    page.patch.set_visible(False)
    axes = page.add_subplot()
    axes.patch.set_visible(False)
    axes.xaxis.set_label_coords(0.5, _LABELS[1], blended_transform_factory(axes.transAxes, page.transFigure))
    axes.yaxis.set_label_coords(_LABELS[0], 0.5, blended_transform_factory(page.transFigure, axes.transAxes))
    axes.set(xlabel=shortened(x_label, 60), ylabel=shortened(y_label, 40))
    return page, axes


@dataclass(frozen=True)
class Curve:
    """The points of one model: (K,) x and y, the case of each where they have one, further looks of the line.

    `band` has the least and the largest (K,) y of what a point stands for: a band, or whiskers where no line joins.
    """

    model: str
    x: ArrayLike
    y: ArrayLike
    cases: Sequence[int] | None = None
    look: Mapping[str, Any] = field(default_factory=dict)
    band: tuple[ArrayLike, ArrayLike] | None = None

    def ends(self) -> Array:
        """From where to where its y go: the range of the band, else the first and the last."""
        if self.band is None:
            return np.asarray(self.y)[[0, -1]]
        return np.array([np.min(self.band[0]), np.max(self.band[1])])


def lines(
    digest: Digest,
    curves: Sequence[Curve],
    x_label: str,
    y_label: str,
    title: str,
    salt: str,
    *,
    finish: Callable[[Axes], object] = lambda _: None,
    shown: Callable[[float], str] = short_percent,
    told: Callable[[Curve], str] | None = None,
) -> Figure:
    """A chart of a curve a model, which says in words from where to where each goes.

    Parameters
    ----------
    salt : makes the ids of the drawing its own on a page
    finish : sets scales and adds what is no model's; called when all curves are drawn
    shown : a number on the y axis as a text
    told : what is said of a curve instead of where its y axis begins and ends
    """
    with rc_context(STYLE):
        page, axes = panel(x_label, y_label)
        for curve in curves:
            number = digest.colour(curve.model)
            if curve.band is not None and np.any(np.not_equal(*curve.band)):
                if curve.look.get("linestyle") == "none":
                    axes.vlines(curve.x, *curve.band, color=colour(number), alpha=0.6, linewidth=1.0)
                else:
                    axes.fill_between(curve.x, *curve.band, color=colour(number), alpha=0.14, linewidth=0)
            look = {
                "color": colour(number),
                "marker": marker(number),
                "linestyle": line(number),
                **curve.look,
            }
            joined = look["linestyle"] != "none"
            every = max(1, math.ceil(len(np.atleast_1d(curve.x)) / _MOST_MARKED)) if joined else 1
            (drawn,) = axes.plot(curve.x, curve.y, markevery=every, **look)
            # no letter that an attribute would need escaped
            plain = quote(curve.model.encode("utf-8", "replace"))
            drawn.set_gid(f"{ID}{plain} {','.join(map(str, (curve.cases or ())[::every]))}")
            if joined:
                drawn.set_label(curve.model)
        finish(axes)
        name_curves(axes)
        for_script, svg = axes_for_script(axes), svg_of(page)

    def ends(curve: Curve) -> str:
        found = dict.fromkeys(shown(float(y)) for y in curve.ends())
        return f"{'from ' if len(found) > 1 else ''}{' to '.join(found)}"

    words = listed(f"{curve.model} {(told or ends)(curve)}" for curve in curves)
    return Figure(for_the_page(svg, f"{title}: {words}.", salt, for_script), title)


def level_line(axes: Axes, at: float, name: str, style: str, axis: str = "y") -> None:
    """A line across the chart at a value of one axis, named; none at one that is not positive or not known."""
    if at > 0.0:
        look: Any = {"va": "bottom", "ha": "right", "fontsize": 7.0, "color": colour(REFERENCE)}
        if axis == "y":
            axes.axhline(at, linestyle=style, color=colour(REFERENCE), linewidth=1.0)
            axes.text(0.995, at, name, transform=axes.get_yaxis_transform(), **look)
        else:
            axes.axvline(at, linestyle=style, color=colour(REFERENCE), linewidth=1.0)
            look |= {"va": "top", "rotation": 90}
            axes.text(at, 0.99, name, transform=axes.get_xaxis_transform(), **look)


def from_origin(axes: Axes) -> None:
    """Both axes begin at zero, or below where curves do."""
    axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))


def percent_axis(axes: Axes, values: ArrayLike) -> None:
    """The y axis shows ratios as percentages: from zero, or by decades where they span more than one."""
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
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: quantity(value, "s", 1)))


def log_axis(axes: Axes, which: str) -> None:
    """Decades without minor clutter; steps between where there are fewer than three."""
    axes.set(**{f"{which}scale": "log"})
    axis = axes.xaxis if which == "x" else axes.yaxis
    low, high = axis.get_view_interval()
    subdivisions = (1.0, 2.0, 5.0) if high < 30 * low else (1.0, 3.0) if high < 1000 * low else (1.0,)
    axis.set_major_locator(LogLocator(subs=subdivisions, numticks=8))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))


def place(values: Sequence[float]) -> tuple[str, dict[float, float]]:
    """How to lay out a parameter's values on an axis: ("linear" | "log" | "even", value -> position).

    Evenly where neither scale would keep neighbours apart, as for Poisson ratios that close in on 1/2.
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
    """Named ticks (position, name) on the x axis: thinned where there are many, slanted where they collide."""
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


# --- whose curve a curve is: told to the page's script, which shows it under the pointer, and written beside it ---


def name_curves(axes: Axes) -> None:
    """Write the names of joined curves above or below their last points, where nothing else is drawn."""
    curves = [curve for curve in axes.lines if not str(curve.get_label()).startswith("_")]
    if not 1 < len(curves) <= _MOST_NAMED:
        return
    axes.apply_aspect()
    pixels = axes.figure.dpi / 72.0  # per point
    frame, drawn = (
        axes.get_window_extent(),
        np.concatenate([_drawn(curve, between=True) for curve in axes.lines]),
    )
    taken: list[Bbox] = []
    for curve in curves:
        own = _drawn(curve, between=False)
        if not len(own):
            continue
        right, middle = own[np.argmax(own[:, 0])]
        width, height = pixels * _LETTER * len(str(curve.get_label())), pixels * _HIGH
        for up in (True, False):
            low = middle + (pixels * _GAP if up else -pixels * _GAP - height)
            box = Bbox.from_bounds(right - width, low, width, height)
            inside = frame.x0 <= box.x0 and frame.y0 <= box.y0 and box.y1 <= frame.y1
            if inside and not box.count_overlaps(taken) and not box.count_contains(drawn):
                taken.append(box)
                at = axes.transData.inverted().transform((right, middle))
                look: Any = {"ha": "right", "va": "bottom" if up else "top", "fontsize": 7.4}
                name, shift = str(curve.get_label()), (0, _GAP if up else -_GAP)
                axes.annotate(name, tuple(at), xytext=shift, textcoords="offset points", **look)
                break


def _drawn(curve: Line2D, *, between: bool) -> Array:
    """(K, 2) pixels of a curve's points and, where a line joins them, of places between."""
    path = curve.get_transform().transform_path(curve.get_path())
    if between and curve.get_linestyle() != "None" and len(path) > 1:
        path = path.interpolated(20)
    places = np.asarray(path.vertices)
    return places[np.isfinite(places).all(axis=1)]


def axes_for_script(axes: Axes) -> str:
    """Attributes that turn places on the drawing into values: scale, two values, their places [pt], unit."""
    width, height = (float(v) * 72.0 / axes.figure.dpi for v in axes.figure.bbox.size)
    box = axes.get_position()
    found = []
    for which, axis, low, high in (
        ("x", axes.xaxis, box.x0 * width, box.x1 * width),
        ("y", axes.yaxis, height - box.y0 * height, height - box.y1 * height),
    ):
        formatter = axis.get_major_formatter()
        if isinstance(formatter, FixedFormatter):
            continue  # names
        shown = formatter(1.0)
        unit = "%" if shown.endswith("%") else "s" if shown.endswith("s") else ""
        start, end = axis.get_view_interval()
        found.append(f' data-{which}="{axis.get_scale()} {start:.6g} {end:.6g} {low:.1f} {high:.1f} {unit}"')
    return "".join(found)
