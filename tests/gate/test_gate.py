"""Accuracy baselines: what is worse, better, failing and not comparable; exit codes; runs side by side."""

import dataclasses
import json
import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.command import SMALL_STUDY, do, vdmbench
from tests.report.runs import make_case, make_run, of_metric, of_model
from vdmbench import gate
from vdmbench.cli.arguments import parse
from vdmbench.gate import BaselineError, Finding, accept, compare, counts, read_baseline
from vdmbench.measures.case import CaseResult, Run
from vdmbench.measures.measurement import Measurement, Quantity
from vdmbench.measures.metrics import METRICS
from vdmbench.store.plain import StoreError
from vdmbench.study.config import expand, load_study
from vdmbench.study.files import study_path
from vdmbench.study.schema import Study

VECTOR, DRIFT = "relative_l2_displacement_error", "volume_drift"
ERRORS = {"vdm-vector": 0.2, "vdm-paper": 0.8}
STUDY = expand(load_study(study_path("quickstart")))[0].study


def of_study(case: CaseResult, study: Study) -> CaseResult:
    return dataclasses.replace(case, study=study)


def case_of(errors: Mapping[str, float], **changes: object) -> CaseResult:
    given = {"label": "nu = 0.49", "reference_error": {f"gci:{VECTOR}": 0.01}, "subdivisions": 0}
    return of_study(make_case(errors, **(given | changes)), STUDY)  # type: ignore[arg-type]


CASE = case_of(ERRORS)
BASE = gate.baseline_of(make_run([CASE]))


def findings(*cases: CaseResult, was: gate.Baseline = BASE) -> list[Finding]:
    return compare(make_run(cases), was)


def one(case: CaseResult, metric: str = VECTOR, was: gate.Baseline = BASE) -> Finding:
    """What became of a metric of vdm-vector."""
    return of_vector(findings(case, was=was), metric)


def of_vector(found: list[Finding], metric: str = VECTOR) -> Finding:
    """The one of vdm-vector."""
    return next(f for f in found if (f.model, f.metric) == ("vdm-vector", metric))


def test_the_same_run_is_unchanged_to_the_last_metric() -> None:
    same = findings(CASE)
    assert set(counts(same)) == {gate.SAME}
    assert len(same) > 20
    assert not gate.regressed(same)
    assert gate.why_not_passed(same) == ""
    gated = {metric for values in BASE.cases["nu = 0.49"].values.values() for metric in values}
    assert gated >= {VECTOR, DRIFT, gate.OWN + VECTOR}
    assert not gated & {"mean_strain", "contact_work", "seconds_setup", "seconds_per_step", "peak_bytes"}


@pytest.mark.parametrize(
    ("metric", "was", "now", "outcome"),
    [
        (VECTOR, 0.2, 0.2039, gate.SAME),  # 2 %
        (VECTOR, 0.2, 0.2041, gate.WORSE),
        (VECTOR, 0.2, 0.1959, gate.BETTER),
        (VECTOR, 1e-5, 9e-4, gate.SAME),  # 0.1 percentage points
        ("hausdorff_distance", 10e-6, 10.9e-6, gate.SAME),  # a micrometre
        ("hausdorff_distance", 10e-6, 11.1e-6, gate.WORSE),
        (DRIFT, 1e-13, -9e-10, gate.SAME),  # rounding of what is conserved
        (DRIFT, 1e-13, -1e-8, gate.WORSE),
        (DRIFT, 0.05, 0.0495, gate.SAME),
        (DRIFT, 0.05, -0.05, gate.WORSE),  # the sign
        (DRIFT, 0.05, -0.04, gate.WORSE),
        (VECTOR, 0.2, float("nan"), gate.NEWLY_FAILING),
        (VECTOR, float("nan"), 0.2, gate.NEWLY_PASSING),
        (VECTOR, float("nan"), float("nan"), gate.STILL_FAILING),
    ],
)
def test_what_counts_as_worse(metric: str, was: float, now: float, outcome: str) -> None:
    then = gate.baseline_of(make_run([of_metric(CASE, "vdm-vector", metric, was)]))
    found = one(of_metric(CASE, "vdm-vector", metric, now), metric, then)
    assert found.outcome == outcome
    assert gate.regressed([found]) == (outcome in gate.REGRESSED)
    assert ("not one number" in gate.why_not_passed([found])) == (outcome == gate.STILL_FAILING)


