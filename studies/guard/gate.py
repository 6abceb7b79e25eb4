"""Accuracy baselines: what a study's metrics were when somebody accepted them, and what has become of them.

A baseline holds, for each case, model and metric, the value at full load with a tolerance, and says why it was
accepted. Only sizes are gated: an error or a drift that shrinks is better, one that grows is worse. Times, memory
and descriptive metrics (`vdmbench.measures.metrics.Sense`) are not in it.
"""

from __future__ import annotations

import hashlib
import json
import math
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

from pydantic import ConfigDict, Field

from ..machine.files import write_atomically
from ..machine.safe_open import UnfitFileError, read_regular
from ..machine.stored_json import Shape, parsed, sealed, unsealed
from ..measures.case import CaseResult, MetricSeries, Run
from ..measures.metrics import METRICS, Metric, Sense, full_load_step
from ..store.hdf5 import StoreError
from ..study.config import resolved
from ..study.kinds import safe_name

SCHEMA = 1
SEALED_AS = "baseline"  # and not by its file's name: a baseline may be copied to another
MAX_BYTES = 50_000_000
RELATIVE = 0.02  # of a value: another BLAS, another core count and another order of sums move it by far less
# what counts as no change whatever the value, by unit: 0.1 percentage points, a micrometre
ABSOLUTE = {"1": 1e-3, "m": 1e-6}
CONSERVED = 1e-9  # of what is conserved: a deviation is judged by its own size, down to where it is rounding
ONLY_CASE = "the only case"  # what the case of a study without a sweep is called
OWN = "own error: "  # before the name of a metric in which the reference's own error was measured

WORSE, BETTER, SAME = "worse", "better", "unchanged"
NEWLY_FAILING, NEWLY_PASSING = "newly failing", "newly passing"
NOT_COMPARABLE, MISSING, NEW = "not comparable", "missing", "new"
OUTCOMES = (WORSE, NEWLY_FAILING, NOT_COMPARABLE, MISSING, BETTER, NEWLY_PASSING, NEW, SAME)
REGRESSED = (WORSE, NEWLY_FAILING)
_COMPARED = (WORSE, BETTER, SAME, NEWLY_FAILING, NEWLY_PASSING)


class BaselineError(ValueError):
    """A baseline that cannot be read, written or used; the message says which and what to do."""


class _Stored(Shape):
    model_config = ConfigDict(extra="forbid", frozen=True)


_Number = Annotated[float, Field(allow_inf_nan=False)]


class Entry(_Stored):
    """One accepted metric at full load; `value` is None where the model had none."""

    value: _Number | None
    tolerance: Annotated[float, Field(ge=0, allow_inf_nan=False)]
    unit: str
    version: int


class ModelEntry(_Stored):
    """The accepted metrics of one model, by name."""

    version: str
    metrics: dict[str, Entry]


class CaseEntry(_Stored):
    """One accepted case; `inputs` is the SHA-256 of its resolved inputs, `reference` one of its models or None."""

    inputs: str
    reference: str | None
    models: dict[str, ModelEntry]


class _Version(Shape):
    schema_version: int = Field(alias="schema", ge=1)


class Baseline(_Version, _Stored):
    """What was accepted of a study, when and why; cases by their label."""

    study: str
    reason: str
    date: str
    cases: dict[str, CaseEntry]
    seal: str = ""  # that of the file, which `vdmbench.machine.stored_json` makes and holds against it


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


# --- what is compared ---


def _entries(case: CaseResult, model: str) -> Iterator[tuple[str, Entry]]:
    """The gated metrics of one model in one case."""
    step = full_load_step(case.load_factors)
    for name, series in case.metrics.get(model, {}).items():
        if sense_of(name) != "descriptive":
            value = float(series.values[step])
            yield name, _entry(name, value, series.unit, series.version)
    if model == case.reference:
        # of the unit and version in which the run measured it, or would have where it has no other model
        kinds: dict[str, Metric | MetricSeries] = {**METRICS}
        for found in case.metrics.values():
            kinds |= found
        for key, value in sorted(case.reference_error.items()):
            name = key.removeprefix("gci:")
            if name != key and name in kinds:
                yield OWN + name, _entry(name, float(value), kinds[name].unit, kinds[name].version)


def sense_of(name: str) -> Sense:
    """What a metric declares that its size tells; of one that this program no longer has, an error."""
    return METRICS[name].sense if name in METRICS else "error"


