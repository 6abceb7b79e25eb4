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
    assert width == 2 * height
    opaque = pixels[..., 3] > 128
    for half in (opaque[:, :height], opaque[:, height:]):
        assert 0.5 < half.mean() < np.pi / 4  # a disc that nearly fills its square
        assert not half[:4].any()
    yellow, purple = pixels[int(0.1 * height), height // 2], pixels[int(0.9 * height), height // 2]
    assert yellow[0] > yellow[2], "the top has the largest value: viridis ends in yellow"
    assert purple[2] > purple[1], "and begins in purple"


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
