"""Panels that share a sheet are what they would be on a sheet of their own."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from matplotlib.axis import Tick

from vdmbench.report.plots import (
    Plot,
    Sheet,
    colour,
    log_axis,
    marker,
    name_ticks,
    percent_axis,
    time_ticks,
)

Draw = Callable[[Plot], None]


def _errors(values: list[float]) -> Draw:
    def draw(plot: Plot) -> None:
        with plot as axes:
            axes.fill_between([1.0, 2.0, 3.0], values, [1.1 * v for v in values], color=colour(0), alpha=0.14)
            axes.plot([1.0, 2.0, 3.0], values, marker=marker(0), color=colour(0))
            axes.axhline(0.1, linestyle="--", color=colour(1), linewidth=1.0)
            axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
            percent_axis(axes, values)

    return draw


def _costs(values: list[float]) -> Draw:
    def draw(plot: Plot) -> None:
        with plot as axes:
            axes.plot([1e-5 * v for v in values], values, linestyle="none", marker="s", color=colour(2))
            time_ticks(axes)
            percent_axis(axes, values)

    return draw


def _named(values: list[float]) -> Draw:
    def draw(plot: Plot) -> None:
        with plot as axes:
            axes.plot(range(len(values)), values, marker="o", color=colour(3))
            name_ticks(axes, [(float(k), f"a name of some length {k}") for k in range(len(values))])
            log_axis(axes, "y")

    return draw


def _on_one_scale(values: list[float]) -> Draw:
    def draw(plot: Plot) -> None:
        with plot as axes:
            axes.plot([1.0, 2.0, 3.0], values, marker=marker(0), color=colour(0))
            percent_axis(axes, [0.9, 1.0])

    return draw


def _named_by_height(values: list[float]) -> Draw:
    def draw(plot: Plot) -> None:
        with plot as axes:
            axes.plot([0.0, 1.0], [0.1, 0.2], color=colour(3))
            name_ticks(axes, [(float(k), f"{v:g}") for k, v in enumerate(values)])

    return draw


@pytest.mark.parametrize("draw", [_on_one_scale, _named_by_height, _errors, _costs, _named])
def test_a_panel_on_a_used_sheet_is_that_on_a_new_one(draw: Callable[[list[float]], Draw]) -> None:
    sheet, values = Sheet(), [[0.3, 0.5, 0.2], [0.1, 0.2, 0.9], [0.02, 4.0, 0.5]]
    for k, heights in enumerate(values):
        alone, shared = Plot("x", f"y {k}", "s"), Plot("x", f"y {k}", "s", sheet)
        for plot in (alone, shared):
            draw(heights)(plot)
        assert shared.drawn("what 1 shows") == alone.drawn("what 1 shows")
        assert f">y {k}</text>" in shared.drawn("")


def test_axes_that_look_alike_are_drawn_once(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Tick] = []
    monkeypatch.setattr(Tick, "draw", lambda tick, _: drawn.append(tick))
    sheet = Sheet()
    counts = []
    for heights in ([0.3, 0.5, 0.2], [0.1, 0.2, 0.9]):
        _on_one_scale(heights)(Plot("x", "y", "s", sheet))
        counts.append(len(drawn))
    assert counts[0] == counts[1] > 0
    _errors([0.3, 0.5, 0.2])(Plot("x", "y", "s", sheet))
    assert len(drawn) > counts[0], "another scale"
