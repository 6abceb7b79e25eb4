"""Still pictures: what is in front hides what is behind, colours and outlines are where they belong."""

from pathlib import Path

import numpy as np
from PIL import Image

from tests.report.runs import icosphere, make_case, make_run
from vdmbench.report import picture
from vdmbench.report.page import write_picture
from vdmbench.report.picture import Panel
from vdmbench.report.section_view import heading, still
from vdmbench.verdict.digest import Digest


def ball(azimuth: float = -1.0) -> Panel:
    points, triangles = icosphere(2)
    return Panel(points, triangles, (points[:, 2] + 1) / 2, "viridis", azimuth)


def drawn(*panels: Panel) -> np.ndarray:
    return np.concatenate(picture._drawings(panels), axis=1)


def test_panels_side_by_side_on_nothing() -> None:
    pixels = drawn(ball(), ball())
    np.testing.assert_array_equal(pixels, drawn(ball(), ball()))
    height, width, channels = pixels.shape
    assert channels == 4
    assert abs(width / height - 2) < 0.05
    opaque = pixels[..., 3] > 128
    for half in (opaque[:, : width // 2], opaque[:, width // 2 :]):
        assert 0.62 < half.mean() < np.pi / 4  # a disc that nearly fills its square
        assert not half[:4].any()
    yellow, purple = pixels[int(0.1 * height), width // 4], pixels[int(0.9 * height), width // 4]
    assert yellow[0] > yellow[2], "the top has the largest value: viridis ends in yellow"
    assert purple[2] > purple[1], "and begins in purple"


def test_a_picture_that_stands_alone_tells_what_it_shows(tmp_path: Path) -> None:
    run = make_run([make_case({"m": 0.5}, subdivisions=2)])
    write_picture(run, tmp_path / "picture.png")
    pixels = np.asarray(Image.open(tmp_path / "picture.png"))
    assert pixels.shape[1:] == (3 * 420, 4)
    assert (pixels[..., 3] == 255).all(), "its letters are read on any ground"
    digest = Digest(run)
    panels, _ = still(digest, run.cases[0])
    figure = picture._figure(panels, heading(digest, "", run.cases[0]))
    assert (
        figure.get_suptitle()
        == "A ball under a fingertip\nthe only case, drawn with 5 times the displacement"
    )
    drawn, bars = figure.axes[::2], figure.axes[1::2]
    assert [a.get_title() for a in drawn] == [
        "displacement of m",
        "displacement of the reference",
        "difference",
    ]
    tops = [np.linalg.norm(u, axis=1).max() for u in (run.cases[0].models["m"].displacement[-1],) * 2]
    tops.append(tops[0] / 3)  # 1.5 times the reference
    np.testing.assert_allclose(
        [bar.get_xlim() for bar in bars], [(0.0, 1e3 * top) for top in tops], rtol=1e-9, atol=1e-12
    )
    assert {bar.get_xlabel() for bar in bars} == {"mm"}


def test_what_is_in_front_hides_what_is_behind() -> None:
    """A ball right behind another, whatever order their facets are listed in."""
    points, triangles = icosphere(2)
    near = points + 3 * picture.directions(0.3)[2]
    alone = drawn(Panel(near, triangles, near[:, 2], "viridis", 0.3))
    far = 0.9 * points  # inside the outline of the near one
    for order in (1, -1):
        parts = [(far, np.zeros(len(far))), (near, near[:, 2])][::order]
        both = Panel(
            np.concatenate([part for part, _ in parts]),
            np.concatenate([triangles, triangles + len(points)]),
            np.concatenate([values for _, values in parts]),
            "viridis",
            0.3,
        )
        np.testing.assert_allclose(drawn(both).astype(int), alone, rtol=0, atol=1)


def test_a_body_of_no_size_and_values_beyond_the_scale_are_drawn() -> None:
    points, triangles = icosphere(1)
    point = Panel(np.zeros_like(points), triangles, np.zeros(len(points)), "inferno", 0.0)
    assert not drawn(point)[..., 3].any()
    over = Panel(points, triangles, np.full(len(points), 7.0), "viridis", -1.0)
    top = Panel(points, triangles, np.ones(len(points)), "viridis", -1.0)
    np.testing.assert_array_equal(drawn(over), drawn(top))