def _entry(name: str, value: float, unit: str, version: int) -> Entry:
    absolute = CONSERVED if sense_of(name) == "conserved" else ABSOLUTE.get(unit, 0.0)
    if not math.isfinite(value):
        return Entry(value=None, tolerance=absolute, unit=unit, version=version)
    tolerance = max(RELATIVE * abs(value), absolute)
    return Entry(value=_rounded(value), tolerance=_rounded(tolerance), unit=unit, version=version)


def _rounded(value: float) -> float:
    """To six digits: more of them differ from machine to machine."""
    return float(f"{value:.6g}")


def _inputs(case: CaseResult) -> str:
    """SHA-256 of what the case was asked, without the study's names and lists."""
    own = {
        key: value
        for key, value in resolved(case.study).items()
        if key not in ("study", "sweep", "calibration", "acceptance", "inputs")
    }
    if isinstance(geometry := own.get("geometry"), Mapping) and "path" in geometry:
        own["geometry"] = {**geometry, "path": Path(str(geometry["path"])).name}
    return hashlib.sha256(json.dumps(own, sort_keys=True).encode()).hexdigest()


def case_entries(run: Run) -> dict[str, CaseEntry]:
    """What a baseline would hold of a run, by the labels of its cases."""
    return {
        case.label or ONLY_CASE: CaseEntry(
            inputs=_inputs(case),
            reference=case.reference,
            models={
                name: ModelEntry(version=result.version, metrics=dict(_entries(case, name)))
                for name, result in case.models.items()
            },
        )
        for case in run.cases
    }


# --- baselines on disk ---


def baseline_path(results: Path, study: str) -> Path:
    """Where the baseline of a study is kept. Raises ValueError where the name would lead elsewhere."""
    return results / "baselines" / f"{safe_name(study)}.json"


def no_baseline(path: Path) -> str:
    """What is wrong, and what to do, where a study has no baseline."""
    return f"{path}: no such baseline; make one with: vdmbench accept DIR --reason TEXT"


def not_comparable(why: str) -> Finding:
    """What there is to say of a study where nothing can be compared."""
    return Finding(NOT_COMPARABLE, "baseline", "", "", why=why)


def read_baseline(path: Path) -> Baseline:
    """Read and validate a baseline.

    Raises
    ------
    BaselineError
        no such file, or of a newer schema.
    StoreError
        not a baseline, or changed since it was accepted.
    """
    again = f"vdmbench accept DIR --reason TEXT --baseline {shlex.quote(str(path))}"
    if not path.exists():
        raise BaselineError(f"{no_baseline(path)} --baseline {shlex.quote(str(path))}")
    try:
        raw = read_regular(path, MAX_BYTES)
    except (UnfitFileError, IsADirectoryError, NotADirectoryError) as error:
        raise BaselineError(f"{path}: {error.strerror}") from None
    try:
        schema = parsed(raw, _Version)["schema"]
        found = Baseline.model_validate(unsealed(raw, SEALED_AS, Baseline)) if schema <= SCHEMA else None
    except ValueError as error:
        raise StoreError(f"{path}: not a baseline ({error}); restore it, or accept again: {again}") from None
    if found is None:
        raise BaselineError(f"{path}: schema {schema} is newer than this program's {SCHEMA}; update vdmbench")
    return found


def accept(run: Run, path: Path, reason: str) -> Baseline:
    """Write a run's metrics as the baseline.

    Raises
    ------
    BaselineError
        no reason, cases that failed or are missing, metrics of another version, or nothing to accept.
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
    if stale := _stale_metric(run):
        raise BaselineError(f"{stale} is of another version in this run: run the study again, then accept")
    baseline = Baseline(
        schema=SCHEMA,
        study=run.study.study.name,
        reason=reason.strip(),
        date=datetime.now(UTC).date().isoformat(),
        cases=case_entries(run),
    )
    write_atomically(path, sealed(baseline.model_dump(by_alias=True), SEALED_AS) + b"\n")
    return baseline


def _stale_metric(run: Run) -> str | None:
    """A metric that this program computes otherwise than the run did."""
    for case in run.cases:
        for entries in case.metrics.values():
            for name, series in entries.items():
                if name not in METRICS or series.version != METRICS[name].version:
                    return name
    return None


# --- the comparison ---


def compare(run: Run, baseline: Baseline) -> list[Finding]:
    """Every metric of the run beside the baseline's.

    Raises
    ------
    BaselineError
        a baseline of another study.
    """
    name = run.study.study.name
    if baseline.study != name:
        raise BaselineError(f"the baseline is of study {baseline.study!r}, the run of {name!r}")
    return compare_cases(run, baseline.cases)


def compare_cases(run: Run, before: Mapping[str, CaseEntry], whose: str = "the baseline") -> list[Finding]:
    """Every metric of the run beside those of accepted cases, or of another run's, called `whose`."""
    name, now = run.study.study.name, case_entries(run)
    # a failure is labelled for people: in a study of one case by the study's name
    failed = {
        ONLY_CASE if failure["label"] == name else failure["label"]: failure["message"]
        for failure in run.failed
    }
    unfinished = {label or ONLY_CASE for label in run.missing}
    findings: list[Finding] = []
    for label, was in before.items():
        if label in now:
            findings += _compare_case(label, was, now[label], whose)
        elif label in failed:
            findings.append(Finding(NEWLY_FAILING, label, "", "", why=failed[label]))
        else:
            why = "the run has not got to it" if label in unfinished else "the run has no such case"
            findings.append(Finding(MISSING, label, "", "", why=why))
    for label in sorted(unfinished - before.keys()):
        findings.append(Finding(MISSING, label, "", "", why="the run has not got to it"))
    for label in (*now, *failed):
        if label not in before:
            state = f", and it failed: {failed[label]}" if label in failed else ""
            findings.append(Finding(NEW, label, "", "", why=f"{whose} has no such case{state}"))
    return findings


