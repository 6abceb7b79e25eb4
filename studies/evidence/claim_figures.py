"""The figures of the claims page: curves over a load or a parameter, and one bar per model."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from ..measures.bars import series
from ..report.blocks import Figure
from ..report.plots import Plot, colour, draw, log_axis, percent_ticks
from ..verdict.digest import Digest
from ..verdict.formatting import listed, plain, short_percent

Line = tuple[str, Sequence[float], Sequence[float]]  # model, x, y


def curves(
    digest: Digest,
    lines: Sequence[Line],
    x_label: str,
    y_label: str,
    salt: str,
    *,
    log_x: bool = False,
    log_y: bool = False,
    ratio: bool = False,
) -> tuple[Figure, ...]:
    """One figure of a curve per model, none where there is nothing to draw. `ratio`: y is no percentage."""
    drawable = [kept for item in lines if (kept := _drawable(item, log_y=log_y))[1]]
    if not drawable:
        return ()
    plot = Plot(x_label, y_label, salt)
    with plot as axes:
        for model, x, y in drawable:
            draw(axes, digest.colour(model), model, x, y)
        for which, wanted, column in (("x", log_x, 1), ("y", log_y, 2)):
            values = {value for item in drawable for value in item[column]}
            if wanted and len(values) > 1:  # one value spans no decade
                log_axis(axes, which)
        if axes.get_yscale() == "linear":
            low, high = axes.get_ylim()
            low, high = min(0.0, low), high if high > 0.0 else 1.0
            axes.set_ylim(low, high + 0.04 * (high - low))  # from zero: room for a marker at the top
        if not ratio:
            percent_ticks(axes)
    show = plain if ratio else short_percent
    told = listed(f"{model} from {show(y[0])} to {show(y[-1])}" for model, _, y in drawable)
    title = f"{y_label[:1].upper()}{y_label[1:]} against {x_label}"
    return (Figure(plot.drawn(f"{title}: {told}."), title),)


def histories(digest: Digest, metric: str, models: Iterable[str]) -> list[Line]:
    """(model, load factors, |values|) of the first case with a load history."""
    case = next((c for c in digest.cases if len(c.load_factors) > 1), None)
    if case is None:
        return []
    lines: list[Line] = []
    for model in models:
        values = series(case, model, metric)
        if values is not None and np.isfinite(values).any():
            keep = np.isfinite(values)
            lines.append((model, case.load_factors[keep].tolist(), np.abs(values[keep]).tolist()))
    return lines


def _drawable(item: Line, *, log_y: bool) -> tuple[str, list[float], list[float]]:
    """The points of a curve that are finite and that its scale can show."""
    model, x, y = item
    kept = [(a, b) for a, b in zip(x, y, strict=True) if math.isfinite(b) and (b > 0 or not log_y)]
    return model, [a for a, _ in kept], [b for _, b in kept]


def bars(
    digest: Digest, values: Mapping[str, float], x_label: str, salt: str, *, log: bool = False
) -> tuple[Figure, ...]:
    """One figure of a horizontal bar per model."""
    if not values:
        return ()
    plot = Plot(x_label, "", salt)
    with plot as axes:
        names = list(values)
        for row, name in enumerate(names):
            axes.barh(row, values[name], color=colour(digest.colour(name)), height=0.6)
        axes.set_yticks(range(len(names)), names)
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
        if log:
            log_axis(axes, "x")
        axes.figure.subplots_adjust(left=0.42)
    told = listed(f"{name} {plain(value)}" for name, value in values.items())
    title = f"{x_label[:1].upper()}{x_label[1:]}"
    return (Figure(plot.drawn(f"{title}: {told}."), title),)
