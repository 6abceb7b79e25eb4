"""Charts: the scale of errors, names beside curves, what the page's script is told."""

from __future__ import annotations

import itertools
import re

import pytest

from tests.report.runs import REFERENCE, make_case, make_run
from vdmbench.report.blocks import Figures
from vdmbench.report.plots import Plot, percent_axis, tell
from vdmbench.report.section_errors import error_against_load, error_against_parameters
from vdmbench.verdict.digest import Digest


@pytest.mark.parametrize(
    ("values", "scale"),
    [([0.02, 0.9], "log"), ([0.2, 0.9], "linear"), ([0.0, 0.9], "linear"), ([], "linear"), ([0.0], "linear")],
)
def test_errors_that_span_more_than_a_decade_are_drawn_by_decades(values: list[float], scale: str) -> None:
    with Plot("x", "y", "s") as axes:
        axes.plot(range(len(values)), values)
        percent_axis(axes, values)
        assert axes.get_yscale() == scale
        low, high = axes.get_ylim()
        assert all(low <= value <= high for value in values)
        assert len([t for t in axes.get_yticks() if low <= t <= high]) >= 2


def _names(*curves: tuple[str, list[float]]) -> dict[str, tuple[float, float]]:
    """Name beside a curve -> where it stands, in pixels."""
    with Plot("x", "y", "s") as axes:
        for name, heights in curves:
            (curve,) = axes.plot([1.0, 2.0], heights, marker="o")
            tell(curve, name)
        axes.set_ylim(0.0, 1.0)
    boxes = {text.get_text(): text.get_window_extent() for text in axes.texts}
    overlaps = [(a, b) for a, b in itertools.combinations(boxes, 2) if boxes[a].overlaps(boxes[b])]
    assert overlaps == []
    return {name: (box.x1, (box.y0 + box.y1) / 2) for name, box in boxes.items()}


def test_curves_are_named_where_there_is_room() -> None:
    apart = _names(("low", [0.2, 0.2]), ("high", [0.8, 0.8]))
    assert apart["high"][1] > apart["low"][1]
    two = _names(("upper", [0.51, 0.51]), ("lower", [0.5, 0.5]))
    assert set(two) == {"upper", "lower"}, "one above, one below"
    crowd = _names(*((f"m{k}", [0.5 + 0.01 * k] * 2) for k in range(5)))
    assert 0 < len(crowd) < 5, "the legend tells the others"
    assert _names(("alone", [0.5, 0.5])) == {}, "one curve needs no name"


def test_a_curve_tells_the_script_whose_points_it_has_and_on_which_axes() -> None:
    plot = Plot("x", "y", "s")
    with plot as axes:
        (curve,) = axes.plot([1.0, 2.0], [0.1, 0.2], marker="o")
        tell(curve, 'a "b" <c>', [4, 7])
        percent_axis(axes, [0.1, 0.2])
    svg = plot.drawn("")
    assert 'data-told="a%20%22b%22%20%3Cc%3E 4,7"' in svg
    assert re.search(r'data-x="linear [\d.]+ [\d.]+ [\d.]+ [\d.]+ "', svg)
    assert re.search(r'data-y="linear 0 0.216 [\d.]+ [\d.]+ %"', svg)
    group = svg[svg.index("data-told") :]
    assert group[: group.index("<g clip-path") + 500].count("<use") >= 2


def test_one_load_that_is_left_of_a_history_is_no_curve() -> None:
    whole, short = (
        Digest(make_run([make_case({"m": 0.1}, stopped={"m": first, REFERENCE: first}, subdivisions=0)]))
        for first in (4, 1)
    )
    assert error_against_load(whole) is not None
    assert error_against_load(short) is None


def test_a_line_joins_the_medians_of_cases_that_share_a_value() -> None:
    cases = [
        make_case({"m": 0.01 * error * nu}, label=f"{k}", swept={"nu": nu, "k": float(k)}, subdivisions=0)
        for nu in (1.0, 2.0)
        for k, error in enumerate((3, 5, 12))
    ]
    section = error_against_parameters(Digest(make_run(cases)))
    assert section is not None
    figures = [figure for block in section.blocks if isinstance(block, Figures) for figure in block.figures]
    assert [figure.title[-2:] for figure in figures] == ["nu", "nu", " k", " k"]
    assert figures[0].svg.count("data-told") == 1
    assert "m from 3 % to 24 %" in figures[0].svg, "the range of all cases"


def test_where_the_mesh_size_is_swept_the_order_of_each_error_is_told() -> None:
    cases = [
        make_case({"m": h**1.5, "n": 0.3}, label=f"{h}", swept={"geometry.mesh_size": h}, subdivisions=0)
        for h in (0.01, 0.02, 0.04)
    ]
    section = error_against_parameters(Digest(make_run(cases)))
    assert section is not None
    assert "in the mesh size: m 1.50 and n 0.00" in section.blocks[0].text
