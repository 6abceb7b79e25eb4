"""How the report's figures look: colours, markers and lines of the models, and the scales they share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .axes import Axes, Axis
from .digest import REFERENCE, Array
from .formatting import plain, quantity

PALETTE_SIZE = 7
_MOST_TICKS = 16
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
LINES = ("-", "--", "-.", ":")


def colour(model: int) -> str:
    """Colour of a model by its number; the reference is `REFERENCE`."""
    return "var(--reference)" if model == REFERENCE else f"var(--model-{model % PALETTE_SIZE})"


def marker(model: int) -> str:
    """Marker of a model: differs where colours may not be told apart."""
    return "o" if model == REFERENCE else MARKERS[model % len(MARKERS)]


def line(model: int) -> str:
    """Line style of a model: solid for as long as the palette lasts."""
    return LINES[(max(model, 0) // PALETTE_SIZE) % len(LINES)]


def shortened(text: str, most: int = 22) -> str:
    """A name from a study file as a label: one line, no control characters, not too long."""
    text = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)
    return text if len(text) <= most else f"{text[: most - 1]}…"


def panel(x_label: str, y_label: str, salt: str) -> Axes:
    """An empty panel; `salt` is a name of its own on the page."""
    return Axes(shortened(x_label, 60), shortened(y_label, 40), salt)


def percent_axis(axes: Axes, values: Sequence[float]) -> None:
    """The y axis shows ratios as percentages: from zero, or by decades where they span several."""
    finite = [v for v in values if np.isfinite(v) and v > 0]
    if finite and max(finite) > 3.0 and max(finite) > 30 * min(finite):
        axes.y.see(finite)
        log_axis(axes.y)
    else:
        axes.y.low, axes.y.high = 0.0, 1.08 * max(finite) if finite else 1.0
    percent_ticks(axes)


def percent_ticks(axes: Axes) -> None:
    """Ratios on the y axis named as percentages."""
    axes.y.name = lambda value: f"{plain(value * 100)} %"


def time_ticks(axes: Axes) -> None:
    """Seconds on a logarithmic x axis, named with their prefix."""
    log_axis(axes.x)
    axes.x.name = lambda value: quantity(value, "s", 1)


def log_axis(axis: Axis) -> None:
    """Decades without minor clutter; 1-2-5 steps where there are fewer than two decades."""
    axis.log = True
    axis.name = plain


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
    axes.x.ticks = [(x, shortened(name, 16)) for x, name in ticks]
