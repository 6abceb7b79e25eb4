"""The figures of the claims page: curves over a load or a parameter, and one bar per model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .blocks import Figure
from .digest import Digest
from .formatting import listed, plain, short_percent
from .plots import Plot, colour, line, log_axis, marker, percent_ticks

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
    drawable = [item for item in lines if len(item[1])]
    if not drawable:
        return ()
    plot = Plot(x_label, y_label, salt)
    with plot as axes:
        for model, x, y in drawable:
            k = digest.colour(model)
            axes.plot(x, y, line(k), marker=marker(k), color=colour(k))
        for which, wanted in (("x", log_x), ("y", log_y)):
            if wanted:
                log_axis(axes, which)
        if not log_y:
            low, high = axes.get_ylim()
            axes.set_ylim(min(0.0, low), high if high > 0.0 else 1.0)
        if not ratio:
            percent_ticks(axes)
    show = plain if ratio else short_percent
    told = listed(f"{model} from {show(y[0])} to {show(y[-1])}" for model, _, y in drawable)
    title = f"{y_label[:1].upper()}{y_label[1:]} against {x_label}"
    return (Figure(plot.drawn(f"{title}: {told}."), title),)


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
