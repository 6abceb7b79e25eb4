"""Accuracy baselines: what counts as worse, better, failing and not comparable, and what is told about it."""

from __future__ import annotations

import dataclasses
import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.command import SMALL_STUDY, vdmbench
from tests.unit.typed_study import asked
from vdmbench.guard import gate
from vdmbench.guard.gate import (
    Baseline,
    BaselineError,
    Finding,
    accept,
    compare,
    counts,
    read_baseline,
)
from vdmbench.guard.gate_report import describe, junit, markdown, summary
from vdmbench.machine.stored_json import sealed
from vdmbench.measures.case import CaseResult, MetricSeries, Run
from vdmbench.measures.metrics import METRICS, Sense
from vdmbench.store.hdf5 import StoreError
from vdmbench.store.run_directory import write_failure

from .report_runs import make_case, make_run

FORMAT = Path(__file__).parents[2] / "results" / "FORMAT.md"
VECTOR = "relative_l2_displacement_error"
BARS = {"gci:relative_l2_displacement_error": 0.01}


def run_of(errors: Mapping[str, float], **changes: object) -> Run:
    return make_run([make_case(errors, subdivisions=0, label="nu = 0.49", reference_error=BARS, **changes)])  # type: ignore[arg-type]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    accept(run_of({"vdm-vector": 0.2, "vdm-paper": 0.8}), tmp_path / "b.json", "first numbers")
    return tmp_path / "b.json"


def found(path: Path, run: Run, metric: str = VECTOR) -> dict[str, Finding]:
    """Model -> what became of one metric."""
    findings = compare(run, read_baseline(path))
    return {f.model: f for f in findings if f.metric == metric}


def changed(case: CaseResult, model: str, **fields: object) -> CaseResult:
    return dataclasses.replace(
        case,
        models={**case.models, model: dataclasses.replace(case.models[model], **fields)},  # type: ignore[arg-type]
    )


def with_series(case: CaseResult, model: str, metric: str, **fields: object) -> CaseResult:
    series = dataclasses.replace(case.metrics[model][metric], **fields)  # type: ignore[arg-type]
    return dataclasses.replace(case, metrics={**case.metrics, model: {**case.metrics[model], metric: series}})


def test_the_same_run_is_unchanged_to_the_last_metric(path: Path) -> None:
    findings = compare(run_of({"vdm-vector": 0.2, "vdm-paper": 0.8}), read_baseline(path))
    assert set(counts(findings)) == {gate.SAME}
    assert len(findings) > 20
    assert not gate.regressed(findings)
    assert not gate.nothing_compared(findings)


@pytest.mark.parametrize(
    ("now", "outcome"),
    [(0.2, gate.SAME), (0.2039, gate.SAME), (0.2041, gate.WORSE), (0.1961, gate.SAME), (0.1959, gate.BETTER)],
)
def test_the_tolerance_is_two_per_cent(path: Path, now: float, outcome: str) -> None:
    assert found(path, run_of({"vdm-vector": now, "vdm-paper": 0.8}))["vdm-vector"].outcome == outcome


def test_small_errors_and_drifts_have_a_floor(tmp_path: Path) -> None:
    base = make_case({"m": 1e-5}, subdivisions=0)
    accept(
        make_run([with_series(base, "m", "volume_drift", values=np.full(4, 1e-13))]), tmp_path / "b.json", "x"
    )
    slightly = with_series(
        make_case({"m": 9e-4}, subdivisions=0), "m", "volume_drift", values=np.full(4, -9e-10)
    )
    later = make_run([dataclasses.replace(slightly, label=base.label)])
    assert found(tmp_path / "b.json", later)["m"].outcome == gate.SAME
    assert found(tmp_path / "b.json", later, "volume_drift")["m"].outcome == gate.SAME
    drifting = make_run([with_series(base, "m", "volume_drift", values=np.full(4, -1e-8))])
    assert found(tmp_path / "b.json", drifting, "volume_drift")["m"].outcome == gate.WORSE


