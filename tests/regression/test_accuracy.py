"""Accuracy of the shipped fast studies, held against what was accepted: a change that costs accuracy fails here.

Where a change is meant to move the numbers: `make baselines REASON="why"`, and look at the difference.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from studies import gate
from studies.case import Run
from studies.config import expand, load_study
from studies.gate_report import describe
from studies.plan import make_plan, task_of
from studies.store import read_case, read_run
from studies.worker import run_case
from tests.command import vdmbench
from vdm.material import Parameters

ROOT = Path(__file__).parents[2]
STUDIES = ("quickstart", "regression")


@pytest.mark.parametrize("study", STUDIES)
def test_accuracy_is_what_was_accepted(study: str, tmp_path: Path) -> None:
    run = vdmbench("run", study, "--out", "run", cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    baseline = ROOT / "results" / "baselines" / f"{study}.json"
    result = vdmbench("gate", "run", "--baseline", baseline, cwd=tmp_path)
    assert result.returncode == 0, result.stdout + result.stderr
    findings = gate.compare(read_run(tmp_path / "run"), gate.read_baseline(baseline))
    blind = [f for f in findings if f.outcome in (gate.NOT_COMPARABLE, gate.MISSING, gate.NEW)]
    assert not blind, "\n".join([*map(describe, blind), 'accept what is meant: make baselines REASON="..."'])


def test_a_model_made_worse_on_purpose_turns_the_gate_red(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    by_rule = Parameters.from_tissue

    def worse(*arguments: object, **options: object) -> Parameters:
        found = by_rule(*arguments, **options)  # type: ignore[arg-type]
        tension = found.surface_tension
        return found if tension is None else dataclasses.replace(found, surface_tension=1.5 * tension)

    monkeypatch.setattr(Parameters, "from_tissue", worse)
    study = load_study(ROOT / "studies" / "cases" / "regression.toml")
    plan = make_plan(study, expand(study), tmp_path / "run", tmp_path / "cache")
    (case,) = plan.cases
    task = task_of(case, plan)
    Path(task["path"]).parent.mkdir(parents=True)
    run_case(task)
    run = Run({"name": "regression"}, "", [read_case(Path(task["path"]))], [], [], {})
    findings = gate.compare(run, gate.read_baseline(ROOT / "results" / "baselines" / "regression.json"))
    assert gate.regressed(findings)
    hit = {f.model for f in findings if f.outcome in gate.REGRESSED}
    assert "vdm-vector" in hit
    assert not {model for model in hit if model.startswith(("fem", "vdm-boundary"))}
