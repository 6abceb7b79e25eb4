"""What a frame costs against how far it is off."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from matplotlib.axes import Axes

from ..measures.metrics import DEFORMATION, VECTOR
from ..verdict.digest import ELSEWHERE, ONCE, REFERENCE, Cost, Digest
from ..verdict.formatting import quantity, short_percent
from .blocks import Block, Figure, Figures, Section, Text
from .plots import Curve, budget_line, colour, draw, limit_line, lines, own_line, percent_axis, time_ticks

BUDGETS = {
    "haptic device, 1 ms": 1e-3,
    "screen, 16.7 ms": 1.0 / 60.0,
}  # what may ask for a frame, and its time [s]


def run_time_against_error(digest: Digest) -> Section | None:
    """Time per frame, and set-up as a hollow marker, against the median error; whiskers reach best and worst."""
    compared = [name for name in digest.compared if digest.costs[name].frame > 0]
    measures = ((VECTOR, "Displacement error"), (DEFORMATION, "Error in change of shape"))
    spreads = [digest.spread(name, metric) for name in compared for metric, _ in measures]
    heights = [height for one in spreads if one for height in (one.best, one.median, one.worst)]
    figures = [
        figure
        for k, (metric, title) in enumerate(measures)
        if (figure := _pareto(digest, compared, metric, title, heights, f"c{k}"))
    ]
    if not figures:
        return None
    note = (
        "Further left is faster; lower is closer. A filled mark is a frame of the contact, factors kept, measured "
        "when the run ended, all models in turns, as vdmbench bench does. The hollow mark at the end of its dotted "
        "line is the set-up, which is paid once. Dashed up the chart is the reference's frame."
    )
    if len(digest.cases) > 1:
        note += " Marks are medians over the cases. Whiskers reach from the best case to the worst."
    blocks: list[Block] = [Text(note, kind="note"), Figures(figures, digest.legend)]
    return Section("cost", "Run time against error", blocks)


def time_notes(costs: Iterable[Cost]) -> list[str]:
    """What stands beside times that are not simply those of a solve in this run."""
    found = list(costs)
    notes = {
        ELSEWHERE: "compare with times of that machine only",
        ONCE: "not measured in turns with the others; a busy machine, or factors not kept, make it longer",
    }
    told = [f"{mark}, {note}" for mark, note in notes.items() if any(mark in cost.marks for cost in found)]
    return [f"Beside a time: {'; '.join(told)}."] if told else []


def _pareto(
    digest: Digest, compared: Sequence[str], metric: str, title: str, heights: Sequence[float], salt: str
) -> Figure | None:
    points = {name: spread for name in compared if (spread := digest.spread(name, metric))}
    if not points:
        return None
    costs, reference = digest.costs, digest.costs.get(str(digest.reference))
    own, allowed = next(iter(points.values())).median_bar, digest.allowed(metric)
    look = {"markersize": 6.5, "linestyle": "none"}
    curves = [
        Curve(name, [costs[name].frame], [one.median], look=look, band=([one.best], [one.worst]))
        for name, one in points.items()
    ]

    def finish(axes: Axes) -> None:
        for name, spread in points.items():
            k, frame, setup = digest.colour(name), costs[name].frame, costs[name].set_up
            if setup > 0 and math.isfinite(setup):
                axes.plot([frame, setup], [spread.median] * 2, ":", color=colour(k), linewidth=1.0)
                hollow: dict[str, Any] = {"markerfacecolor": "none", "linestyle": "-"}
                draw(axes, k, f"{name}, set-up", [setup], [spread.median], named=False, **hollow)
        if reference is not None and reference.frame > 0:
            axes.axvline(reference.frame, linestyle="--", color=colour(REFERENCE), linewidth=1.0)
        own_line(axes, own)
        limit_line(axes, allowed)
        for name, seconds in BUDGETS.items():
            budget_line(axes, seconds, name)
        time_ticks(axes)
        percent_axis(axes, [*heights, allowed, *([own] if own > 0.0 else [])])

    def words(curve: Curve) -> str:
        frame = quantity(costs[curve.model].frame, "s")
        return f"{frame} per frame at {short_percent(points[curve.model].median)}"

    heading = f"Run time against {title.lower()}"
    return lines(digest, curves, "time", title, heading, salt, finish=finish, told=words)