def test_a_metric_without_a_value_beside_an_answer_is_no_failure_and_a_missing_answer_says_so() -> None:
    """Right after accept, gate said "still failing: vdm-vector / indentation_force_error" of an answer."""
    undefined = of_metric(CASE, "vdm-vector", "hausdorff_distance", math.nan)
    then = gate.baseline_of(make_run([undefined]))
    assert one(undefined, "hausdorff_distance", then).outcome == gate.SAME
    lost = of_metric(undefined, "vdm-vector", VECTOR, math.nan)
    then = gate.baseline_of(make_run([lost]))
    found = one(lost, "hausdorff_distance", then)
    assert (found.outcome, found.why) == (gate.STILL_FAILING, "no answer, and the baseline has none")


def test_only_full_load_counts_and_the_reference_s_own_error_too() -> None:
    values = CASE.metrics["vdm-vector"][VECTOR].copy()
    values[0] = 5.0
    assert one(of_metric(CASE, "vdm-vector", VECTOR, values)).outcome == gate.SAME
    own = findings(dataclasses.replace(CASE, reference_error={f"gci:{VECTOR}": 0.02}))
    (worse,) = (f for f in own if f.outcome != gate.SAME)
    assert (worse.outcome, worse.model, worse.metric) == (gate.WORSE, "fem-linear", gate.OWN + VECTOR)


VERSIONS: dict[str, Callable[[CaseResult], CaseResult]] = {
    "model version 1 -> 2": lambda case: of_model(case, "vdm-vector", version="2"),
    "reference version 1 -> 2": lambda case: of_model(case, "fem-linear", version="2"),
    f"metric version {METRICS[VECTOR].version} -> 7": lambda case: case,
}


