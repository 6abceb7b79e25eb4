"""Names, texts and numbers from elsewhere: none of them may become markup, script or a crash of the report."""

import dataclasses
import html.parser
import re
from pathlib import Path

import numpy as np
import pytest

from solver_common.solution import Status
from tests.report.browser import Browser
from tests.report.runs import make_case, make_run
from vdmbench.measures.case import CaseResult, Run
from vdmbench.report.headline import headline_metrics
from vdmbench.report.page import page_html, write_report

ATTACKS = (
    "<script>window.owned = 1</script>",
    '"><img src=x onerror="window.owned = 2">',
    "</script><script>window.owned = 3</script>",
    "'-window.owned-'<svg onload=window.owned=4>",
    "{{ 7 * 7 }}{% include 'page.css' %}",
    "]]><!-- --></style></title><iframe src=javascript:window.owned=5>",
    "$\\frac{1}{2}$ \\N{BULLET} %s {0}",
    "=cmd()|' /C calc'!A0",
    "\u202egnirts\u2028\u2029\x00\x07\ud800 \U0001f9a0",
    "x" * 5000,
)


def hostile_run() -> Run:
    """Attacks in every text that the report shows."""
    cases = []
    for k, attack in enumerate(ATTACKS):
        model, other = f"m{ATTACKS[0]}", f"n{ATTACKS[1]}"
        case = make_case(
            {model: 0.1 + 0.01 * k, other: 0.2},
            label=attack,
            swept={f"a.{ATTACKS[2]}": attack, ATTACKS[1]: float(k)},
            units={ATTACKS[1]: ATTACKS[0]},
            reference=f"r{ATTACKS[3]}",
            steps=(0.5, 1.0),
            subdivisions=0,
        )
        bad = Status(attack, attack, attack)
        models = {
            name: dataclasses.replace(
                result,
                status=(bad, bad) if name == other else result.status,
                parameters={attack: attack, "number": 1.0},
                version=attack,
            )
            for name, result in case.models.items()
        }
        provenance = {attack: attack, "package.numpy": attack, "mesh_hash": attack}
        cases.append(
            dataclasses.replace(case, models=models, provenance=provenance, mesh_quality={attack: 1.0})
        )
    failed = [
        {"hash": attack, "label": attack, "code": attack, "message": attack, "remedy": attack}
        for attack in ATTACKS
    ]
    run = make_run(cases, name=ATTACKS[0], title=ATTACKS[2])
    return dataclasses.replace(run, study_text="\n".join(ATTACKS), failed=failed, missing=list(ATTACKS))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("hostile") / "report.html"
    write_report(hostile_run(), path)
    return path


class Tags(html.parser.HTMLParser):
    """Elements and attributes as a parser sees them."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs


def test_texts_stay_texts(page: Path) -> None:
    found = Tags(page.read_text())
    assert found.tags.count("script") == 3  # the page's two and the viewer's data
    assert not {"iframe", "object", "embed", "form", "link", "base"} & set(found.tags)
    assert found.tags.count("img") == 1  # the still picture
    assert not [name for name, _ in found.attributes if name.startswith("on")]
    assert not [
        value for _, value in found.attributes if (value or "").lower().lstrip().startswith("javascript:")
    ]
    text = page.read_text()
    assert "49" not in re.findall(r"<h1>(.*?)</h1>", text, re.S)[0], "a template in a title is not run"
    assert "{{ 7 * 7 }}" in text
    assert "\x07? \U0001f9a0" in text, "a lone surrogate does not stop the writing"


def test_no_script_of_theirs_runs(browser: Browser, page: Path, tmp_path: Path) -> None:
    for width in (1400, 400):
        browser.open(page, width)
        assert browser.evaluate("window.owned") is None
        assert browser.evaluate("document.scripts.length") == 3
        assert browser.evaluate("document.querySelectorAll('iframe, img').length") == 1
        assert browser.complaints() == []
        assert browser.requests() == []
        assert browser.evaluate("document.documentElement.scrollWidth") <= width
    options = "[...document.querySelectorAll('[data-control=case] option')]"
    titles = browser.evaluate(f"{options}.map(o => o.textContent)")
    assert any("<script>window.owned = 1</script>" in title for title in titles), "shown as it is written"
    # and if one slipped through all the same, the page's policy stops it
    slipped = tmp_path / "slipped.html"
    slipped.write_bytes(page.read_bytes().replace(b"</body>", b"<script>window.owned = 1</script></body>"))
    browser.open(slipped, 1000)
    assert browser.evaluate("window.owned") is None
    assert any("Content Security Policy" in text for text in browser.complaints())


# --- numbers ---


def with_numbers(case: CaseResult, value: float) -> CaseResult:
    """Every number of a case replaced."""
    models = {
        name: dataclasses.replace(
            result,
            displacement=np.full_like(result.displacement, value),
            seconds_setup=value,
            seconds_per_step=np.full_like(result.seconds_per_step, value),
            volume=np.full_like(result.volume, value),
        )
        for name, result in case.models.items()
    }
    metrics = {
        name: {metric: np.full_like(values, value) for metric, values in entries.items()}
        for name, entries in case.metrics.items()
    }
    error = {
        "difference_01": value,
        "gci:relative_l2_displacement_error": value,
        "gci:relative_l2_deformation_error": value,
    }
    return dataclasses.replace(case, models=models, metrics=metrics, reference_error=error)


@pytest.mark.parametrize("value", [-np.inf, 1e300])
def test_numbers_that_are_none(value: float) -> None:
    odd, plain = (make_case({"m": 0.1}, swept={"k": k}, label=f"k = {k}", subdivisions=0) for k in (1.0, 2.0))
    run = make_run([with_numbers(odd, value), plain])
    text = re.sub(r'<script.*?</script>|"data:image[^"]*"', "", page_html(run), flags=re.S)
    assert not re.search(r'data-value="(nan|inf|-inf)"', text)
    assert not re.search(r"\bnan\b", text, re.I)
    assert len(headline_metrics(run)) == 2


def test_a_run_of_nothing_but_nan() -> None:
    case = with_numbers(make_case({"m": 0.1}, subdivisions=0), np.nan)
    assert "No model has an error at full load" in page_html(make_run([case]))


def test_swept_values_at_the_edge() -> None:
    edges = {"large": (1e300, -1e300, 1e300), "small": (0.0, 0.0, 1e-300), "none": (np.nan, np.inf, np.nan)}
    cases = [
        make_case(
            {"m": 0.1 * (k + 1)},
            label=f"case {k}",
            swept=dict(zip(edges, swept, strict=True)),
            subdivisions=0,
        )
        for k, swept in enumerate(zip(*edges.values(), strict=True))
    ]
    assert "Error against parameters and load" in page_html(make_run(cases))