def _compare_case(label: str, was: CaseEntry, now: CaseEntry, whose: str) -> Iterator[Finding]:
    if was.inputs != now.inputs:
        yield Finding(NOT_COMPARABLE, label, "", "", why="the inputs of the case have changed")
        return
    if (old_reference := _reference(was)) != (new_reference := _reference(now)):
        why = f"the reference has changed: {old_reference} -> {new_reference}"
        yield Finding(NOT_COMPARABLE, label, "", "", why=why)
        return
    for model, old in was.models.items():
        new = now.models.get(model)
        if new is None:
            yield Finding(MISSING, label, model, "", why="the run has no such model")
        elif new.version != old.version:
            why = f"model version {old.version} -> {new.version}"
            yield Finding(NOT_COMPARABLE, label, model, "", why=why)
        else:
            for metric, entry in old.metrics.items():
                yield _compare_metric(label, model, metric, entry, new.metrics.get(metric))
            for metric in sorted(new.metrics.keys() - old.metrics.keys()):
                yield Finding(NEW, label, model, metric, why=f"{whose} has no such metric")
    for model in sorted(now.models.keys() - was.models.keys()):
        yield Finding(NEW, label, model, "", why=f"{whose} has no such model")


def _reference(case: CaseEntry) -> str:
    """What the models were measured against, with its version: all their errors move with it."""
    if case.reference is None:
        return "none"
    model = case.models.get(case.reference)
    return f"{case.reference} of version {model.version if model else 'unknown'}"


def _compare_metric(label: str, model: str, metric: str, was: Entry, now: Entry | None) -> Finding:
    if now is None:
        return Finding(MISSING, label, model, metric, why="the run has no such metric")
    if (was.unit, was.version) != (now.unit, now.version):
        why = (
            f"metric version {was.version} -> {now.version}"
            if was.unit == now.unit
            else f"unit {was.unit} -> {now.unit}"
        )
        return Finding(NOT_COMPARABLE, label, model, metric, why=why)
    old, new = (math.nan if entry.value is None else entry.value for entry in (was, now))
    if math.isnan(old) or math.isnan(new):
        outcome = (
            SAME
            if math.isnan(old) and math.isnan(new)
            else NEWLY_FAILING
            if math.isnan(new)
            else NEWLY_PASSING
        )
    else:
        growth = abs(new) - abs(old)
        outcome = WORSE if growth > was.tolerance else BETTER if growth < -was.tolerance else SAME
    return Finding(outcome, label, model, metric, old, new, was.tolerance, was.unit)


def counts(findings: Sequence[Finding]) -> dict[str, int]:
    """How many findings of each outcome there are, the worst first."""
    found = Counter(finding.outcome for finding in findings)
    return {outcome: found[outcome] for outcome in OUTCOMES if found[outcome]}


def regressed(findings: Sequence[Finding]) -> bool:
    """Whether anything got worse or newly fails."""
    return any(finding.outcome in REGRESSED for finding in findings)


def is_incomplete(findings: Sequence[Finding]) -> bool:
    """Whether the run lacks a case, a model or a metric that it should have."""
    return any(finding.outcome == MISSING for finding in findings)


def nothing_compared(findings: Sequence[Finding]) -> bool:
    """Whether not one number could be held against another."""
    return not any(finding.outcome in _COMPARED for finding in findings)
