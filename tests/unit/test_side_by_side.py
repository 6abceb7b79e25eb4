"""`vdmbench compare`: worse, better, newly failing and not comparable told apart, in 80 columns."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from tests.unit.report_runs import make_case, make_run
from tests.unit.typed_study import asked
from vdmbench.cli import verb_compare
from vdmbench.cli.arguments import parse
from vdmbench.guard.side_by_side import as_text, side_by_side
from vdmbench.measures.case import Run


def _run(errors: dict[str, float], **case: object) -> Run:
    return make_run([make_case(errors, **case)])  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def runs() -> dict[str, Run]:
    first = {"vdm-paper": 0.2, "vdm-vector": 0.1, "bem": 0.05}
    found = {"runs/first": _run(first)}
    found["runs/second"] = _run({"vdm-paper": 0.4, "vdm-vector": 0.02, "bem": 0.05}, stopped={"bem": 3})
    other = _run(first)
    case = asked(other.cases[0], tissue={"youngs_modulus": 5e3, "poisson_ratio": 0.3})
    found["runs/of another tissue"] = dataclasses.replace(other, cases=[case])
    found["runs/without the boundary form"] = _run({"vdm-paper": 0.2, "vdm-vector": 0.1})
    return found


def test_what_became_of_each_is_told(runs: dict[str, Run]) -> None:
    lines = list(as_text(side_by_side(runs)))
    assert max(map(len, lines)) <= 80
    start = lines.index("displacement error")
    assert lines[:6] == [
        "A  runs/first",
        "B  runs/second",
        "C  runs/of another tissue",
        "D  runs/without the boundary form",
        "at full load, the worst of all cases; held against A case by case",
        "",
    ]
    assert lines[start : start + 10] == [
        "displacement error",
        "                        A                 B                 C",
        "vdm-paper               20.0 %            40.0 % worse      20.0 % ?",
        "vdm-vector              10.0 %            2.00 % better     10.0 % ?",
        "bem            5.00 %            – fails           5.00 % ?",
        "",
        "displacement error",
        "                        D",
        "vdm-paper               20.0 %",
        "vdm-vector              10.0 %",
    ]
    assert lines[start + 10] == "bem            – gone"
    assert "C against A: 1 not comparable" in lines
    assert "   the inputs of the case have changed" in lines


def test_json_has_every_metric_and_the_findings(
    runs: dict[str, Run], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = ["first", "second"]
    for name in names:
        (tmp_path / name / "cases").mkdir(parents=True)
    found = {str(tmp_path / name): run for name, run in zip(names, runs.values(), strict=False)}
    monkeypatch.setattr("vdmbench.store.cases.read_run", lambda path: found[str(path)])
    options = parse(["compare", *found, "--json"])
    assert verb_compare.run(options) == 0
    told = json.loads(capsys.readouterr().out)
    row = next(row for row in told["rows"] if (row["metric"], row["model"]) == ("hausdorff_distance", "bem"))
    assert row["outcomes"] == ["first", "newly failing"]
    assert row["values"][0] > 0
    assert row["values"][1] is None
    assert {finding["outcome"] for finding in told["findings"][0]} >= {"worse", "better", "newly failing"}


def test_one_run_is_beside_nothing(tmp_path: Path) -> None:
    (tmp_path / "cases").mkdir()
    with pytest.raises(ValueError, match="give 2 to 26 different run directories, not 1"):
        verb_compare.run(parse(["compare", str(tmp_path), f"{tmp_path}/."]))


def test_no_stored_name_steers_the_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "b"):
        (tmp_path / name / "cases").mkdir(parents=True)
    monkeypatch.setattr("vdmbench.store.cases.read_run", lambda _: _run({"\x1b[31mvdm": 0.1}))
    assert verb_compare.run(parse(["compare", f"{tmp_path}/a", f"{tmp_path}/b"])) == 0
    told = capsys.readouterr().out
    assert "vdm " in told
    assert "\x1b" not in told
