"""Panels: values stand where they belong, ticks are round and told apart, and nothing strange breaks a drawing."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET

import pytest
from numpy.testing import assert_allclose

from studies.report.axes import Axes, Axis
from studies.report.formatting import plain
from studies.report.plots import MARKERS, log_axis, name_ticks, panel, percent_axis
from studies.report.ticks import linear_ticks, log_ticks, names_of

LEFT, RIGHT, TOP, BOTTOM = 60.2, 307.3, 4.3, 182.5  # of a panel without names in place of numbers


def tree(axes: Axes) -> ET.Element:
    return ET.fromstring(str(axes.drawn("what 1 shows")))


def paths(axes: Axes, colour: str) -> list[str]:
    """The outlines drawn in a colour, lines and markers apart."""
    return [p.get("d", "") for p in tree(axes).iter("path") if colour in p.get("style", "")]


def points(path: str) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in re.findall(r"[ML](-?[\d.]+) (-?[\d.]+)", path)]


def texts(axes: Axes) -> list[str]:
    return [text.text or "" for text in tree(axes).iter("text")]


def test_points_stand_where_their_values_are() -> None:
    axes = Axes("x", "y", "s")
    axes.x.low, axes.x.high, axes.y.low, axes.y.high = 0.0, 10.0, 0.0, 4.0
    axes.plot([0, 5, 10], [0, 1, 4], color="red", marker="s")
    joined, marked = paths(axes, "red")
    middle, quarter = (LEFT + RIGHT) / 2, BOTTOM + (TOP - BOTTOM) / 4
    expected = [(LEFT, BOTTOM), (middle, quarter), (RIGHT, TOP)]
    assert_allclose(points(joined), expected, rtol=0, atol=0.006)  # half of the last digit written
    half = 4.5 / 2
    assert_allclose(points(marked), [(x - half, y - half) for x, y in expected], rtol=0, atol=0.006)


def test_a_logarithmic_axis_places_decades_evenly_and_leaves_out_what_it_cannot_hold() -> None:
    axes = Axes("x", "y", "s")
    axes.plot([1.0, 2.0, 3.0, 4.0], [1e-3, -1.0, 1e-1, 1e1], color="red")
    log_axis(axes.y)
    axes.y.low, axes.y.high = 1e-3, 1e1
    (joined,) = paths(axes, "red")
    assert joined.count("M") == 2, "the line is interrupted where there is no logarithm"
    heights = [y for _, y in points(joined)]
    assert_allclose(heights, [BOTTOM, (TOP + BOTTOM) / 2, TOP], rtol=0, atol=0.006)


def test_an_axis_leaves_room_holds_what_is_asked_and_can_be_turned() -> None:
    axis = Axis()
    axis.see([2.0, 4.0, math.nan, math.inf])
    assert_allclose(axis.limits(), (1.9, 4.1), rtol=1e-12, atol=0)
    axis.from_zero()
    assert axis.limits()[0] == 0.0
    axis.inverted = True
    assert_allclose([axis.place(0.0), axis.place(4.1)], [1.0, 0.0], rtol=0, atol=1e-12)
    axis.low, axis.log = None, True
    low, high = axis.limits()
    assert_allclose([low * high, high / low], [8.0, 2.0**1.1], rtol=1e-12, atol=0)


@pytest.mark.parametrize(
    ("low", "high", "most", "names"),
    [
        (0.0, 1.08, 6, ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]),
        (0.4475, 0.5025, 7, ["0.45", "0.46", "0.47", "0.48", "0.49", "0.50"]),
        (-0.3, 0.3, 3, ["−0.2", "0.0", "0.2"]),
        (0.0, 10.0, 4, ["0.0", "2.5", "5.0", "7.5", "10.0"]),
        (0.0, 3e7, 3, ["0", "10⁷", "2×10⁷", "3×10⁷"]),
    ],
)
def test_round_numbers(low: float, high: float, most: int, names: list[str]) -> None:
    assert names_of(linear_ticks(low, high, most)) == names


@pytest.mark.parametrize(
    ("low", "high", "names"),
    [
        (0.8, 9.0, ["1", "2", "5"]),
        (1e-3, 1e3, ["0.001", "0.01", "0.1", "1", "10", "100", "1000"]),
        (1e-16, 1e4, ["10⁻¹⁶", "10⁻¹³", "10⁻¹⁰", "10⁻⁷", "0.0001", "0.1", "100"]),
        (2.2, 4.6, ["3", "4"]),
    ],
)
def test_round_numbers_by_decades(low: float, high: float, names: list[str]) -> None:
    assert [plain(tick) for tick in log_ticks(low, high)] == names


def test_numbers_below_an_axis_have_room() -> None:
    axes = Axes("x", "y", "s")
    axes.plot([1_000_001, 1_000_900], [1.0, 2.0], color="red")
    names = [name for name in texts(axes) if name.startswith("1.000")]
    assert 2 <= len(names) <= 6
    assert len(set(names)) == len(names), "neighbours are told apart"


def test_ratios_share_their_scale_and_span_decades_where_they_must() -> None:
    axes = panel("x", "error", "s")
    axes.plot([0, 1], [0.1, 0.2], color="red")
    percent_axis(axes, [0.1, 0.2, 0.5])
    assert_allclose(axes.y.limits(), (0.0, 0.54), rtol=1e-12, atol=0)
    assert "40 %" in texts(axes)
    axes = panel("x", "error", "s")
    axes.plot([0, 1], [0.1, 0.2], color="red")
    percent_axis(axes, [0.1, 5.0])
    assert axes.y.log
    assert "100 %" in texts(axes)


def test_names_on_an_axis_are_thinned_and_slanted() -> None:
    axes = panel("shape", "error", "s")
    axes.plot(range(40), [1.0] * 40, color="red")
    name_ticks(axes, [(float(k), f"shape {k}") for k in range(40)])
    slanted = [text for text in tree(axes).iter("text") if "rotate(-30" in text.get("transform", "")]
    assert [text.text for text in slanted] == [f"shape {k}" for k in range(0, 40, 3)]


def test_bars_begin_at_zero_and_carry_their_names() -> None:
    axes = Axes("ratio", "", "s")
    axes.bar("one", 2.0, color="red")
    axes.bar("other", 4.0, color="blue")
    left, right = (re.findall(r"[MH](-?[\d.]+)", paths(axes, c)[0])[:2] for c in ("red", "blue"))
    short, long = (float(end) - float(begin) for begin, end in (left, right))
    assert_allclose(long, 2 * short, rtol=0, atol=0.02)
    assert {"one", "other"} <= set(texts(axes))
    first, second = (float(re.findall(r" ([\d.]+)H", paths(axes, c)[0])[0]) for c in ("red", "blue"))
    assert first < second, "the first is on top"


def test_bands_lines_across_and_faint_or_hollow_marks() -> None:
    axes = Axes("x", "y", "s")
    axes.x.low, axes.x.high, axes.y.low, axes.y.high = 0.0, 1.0, 0.0, 1.0
    axes.band([0, 1], [0.25, 0.25], [0.5, 0.5], color="red", alpha=0.2)
    axes.horizontal(0.75, color="blue")
    axes.vertical(0.5, color="green")
    axes.plot([0.5], [0.9], "none", marker="o", color="black", hollow=True, alpha=0.5, of_height=True)
    (band,), (across,), (up,) = (paths(axes, c) for c in ("red", "blue", "green"))
    at = {share: BOTTOM + share * (TOP - BOTTOM) for share in (0.25, 0.5, 0.75)}
    corners = [(LEFT, at[0.5]), (RIGHT, at[0.5]), (RIGHT, at[0.25]), (LEFT, at[0.25])]
    assert_allclose(points(band), corners, rtol=0, atol=0.006)
    assert_allclose(points(across), [(LEFT, at[0.75])], rtol=0, atol=0.006)
    assert_allclose(points(up), [((LEFT + RIGHT) / 2, BOTTOM)], rtol=0, atol=0.006)
    style = next(p.get("style", "") for p in tree(axes).iter("path") if "black" in p.get("style", ""))
    assert style == "fill:none;stroke:black;opacity:0.5"


@pytest.mark.parametrize("mark", [*MARKERS, "x"])
def test_markers_are_about_their_point(mark: str) -> None:
    axes = Axes("x", "y", "s")
    axes.x.low, axes.x.high, axes.y.low, axes.y.high = 0.0, 1.0, 0.0, 1.0
    axes.plot([0.5], [0.5], "none", marker=mark, color="red", markersize=10.0)
    (path,) = paths(axes, "red")
    (x, y), steps = points(path)[0], re.findall(r"[lm](-?[\d.]+) (-?[\d.]+)", path)
    middle = ((LEFT + RIGHT) / 2, (TOP + BOTTOM) / 2)
    if mark == "o":
        assert_allclose((x, y + 5.0), middle, rtol=0, atol=0.01)
        assert path.count("a5 5 0 1 1 0") == 2
        return
    corners = [(x, y)]
    for dx, dy in steps:
        corners.append((corners[-1][0] + float(dx), corners[-1][1] + float(dy)))
    low, high = (tuple(f(c[k] for c in corners) for k in (0, 1)) for f in (min, max))
    assert_allclose([(a + b) / 2 for a, b in zip(low, high, strict=True)], middle, rtol=0, atol=0.06)
    assert 9.9 < high[0] - low[0] < 14.1


@pytest.mark.parametrize("value", [0.0, -1.0, 1e-320, 1e300, math.nan, math.inf])
@pytest.mark.parametrize("log", [False, True])
def test_strange_numbers_leave_a_drawing(value: float, *, log: bool) -> None:
    axes = Axes("<x>", "&y", "s")
    axes.plot([1.0, 2.0], [value, 1.0], color="red", marker="o")
    axes.plot([1.0], [value], color="blue", marker="x")
    if log:
        log_axis(axes.y)
        log_axis(axes.x)
    assert {"<x>", "&y"} <= set(texts(axes))
    assert len(str(axes.drawn("1"))) < 5_000
    assert len(paths(axes, "red")[-1]) > 10, "the other point is there"
