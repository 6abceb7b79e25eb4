"""Whose curve a curve is: told to the page's script, which shows it under the pointer, and written beside it."""

from __future__ import annotations

from collections.abc import Sequence
from urllib.parse import quote

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedFormatter
from matplotlib.transforms import Bbox

from solver_common.arrays import Array

ID = "told:"  # how the id of such a curve begins in the drawing
_LETTER, _HEIGHT, _GAP = 4.5, 8.5, 4.0  # points: of a label, and how far it is from its point
_SIZE = 7.4
_MOST_NAMED = 8  # curves of a chart; of more the legend tells


def tell(curve: Line2D, name: str, cases: Sequence[int] | None = None, *, named: bool = True) -> None:
    """Say whose points these are; `cases` has the number of each point's case, None where it has none of its own.

    Where there is room, the name stands beside the last point, unless `named` is False.
    """
    plain = quote(name.encode("utf-8", "replace"))  # no letter that an attribute would need escaped
    curve.set_gid(f"{ID}{plain} {','.join(map(str, cases or ()))}")
    if named:
        curve.set_label(name)


def name_curves(axes: Axes) -> None:
    """Write the names of told curves beside their last points, where nothing else is drawn."""
    curves = [curve for curve in axes.lines if str(curve.get_gid()).startswith(ID) and _is_named(curve)]
    if not 1 < len(curves) <= _MOST_NAMED:
        return
    axes.apply_aspect()
    points = 72.0 / axes.figure.dpi  # per pixel
    frame = Bbox(axes.get_window_extent().get_points() * points)
    drawn = np.concatenate([_samples(curve) * points for curve in axes.lines] or [np.zeros((0, 2))])
    taken: list[Bbox] = []
    for curve in curves:
        own = _samples(curve, between=False) * points
        if not len(own):
            continue
        last = int(np.argmax(own[:, 0]))
        x, y = own[last]
        data = axes.transData.inverted().transform(own[last] / points)
        width = _LETTER * len(str(curve.get_label()))
        for dx, dy, side in _sides(width):
            box = Bbox.from_bounds(x + dx, y + dy, width, _HEIGHT)
            if _is_free(box, frame, drawn, taken):
                taken.append(box)
                axes.annotate(
                    str(curve.get_label()),
                    (data[0], data[1]),
                    xytext=(dx if side == "left" else dx + width, dy + 1.5),
                    textcoords="offset points",
                    ha=side,
                    fontsize=_SIZE,
                )
                break


def _is_named(curve: Line2D) -> bool:
    return not str(curve.get_label()).startswith("_")


def _sides(width: float) -> list[tuple[float, float, str]]:
    """Where a label's lower left corner may be from its point, and its alignment: above, below, right, left."""
    return [
        (-width, _GAP, "right"),
        (-width, -_GAP - _HEIGHT, "right"),
        (_GAP + 2, -_HEIGHT / 2, "left"),
        (-width - _GAP - 2, -_HEIGHT / 2, "right"),
        (-_GAP, _GAP, "left"),
        (-_GAP, -_GAP - _HEIGHT, "left"),
    ]


def _is_free(box: Bbox, frame: Bbox, drawn: Array, taken: Sequence[Bbox]) -> bool:
    if box.x0 < frame.x0 or box.x1 > frame.x1 + 8 or box.y0 < frame.y0 or box.y1 > frame.y1:
        return False
    inside = (drawn > [box.x0 - 1, box.y0 - 1]).all(axis=1) & (drawn < [box.x1 + 1, box.y1 + 1]).all(axis=1)
    return not inside.any() and not any(box.overlaps(other) for other in taken)


def _samples(curve: Line2D, *, between: bool = True) -> Array:
    """(K, 2) pixels of a curve's points and, where a line joins them, of places between."""
    pixels = curve.get_transform().transform(
        np.column_stack([curve.get_xdata(), curve.get_ydata()]).astype(float)
    )
    pixels = pixels[np.isfinite(pixels).all(axis=1)]
    if not between or len(pixels) < 2 or curve.get_linestyle() == "None":
        return np.asarray(pixels)
    fine = np.linspace(0, len(pixels) - 1, 24 * (len(pixels) - 1) + 1 if len(pixels) < 40 else len(pixels))
    at = np.arange(len(pixels))
    return np.column_stack([np.interp(fine, at, pixels[:, k]) for k in (0, 1)])


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