@pytest.mark.parametrize("name", ["volume_drift", "leak"])
def test_a_metric_is_judged_by_the_sense_that_it_declares(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """A number that grows from 1e-7 to 1e-5 of what is conserved is worse, as an error it is nothing."""

    def outcomes(sense: Sense) -> set[str]:
        metric = dataclasses.replace(METRICS["volume_drift"], name=name, sense=sense)
        monkeypatch.setitem(METRICS, name, metric)
        series = base.metrics["m"]["volume_drift"]
        was, now = (
            dataclasses.replace(
                base, metrics={"m": {name: dataclasses.replace(series, values=np.full(4, v))}}
            )
            for v in (1e-7, -1e-5)
        )
        accept(make_run([was]), tmp_path / "b.json", "first numbers")
        return {
            f.outcome
            for f in compare(make_run([now]), read_baseline(tmp_path / "b.json"))
            if f.metric == name
        }

    base = make_case({"m": 0.1}, subdivisions=0)
    assert outcomes("conserved") == {gate.WORSE}
    assert outcomes("error") == {gate.SAME}
    assert outcomes("descriptive") == set()


def test_the_reference_s_own_error_is_gated_too(path: Path) -> None:
    case = make_case(
        {"vdm-vector": 0.2, "vdm-paper": 0.8},
        subdivisions=0,
        label="nu = 0.49",
        reference_error={"gci:relative_l2_displacement_error": 0.02},
    )
    assert found(path, make_run([case]), gate.OWN + VECTOR)["fem-linear"].outcome == gate.WORSE


@pytest.mark.parametrize("models", [{"vdm-vector": 0.2}, {}])
def test_the_reference_s_own_error_has_the_unit_and_the_floor_of_its_metric(
    tmp_path: Path, models: Mapping[str, float]
) -> None:
    def measured(distance: float, drift: float) -> Run:
        bars = {"gci:hausdorff_distance": distance, "gci:volume_drift": drift, "gci:no_such_metric": 1.0}
        return make_run([make_case(models, subdivisions=0, reference_error=bars)])

    accept(measured(10e-6, 1e-7), tmp_path / "b.json", "first numbers")
    text = json.loads((tmp_path / "b.json").read_text())
    entries = text["cases"][gate.ONLY_CASE]["models"]["fem-linear"]["metrics"]
    assert entries[gate.OWN + "hausdorff_distance"] == {
        "value": 1e-5,
        "tolerance": 1e-6,
        "unit": "m",
        "version": METRICS["hausdorff_distance"].version,
    }
    assert gate.OWN + "no_such_metric" not in entries
    for now, outcome in {
        (10.9e-6, 1e-7): gate.SAME,
        (11.1e-6, 1e-7): gate.WORSE,
        (8.9e-6, 1e-7): gate.BETTER,
    }.items():
        name = gate.OWN + "hausdorff_distance"
        assert found(tmp_path / "b.json", measured(*now), name)["fem-linear"].outcome == outcome
    drifting = measured(10e-6, 2e-7)
    assert found(tmp_path / "b.json", drifting, gate.OWN + "volume_drift")["fem-linear"].outcome == gate.WORSE


def test_failing_and_passing(path: Path, tmp_path: Path) -> None:
    stopped = run_of({"vdm-vector": 0.2, "vdm-paper": 0.8}, stopped={"vdm-vector": 2})
    finding = found(path, stopped)["vdm-vector"]
    assert finding.outcome == gate.NEWLY_FAILING
    assert gate.regressed([finding])
    accept(stopped, tmp_path / "s.json", "it stops")
    assert (
        found(tmp_path / "s.json", run_of({"vdm-vector": 0.2, "vdm-paper": 0.8}))["vdm-vector"].outcome
        == gate.NEWLY_PASSING
    )
    assert found(tmp_path / "s.json", stopped)["vdm-vector"].outcome == gate.SAME
    failed = [{"hash": "a", "label": "nu = 0.49", "code": "crashed", "message": "it died", "remedy": ""}]
    (finding,) = compare(dataclasses.replace(stopped, cases=[], failed=failed), read_baseline(path))
    assert (finding.outcome, finding.why) == (gate.NEWLY_FAILING, "it died")
    elsewhere = [{**failed[0], "label": "nu = 0.3"}]
    gone, new = compare(dataclasses.replace(stopped, cases=[], failed=elsewhere), read_baseline(path))
    assert (gone.outcome, new.outcome, new.case) == (gate.MISSING, gate.NEW, "nu = 0.3")
    assert "it died" in new.why


def test_what_cannot_be_compared_says_why(path: Path) -> None:
    case = run_of({"vdm-vector": 0.2, "vdm-paper": 0.8}).cases[0]
    versions = {
        "model version 1 -> 2": changed(case, "vdm-vector", version="2"),
        f"metric version {METRICS[VECTOR].version} -> 7": with_series(case, "vdm-vector", VECTOR, version=7),
        "unit 1 -> m": with_series(case, "vdm-vector", VECTOR, unit="m"),
        "the inputs of the case have changed": asked(
            case, tissue={"youngs_modulus": 4e3, "poisson_ratio": 0.45}
        ),
        "the reference has changed: fem-linear of version 1 -> vdm-paper of version 1": dataclasses.replace(
            case, reference="vdm-paper"
        ),
        "the reference has changed: fem-linear of version 1 -> fem-linear of version 2": changed(
            case, "fem-linear", version="2"
        ),
        "the reference has changed: fem-linear of version 1 -> none": dataclasses.replace(
            case, reference=None
        ),
    }
    for why, now in versions.items():
        findings = compare(make_run([now]), read_baseline(path))
        assert [f.why for f in findings if f.outcome == gate.NOT_COMPARABLE] == [why]
        assert not gate.regressed(findings)
    findings = compare(make_run([versions["the inputs of the case have changed"]]), read_baseline(path))
    assert gate.nothing_compared(findings)


def test_more_and_less_than_the_baseline(path: Path) -> None:
    less = compare(run_of({"vdm-vector": 0.2}), read_baseline(path))
    assert [(f.outcome, f.model) for f in less if f.outcome != gate.SAME] == [(gate.MISSING, "vdm-paper")]
    more = compare(run_of({"vdm-vector": 0.2, "vdm-paper": 0.8, "new": 0.1}), read_baseline(path))
    assert [(f.outcome, f.model) for f in more if f.outcome != gate.SAME] == [(gate.NEW, "new")]
    other_case = make_run([make_case({"vdm-vector": 0.2}, subdivisions=0, label="nu = 0.3")])
    assert {f.outcome for f in compare(other_case, read_baseline(path))} == {gate.MISSING, gate.NEW}


def test_names_of_the_study_do_not_matter_to_the_inputs(path: Path) -> None:
    case = run_of({"vdm-vector": 0.2, "vdm-paper": 0.8}).cases[0]
    names = {
        "study": {"name": "ball", "models": [], "title": "another"},
        "sweep": {"a": [1, 2]},
        "calibration": {"training": 2},
    }
    names["inputs"] = {
        "tissue.youngs_modulus": {"sd": 300.0}
    }  # which decide nothing of the study's own answers
    renamed = asked(case, **names)
    assert set(counts(compare(make_run([renamed]), read_baseline(path)))) == {gate.SAME}


OTHER = {
    "tissue": {"youngs_modulus": 4e3, "poisson_ratio": 0.45},
    "models": {"vdm-vector": {"bulk_modulus": 1.0}},
    "vdm": {"bulk_modulus": 1.0},
    "load": {"factors": [0.5]},
    "constraints": [],
    "uncertainty": {"levels": 3},
}


@pytest.mark.parametrize("table", OTHER)
def test_every_other_table_of_the_study_is_an_input(path: Path, table: str) -> None:
    case = run_of({"vdm-vector": 0.2, "vdm-paper": 0.8}).cases[0]
    other = asked(case, **{table: OTHER[table]})
    assert set(counts(compare(make_run([other]), read_baseline(path)))) == {gate.NOT_COMPARABLE}


def test_descriptive_metrics_and_times_are_not_gated(path: Path) -> None:
    text = path.read_text()
    assert "mean_strain" not in text
    assert "contact_work" not in text
    assert "seconds" not in text


def test_accepting_needs_a_reason_and_a_whole_run(tmp_path: Path) -> None:
    run = run_of({"vdm-vector": 0.2})
    with pytest.raises(BaselineError, match="needs a reason"):
        accept(run, tmp_path / "b.json", "  ")
    for broken in (dataclasses.replace(run, missing=["x"]), dataclasses.replace(run, cases=[])):
        with pytest.raises(BaselineError, match="finish the run"):
            accept(broken, tmp_path / "b.json", "why not")
    old = with_series(run.cases[0], "vdm-vector", VECTOR, version=0)
    with pytest.raises(BaselineError, match=f"{VECTOR} is of another version"):
        accept(make_run([old]), tmp_path / "b.json", "why not")
    assert not (tmp_path / "b.json").exists()


def test_a_baseline_of_another_study_is_refused(path: Path) -> None:
    with pytest.raises(BaselineError, match="of study 'ball', the run of 'cube'"):
        compare(make_run([make_case({"m": 0.1}, subdivisions=0)], name="cube"), read_baseline(path))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\xff\xfe", "not a baseline"),
        (b"[" * 100_000, "nested too deeply"),
        (b"[]", "not a baseline"),
        (b'{"schema": 0, "study": "a", "reason": "r", "date": "d", "cases": {}}', "greater than or equal"),
        (b'{"schema": 1, "study": 3}', "not a baseline"),
        (
            b'{"schema": 1, "study": "a", "reason": "r", "date": "d", "cases": {}, "more": 1}',
            "not a baseline",
        ),
    ],
)
def test_damaged_baselines(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "b.json").write_bytes(content)
    with pytest.raises(StoreError, match=f"{message}.*vdmbench accept DIR"):
        read_baseline(tmp_path / "b.json")


