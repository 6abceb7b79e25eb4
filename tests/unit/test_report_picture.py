"""Still pictures: rendered where a GL library is, left out with a reason where it is not."""

from __future__ import annotations

import io
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from studies.report import picture
from studies.report.page import page_html
from studies.report.picture import Panel, render

from .report_runs import icosphere, make_case, make_run

has_gl = pytest.mark.skipif(picture._off_screen_window() is None, reason="no off-screen GL library")


def ball(azimuth: float = -1.0) -> Panel:
    points, triangles = icosphere(2)
    return Panel(points, triangles, (points[:, 2] + 1) / 2, "viridis", azimuth)


@has_gl
def test_panels_side_by_side_on_nothing() -> None:
    (png, again), why = render([[ball(), ball()]] * 2)
    assert why == ""
    assert png == again
    pixels = np.asarray(Image.open(io.BytesIO(png)))
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


@has_gl
def test_a_flat_body_has_a_flat_picture() -> None:
    panel = ball()
    flat = Panel(panel.points * [1.0, 1.0, 0.2], panel.triangles, panel.values, "viridis", 0.0)
    (png,), _ = render([[flat]])
    pixels = np.asarray(Image.open(io.BytesIO(png)))
    assert 0.44 < pixels.shape[0] / pixels.shape[1] < 0.47
    columns = np.flatnonzero((pixels[..., 3] > 128).any(axis=0))
    assert columns[-1] - columns[0] > 0.9 * pixels.shape[1]


@has_gl
def test_page_has_a_picture_of_each_key_case_in_words_too() -> None:
    html = page_html(make_run([make_case({"m": 0.5}, subdivisions=2)]), render)
    assert html.count('<img src="data:image/png;base64,') == 1
    sizes = ("fem-linear, displaced by up to 2.00 mm", "m, displaced by up to 3.00 mm")
    assert f'alt="Left to right: {"; ".join(sizes)}; their difference, up to 1.00 mm.' in html


def test_no_library_no_picture_but_a_reason(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(picture, "_LIBRARIES", (("libNoSuchThing.so.99", "vtkEGLRenderWindow"),))
    with pytest.raises(SystemExit, match="install libegl1"):
        picture.main([str(tmp_path)])


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (subprocess.CompletedProcess([], -11, b"", b""), "the renderer crashed"),
        (
            subprocess.CompletedProcess([], 1, b"", b"Traceback\nno off-screen GL library\n"),
            "no off-screen GL library",
        ),
        (subprocess.CompletedProcess([], 1, b"", b""), "the renderer failed"),
        (subprocess.CompletedProcess([], 0, b"", b""), "made no picture"),
        (subprocess.TimeoutExpired("python", 1.0), "took more than"),
    ],
)
def test_a_renderer_that_dies_costs_the_pictures_only(
    monkeypatch: pytest.MonkeyPatch, answer: subprocess.CompletedProcess[bytes] | Exception, words: str
) -> None:
    def run(*_: object, **__: object) -> subprocess.CompletedProcess[bytes]:
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr(picture.subprocess, "run", run)
    files, why = render([[ball()]])
    assert files == []
    assert words in why
    html = page_html(make_run([make_case({"m": 0.5}, subdivisions=0)]), render)
    assert f"No still pictures: {why}." in html
    assert "viewer-data" in html
