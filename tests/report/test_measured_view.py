"""Measured points in the report's 3-D views."""

from __future__ import annotations

import dataclasses
import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.testing import assert_allclose
from PIL import Image

from tests.report.browser import Browser
from tests.report.runs import RADIUS, make_case, make_run
from vdmbench.measures.case import CaseResult
from vdmbench.measures.measurement import Measurement, Quantity
from vdmbench.report.page import page_html
from vdmbench.report.section_view import payload, views
from vdmbench.verdict.digest import Digest

WEIGHTS = (0.5, 0.25, 0.25)


def measured_case() -> CaseResult:
    """The north pole's facet measured in y and z at full load, another facet in z at half of it."""
    case = make_case({"vdm-paper": 0.4}, steps=(0.5, 1.0))
    pole = int(case.points[:, 2].argmax())
    facet, other = int(np.flatnonzero((case.triangles == pole).any(axis=1))[0]), 0
    rows = [
        Quantity("tips", "top", "y", 1, 0.0, 1e-4, 0.0, facet=facet, weights=WEIGHTS),
        Quantity("tips", "top", "z", 1, 0.01, 5e-3, 0.0, facet=facet, weights=WEIGHTS),
        Quantity("tips", "early", "z", 0, 0.0, 1e-4, 0.0, facet=other, weights=WEIGHTS),
        Quantity("bent", "", "rms distance", 1, 0.0, 1e-4, 0.0),
    ]
    nothing = np.full(len(rows), np.nan)
    found = Measurement(rows, {"vdm-paper": nothing}, {"vdm-paper": nothing}, {"tips": "", "bent": ""})
    return dataclasses.replace(case, measurement=found)


def viewed(case: CaseResult, view: int = 0) -> list[dict[str, Any]]:
    digest = Digest(make_run([case]))
    data: Any = payload(views(digest)[view], digest)
    measured: list[dict[str, Any]] = data["cases"][0].get("measured", [])
    return measured


def test_the_viewer_gets_each_point_with_what_is_known_of_it() -> None:
    case = measured_case()
    top, early = viewed(case)
    assert (top["name"], top["step"], top["value"]) == ("top", 1, [None, 0.0, 0.01])
    assert (early["name"], early["step"], early["value"]) == ("early", 0, [None, None, 0.0])
    place = np.array(top["weights"]) @ case.points[top["nodes"]]
    assert place[2] > 0.9 * RADIUS
    assert_allclose(top["weights"], WEIGHTS)
    assert viewed(make_case({"vdm-paper": 0.4})) == []


def test_points_are_drawn_told_and_can_be_hidden(browser: Browser, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text(page_html(make_run([measured_case()]), stills=False))
    tick = "document.querySelector('[data-control=measured]')"
    told = "document.querySelector('.told').textContent"

    def marked(browser: Browser) -> int:
        browser.settle()
        box = "(r => ({x: r.x, y: r.y + scrollY, width: r.width, height: r.height}))"
        clip = browser.evaluate(f"{box}(document.querySelector('.stage > canvas').getBoundingClientRect())")
        image = np.asarray(Image.open(io.BytesIO(browser.picture(clip=clip))).convert("RGB")).astype(int)
        return int((np.abs(image - [0xD6, 0x2F, 0x7F]).max(axis=2) < 12).sum())

    browser.open(path, 1300)
    # the model has the pole 2.8 mm below, and there 10 mm above was measured
    assert "1 measured point, up to 12." in browser.evaluate(told)
    assert marked(browser) > 10
    browser.evaluate(f"{tick}.click()")
    assert marked(browser) == 0
    assert browser.complaints() == []
    path.write_text(page_html(make_run([make_case({"vdm-paper": 0.4})]), stills=False))
    browser.open(path, 1300)
    assert browser.evaluate(f"{tick}.closest('label').hidden") is True
    assert "measured" not in browser.evaluate(told)