def test_a_baseline_of_a_newer_program_is_not_called_damaged(tmp_path: Path) -> None:
    (tmp_path / "b.json").write_text('{"schema": 99}')
    with pytest.raises(BaselineError, match="newer than this program"):
        read_baseline(tmp_path / "b.json")


@pytest.mark.parametrize(
    ("old", "new"), [('"value": 0.8', '"value": 0.9'), ("first", "other"), ('"seal"', '"soul"')]
)
def test_an_edit_of_a_baseline_is_found(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(StoreError, match="vdmbench accept DIR --reason TEXT --baseline"):
        read_baseline(path)


def test_the_shipped_baselines_are_sealed() -> None:
    shipped = FORMAT.parent / "baselines"
    for study in ("quickstart", "regression"):
        assert read_baseline(shipped / f"{study}.json").cases


def test_what_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path):
        with pytest.raises(BaselineError, match="is in a file's place; remove it"):
            read_baseline(path)


def test_the_format_is_as_documented(path: Path) -> None:
    text = FORMAT.read_text().split("## Baseline")[1].split("\n## ")[0]
    documented = [set(re.findall(r"`(\w+)`", line)) for line in text.splitlines() if line.startswith("| `")]
    baseline = json.loads(path.read_text())
    case = baseline["cases"]["nu = 0.49"]
    model = case["models"]["vdm-vector"]
    names = baseline.keys() | case.keys() | model.keys() | model["metrics"][VECTOR].keys()
    assert names == set().union(*documented)
    assert case["reference"] == "fem-linear"
    assert baseline["schema"] == gate.SCHEMA


