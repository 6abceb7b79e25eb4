"""Runs beside each other: each model's worst value of each metric, held against the first run's case by case."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from ..measures.case import Run
from ..measures.metrics import DEFORMATION, VECTOR
from ..verdict.formatting import of_unit, plural
from .gate import (
    BETTER,
    MISSING,
    NEW,
    NEWLY_FAILING,
    NEWLY_PASSING,
    NOT_COMPARABLE,
    OUTCOMES,
    SAME,
    WORSE,
    CaseEntry,
    Entry,
    Finding,
    case_entries,
    compare_cases,
    counts,
)

# what is shown whether it has changed or not; of the others what has
HEADLINE = {
    VECTOR: "displacement error",
    DEFORMATION: "error in change of shape",
    "max_nodal_error": "largest difference at a node",
    "volume_drift": "volume drift",
}
_CHANGED = {WORSE, BETTER, NEWLY_FAILING, NEWLY_PASSING}
FIRST = "first"  # outcome of the run that the others are held against
MARKS = {
    WORSE: "worse",
    NEWLY_FAILING: "fails",
    NOT_COMPARABLE: "?",
    MISSING: "gone",
    BETTER: "better",
    NEWLY_PASSING: "passes",
    NEW: "new",
    SAME: "",
    FIRST: "",
}
WIDTH = 80
_NAME, _RUN = 24, 18  # letters of a model, and at least of a run's column


@dataclass(frozen=True)
class Row:
    """One model and metric: of each run the worst value of its cases (NaN where it has none), and what became."""

    metric: str
    model: str
    unit: str
    values: tuple[float, ...]
    outcomes: tuple[str, ...]


@dataclass(frozen=True)
class SideBySide:
    """The names of the runs, a row for each metric and model, and what was found of each run but the first."""

    names: tuple[str, ...]
    rows: tuple[Row, ...]
    findings: tuple[tuple[Finding, ...], ...]


def side_by_side(runs: Mapping[str, Run]) -> SideBySide:
    """Hold runs, by their names, against the first of them."""
    entries = [case_entries(run) for run in runs.values()]
    findings = [tuple(compare_cases(run, entries[0], "A")) for run in list(runs.values())[1:]]
    keys: dict[tuple[str, str], str] = {}
    for cases in entries:
        for case in cases.values():
            for model, entry in case.models.items():
                for metric, value in entry.metrics.items():
                    keys.setdefault((metric, model), value.unit)
    metrics = list(dict.fromkeys(metric for metric, _ in keys))
    rows = [
        Row(
            metric,
            model,
            unit,
            tuple(_worst(cases, model, metric) for cases in entries),
            (FIRST, *(_outcome(found, model, metric) for found in findings)),
        )
        for (metric, model), unit in sorted(keys.items(), key=lambda item: metrics.index(item[0][0]))
    ]
    return SideBySide(tuple(runs), tuple(rows), tuple(findings))


def _worst(cases: Mapping[str, CaseEntry], model: str, metric: str) -> float:
    found = [
        _value(case.models[model].metrics.get(metric)) for case in cases.values() if model in case.models
    ]
    return max((value for value in found if not math.isnan(value)), key=abs, default=math.nan)


def _value(entry: Entry | None) -> float:
    return math.nan if entry is None or entry.value is None else entry.value


def _outcome(findings: Sequence[Finding], model: str, metric: str) -> str:
    """The worst that is said of a model's metric, by itself or with its whole case."""
    said = {f.outcome for f in findings if f.model in ("", model) and f.metric in ("", metric)}
    return next((outcome for outcome in OUTCOMES if outcome in said), SAME)


def as_text(found: SideBySide) -> Iterator[str]:
    """Lines of at most 80 letters: a block for each metric, a row for each model, a column for each run."""
    letters = dict(zip(found.names, "ABCDEFGHIJKLMNOPQRSTUVWXYZ", strict=False))
    for name, letter in letters.items():
        yield f"{letter}  {name}"[:WIDTH]
    yield "at full load, the worst of all cases; held against A case by case"
    columns = max(1, (WIDTH - _NAME) // _RUN)
    changed = {row.metric for row in found.rows if _CHANGED & {*row.outcomes}}
    for metric in dict.fromkeys(row.metric for row in found.rows):
        if metric not in HEADLINE and metric not in changed:
            continue
        rows = [row for row in found.rows if row.metric == metric]
        for start in range(0, len(found.names), columns):
            shown = range(start, min(start + columns, len(found.names)))
            yield ""
            yield HEADLINE.get(metric, metric.replace("_", " "))
            yield (" " * _NAME + "".join(f"{letters[found.names[k]]:<{_RUN}}" for k in shown)).rstrip()
            for row in rows:
                cells = (f"{of_unit(row.values[k], row.unit)} {MARKS[row.outcomes[k]]}" for k in shown)
                yield (
                    f"{_short(row.model):<{_NAME}}" + "".join(f"{cell:<{_RUN}}" for cell in cells)
                ).rstrip()
    yield ""
    for name, findings in zip(found.names[1:], found.findings, strict=True):
        told = ", ".join(f"{number} {outcome}" for outcome, number in counts(findings).items())
        yield f"{letters[name]} against A: {told or 'nothing to compare'}"
        why = dict.fromkeys(finding.why for finding in findings if finding.why)
        yield from (f"   {reason}"[:WIDTH] for reason in list(why)[:3])
        if len(why) > 3:
            yield f"   and {plural(len(why) - 3, 'other reason')}; all by --json"


def _short(name: str) -> str:
    return name if len(name) < _NAME else f"{name[: _NAME - 2]}…"
