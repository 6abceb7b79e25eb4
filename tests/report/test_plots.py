"""Charts: what a curve shows and what the page's script is told of it."""

import html
import json
import re

import pytest
from matplotlib.figure import Figure as Canvas

from tests.report.runs import make_case, make_run
from vdmbench.report.blocks import Figures
from vdmbench.report.plots import Curve, level_line, lines, name_curves, percent_axis
from vdmbench.report.section_charts import errors
from vdmbench.verdict.digest import Digest


def test_a_curve_tells_the_script_whose_points_it_has_and_where_they_are() -> None:
    name = 'a "b" <c>'
    digest = Digest(make_run([make_case({name: 0.1}, label=f"k = {k}", subdivisions=0) for k in range(2)]))
    curve = Curve(name, [1.0, 2.0], [0.1, 0.2], [1, 0])
    svg = lines(digest, [curve], "x", "y", "", "s", finish=lambda axes: percent_axis(axes, [0.1, 0.2])).svg
    (told,) = re.findall(r'data-told="([^"]*)"', svg)
    assert json.loads(html.unescape(told)) == [f"{name}\nk = 1\n10 % at 1", f"{name}\nk = 0\n20 % at 2"]
    group = svg[svg.index("data-told") :]
    assert group[: group.index("<g clip-path") + 500].count("<use") >= 2


def test_a_line_joins_the_medians_of_cases_that_share_a_value() -> None:
    cases = [
        make_case({"m": 0.01 * error * nu}, label=f"{k}", swept={"nu": nu, "k": float(k)}, subdivisions=0)
        for nu in (1.0, 2.0)
        for k, error in enumerate((3, 5, 12))
    ]
    section = errors(Digest(make_run(cases)))
    figures = [figure for block in section.blocks if isinstance(block, Figures) for figure in block.figures]
    assert [figure.title[-2:] for figure in figures] == ["nu", "nu", " k", " k"]
    assert figures[0].svg.count("data-told") == 1
    assert "m from 5 % at 1 to 10 % at 2" in figures[0].svg


def test_where_the_mesh_size_is_swept_the_order_of_each_error_is_told() -> None:
    cases = [
        make_case({"m": h**1.5, "n": 0.3}, label=f"{h}", swept={"geometry.mesh_size": h}, subdivisions=0)
        for h in (0.01, 0.02, 0.04)
    ]
    section = errors(Digest(make_run(cases)))
    assert "in the mesh size: m 1.50 and n 0.00" in section.blocks[0].text


@pytest.mark.parametrize(
    ("x", "y", "place"),
    [
        ([0, 1], [0.5, 0.5], ("right", "bottom")),
        ([0.5, 1], [0.1, 0.12], ("left", "bottom")),
        ([0, 1], [0.115, 0.115], ("right", "top")),
    ],
)
def test_the_name_of_a_level_is_where_no_curve_is(
    x: list[float], y: list[float], place: tuple[str, str]
) -> None:
    """ "reference's own" was struck by the curve that ended there."""
    axes = Canvas(figsize=(4.4, 3.0)).add_subplot()
    axes.plot(x, y, label="m")
    axes.set(xlim=(0, 1), ylim=(0, 1))
    level_line(axes, 0.1, "accepted", "-.")
    name_curves(axes)
    (name,) = (text for text in axes.texts if text.get_text() == "accepted")
    assert (name.get_horizontalalignment(), name.get_verticalalignment()) == place


def test_the_name_of_a_level_is_not_struck_by_a_level_across_it() -> None:
    axes = Canvas(figsize=(4.4, 3.0)).add_subplot()
    axes.plot([0, 1], [0.5, 0.5], label="m")
    axes.set(xlim=(0, 1), ylim=(0, 1))
    level_line(axes, 0.9, "screen", ":", "x")
    level_line(axes, 0.1, "accepted", "-.")
    name_curves(axes)
    (name,) = (text for text in axes.texts if text.get_text() == "accepted")
    assert name.get_horizontalalignment() == "left"