@pytest.mark.parametrize("value", ["NaN", "Infinity", '"0.1"', "-1"])
def test_a_tolerance_is_a_finite_number_from_zero(path: Path, value: str) -> None:
    data = json.loads(path.read_text())
    entry = data["cases"]["nu = 0.49"]["models"]["vdm-vector"]["metrics"][VECTOR]
    path.write_text(
        path.read_text().replace(f'"tolerance": {entry["tolerance"]}', f'"tolerance": {value}', 1)
    )
    with pytest.raises(StoreError, match=r"tolerance|beyond"):
        read_baseline(path)


def test_junit_and_markdown(path: Path) -> None:
    now = run_of({"vdm-vector": 0.3, "vdm-paper": 0.8})
    case = changed(now.cases[0], "vdm-paper", version="2")
    findings = compare(make_run([case]), read_baseline(path))
    root = ElementTree.fromstring(junit("ba<ll\x00", findings))
    (suite,) = root
    cases = suite.findall("testcase")
    assert len(cases) == int(suite.attrib["tests"]) == len(findings)
    failures = suite.findall("testcase/failure")
    assert len(failures) == int(suite.attrib["failures"]) == counts(findings)[gate.WORSE]
    assert len(suite.findall("testcase/skipped")) == int(suite.attrib["skipped"]) == 1
    assert "0.2 -> 0.3 (tolerance 0.004)" in "".join(f.attrib["message"] for f in failures)
    text = markdown("ball", "Accepted for: a | reason", findings)
    assert f"| worse | nu = 0.49 | vdm-vector | {VECTOR} | 0.2 | 0.3 | 0.004 |  |" in text
    assert "a \\| reason" in text
    assert "unchanged |" not in text
    assert summary(findings).startswith(f"{counts(findings)[gate.WORSE]} worse")
    assert "model version 1 -> 2" in describe(next(f for f in findings if f.model == "vdm-paper"))


def test_junit_does_not_pass_what_the_baseline_has_not() -> None:
    nothing = Baseline(schema=1, study="ball", reason="first", date="2026-01-02", cases={})
    findings = compare(run_of({"vdm-vector": 0.2}), nothing)
    assert counts(findings) == {gate.NEW: 1}
    assert gate.nothing_compared(findings)
    (suite,) = ElementTree.fromstring(junit("ball", findings))
    assert suite.attrib["skipped"] == suite.attrib["tests"] == "1"


