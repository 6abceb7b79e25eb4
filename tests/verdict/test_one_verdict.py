"""Page, terminal, JSON and Python take one verdict: the same words and numbers stand in all of them."""

import html
import json
import re
from pathlib import Path

import pytest

from tests.report.runs import make_case, make_run, sweep_run
from vdmbench.api import Results
from vdmbench.cli.output import WIDTH, print_run, print_table
from vdmbench.measures.case import Run
from vdmbench.report.page import page_html
from vdmbench.verdict.digest import Digest
from vdmbench.verdict.formatting import measure
from vdmbench.verdict.verdict import verdicts
from vdmbench.verdict.words import told


def flat(text: str) -> str:
    return re.sub(r"\s+", " ", text)


def printed(run: Run, capsys: pytest.CaptureFixture[str], *, as_json: bool) -> str:
    capsys.readouterr()
    print_run(run, Path("runs/ball"), Path("runs/ball/report.html"), as_json)
    return capsys.readouterr().out


def test_page_terminal_json_and_notebook_say_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    run = sweep_run()
    found = verdicts(Digest(run))
    page = flat(html.unescape(re.sub(r"<[^>]*>", " ", page_html(run))))
    terminal = flat(printed(run, capsys, as_json=False))
    data = json.loads(printed(run, capsys, as_json=True))
    results = Results(Path("runs/ball"), run, Path("runs/ball/report.html"))
    assert results.verdicts == found
    notebook = flat(html.unescape(re.sub(r"<[^>]*>", " ", results._repr_html_())))
    assert {family: one["word"] for family, one in data["verdicts"].items()} == {
        family: one.word for family, one in found.items()
    }
    words = told(found)
    assert len(words["rows"]) == 2
    for row, one in zip(words["rows"], found.asked, strict=True):
        number = measure(one.figures.value, bar=one.figures.bar)
        assert f"{row['title']}: {row['word']}. {row['text']}" in terminal
        assert f"{one.figures.lead} {number}" in row["numbers"]
        assert f"{row['title']} {row['word']} {one.model} {' '.join(row['numbers'])}" in page
        assert row["text"] in notebook
    for sentence in words["notes"]:
        assert all(flat(sentence) in text for text in (terminal, page, notebook))
    assert data["answers"]["instead"] == words["instead"]


def test_no_line_of_the_terminal_is_wider_than_it(capsys: pytest.CaptureFixture[str]) -> None:
    names = {"vdm-consistent:nonlinear": 0.05, "bem:quasi-linear": 0.06, "fem-linear": 0.02}
    cases = [
        make_case(names, reference="fem-linear refined", swept={"k": k}, label=f"k = {k}", subdivisions=0)
        for k in (1.0, 2.0)
    ]
    text = printed(make_run(cases), capsys, as_json=False)
    assert max(map(len, text.splitlines())) <= WIDTH
    first = [line for line in text.splitlines() if line.strip() and not line.startswith(" ")]
    assert first[0].split()[0] == "model", "a table, not a paragraph a model"
    assert [line.split()[0] for line in first[1:3]] == list(names)[:2]
    print_table([{"claim": "a claim", "reason": "word " * 30, "number": "10 %"}])
    wide = capsys.readouterr().out.splitlines()
    assert wide[0] == "a claim"
    assert max(map(len, wide)) <= WIDTH
