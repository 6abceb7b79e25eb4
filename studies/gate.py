"""The accuracy gate. In: a run and its baseline, or runs. Out: what is worse, better, missing or not comparable.

A baseline holds the value of each case, model and metric at full load, the verdict of each family, the inputs of
the cases, the versions of models and metrics, and the reason why it was accepted. Only absolute values are gated:
an error that grows is worse, one that shrinks is better. Words are compared likewise. Times, memory and
descriptive metrics (`vdmbench.measures.metrics.Sense`) are not gated.
"""

from __future__ import annotations

import json
import math
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from .machine import json_text, write_atomically
from .measures.case import CaseResult, Run
from .measures.metrics import METRICS, VECTOR, Sense, measurement_error
from .measures.uncertainty import SIGNED
from .store.plain import StoreError, typed
from .study.kinds import Enters, safe_name
from .study.measured import AXES
from .verdict.acceptance import WORDS
from .verdict.digest import digest_of
from .verdict.verdict import verdicts

SCHEMA = 2  # in 1 the inputs were a digest, which could not show what had changed
RELATIVE = 0.02  # of a value: another BLAS, core count or order of sums changes it far less
ABSOLUTE = {
    "1": 1e-3,
    "m": 1e-6,
}  # differences below these count as unchanged, by unit: 0.1 percentage points, a micrometre
CONSERVED = 1e-9  # least tolerance of a conserved quantity: its deviation is compared down to rounding
MEASURED = measurement_error.__name__
ONLY_CASE = "the only case"  # label of the case of a study without a sweep
VERDICT = "verdict"  # in place of a metric, of a family in place of a model
OWN = "own error: "  # before the name of a metric in which the reference's own error was measured
_SHOWN = 3  # changed inputs that are named

WORSE, BETTER, SAME = "worse", "better", "unchanged"
NEWLY_FAILING, NEWLY_PASSING, STILL_FAILING = "newly failing", "newly passing", "still failing"
NOT_COMPARABLE, MISSING, NEW = "not comparable", "missing", "new"
REGRESSED, INCOMPLETE = (WORSE, NEWLY_FAILING), (NOT_COMPARABLE, MISSING)
OUTCOMES = (*REGRESSED, *INCOMPLETE, BETTER, NEWLY_PASSING, NEW, STILL_FAILING, SAME)
_COMPARED = (WORSE, BETTER, SAME, NEWLY_FAILING, NEWLY_PASSING)
_SKIPPED = (NOT_COMPARABLE, MISSING, NEW, STILL_FAILING)


class BaselineError(ValueError):
    """A baseline that cannot be read, written or used; the message says which and what to do."""


@dataclass(frozen=True)
class Measure:
    """A metric as it was accepted; its unit is "1" where it has none."""

    unit: str
    version: int


@dataclass(frozen=True)
class Entry:
    """One accepted case: inputs that differ from the baseline's, None if not given; model -> metric -> value.

    A value is None where the model had none.
    """

    inputs: dict[str, Any]
    reference: str | None
    values: Mapping[str, Mapping[str, float | None]]


@dataclass(frozen=True, kw_only=True)
class Baseline:
    """The accepted values of a study, with date and reason; `inputs` by their keys (SI), cases by their labels.

    `verdicts` holds the word of each family under the limits of `acceptance`; older baselines have none.
    """

    schema: int = SCHEMA
    study: str
    reason: str = ""
    date: str = ""
    inputs: dict[str, Any]
    models: dict[str, str]
    metrics: dict[str, Measure]
    acceptance: dict[str, Any] = field(default_factory=dict)
    verdicts: dict[str, str] = field(default_factory=dict)
    cases: dict[str, Entry]

    def inputs_of(self, case: str) -> dict[str, Any]:
        """The inputs of a case, by key."""
        whole = self.inputs | self.cases[case].inputs
        return {key: value for key, value in whole.items() if value is not None}


@dataclass(frozen=True)
class Finding:
    """One comparison. `was` and `now` are NaN where there is no number."""

    outcome: str
    case: str
    model: str
    metric: str
    was: float = math.nan
    now: float = math.nan
    tolerance: float = math.nan
    unit: str = "1"
    why: str = ""


# --- the baseline of a run ---