def test_the_commands_and_their_exit_codes(tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(SMALL_STUDY)
    assert vdmbench("run", "small.toml", cwd=tmp_path).returncode == 0
    directory = "results/runs/small"
    files = ("--junit", "none.xml", "--markdown", "none.md")
    nothing = vdmbench("gate", directory, "--json", *files, cwd=tmp_path)
    assert nothing.returncode == 6
    assert json.loads(nothing.stdout)["counts"] == {"not comparable": 1}
    (suite,) = ElementTree.parse(tmp_path / "none.xml").getroot()
    assert suite.attrib["tests"] == suite.attrib["skipped"] == "1"
    assert "no such baseline" in (tmp_path / "none.md").read_text()
    assert "vdmbench accept DIR" in nothing.stderr
    assert "--baseline" not in nothing.stderr
    nowhere = vdmbench("gate", directory, "--baseline", "nowhere.json", cwd=tmp_path)
    assert nowhere.returncode == 2
    assert "vdmbench accept DIR --reason TEXT --baseline nowhere.json" in nowhere.stderr
    assert vdmbench("accept", directory, cwd=tmp_path).returncode == 2
    assert vdmbench("accept", directory, "--reason", " ", cwd=tmp_path).returncode == 2
    accepted = vdmbench("accept", directory, "--reason", "first", cwd=tmp_path)
    assert accepted.returncode == 0, accepted.stderr
    baseline = tmp_path / "results/baselines/small.json"
    same = vdmbench("gate", directory, "--junit", "out.xml", "--markdown", "out.md", cwd=tmp_path)
    assert same.returncode == 0, same.stderr
    assert "first" in same.stdout
    assert ElementTree.parse(tmp_path / "out.xml").getroot().tag == "testsuites"
    assert "first" in (tmp_path / "out.md").read_text()

    data = json.loads(baseline.read_text())
    (case,) = data["cases"].values()
    case["models"]["vdm-paper"]["metrics"][VECTOR]["value"] *= 0.9
    (tmp_path / "better.json").write_text(json.dumps(data))
    edited = vdmbench("gate", directory, "--baseline", "better.json", cwd=tmp_path)
    assert edited.returncode == 5
    assert "accept again: vdmbench accept DIR --reason TEXT --baseline better.json" in edited.stderr
    (tmp_path / "better.json").write_bytes(sealed(data, gate.SEALED_AS))
    worse = vdmbench("gate", directory, "--baseline", "better.json", "--json", cwd=tmp_path)
    assert worse.returncode == 1
    assert json.loads(worse.stdout)["counts"]["worse"] == 1
    case["inputs"] = "other"
    (tmp_path / "other.json").write_bytes(sealed(data, gate.SEALED_AS))
    assert vdmbench("gate", directory, "--baseline", "other.json", cwd=tmp_path).returncode == 6
    data["study"] = "elsewhere"
    (tmp_path / "elsewhere.json").write_bytes(sealed(data, gate.SEALED_AS))
    assert vdmbench("gate", directory, "--baseline", "elsewhere.json", cwd=tmp_path).returncode == 2
    (result,) = (tmp_path / directory / "cases").iterdir()
    whole = result.read_bytes()
    result.write_bytes(whole[:-1])
    assert vdmbench("gate", directory, cwd=tmp_path).returncode == 5
    assert vdmbench("accept", directory, "--reason", "x", cwd=tmp_path).returncode == 5

    result.unlink()
    unfinished = vdmbench("gate", directory, cwd=tmp_path)
    assert unfinished.returncode == 6
    assert "the run has not got to it" in unfinished.stdout
    (tmp_path / directory / "failed").mkdir(exist_ok=True)
    failure = {"hash": result.stem, "label": "", "code": "crashed", "message": "it died", "remedy": ""}
    write_failure(tmp_path / directory / "failed" / f"{result.stem}.json", failure, "")
    failed = vdmbench("gate", directory, cwd=tmp_path)
    assert failed.returncode == 1
    assert "newly failing: the only case: it died" in failed.stdout
    result.write_bytes(whole)
    assert vdmbench("gate", directory, cwd=tmp_path).returncode == 0


def test_series_of_a_step_that_is_not_full_load_do_not_matter(path: Path) -> None:
    case = run_of({"vdm-vector": 0.2, "vdm-paper": 0.8}).cases[0]
    values = case.metrics["vdm-vector"][VECTOR].values.copy()
    values[0] = 5.0
    series = MetricSeries(values, "1", "", METRICS[VECTOR].version)
    metrics = {**case.metrics, "vdm-vector": {**case.metrics["vdm-vector"], VECTOR: series}}
    assert (
        found(path, make_run([dataclasses.replace(case, metrics=metrics)]))["vdm-vector"].outcome == gate.SAME
    )
