"""The page as text: what stands in it, the same bytes from the same run, its size, its security policy."""

import base64
import dataclasses
import difflib
import hashlib
import html as html_module
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.report.runs import REFERENCE, asked, cheap_run, make_case, make_run, sweep_run, whole_case
from vdmbench.measures.case import Run
from vdmbench.report import section_view
from vdmbench.report.blocks import Figures, Viewer
from vdmbench.report.page import page_html, write_report
from vdmbench.report.section_charts import errors
from vdmbench.report.section_tables import small_strain_limits, stopped_models
from vdmbench.report.section_view import payload, still
from vdmbench.verdict.digest import Digest


def section(html: str, name: str) -> str:
    found = re.search(rf'<section id="{name}".*?</section>', html, re.S)
    assert found is not None, f"no section {name}"
    return found[0]


def words(html: str) -> str:
    """Text of some markup, blanks collapsed."""
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", html)).strip()  # a space that does not break is one


def partly_done() -> Run:
    failed = {"hash": "ab" * 32, "label": "nu = 0.5", "code": "timeout", "message": "took 60 s"}
    return dataclasses.replace(sweep_run(), failed=[failed | {"remedy": "raise it"}], missing=["nu = 0.2"])


@pytest.fixture(scope="module")
def html() -> str:
    return page_html(partly_done())


GOLDEN = Path(__file__).parent / "golden.txt"


def shown(html: str) -> str:
    """What a reader of the page reads, a line a block; of a drawing its words for those who do not see it."""
    html = re.sub(r"<style>.*?</style>|<script.*?</script>|<title>.*?</title>", "", html, flags=re.S)
    html = re.sub(r'<svg[^>]*aria-label="([^"]*)".*?</svg>', r"[\1]", html, flags=re.S)
    html = re.sub(r"<svg.*?</svg>", "", html, flags=re.S)
    html = re.sub(r'<span class="whole">([^<]*)</span>', r"\1", re.sub(r"\s+", " ", html))
    html = re.sub(r"</(?:p|tr|li|h1|h2|div|figure|figcaption|caption|dl|summary|ul)>", "\n", html)
    html = re.sub(r"</t[hd]>", " | ", html)
    text = html_module.unescape(re.sub(r"<[^>]*>", " ", html)).replace("\u00a0", " ")
    text = re.sub(r"\d[\d.]*×10⁻¹. %", "0 %", text)  # rounding, another one on each machine
    lines = (re.sub(r"\s+", " ", line).strip(" |") for line in text.split("\n"))
    return "\n".join(filter(None, lines)) + "\n"


def test_the_page_reads_as_it_was_looked_at(html: str) -> None:
    """Every word and number of one page. Where it differs: look at the page, then copy the new text."""
    text = shown(html)
    if text != GOLDEN.read_text():
        path = Path("build/golden.txt")
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        difference = difflib.unified_diff(GOLDEN.read_text().split("\n"), text.split("\n"), lineterm="", n=0)
        pytest.fail(f"{path} is what the page says now:\n" + "\n".join(difference))


def test_every_section_is_linked(html: str) -> None:
    names = re.findall(r'<section id="(\w+)"', html)
    assert len(names) >= 8
    assert list(re.findall(r'<a href="#(\w+)"', html)) == names


# --- partial and odd runs ---


def test_without_a_reference_no_error_is_claimed() -> None:
    cases = [
        make_case({"m": 0.1 * k}, label=str(k), swept={"k": float(k)}, reference=None, subdivisions=0)
        for k in (1, 2)
    ]
    html = page_html(make_run(cases))
    names = re.findall(r'<section id="(\w+)"', html)
    assert names == ["headline", "surface", "drift", "cases", "reproduce"]
    assert "error" not in words(section(html, "headline")).lower()


def test_nothing_finished() -> None:
    failed = [{"hash": "ab" * 32, "label": "", "code": "crash", "message": "killed", "remedy": ""}]
    html = page_html(dataclasses.replace(make_run([]), failed=failed, missing=["k = 1"]))
    assert "No case has a result yet, so there is nothing to compare." in html
    assert "abababab crash killed" in words(section(html, "failures"))
    assert "viewer-data" not in html.split("</style>")[1]


def test_models_and_metrics_may_be_missing_in_a_case() -> None:
    whole = make_case({"a": 0.1, "b": 0.2}, label="k = 0", swept={"k": 0.0}, subdivisions=0)
    partly = make_case({"a": 0.3}, label="k = 1", swept={"k": 1.0}, subdivisions=0)
    bare = dataclasses.replace(partly, label="k = 2", hash="c" * 64, swept={"k": 2.0}, metrics={})
    html = page_html(make_run([whole, partly, bare]))
    assert "20.0 %" in words(section(html, "headline")).replace("\u00a0", " ")


