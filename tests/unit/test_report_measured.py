"""Times of an earlier run or of another machine are marked on the terminal and in JSON."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.command import vdmbench, write_study
from tests.work.shared_work import ALONE, plan_of, run
from vdmbench.machine.processors import processor_name
from vdmbench.measures.case import CaseResult
from vdmbench.report.headline import _table, headline_metrics, headline_rows
from vdmbench.report.section_cost import time_notes
from vdmbench.verdict import measured
from vdmbench.verdict.digest import Digest
from vdmbench.work import cache as answers
from vdmbench.work import provenance

from .report_runs import REFERENCE, make_case, make_run

TIMES = ("seconds_setup", "seconds_per_step")


def _case(processor: str, **parameters: str) -> CaseResult:
    """A case of two models, the parameters being those of `vdm-m`."""
    case = make_case({"vdm-m": 0.1}, subdivisions=1)
    model = case.models["vdm-m"]
    marked = dataclasses.replace(model, parameters={**model.parameters, **parameters})
    return dataclasses.replace(
        case,
        models={**case.models, "vdm-m": marked},
        provenance={**case.provenance, "processor": processor},
    )


@pytest.mark.parametrize(
    ("case", "marks", "of_reference"),
    [
        (_case(processor_name()), [], []),
        (_case(processor_name(), measured_earlier="yes"), ["earlier run"], []),
        (_case("Abacus 3"), ["another machine"], ["another machine"]),
        (_case("Abacus 3", measured_on=processor_name()), [], ["another machine"]),
        (
            _case(processor_name(), measured_earlier="yes", measured_on="Abacus 3"),
            ["earlier run", "another machine"],
            [],
        ),
    ],
)
def test_times_say_when_and_where(case: CaseResult, marks: list[str], of_reference: list[str]) -> None:
    shown = make_run([case])
    for name, expected in (("vdm-m", marks), (REFERENCE, of_reference)):
        (row,) = (row for row in headline_rows(shown) if row["model"].split()[0] == name)
        for column in ("set-up", "per frame"):
            assert row[column].endswith(f" ({', '.join(expected)})") if expected else "(" not in row[column]
        for time in TIMES:
            assert headline_metrics(shown)[name][time]["measured"] == expected
        (row_of_page,) = (line for line in _table(Digest(shown)).rows if line[0].text.split()[0] == name)
        details = "\n".join(cell.detail for cell in row_of_page[1:])
        for word, mark in (("earlier", "earlier run"), ("another machine", "another machine")):
            assert (word in details) == (mark in expected)
    told = " ".join(time_notes(Digest(shown).summaries))
    assert ("Measured on another machine" in told) == ("another machine" in [*marks, *of_reference])


def test_a_case_that_was_done_before_the_others_is_of_an_earlier_run() -> None:
    cases = [make_case({"vdm-m": 0.1}, label=label, subdivisions=1) for label in ("a", "b")]
    cases = [dataclasses.replace(case, hash=2 * str(k)) for k, case in enumerate(cases)]

    def marks(*resumed: str) -> tuple[str, ...]:
        return measured.measured(dataclasses.replace(make_run(cases), plan={"resumed": resumed}), "vdm-m")

    assert marks("00") == marks("11") == ("earlier run",)
    assert marks() == ()


def test_an_entire_case_that_is_resumed_says_so(tmp_path: Path) -> None:
    sweep = '[sweep]\n"tissue.poisson_ratio" = [0.49, 0.4]\n[load]'
    write_study(tmp_path, a=("[load]", sweep))
    assert vdmbench("run", "small.toml", cwd=tmp_path).returncode == 0
    shutil.rmtree(tmp_path / "results/cache")  # so that no answer of its own marks the other case
    next((tmp_path / "results/runs/small/cases").iterdir()).unlink()
    for what in ("resumed", "nothing to do"):
        said = vdmbench("run", "small.toml", "--json", cwd=tmp_path)
        assert said.returncode == 0, said.stderr
        times = json.loads(said.stdout)["metrics"]["vdm-paper"]["seconds_setup"]
        assert times["measured"] == ["earlier run"], what


def test_what_another_machine_has_measured_says_so_in_the_next_case(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of models from a case file, and of the reference from a cache that was copied."""
    changes: dict[str, Any] = ALONE | {"sweep": {}}
    monkeypatch.setattr(answers, "processor_name", lambda: "Abacus 3")
    monkeypatch.setattr(provenance, "_machine", lambda: {"processor": "Abacus 3"})
    run(plan_of(tmp_path, tmp_path / "cache", **changes))
    monkeypatch.undo()
    study = ALONE["study"] | {"models": ["vdm-vector", "vdm-paper", "fem-linear"]}
    (case,) = run(plan_of(tmp_path, tmp_path / "cache", **changes | {"study": study}))
    found = {name: result.parameters.get("measured_on") for name, result in case.models.items()}
    assert found == {"vdm-vector": "Abacus 3", "vdm-paper": None, "fem-linear": "Abacus 3"}
    assert measured.measured(make_run([case]), "vdm-vector") == ("earlier run", "another machine")