def baseline_of(run: Run, reason: str = "") -> Baseline:
    """The baseline of a run: every gated metric at full load, or against a measurement if there is one."""
    values: dict[str, dict[str, dict[str, float | None]]] = {
        case.hash: {name: {} for name in case.models} for case in run.cases
    }
    digest = digest_of(run)
    names = [name for name in METRICS if sense_of(name) != "descriptive" and name != MEASURED]
    last = {  # step of a case at which points were measured
        case.hash: max((one.step for one in case.measurement.quantities if one.component in AXES), default=-1)
        for case in run.cases
        if case.measurement is not None
    }
    table = digest.table
    gated = table["full_load"] & table["metric"].isin(names)
    measured = (table["metric"] == MEASURED) & (table["step"] == table["case"].map(last))
    rows = table.loc[gated | measured, ["case", "model", "metric", "value"]]
    for case, model, metric, value in rows.itertuples(index=False):
        values[case][model][metric] = _rounded(value)
    asked = {case.hash: asked_of(case) for case in run.cases}
    common = next(iter(asked.values()), {})
    for case in run.cases:
        if case.reference is not None and case.reached == case.full_load:
            for key, value in sorted(case.reference_error.items()):
                metric = key.removeprefix("gci:")
                if metric != key and metric in METRICS:
                    values[case.hash][case.reference][OWN + metric] = _rounded(value)
    return Baseline(
        study=run.study.study.name,
        reason=reason,
        date=datetime.now(UTC).date().isoformat(),
        inputs=common,
        models={name: result.version for case in run.cases for name, result in case.models.items()},
        metrics={name: Measure(unit=one.unit, version=one.version) for name, one in METRICS.items()},
        acceptance=run.study.acceptance.model_dump(mode="json"),
        verdicts={one.family: one.word for one in verdicts(digest).asked},
        cases={
            case.label or ONLY_CASE: Entry(
                inputs={key: asked[case.hash].get(key) for key in _changed(common, asked[case.hash])},
                reference=case.reference,
                values=values[case.hash],
            )
            for case in run.cases
        },
    )


def asked_of(case: CaseResult) -> dict[str, Any]:
    """The inputs that decide a case's numbers, by key, without names, lists and defaults; a file by its name."""
    given = case.study.model_dump(mode="json", exclude_defaults=True, exclude={"study", "inputs"})
    found = dict(_leaves(case.study.without(given, Enters.NOTHING)))
    if "geometry.path" in found:
        found["geometry.path"] = Path(found["geometry.path"]).name
    return found


def _leaves(tables: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Key -> value of nested tables; items of a list of tables go by their name, else by their number from 1."""
    for key, value in tables.items():
        if isinstance(value, list) and value and all(isinstance(part, dict) for part in value):
            named = {str(part.get("name") or k): part for k, part in enumerate(value, start=1)}
            yield from _leaves(named, f"{before}{key}.")
        elif isinstance(value, dict) and value:
            yield from _leaves(value, f"{before}{key}.")
        elif value is not None:
            yield f"{before}{key}", value


def _changed(was: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    return [key for key in dict.fromkeys((*was, *now)) if was.get(key) != now.get(key)]


def sense_of(name: str) -> Sense:
    """The sense of a metric; "error" for one that this program no longer has."""
    return METRICS[name].sense if name in METRICS else "error"


def _rounded(value: float) -> float | None:
    """To six digits, as further ones differ between machines; None for no number."""
    return float(f"{value:.6g}") if math.isfinite(value) else None


def _tolerance(metric: str, unit: str, value: float) -> float:
    """Largest difference from an accepted value that counts as unchanged."""
    least = CONSERVED if sense_of(metric) == "conserved" else ABSOLUTE.get(unit, 0.0)
    return max(RELATIVE * abs(value), least)


# --- baselines on disk ---


def baseline_path(results: Path, study: str) -> Path:
    """Path of a study's baseline. Raises ValueError for a name that is unsafe in a path."""
    return results / "baselines" / f"{safe_name(study)}.json"


def no_baseline(path: Path) -> str:
    """The message for a study without a baseline, with the remedy."""
    return f"{path}: no such baseline; make one with: vdmbench accept DIR --reason TEXT"


def read_baseline(path: Path) -> Baseline:
    """Read and validate a baseline.

    Raises
    ------
    BaselineError
        no such file, or one of another version of this program.
    StoreError
        not a baseline.
    """
    again = f"vdmbench accept DIR --reason TEXT --baseline {shlex.quote(str(path))}"
    if not path.exists():
        raise BaselineError(f"{no_baseline(path)} --baseline {shlex.quote(str(path))}")
    found = _loaded(path)
    if found is None:
        raise StoreError(f"{path}: not a baseline; restore it, or delete it and accept again: {again}")
    if found["schema"] < SCHEMA:
        raise BaselineError(f"{path}: made by an older version; accept again: {again}")
    if found["schema"] > SCHEMA:
        told = f"schema {found['schema']} is newer than this program's {SCHEMA}; update vdmbench"
        raise BaselineError(f"{path}: {told}")
    try:
        return typed(Baseline, found)
    except ValueError as error:
        raise StoreError(f"{path}: not a baseline ({error}); restore it, or accept again: {again}") from None


def _loaded(path: Path) -> dict[str, Any] | None:
    """A baseline of any version as plain data; None if the file is none."""
    try:
        found = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) and isinstance(found.get("schema"), int) else None


