"""Page, terminal, JSON and Python take one verdict: the same words and numbers stand in all of them."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from typing import Any

import pytest

from vdmbench.api import Results
from vdmbench.cli.output import WIDTH, print_run, print_table
from vdmbench.measures.case import Run
from vdmbench.report.page import page_html
from vdmbench.verdict.digest import Digest
from vdmbench.verdict.sentences import told
from vdmbench.verdict.verdict import verdicts

from .report_runs import make_case, make_run, measured_anew, sweep_run

LIMITED = {"displacement_error": 0.04, "largest_difference": 2e-4, "region": "finger", "frame_time": 5e-4}


def limited_run() -> Run:
    """A sweep against limits of every kind."""
    run = sweep_run()
    return make_run([measured_anew(case) for case in run.cases], acceptance=LIMITED)


def flat(text: str) -> str:
    return re.sub(r"\s+", " ", text)


def printed(run: Run, capsys: pytest.CaptureFixture[str], *, as_json: bool) -> str:
    capsys.readouterr()
    print_run(run, Path("runs/ball"), Path("runs/ball/report.html"), as_json)
    return capsys.readouterr().out


@pytest.mark.parametrize("make", [sweep_run, limited_run])
def test_page_terminal_json_and_notebook_say_the_same(make: Any, capsys: pytest.CaptureFixture[str]) -> None:
    run = make()
    found = verdicts(Digest(run))
    page = flat(html.unescape(re.sub(r"<[^>]*>", " ", page_html(run, stills=False))))
    terminal = flat(printed(run, capsys, as_json=False))
    data = json.loads(printed(run, capsys, as_json=True))
    results = Results(Path("runs/ball"), run, Path("runs/ball/report.html"))
    assert results.verdicts == found
    notebook = flat(html.unescape(re.sub(r"<[^>]*>", " ", results._repr_html_())))
    assert {family: one["word"] for family, one in data["verdicts"].items()} == {
        family: one.word for family, one in found.items()
    }
    words = told(found)
    assert len(words.rows) == 2
    for row in words.rows:
        assert f"{row.title}: {row.word}. {row.text}" in terminal
        assert f"{row.title} {row.word} {row.text}" in page
        assert row.text in notebook
    for sentence in (*words.notes, *words.instead):
        assert flat(sentence) in terminal
        assert flat(sentence) in page
        assert flat(sentence) in notebook
    assert data["answers"]["instead"] == list(words.instead)


def test_every_limit_has_its_word_and_its_number() -> None:
    found = {limit.key: limit for limit in verdicts(Digest(limited_run()))["vdm-derived"].limits}
    assert found["displacement_error"].word == found["frame_time"].word == "no"
    assert list(found) == ["displacement_error", "deformation_error", "largest_difference", "frame_time"]
    frame = found["frame_time"]
    assert (frame.value, frame.allowed, frame.unit) == (8e-4, 5e-4, "s")
    difference = found["largest_difference"]
    assert difference.region == "finger"
    # 10.6 % of twice 2 mm
    assert difference.value == pytest.approx(0.106 * 0.004, rel=0.02)


def test_no_line_of_the_terminal_is_wider_than_it(capsys: pytest.CaptureFixture[str]) -> None:
    names = {"vdm-consistent:nonlinear": 0.05, "bem:quasi-linear": 0.06, "fem-linear": 0.02}
    cases = [
        make_case(names, reference="fem-linear refined", swept={"k": k}, label=f"k = {k}", subdivisions=0)
        for k in (1.0, 2.0)
    ]
    text = printed(make_run(cases), capsys, as_json=False)
    assert max(map(len, text.splitlines())) <= WIDTH
    assert [line.split()[0] for line in text.splitlines()[1:5:2]] == list(names)[:2]
    print_table([{"claim": "a claim", "reason": "word " * 30, "number": "10 %"}])
    wide = capsys.readouterr().out.splitlines()
    assert wide[0] == "a claim"
    assert max(map(len, wide)) <= WIDTH
