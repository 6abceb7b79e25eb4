"""What a frame costs against how far it is off."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..measures.metrics import DEFORMATION, VECTOR
from ..verdict.digest import REFERENCE, Digest, ModelSummary, Spread
from ..verdict.formatting import listed, quantity, short_percent
from ..verdict.measured import EARLIER, ELSEWHERE, ONCE
from .blocks import Block, Figure, Figures, Section, Text
from .plots import Plot, colour, draw, limit_line, percent_axis, time_ticks

BUDGETS = (1e-3, 1.0 / 60.0)  # s for a frame: of a haptic device, of a screen


def run_time_against_error(digest: Digest) -> Section | None:
    """Time per frame, and set-up as a hollow marker, against the median error; whiskers reach best and worst."""
    figures = []
    compared = [summary for summary in digest.summaries if summary.name in digest.compared]
    measures = (
        ("Displacement error", [summary.vector for summary in compared], digest.allowed(VECTOR)),
        (
            "Error in change of shape",
            [summary.deformation for summary in compared],
            digest.allowed(DEFORMATION),
        ),
    )
    heights = [
        height
        for _, spreads, _ in measures
        for spread in spreads
        if spread
        for height in (spread.best, spread.median, spread.worst)
    ]
    for k, (title, spreads, allowed) in enumerate(measures):
        figure = _pareto(digest, compared, spreads, title, heights, allowed, f"c{k}")
        figures += [figure] if figure else []
    if not figures:
        return None
    note = (
        "Further left is faster; lower is closer. A filled mark is a frame of the contact, factors kept, measured "
        "when the run ended, all models in turns, as vdmbench bench does. The hollow mark at the end "
        "of its dotted line is the set-up, which is paid once. Dashed grey is the reference: its time for a frame, "
        "and its own error where that was measured. The broken line with dots is what the study accepts. Dotted "
        "are two budgets for a frame: 1 ms, as a haptic device asks, and 16.7 ms, as a screen does."
    )
    if len(digest.cases) > 1:
        note += " Marks are medians over the cases. Whiskers reach from the best case to the worst."
    notes = time_notes(digest.summaries)
    blocks: list[Block] = [Text(note, kind="note"), Figures(figures, digest.legend)]
    return Section("cost", "Run time against error", [*blocks, *(Text(n, kind="note") for n in notes)])


def time_notes(summaries: Sequence[ModelSummary]) -> list[str]:
    """What times and memory of these models mean where they are not simply those of a solve in this run."""
    notes = []
    if earlier := [s.name for s in summaries if EARLIER in s.marks]:
        notes.append(
            f"Measured earlier: {listed(earlier)}. Results and times come from an earlier run; the machine may "
            "have been less busy then, or busier."
        )
    if elsewhere := [s.name for s in summaries if ELSEWHERE in s.marks]:
        notes.append(
            f"Measured on another machine than this page was made on: {listed(elsewhere)}. Compare these times "
            "with times of that machine only."
        )
    if once := [s.name for s in summaries if ONCE in s.marks]:
        notes.append(
            f"Not measured in turns, but taken from one answer in this study: {listed(once)}. They are slow, or on "
            "a mesh of their own."
        )
    if iterative := [s.name for s in summaries if s.iterative]:
        notes.append(
            f"Solved iteratively, as suits the few loads of a study: {listed(iterative)}. With factors kept, the "
            "same elements take longer to set up and less for a frame; vdmbench bench measures that."
        )
    return notes


def _pareto(
    digest: Digest,
    compared: Sequence[ModelSummary],
    spreads: Sequence[Spread | None],
    title: str,
    heights: Sequence[float],
    allowed: float,
    salt: str,
) -> Figure | None:
    points = [
        (summary.name, summary.seconds_per_step, summary.seconds_setup, spread)
        for summary, spread in zip(compared, spreads, strict=True)
        if spread and summary.seconds_per_step > 0
    ]
    if not points:
        return None
    reference = next((s for s in digest.summaries if s.is_reference), None)
    many = len(digest.cases) > 1
    plot = Plot("time", f"{title} (median)" if many else title, salt)
    with plot as axes:
        for model, frame, setup, spread in points:
            k = digest.colour(model)
            if spread.worst > spread.best:
                axes.plot(
                    [frame, frame], [spread.best, spread.worst], color=colour(k), linewidth=1.0, alpha=0.6
                )
            if setup > 0 and math.isfinite(setup):
                axes.plot([frame, setup], [spread.median] * 2, ":", color=colour(k), linewidth=1.0)
                about = f"{model}, set-up"
                draw(
                    axes,
                    k,
                    about,
                    [setup],
                    [spread.median],
                    named=False,
                    markerfacecolor="none",
                    linestyle="-",
                )
            draw(axes, k, model, [frame], [spread.median], markersize=6.5, linestyle="none")
        if reference is not None and reference.seconds_per_step > 0:
            axes.axvline(reference.seconds_per_step, linestyle="--", color=colour(REFERENCE), linewidth=1.0)
        own = points[0][3].median_bar
        if own > 0.0:
            axes.axhline(own, linestyle="--", color=colour(REFERENCE), linewidth=1.0)
        limit_line(axes, allowed)
        for budget in BUDGETS:
            axes.axvline(budget, linestyle=":", color=colour(REFERENCE), linewidth=1.0)
        time_ticks(axes)
        percent_axis(axes, [*heights, allowed, *([own] if own > 0.0 else [])])
    described = [
        f"{model} {quantity(frame, 's')} per frame at {short_percent(spread.median)}"
        for model, frame, _, spread in points
    ]
    heading = f"Run time against {title.lower()}"
    return Figure(plot.drawn(f"{heading}: {listed(described)}."), heading)