def accept(run: Run, path: Path, reason: str) -> Baseline:
    """Write a run's metrics as the baseline.

    Raises
    ------
    BaselineError
        no reason, cases that failed or are missing, nothing to accept, or another file in the baseline's place.
    OSError
        disk full or read-only.
    """
    if not reason.strip():
        raise BaselineError(
            "an accepted baseline needs a reason; say why the numbers are right: --reason TEXT"
        )
    if run.failed or run.missing or not run.cases:
        raise BaselineError(
            f"{len(run.failed)} cases failed and {len(run.missing)} are missing: finish the run before "
            f"accepting it"
        )
    if path.exists() and _loaded(path) is None:
        raise BaselineError(f"{path}: is no baseline and stays as it is; name another file, or delete it")
    baseline = baseline_of(run, reason.strip())
    write_atomically(path, json_text(baseline, indent=1).encode() + b"\n")
    return baseline


# --- the comparison ---


def compare(run: Run, was: Baseline, whose: str = "the baseline") -> list[Finding]:
    """Every metric of the run beside the baseline's, or beside those of another run, called `whose`.

    Raises
    ------
    BaselineError
        a baseline of another study.
    """
    now, name = baseline_of(run), run.study.study.name
    if whose == "the baseline" and was.study != name:
        raise BaselineError(f"the baseline is of study {was.study!r}, the run of {name!r}")
    was = _named_as(was, now)
    # the label of a failure is for people: in a study of one case it is the study's name
    failed = {
        ONLY_CASE if failure["label"] == name else failure["label"]: failure["message"]
        for failure in run.failed
    }
    unfinished = {label or ONLY_CASE for label in run.missing}
    findings: list[Finding] = []
    for label in was.cases:
        if label in now.cases:
            findings += _compare_case(label, was, now, whose)
        elif label in failed:
            findings.append(Finding(NEWLY_FAILING, label, "", "", why=failed[label]))
        else:
            why = "the run has not got to it" if label in unfinished else "the run has no such case"
            findings.append(Finding(MISSING, label, "", "", why=why))
    for label in sorted(unfinished - was.cases.keys()):
        findings.append(Finding(MISSING, label, "", "", why="the run has not got to it"))
    for label in (*now.cases, *failed):
        if label not in was.cases:
            state = f", and it failed: {failed[label]}" if label in failed else ""
            findings.append(Finding(NEW, label, "", "", why=f"{whose} has no such case{state}"))
    # at least one number of the same case and model must be compared: words alone do not count
    if all(f.metric for f in findings) and any(f.outcome in _COMPARED for f in findings):
        findings += _compare_verdicts(was, now)
    return findings


def _named_as(was: Baseline, now: Baseline) -> Baseline:
    """The baseline, its cases named as those of the run with the same inputs: older labels told lengths in m."""
    gone, new = was.cases.keys() - now.cases.keys(), now.cases.keys() - was.cases.keys()
    names = {old: one for old in gone for one in new if was.inputs_of(old) == now.inputs_of(one)}
    return replace(was, cases={names.get(label, label): entry for label, entry in was.cases.items()})