@pytest.mark.parametrize("why", VERSIONS)
def test_a_new_version_does_not_hide_what_is_worse(why: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a version that was raised a worse error fails, and one that is no worse passes; both say so."""
    if why.startswith("metric"):
        monkeypatch.setitem(METRICS, VECTOR, dataclasses.replace(METRICS[VECTOR], version=7))
    for error, outcome in {2.0: gate.WORSE, 0.2: gate.SAME, 0.02: gate.BETTER}.items():
        found = findings(VERSIONS[why](case_of({**ERRORS, "vdm-vector": error})))
        assert (of_vector(found).outcome, of_vector(found).why) == (outcome, why)
        assert gate.regressed(found) == (outcome == gate.WORSE)
        assert gate.why_not_passed(found) == ""


TISSUE = {"tissue": STUDY.tissue.model_copy(update={"youngs_modulus": 3000.0})}


@pytest.mark.parametrize(
    ("now", "why"),
    [
        (of_study(CASE, STUDY.model_copy(update=TISSUE)), "tissue.youngs_modulus was 5000.0, is 3000.0"),
        (dataclasses.replace(CASE, reference="vdm-paper"), "study.reference was fem-linear, is vdm-paper"),
        (dataclasses.replace(CASE, reference=None), "study.reference was fem-linear, is none"),
    ],
)
def test_what_cannot_be_compared_names_what_changed_and_does_not_pass(now: CaseResult, why: str) -> None:
    (found,) = findings(now)
    assert (found.outcome, found.why) == (gate.NOT_COMPARABLE, why)
    assert "not one number" in gate.why_not_passed([found], allow_missing=True)
    same = dataclasses.replace(CASE, label="another", hash="another")
    both = findings(now, same, was=gate.baseline_of(make_run([CASE, same])))
    assert not gate.regressed(both)
    assert "--allow-missing" in gate.why_not_passed(both)
    assert gate.why_not_passed(both, allow_missing=True) == ""


def test_an_error_against_a_measurement_counts_at_the_step_that_was_measured() -> None:
    """Markers seen at half of the load are no failure at full load; an answer that no longer gets there is one."""
    half = CASE.load_factors.tolist().index(0.5)
    marker = Quantity("tips", "tip", "z", half, 0.01, 1e-4, 0.0)

    def seen(*errors: float) -> CaseResult:
        values = np.array([*errors, *[np.nan] * (len(CASE.load_factors) - len(errors))])
        metrics = {name: {**found, gate.MEASURED: values} for name, found in CASE.metrics.items()}
        said = dict.fromkeys(CASE.models, 0.01 + values[[half]])
        return dataclasses.replace(CASE, metrics=metrics, measurement=Measurement([marker], said, said))

    assert half == 1
    was = gate.baseline_of(make_run([seen(np.nan, 1e-3)]))
    assert one(seen(np.nan, 2e-3), gate.MEASURED, was).outcome == gate.WORSE
    assert one(seen(1e-4, np.nan), gate.MEASURED, was).outcome == gate.NEWLY_FAILING


def test_inputs_are_named_by_key_and_names_lists_and_folders_are_none() -> None:
    sweep = [
        of_study(dataclasses.replace(CASE, label=f"{E}", hash=f"{E}"), _stiff(E)) for E in (1e3, 2e3, 3e3)
    ]
    was = gate.baseline_of(make_run(sweep))
    assert was.cases["1000.0"].inputs == {}
    assert was.cases["3000.0"].inputs == {"tissue.youngs_modulus": 3e3}
    assert was.inputs["constraints.finger.force"] == 0.1
    assert not {"study.title", "sweep.mode", "acceptance.frame_time"} & was.inputs.keys()
    sweep[2] = dataclasses.replace(sweep[1], label="3000.0", hash="c")
    told = [f.why for f in findings(*sweep, was=was) if f.outcome == gate.NOT_COMPARABLE]
    assert told == ["tissue.youngs_modulus was 3000.0, is 2000.0"]


def _stiff(modulus: float) -> Study:
    return STUDY.model_copy(update={"tissue": STUDY.tissue.model_copy(update={"youngs_modulus": modulus})})


def test_more_and_less_than_the_baseline() -> None:
    def changed(run: Run) -> list[tuple[str, str]]:
        return [(f.outcome, f.model or f.case) for f in compare(run, BASE) if f.outcome != gate.SAME]

    run = make_run([CASE])
    assert changed(make_run([case_of({"vdm-vector": 0.2})])) == [(gate.MISSING, "vdm-paper")]
    assert changed(make_run([case_of(ERRORS | {"new": 0.1})])) == [(gate.NEW, "new")]
    assert changed(dataclasses.replace(run, missing=["nu = 0.3"])) == [(gate.MISSING, "nu = 0.3")]
    failed = [{"hash": "a", "label": "nu = 0.49", "code": "crashed", "message": "it died", "remedy": ""}]
    (died,) = compare(dataclasses.replace(run, cases=[], failed=failed), BASE)
    assert (died.outcome, died.why) == (gate.NEWLY_FAILING, "it died")
    with pytest.raises(BaselineError, match="of study 'ball', the run of 'cube'"):
        compare(make_run([CASE], name="cube"), BASE)


def test_a_case_that_is_named_otherwise_is_the_same_case() -> None:
    """Labels told lengths in m once; a baseline of then was "the run has no such case"."""
    swept = [of_study(dataclasses.replace(CASE, label=f"{E}", hash=f"{E}"), _stiff(E)) for E in (1e3, 2e3)]
    was = gate.baseline_of(make_run(swept))
    now = [dataclasses.replace(case, label=f"E = {case.label}") for case in swept]
    assert set(counts(findings(*now, was=was))) == {gate.SAME}
    assert gate.MISSING in counts(findings(now[0], was=was))


def test_accepting_needs_a_reason_a_whole_run_and_a_place_that_is_a_baseline_s(tmp_path: Path) -> None:
    run, path = make_run([CASE]), tmp_path / "b.json"
    for broken, reason, message in (
        (run, "  ", "needs a reason"),
        (dataclasses.replace(run, missing=["x"]), "x", "finish the run"),
        (dataclasses.replace(run, cases=[]), "x", "finish the run"),
    ):
        with pytest.raises(BaselineError, match=message):
            accept(broken, path, reason)
    assert not path.exists()
    path.write_text('{"a thesis": 1}')
    with pytest.raises(BaselineError, match="is no baseline and stays"):
        accept(run, path, "x")
    assert path.read_text() == '{"a thesis": 1}'
    path.write_text('{"schema": 1, "study": "ball", "cases": {}}')
    with pytest.raises(BaselineError, match="made by an older version; accept again"):
        read_baseline(path)
    accept(run, path, "first numbers")
    assert set(counts(compare(run, read_baseline(path)))) == {gate.SAME}


@pytest.mark.parametrize(
    ("content", "error", "message"),
    [
        (b"\xff\xfe", StoreError, "not a baseline"),
        (b"[" * 100_000, StoreError, "not a baseline"),
        (b"[]", StoreError, "not a baseline"),
        (b'{"schema": 2, "study": 3, "cases": {}}', StoreError, "'study' is not of type str"),
        (b'{"schema": 99, "study": "a", "cases": {}}', BaselineError, "newer than this program"),
    ],
)
def test_what_is_no_baseline(tmp_path: Path, content: bytes, error: type[Exception], message: str) -> None:
    (tmp_path / "b.json").write_bytes(content)
    with pytest.raises(error, match=message):
        read_baseline(tmp_path / "b.json")


def test_junit_and_markdown() -> None:
    found = findings(of_model(case_of({**ERRORS, "vdm-vector": 0.3}), "vdm-paper", version="2"))
    found.append(Finding(gate.NEW, "a | case", "", "", why="the baseline has no such case"))
    root = ElementTree.fromstring(gate.junit("ba<ll\x00", found))
    (suite,) = root
    failures = suite.findall("testcase/failure")
    assert len(suite) == int(suite.attrib["tests"]) == len(found)
    assert len(failures) == int(suite.attrib["failures"]) == counts(found)[gate.WORSE]
    assert len(suite.findall("testcase/skipped")) == int(suite.attrib["skipped"]) == 1
    assert "0.2 -> 0.3 (tolerance 0.004)" in "".join(f.attrib["message"] for f in failures)
    text = gate.markdown("ball", "first", found)
    assert f"| worse | nu = 0.49 | vdm-vector | {VECTOR} | 0.2 | 0.3 | 0.004 |  |" in text
    assert "a \\| case" in text


def test_the_commands_and_their_exit_codes(tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(SMALL_STUDY)
    assert vdmbench("run", "small.toml", cwd=tmp_path).returncode == 0
    run, baseline = "results/runs/small", tmp_path / "results/baselines/small.json"

    def gated(*words: str | Path) -> tuple[int, str]:
        done = vdmbench("gate", run, *words, cwd=tmp_path)
        return done.returncode, done.stdout + done.stderr

    code, told = gated("--junit", "none.xml")
    assert (code, "vdmbench accept DIR" in told) == (6, True)
    assert ElementTree.parse(tmp_path / "none.xml").getroot()[0].attrib["tests"] == "1"
    assert gated("--baseline", "nowhere.json")[0] == 2
    assert vdmbench("accept", run, cwd=tmp_path).returncode == 2
    assert vdmbench("accept", run, "--reason", "first", cwd=tmp_path).returncode == 0
    code, told = gated("--junit", "out.xml", "--markdown", "out.md")
    assert (code, "first" in told) == (0, True)
    assert "first" in (tmp_path / "out.md").read_text()

    whole = baseline.read_text()
    for spoil, expected, word in (
        (lambda d: _case(d)["values"]["vdm-paper"].update({VECTOR: 0.01}), 1, "worse"),
        (lambda d: d["models"].update({"vdm-paper": "0"}), 0, "model version 0"),
        (lambda d: d["inputs"].update({"tissue.youngs_modulus": 1.0}), 6, "tissue.youngs_modulus was 1.0"),
        (lambda d: _case(d)["values"].update({"gone": {}}), 6, "--allow-missing"),
        (lambda d: d.update(study="elsewhere"), 2, "of study 'elsewhere'"),
        (lambda d: d.update(cases={}), 6, "not one number"),
        (lambda d: d.update(metrics=1), 5, "accept again"),
    ):
        data = json.loads(whole)
        spoil(data)
        baseline.write_text(json.dumps(data))
        code, told = gated()
        assert (code, word in told) == (expected, True), told
        assert gated("--allow-missing")[0] == (0 if word == "--allow-missing" else expected)
    baseline.write_text(whole)
    next((tmp_path / run / "cases").iterdir()).unlink()
    code, told = gated("--junit", "out.xml")
    assert (code, "the run has not got to it" in told) == (6, True)
    assert 'failures="1"' in (tmp_path / "out.xml").read_text()


def _case(data: dict[str, dict[str, dict[str, dict[str, float]]]]) -> dict[str, dict[str, float]]:
    (case,) = data["cases"].values()
    return case


# --- runs side by side ---


@pytest.fixture
def beside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Four runs that are read by their directories' names."""
    worse = {"vdm-paper": 0.4, "vdm-vector": 0.02, "bem": 0.05}
    first = {"vdm-paper": 0.2, "vdm-vector": 0.1, "bem": 0.05}
    found = {
        "first": case_of(first),
        "second": case_of(worse, stopped={"bem": 3}),
        "third": of_study(case_of(first), _stiff(1e3)),
        "fourth": case_of({"vdm-paper": 0.2, "vdm": 0.1}),
    }
    for name in found:
        (tmp_path / name / "cases").mkdir(parents=True)
    monkeypatch.setattr("vdmbench.store.cases.read_run", lambda path: make_run([found[path.name]]))
    return [str(tmp_path / name) for name in found]


def test_json_has_every_metric_and_the_findings(
    beside: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert do(parse(["compare", *beside[:2], "--json"])) == 0
    told = json.loads(capsys.readouterr().out)
    row = next(row for row in told["rows"] if (row["metric"], row["model"]) == ("hausdorff_distance", "bem"))
    assert row["outcomes"] == ["first", "newly failing"]
    assert row["values"][0] > 0
    assert row["values"][1] is None
    assert row["bars"] == [None, None], "the reference's own error was not measured in it"
    assert {finding["outcome"] for finding in told["findings"][0]} >= {"worse", "better", "newly failing"}
    with pytest.raises(ValueError, match="give 2 to 26 different run directories, not 1"):
        do(parse(["compare", beside[0], f"{beside[0]}/."]))


def test_a_number_beside_another_has_the_bar_of_the_reference_of_its_case(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    low, high = (
        case_of({"bem": 0.05}),
        case_of({"bem": 0.07}, reference_error={f"gci:{VECTOR}": 0.02}, label="far"),
    )
    for name in ("a", "b"):
        (tmp_path / name / "cases").mkdir(parents=True)
    monkeypatch.setattr(
        "vdmbench.store.cases.read_run", lambda path: make_run([low, high] if path.name == "a" else [low])
    )
    assert do(parse(["compare", str(tmp_path / "a"), str(tmp_path / "b")])) == 0
    told = capsys.readouterr().out
    assert re.search(r"bem +7\.00 % ± 2\.00 % +5\.00 % ± 1\.00 %", told)


def test_the_verdict_of_a_family_is_gated() -> None:
    """As accepted, worse, better, and under other limits; a baseline of before has none."""
    good, bad = (
        case_of({"vdm-vector": 0.05, "vdm-paper": 0.8}),
        case_of({"vdm-vector": 0.2, "vdm-paper": 0.8}),
    )
    accepted = gate.baseline_of(make_run([good]))
    assert accepted.verdicts == {"vdm-printed": "no", "vdm-derived": "yes"}

    def words(case: CaseResult, was: gate.Baseline) -> dict[str, tuple[str, str]]:
        found = [finding for finding in findings(case, was=was) if finding.metric == gate.VERDICT]
        return {finding.model: (finding.outcome, finding.why) for finding in found}

    assert words(good, accepted) == {"vdm-printed": (gate.SAME, ""), "vdm-derived": (gate.SAME, "")}
    assert words(bad, accepted)["vdm-derived"] == (gate.WORSE, "yes -> no")
    assert words(good, gate.baseline_of(make_run([bad])))["vdm-derived"] == (gate.BETTER, "no -> yes")
    other = dataclasses.replace(accepted, acceptance=accepted.acceptance | {"displacement_error": 0.3})
    assert words(good, other)[""] == (gate.NOT_COMPARABLE, "acceptance: displacement_error was 0.3, is 0.1")
    assert words(bad, dataclasses.replace(accepted, verdicts={})) == {}
