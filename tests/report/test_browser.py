"""The page in a real browser: nothing complains, nothing is fetched, the viewer draws what the numbers say."""

import csv
import dataclasses
import io
import time
import urllib.parse
import urllib.request
import xml.etree.ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from tests.report.browser import PATIENCE, Browser
from tests.report.runs import REFERENCE, sweep_run
from vdmbench.measures.case import Run
from vdmbench.report.page import page_html

Seen = TypeVar("Seen")
VIEWER = "document.querySelector('.viewer')"


@pytest.fixture(scope="module")
def run() -> Run:
    return sweep_run()


@pytest.fixture(scope="module")
def page(run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(page_html(run))
    return path


def visible(browser: Browser, selector: str) -> bool:
    """Whether an element takes room on the page."""
    return bool(browser.evaluate(f"document.querySelector({selector!r}).getBoundingClientRect().height > 0"))


def stage(browser: Browser) -> np.ndarray:
    """Pixels of the viewer's drawing, (height, width, 3), once two pictures in a row are the same."""
    last = _picture_of_stage(browser)
    for _ in range(20):
        image = _picture_of_stage(browser)
        if np.array_equal(image, last):
            return image
        last = image
    raise AssertionError("the drawing does not come to rest")


def stage_where(browser: Browser, drawn: Callable[[np.ndarray], bool]) -> np.ndarray:
    """The drawing once it is as it should be: a busy machine shows an old frame for a while."""
    return where(stage, browser, drawn)


def where(look: Callable[[Browser], Seen], browser: Browser, drawn: Callable[[Seen], bool]) -> Seen:
    """What a look sees once it is as it should be."""
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        if drawn(found := look(browser)):
            return found
    raise AssertionError("the drawing is not as it should be")


def like(first: np.ndarray) -> Callable[[np.ndarray], bool]:
    return lambda now: changed(first, now) == 0.0


def unlike(first: np.ndarray, least: float) -> Callable[[np.ndarray], bool]:
    return lambda now: changed(first, now) > least


def _picture_of_stage(browser: Browser) -> np.ndarray:
    browser.evaluate(
        "document.querySelector('.stage').scrollIntoView({behavior: 'instant', block: 'nearest'})"
    )
    browser.settle()
    box = "(r => ({x: r.x, y: r.y + scrollY, width: r.width, height: r.height}))"
    clip = browser.evaluate(f"{box}(document.querySelector('.stage > canvas').getBoundingClientRect())")
    return np.asarray(Image.open(io.BytesIO(browser.picture(clip))).convert("RGB")).astype(int)


def changed(before: np.ndarray, after: np.ndarray) -> float:
    """Share of pixels that differ visibly."""
    return float((np.abs(before - after).max(axis=2) > 24).mean())


def move(browser: Browser, control: str, value: float) -> None:
    browser.evaluate(
        f"(c => {{ c.value = {value}; for (const kind of ['input', 'change']) c.dispatchEvent(new Event(kind)); }})"
        f"({VIEWER}.querySelector('[data-control={control}]'))"
    )


def views(browser: Browser) -> dict[str, np.ndarray]:
    """Pixels of each view, as `stage`."""
    image = stage(browser)
    box = "(r => [r.x, r.y, r.width, r.height])"
    left, top, *_ = browser.evaluate(f"{box}({VIEWER}.querySelector('.stage').getBoundingClientRect())")
    found = {}
    for name in ("model", "reference", "difference"):
        x, y, width, height = browser.evaluate(
            f"{box}({VIEWER}.querySelector('[data-view={name}]').getBoundingClientRect())"
        )
        row, column = round(y - top), round(x - left)
        found[name] = image[row : row + round(height), column : column + round(width)]
    return found


def views_where(browser: Browser, drawn: Callable[[dict[str, np.ndarray]], bool]) -> dict[str, np.ndarray]:
    """The views once they are as they should be, as `stage_where`."""
    return where(views, browser, drawn)


# --- the page ---


@pytest.mark.parametrize(("width", "dark"), [(400, True), (1400, False)], ids=["dark", "light"])
def test_opens_without_complaint_and_fits(browser: Browser, page: Path, width: int, dark: bool) -> None:
    browser.open(page, width, dark=dark)
    assert browser.complaints() == []
    assert browser.requests() == []
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    colours = browser.evaluate("(s => [s.color, s.backgroundColor])(getComputedStyle(document.body))")
    text, paper = (np.array([int(v) for v in c[4:-1].split(",")]) for c in colours)
    assert (paper.mean() < 60) == dark
    assert abs(text - paper).min() > 150
    ink = browser.evaluate("getComputedStyle(document.querySelector('.plot text')).fill")
    assert ink == colours[0], "figures take the colour of the page's text"


def test_print_shows_the_still_pictures_and_every_row(browser: Browser, page: Path) -> None:
    browser.open(page, 1000)
    assert visible(browser, ".viewer")
    assert not visible(browser, ".still")
    browser.send("Emulation.setEmulatedMedia", media="print")
    assert visible(browser, ".still")
    assert not visible(browser, ".viewer")
    assert not visible(browser, ".tools")
    marks = "document.querySelectorAll('.swatch :is(use, path)')"
    assert browser.evaluate(f"[...{marks}].every(m => m.getBoundingClientRect().width > 0)")
    assert browser.evaluate(f"{marks}.length") > 5, "drawn: browsers leave backgrounds out of print"
    beyond = "t => t.scrollWidth > t.closest('.table').clientWidth + 1"
    wide = f"[...document.querySelectorAll('.table table')].filter({beyond})"
    assert browser.evaluate(f"{wide}.map(t => t.dataset.name)") == [], "paper does not scroll"
    browser.send("Emulation.setEmulatedMedia", media="")


@pytest.mark.parametrize("without", ["WebGL", "scripts"])
def test_without_webgl_or_scripts_there_are_pictures_and_a_reason(
    browser: Browser, page: Path, without: str
) -> None:
    if without == "WebGL":
        code = "HTMLCanvasElement.prototype.getContext = () => null"
        added = browser.send("Page.addScriptToEvaluateOnNewDocument", source=code)["identifier"]
        browser.open(page, 1000)
        browser.send("Page.removeScriptToEvaluateOnNewDocument", identifier=added)
    else:
        browser.open(page, 1000, scripts=False)
    assert browser.complaints() == []
    assert not visible(browser, ".viewer")
    assert visible(browser, ".still img")
    assert visible(browser, ".no-viewer")


# --- tables ---


def csv_of(browser: Browser, table: str) -> list[list[str]]:
    """What the table's CSV button downloads."""
    browser.evaluate("HTMLAnchorElement.prototype.click = function () { window.lastLink = this.href; }")
    browser.evaluate(
        f"document.querySelector('[data-name={table}]').closest('.table').querySelector('[data-action=csv]').click()"
    )
    link = browser.evaluate("window.lastLink")
    header, _, body = link.partition(",")
    assert header == "data:text/csv;charset=utf-8"
    return list(csv.reader(io.StringIO(urllib.parse.unquote(body))))


def test_csv_holds_full_numbers_and_their_units(browser: Browser, page: Path) -> None:
    browser.open(page, 1000)
    head, *rows = csv_of(browser, "headline")
    assert head[:3] == ["Model", "Contact region", "Hausdorff distance [m]"]
    assert float(rows[1][head.index("Displacement error ±")]) == 0.0068
    assert rows[2][head.index("Displacement error ±")] == ""
    assert head[-3:] == ["Set-up [s]", "A frame [s]", "Memory [B]"]
    assert rows[2][0] == "fem-linear, reference"
    assert_allclose(
        [float(rows[1][k]) for k in map(head.index, ("Contact region", "Displacement error"))],
        0.078,
        rtol=1e-9,
        atol=1e-12,
    )
    head, *rows = csv_of(browser, "cases")
    assert head[2] == "pressure of finger [Pa]"
    assert [float(row[2]) for row in rows] == [800.0, 200.0, 800.0, 200.0, 800.0, 200.0]


# --- charts ---


def test_a_point_names_its_case_and_a_chart_is_saved_with_its_legend(
    browser: Browser, tmp_path: Path, run: Run
) -> None:
    cases = run.cases[::2]  # of one pressure: each point is a case
    page = tmp_path / "report.html"
    page.write_text(page_html(dataclasses.replace(run, cases=cases)))
    browser.open(page, 1400)
    browser.evaluate("document.querySelector('#parameters').scrollIntoView({behavior: 'instant'})")
    mark = "document.querySelectorAll('#parameters .plot [data-told*=vdm-vector] use')[1]"
    x, y = browser.evaluate(f"(r => [r.x + r.width / 2, r.y + r.height / 2])({mark}.getBoundingClientRect())")
    browser.send("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
    told = browser.evaluate("document.querySelector('.tip').innerText").splitlines()
    error = cases[1].metrics["vdm-vector"]["relative_l2_displacement_error"][-1]
    assert told[:2] == ["vdm-vector", cases[1].label]
    value, at = told[2].split(" % at ")
    assert_allclose([float(value), float(at)], [100 * error, 0.45], rtol=0.02, atol=0)
    browser.send("Input.dispatchMouseEvent", type="mouseMoved", x=5, y=5)
    assert not visible(browser, ".tip")

    browser.evaluate(
        "HTMLAnchorElement.prototype.click = function () { window.saved = [this.download, this.href]; }"
    )
    browser.evaluate("document.querySelector('#parameters [data-action=svg]').click()")
    name, url = browser.evaluate("saved")
    assert name == "A-ball-under-a-fingertip-Displacement-error-against-Poisson-ratio.svg"
    svg = urllib.parse.unquote(url.partition(",")[2])
    assert "var(" not in svg, "it stands alone"
    assert "#0072b2" in svg
    texts = [
        text.text for text in xml.etree.ElementTree.fromstring(svg).iter("{http://www.w3.org/2000/svg}text")
    ]
    assert texts[-3:] == ["vdm-paper", "vdm-vector", "the reference's own"], "the legend"
    assert browser.complaints() == []


# --- the viewer ---


def test_three_views_are_one_picture(browser: Browser, page: Path) -> None:
    browser.open(page, 1400)
    first = views(browser)
    for name, pixels in first.items():
        drawn = np.abs(pixels - pixels[5, -5]).max(axis=2) > 24
        assert 0.1 < drawn.mean() < 0.9, name
        saturation = np.ptp(pixels[drawn], axis=1)
        assert (saturation > 40).mean() > 0.6, "viridis is colourful, an unlit or empty drawing is not"
    assert changed(first["model"], first["difference"]) > 0.1
    assert changed(first["model"], first["reference"]) > 0.01

    def all_differ(before: dict[str, np.ndarray], least: float) -> Callable[[dict[str, np.ndarray]], bool]:
        return lambda now: all(changed(before[name], image) > least for name, image in now.items())

    def as_at_first(now: dict[str, np.ndarray]) -> bool:
        return all(changed(first[name], image) == 0.0 for name, image in now.items())

    move(browser, "step", 0)  # one load for all
    views_where(browser, all_differ(first, 0.05))
    move(browser, "step", 3)
    views_where(browser, as_at_first)
    move(browser, "scale", 0)
    views_where(browser, all_differ(first, 0.01))
    move(browser, "scale", 50)
    last = views_where(browser, as_at_first)
    for box in ("edges", "rest", "regions"):
        browser.evaluate(f"{VIEWER}.querySelector('[data-control={box}]').click()")
        last = views_where(browser, all_differ(last, 0.004))
    told = f"{VIEWER}.querySelector('.told').textContent"
    assert browser.evaluate(told).splitlines()[1:3] == [
        f"reference: {REFERENCE}, up to 4 mm",
        "difference, up to 2.88 mm",
    ]
    move(browser, "case", 2)
    views_where(browser, all_differ(first, 0.01))
    assert browser.complaints() == []


def test_a_lost_graphics_context_comes_back_or_leaves_the_pictures(browser: Browser, page: Path) -> None:
    browser.open(page, 1400)
    first = stage(browser)
    context = f"{VIEWER}.querySelector('canvas').getContext('webgl2')"
    browser.evaluate(f"window.loss = {context}.getExtension('WEBGL_lose_context'); loss.loseContext()")
    stage_where(browser, unlike(first, 0.2))  # nothing is left to see
    assert visible(browser, ".viewer"), "for a while it waits"
    move(browser, "step", 0)  # what is asked for meanwhile is shown afterwards
    browser.evaluate("loss.restoreContext()")
    stage_where(browser, unlike(first, 0.05))
    move(browser, "step", 3)
    stage_where(browser, like(first))
    browser.evaluate("window.setTimeout = (act) => act(); loss.loseContext()")
    stage_hidden = (
        "new Promise(done => requestAnimationFrame(() => done(document.querySelector('.viewer').hidden)))"
    )
    assert browser.evaluate(stage_hidden), "its patience has an end"
    assert visible(browser, ".still img")


def test_a_picture_of_the_views_is_saved_with_what_they_show(browser: Browser, page: Path) -> None:
    browser.open(page, 1400)
    shown = stage(browser)
    browser.evaluate(
        "HTMLAnchorElement.prototype.click = function () { window.saved = [this.download, this.href]; }"
    )
    browser.evaluate(f"{VIEWER}.querySelector('[data-control=save]').click()")
    name, url = browser.evaluate("saved")
    assert name == "A-ball-under-a-fingertip-vdm-paper.png"
    pixels = np.asarray(Image.open(io.BytesIO(urllib.request.urlopen(url).read())).convert("RGB")).astype(int)
    height, width, _ = shown.shape
    assert pixels.shape == (height + 30, width, 3)
    assert changed(pixels[20 : height - 20, 20:-20], shown[20:-20, 20:-20]) < 0.01, (
        "but for its rounded corners"
    )
    assert np.ptp(pixels[height:]) > 50, "words below"


def test_keys_mouse_and_touch_turn_and_zoom(browser: Browser, page: Path) -> None:
    browser.open(page, 1400)
    browser.evaluate("document.querySelector('#surface').scrollIntoView({behavior: 'instant'})")
    browser.evaluate("document.querySelector('.stage > canvas').focus()")

    def press(key: str) -> None:
        for kind in ("keyDown", "keyUp"):
            browser.send("Input.dispatchKeyEvent", type=kind, key=key)

    press("0")  # the first key also draws the ring of the focus
    first = stage(browser)
    for keys in (("ArrowUp", "ArrowUp", "ArrowUp"), ("-", "-", "-"), ("+", "+", "+")):
        for key in keys:
            press(key)
        stage_where(browser, unlike(first, 0.02))
        press("0")
        stage_where(browser, like(first))
    x, y = middle(browser)
    for kind, dy in (("mousePressed", 0), ("mouseMoved", 60), ("mouseReleased", 60)):
        browser.send("Input.dispatchMouseEvent", type=kind, x=x, y=y + dy, button="left", clickCount=1)
    stage_where(browser, unlike(first, 0.02))
    press("0")
    spread = [[(-30, 0), (30, 0)], [(-90, 0), (90, 0)]]
    for kind, points in zip(("touchStart", "touchMove", "touchEnd"), [*spread, []], strict=True):
        touches = [{"x": x + dx, "y": y + dy, "id": k} for k, (dx, dy) in enumerate(points)]
        browser.send("Input.dispatchTouchEvent", type=kind, touchPoints=touches)

    def covered(image: np.ndarray) -> float:
        return float((np.abs(image - first[-20, 20]).max(axis=2) > 24).mean())

    stage_where(browser, lambda zoomed: covered(zoomed) > 1.3 * covered(first))


def middle(browser: Browser) -> tuple[float, float]:
    """Centre of the first view in the window."""
    centre = "(r => [r.x + r.width / 2, r.y + r.height / 2])"
    x, y = browser.evaluate(f"{centre}({VIEWER}.querySelector('.view').getBoundingClientRect())")
    return x, y


def read_out(browser: Browser) -> list[list[str]]:
    rows = (
        f"[...{VIEWER}.querySelectorAll('.readout tbody tr')].map(r => [...r.cells].map(c => c.textContent))"
    )
    found: list[list[str]] = browser.evaluate(rows)
    return found


def numbers(texts: list[str]) -> list[float]:
    return [float(text.replace("−", "-")) for text in texts]


def test_a_node_shows_its_numbers(browser: Browser, page: Path, run: Run) -> None:
    browser.open(page, 1400)
    move(browser, "node", 17)
    worst = max(run.cases, key=lambda c: c.metrics["vdm-paper"]["relative_l2_displacement_error"][-1])
    u = worst.models["vdm-paper"].displacement[-1, 17] * 1e3
    r = worst.models[REFERENCE].displacement[-1, 17] * 1e3
    rows = read_out(browser)
    assert [row[0] for row in rows] == ["vdm-paper", f"{REFERENCE} (reference)", "difference"]
    for row, value in zip(rows, (u, r, u - r), strict=True):
        # three digits are shown, and packing rounds to 1.5e-5 of the largest displacement
        assert_allclose(numbers(row[1:]), [*value, np.linalg.norm(value)], rtol=5.1e-3, atol=2e-4)
    caption = browser.evaluate(f"{VIEWER}.querySelector('.readout caption').textContent")
    place = numbers(caption[caption.index("(") + 1 : caption.index(")")].split(","))
    assert_allclose(place, worst.points[17] * 1e3, rtol=5.1e-3, atol=2e-3)
    move(browser, "node", 100000)
    assert read_out(browser) == []


def test_a_click_picks_the_node_in_front(browser: Browser, page: Path, run: Run) -> None:
    browser.open(page, 1400)
    browser.evaluate("document.querySelector('#surface').scrollIntoView({behavior: 'instant'})")
    x, y = middle(browser)
    for kind in ("mousePressed", "mouseReleased"):
        browser.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    picked = int(browser.evaluate(f"{VIEWER}.querySelector('[data-control=node]').value"))
    # the camera looks from azimuth -1 and 0.38 above the horizon onto the middle of a ball
    azimuth, elevation = -1.0, 0.38
    towards = np.array(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
    )
    directions = run.cases[0].points / np.linalg.norm(run.cases[0].points, axis=1, keepdims=True)
    assert directions[picked] @ towards > 0.97
    assert len(read_out(browser)) == 3