def _compare_verdicts(was: Baseline, now: Baseline) -> Iterator[Finding]:
    """The word of each family beside the accepted one, under the same limits; nothing without an accepted word."""
    if was.verdicts and was.acceptance != now.acceptance:
        why = _inputs_changed(was.acceptance, now.acceptance)
        yield Finding(NOT_COMPARABLE, "", "", VERDICT, why=f"acceptance: {why}")
        return
    for family, word in was.verdicts.items():
        here = now.verdicts.get(family)
        if here is None:
            yield Finding(MISSING, "", family, VERDICT, why="the run has no model of this family")
            continue
        worse = WORDS.index(here) - WORDS.index(word)
        outcome = WORSE if worse > 0 else BETTER if worse < 0 else SAME
        yield Finding(outcome, "", family, VERDICT, why="" if here == word else f"{word} -> {here}")


def _compare_case(label: str, was: Baseline, now: Baseline, whose: str) -> Iterator[Finding]:
    before, after = was.cases[label], now.cases[label]
    if why := _inputs_changed(was.inputs_of(label), now.inputs_of(label)):
        yield Finding(NOT_COMPARABLE, label, "", "", why=why)
        return
    if before.reference != after.reference:
        why = f"study.reference was {before.reference or 'none'}, is {after.reference or 'none'}"
        yield Finding(NOT_COMPARABLE, label, "", "", why=why)
        return
    for model, values in before.values.items():
        if model not in after.values:
            yield Finding(MISSING, label, model, "", why="the run has no such model")
            continue
        own = after.values[model]
        versions = [
            f"{what} version {old} -> {new}"
            for what, name in (("model", model), ("reference", before.reference or model))
            if (old := was.models[name]) != (new := now.models[name])
        ][:1]
        for metric, value in values.items():
            if metric not in own:
                yield Finding(MISSING, label, model, metric, why="the run has no such metric")
                continue
            name = metric.removeprefix(OWN)
            then, here = was.metrics[name], now.metrics[name]
            if then.unit != here.unit:
                why = f"unit {then.unit} -> {here.unit}"
                yield Finding(NOT_COMPARABLE, label, model, metric, why=why)
                continue
            changed = (
                [f"metric version {then.version} -> {here.version}"] if then.version != here.version else []
            )
            found = _compare_value(label, model, metric, (value, own[metric]), then.unit, versions + changed)
            if found.outcome == STILL_FAILING and None not in (values.get(VECTOR), own.get(VECTOR)):
                found = replace(found, outcome=SAME)  # the model answers; this metric has no value here
            elif found.outcome == STILL_FAILING:
                why = f"no answer, and {whose} has none"
                found = replace(found, why="; ".join(filter(None, [found.why, why])))
            yield found
        for metric in sorted(own.keys() - values.keys()):
            yield Finding(NEW, label, model, metric, why=f"{whose} has no such metric")
    for model in sorted(after.values.keys() - before.values.keys()):
        yield Finding(NEW, label, model, "", why=f"{whose} has no such model")