@pytest.mark.parametrize(("name", "is_said"), [("fem", True), ("fem-linear", False)])
def test_where_stability_is_not_examined_is_said_of_finite_strain_alone(name: str, is_said: bool) -> None:
    html = page_html(make_run([make_case({name: 0.1}, subdivisions=0)]))
    assert ("stability of an answer of fem is not examined" in words(section(html, "headline"))) == is_said


# --- bytes ---


def test_same_run_same_bytes_and_unique_ids(html: str, tmp_path: Path) -> None:
    write_report(partly_done(), tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == html
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"], "no temporary file is left"
    ids = re.findall(r'\bid="([^"]+)"', html)
    assert len(ids) == len(set(ids)) > 20
    for target in re.findall(r'(?:href="#|url\(#)([^")]+)', html):
        assert target in ids


def test_nothing_of_the_page_comes_from_elsewhere(html: str) -> None:
    assert not re.findall(r"https?://(?!www\.w3\.org)", html)
    assert not re.findall(r'(?:src|href)="(?!#|data:)', html)


def test_policy_allows_the_two_scripts_of_the_page_and_no_other(html: str) -> None:
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', html)
    directives = dict(part.strip().split(" ", 1) for part in policy[1].replace("&#39;", "'").split(";"))
    assert directives["default-src"] == "'none'"
    assert directives["img-src"] == "data:"
    scripts = re.findall(r"<script>(.*?)</script>", html, re.S)
    assert len(scripts) == 2
    digests = [base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts]
    assert directives["script-src"].split() == [f"'sha256-{digest}'" for digest in digests]


@pytest.mark.parametrize(("apart", "drawn"), [(0.0, False), (2e-5, False), (2e-3, True)])
def test_a_parameter_that_no_error_depends_on_has_no_chart(apart: float, drawn: bool) -> None:
    """As the force between linear models: what the turn that is taken out leaves of it is no dependence."""
    key = "constraints.finger.force"
    cases = [make_case({"vdm-paper": 0.3 + apart * k}, swept={key: 1.0 + k}, label=f"{k}") for k in range(3)]
    found = errors(Digest(make_run(cases)))
    assert any(isinstance(block, Figures) for block in found.blocks) == drawn


def test_thousands_of_cases_are_cut_and_say_so() -> None:
    html = page_html(cheap_run(1200))
    assert len(html.encode()) < 5_000_000
    assert "of 1200 are listed" in words(section(html, "cases"))


# --- the viewer's data ---


def unpack(text: object, kind: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(str(text)), dtype=kind)


def test_viewer_data_hold_the_displacements() -> None:
    cases = [make_case({"m": e}, label=str(e), swept={"k": e}, subdivisions=2) for e in (0.1, 0.4)]
    digest = Digest(make_run(cases))
    data = json.loads(json.dumps(payload(digest, cases[::-1], digest.models, True)))
    (geometry,) = data["geometries"]  # one for both cases
    low, step = np.array(geometry["low"]), np.array(geometry["step"])
    points = low + step * unpack(geometry["points"], "<u2").reshape(-1, 3)
    assert_allclose(points, cases[0].points, rtol=0, atol=0.1 / 65535)
    assert (unpack(geometry["triangles"], "<u2").reshape(-1, 3) == cases[0].triangles).all()
    worst = data["cases"][0]
    assert worst["reference"] == REFERENCE
    assert worst["factors"] == [0.25, 0.5, 0.75, 1.0]
    for model in worst["models"]:
        for k, packed in enumerate(model["steps"]):
            found = packed["scale"] * unpack(packed["data"], "<i2").reshape(-1, 3)
            true = cases[1].models[model["name"]].displacement[k]
            assert_allclose(found, true, rtol=0, atol=0.51 * np.abs(true).max() / 32767)


def test_the_viewer_begins_where_supports_and_loads_are_seen() -> None:
    """The finger is turned to each side: the camera is within a right angle of it."""
    case = make_case({"m": 0.1}, subdivisions=2)
    for angle in (0.3, 2.0, 4.0):
        side = case.points @ [np.cos(angle), np.sin(angle), 0.0] > 0.04
        turned = dataclasses.replace(case, regions={**case.regions, "finger": side})
        digest = Digest(make_run([turned]))
        data: Any = payload(digest, digest.cases, digest.models, True)
        assert np.cos(data["cases"][0]["azimuth"] - angle) > 0.2
        regions = data["cases"][0]["regions"]
        assert [region["kind"] for region in regions] == ["fixed", "contact"]
        nodes = np.frombuffer(base64.b64decode(regions[1]["nodes"]), "<u2")
        assert nodes.tolist() == np.flatnonzero(side).tolist()


def test_a_model_that_stopped_is_told_with_a_step_of_the_study() -> None:
    """With that before which it stopped, not with a load on the way at which another model did."""
    case = make_case({"m": 0.1}, stopped={"m": 1}, subdivisions=0)
    for own, told in (([0.25, 0.5, 0.75, 1.0], "0.5"), ([0.75, 1.0], "0.75")):
        digest = Digest(make_run([asked(case, load={"factors": own})]))
        (one,) = stopped_models(digest)
        assert one.where == f"the only case, load factor {told}"


@pytest.mark.parametrize(
    ("stopped", "opens"), [({}, 3), ({REFERENCE: 2}, 1), ({REFERENCE: 3, "m": 1}, 0), ({REFERENCE: 0}, 3)]
)
def test_the_error_is_first_shown_at_the_last_load_that_model_and_reference_reached(
    stopped: dict[str, int], opens: int
) -> None:
    """Where the reference had ended, the page opened at full load: an empty picture."""
    case = make_case({"m": 0.1}, stopped=stopped, subdivisions=1)
    digest = Digest(make_run([case]))
    for history in (True, False):
        (shown,) = payload(digest, [case], digest.models, history)["cases"]  # type: ignore[attr-defined]
        assert shown["factors"][shown["opens"]] == case.load_factors[opens]
    panels, words = still(digest, case)
    assert len(panels) == (1 if opens == 3 and stopped else 3)
    load = f"At {25 * (opens + 1)} % of the load, the last that both reached."
    assert (load in words) is (opens < 3)


def test_a_failed_step_is_a_message_to_the_viewer() -> None:
    digest = Digest(make_run([make_case({"m": 0.1}, stopped={"m": 1}, subdivisions=0)]))
    data = json.loads(json.dumps(payload(digest, digest.cases, digest.models, True), allow_nan=False))
    steps = next(m["steps"] for m in data["cases"][0]["models"] if m["name"] == "m")
    assert "data" in steps[0]
    assert steps[1:] == [{"message": "the volume could not be held"}] * 3


@pytest.mark.parametrize(
    ("share", "told"), [(0.9, "one load step only"), (0.01, "too many nodes for a viewer")]
)
def test_a_surface_too_large_for_the_page_has_less_of_a_viewer(
    monkeypatch: pytest.MonkeyPatch, share: float, told: str
) -> None:
    digest = Digest(make_run([make_case({"m": 0.1}, subdivisions=3)]))
    most = share * len(json.dumps(payload(digest, digest.cases, digest.models, True)))
    monkeypatch.setattr(section_view, "MOST_BYTES", most)
    found = section_view.surface(digest)
    (viewer,) = (block for block in found.blocks if isinstance(block, Viewer))
    assert len(json.dumps(viewer.payload)) <= most
    assert told in viewer.note.text


# --- axes ---


def test_everything_drawn_is_told_in_words_and_every_table_can_be_taken_away(html: str) -> None:
    drawn = re.findall(r"<svg [^>]*>", re.sub(r'<svg [^>]*aria-hidden="true">', "", html))
    assert len(drawn) >= 6
    for tag in drawn:
        told = re.search(r'role="img" aria-label="([^"]*)"', tag)
        assert told is not None, tag
        assert len(told.group(1).split()) > 5, told.group(1)
        assert re.search(r"\d", told.group(1)), "an alternative gives the numbers"
    assert all(re.search(r'alt="[^"]{10,}"', tag) for tag in re.findall(r"<img [^>]*>", html))
    tables = len(re.findall(r"<table(?! class=\"families\")", html))
    assert tables >= 4
    in_the_head = 2
    assert html.count('data-action="csv"') == tables - in_the_head


def test_a_small_strain_limit_is_told_in_the_unit_of_the_only_load_else_as_a_multiple() -> None:
    """0.35 and 0.6 times a study's loads: several, and a pressure of 1 kPa alone."""
    several = whole_case()
    press = {"kind": "contact", "region": "base", "name": "finger", "pressure": 1000.0}
    alone = asked(several, constraints=[press], gravity=None)
    for case, title, loads in (
        (several, "Times the study's loads", ["0.350", "to 0.600"]),
        (alone, "Load", ["350 Pa", "to 600 Pa"]),
    ):
        found = small_strain_limits(Digest(make_run([case])))
        table = found.blocks[0]
        place = [column.title for column in table.columns].index(title)
        assert [row[place].text for row in table.rows] == loads