def _inputs_changed(was: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """The inputs that differ, with both values; "" if none does."""
    changed = _changed(was, now)
    told = [f"{key} was {was.get(key, 'not given')}, is {now.get(key, 'not given')}" for key in changed]
    return "; ".join(told[:_SHOWN]) + (f"; {len(told) - _SHOWN} more" if len(told) > _SHOWN else "")


def _compare_value(
    label: str,
    model: str,
    metric: str,
    values: tuple[float | None, float | None],
    unit: str,
    changed: Sequence[str],
) -> Finding:
    """One number beside the accepted one; a finding for another version of model or metric says so."""
    old, new = (math.nan if value is None else value for value in values)
    tolerance = _tolerance(metric.removeprefix(OWN), unit, 0.0 if math.isnan(old) else old)
    said = list(changed)
    if math.isnan(new):
        outcome = STILL_FAILING if math.isnan(old) else NEWLY_FAILING
    elif math.isnan(old):
        outcome = NEWLY_PASSING
    elif metric in SIGNED and old * new < 0 and min(abs(old), abs(new)) > tolerance:
        outcome = WORSE
        said.append("the sign has changed")
    else:
        growth = abs(new) - abs(old)
        outcome = WORSE if growth > tolerance else BETTER if growth < -tolerance else SAME
    return Finding(outcome, label, model, metric, old, new, tolerance, unit, "; ".join(said))


def counts(findings: Sequence[Finding]) -> dict[str, int]:
    """How many findings of each outcome there are, the worst first."""
    found = Counter(finding.outcome for finding in findings)
    return {outcome: found[outcome] for outcome in OUTCOMES if found[outcome]}


def regressed(findings: Sequence[Finding]) -> bool:
    """Whether anything got worse or newly fails."""
    return any(finding.outcome in REGRESSED for finding in findings)


def why_not_passed(findings: Sequence[Finding], *, allow_missing: bool = False) -> str:
    """Why findings do not pass although none is a regression; "" if they pass."""
    if not any(finding.outcome in _COMPARED for finding in findings):
        return "not one number could be held against another"
    if allow_missing or not any(finding.outcome in INCOMPLETE for finding in findings):
        return ""
    return (
        "parts are missing or not comparable: finish the run, accept it as the new baseline, or let them be by "
        "--allow-missing"
    )


# --- findings as text ---


def describe(finding: Finding) -> str:
    """One finding in a line."""
    place = " / ".join(part for part in (finding.case, finding.model, finding.metric) if part)
    parts = [f"{finding.outcome}: {place}"]
    if not (math.isnan(finding.was) and math.isnan(finding.now)):
        unit = "" if finding.unit == "1" else f" {finding.unit}"
        was, now, tolerance = (_number(v) or "none" for v in (finding.was, finding.now, finding.tolerance))
        parts.append(f"{was}{unit} -> {now}{unit} (tolerance {tolerance}{unit})")
    return ": ".join([*parts, *filter(None, [finding.why])])


def summary(findings: Sequence[Finding]) -> str:
    """The counts in one line."""
    return ", ".join(f"{count} {outcome}" for outcome, count in counts(findings).items()) or "nothing"


def junit(study: str, findings: Sequence[Finding], *, allow_missing: bool = False) -> bytes:
    """JUnit XML: one test case per finding.

    A regression is a failure; so is a missing or not comparable value, unless allowed.
    """
    failures = REGRESSED if allow_missing else (*REGRESSED, *INCOMPLETE)
    skipped = tuple(outcome for outcome in _SKIPPED if outcome not in failures)
    suite = ElementTree.Element(
        "testsuite",
        name=_clean(f"accuracy of {study}"),
        tests=str(len(findings)),
        failures=str(sum(f.outcome in failures for f in findings)),
        skipped=str(sum(f.outcome in skipped for f in findings)),
        errors="0",
    )
    for finding in findings:
        model = ".".join(part for part in (study, finding.model) if part)
        name = ": ".join(part for part in (finding.case, finding.metric) if part)
        case = ElementTree.SubElement(suite, "testcase", classname=_clean(model), name=_clean(name))
        if finding.outcome in failures or finding.outcome in skipped:
            kind = "failure" if finding.outcome in failures else "skipped"
            ElementTree.SubElement(case, kind, message=_clean(describe(finding)))
    root = ElementTree.Element("testsuites")
    root.append(suite)
    out: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return out


def markdown(study: str, told: str, findings: Sequence[Finding]) -> str:
    """A summary with a table of all changed findings; `told` is a sentence on the baseline."""
    text = f"# Accuracy of {_cell(study)}\n\n{summary(findings)}. {_cell(told)}\n"
    changed = [finding for finding in findings if finding.outcome != SAME]
    if changed:
        text += "\n| outcome | case | model | metric | was | is | tolerance | why |\n" + "| --- " * 8 + "|\n"
    for finding in changed:
        cells = [finding.outcome, finding.case, finding.model, finding.metric]
        cells += [_number(value) for value in (finding.was, finding.now, finding.tolerance)]
        text += f"| {' | '.join(_cell(cell) for cell in (*cells, finding.why))} |\n"
    return text


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.4g}"


def _cell(text: str) -> str:
    return _clean(text).replace("\\", "\\\\").replace("|", "\\|").replace("<", "&lt;").replace("\n", " ")


def _clean(text: str) -> str:
    """Without the characters that XML 1.0 cannot hold."""
    return "".join(c if c.isprintable() or c in "\n\t" else "\N{REPLACEMENT CHARACTER}" for c in text)
