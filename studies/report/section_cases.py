"""Every case in a table, and the cases that failed, each with what to do about it."""

from __future__ import annotations

import math

from ..measures.bars import at_full_load, reference_bar
from ..measures.case import CaseResult
from ..measures.metrics import DEFORMATION, VECTOR
from ..verdict.digest import Digest, failed_steps
from ..verdict.formatting import NOTHING, listed, parameter_name, percent, plural, swept_value
from .blocks import Block, Cell, Column, Section, Table, Text

_OPEN_ROWS = 12
_MOST_CELLS = 9000  # of the page; the rest is in metrics.csv


def case_table(digest: Digest) -> Section | None:
    """One row per finished case, the worst of the focus model first."""
    if not digest.cases:
        return None
    keys = digest.swept_keys
    units = {
        key: next((c.swept_units.get(key, "1") for c in digest.cases if key in c.swept), "1") for key in keys
    }
    columns = [Column("Case", numeric=False)]
    for key in keys:
        texts = any(isinstance(case.swept.get(key), str) for case in digest.cases)
        unit = "" if texts or units[key] == "1" else units[key]
        columns.append(Column(parameter_name(key), numeric=not texts, unit=unit))
    columns.append(Column("Nodes"))
    for model in digest.compared:
        columns.append(Column(model, "displacement", unit="1"))
        columns.append(Column(model, "deformation", unit="1"))
    if digest.compared:
        columns += [Column("Reference's own", detail, unit="1") for detail in ("displacement", "deformation")]
    roles = {case.hash: role for role, case in digest.key_cases if role}
    ranked = sorted(digest.cases, key=lambda case: _rank(digest, case))
    most = max(_OPEN_ROWS, _MOST_CELLS // len(columns))
    rows = [_row(digest, case, keys, units, roles.get(case.hash, "")) for case in ranked[:most]]
    blocks: list[Block] = [Table("cases", "", columns, rows, open_rows=_OPEN_ROWS)]
    note = "Errors at full load."
    if len(digest.cases) > 1 and digest.focus and digest.compared:
        note += f" The largest displacement error of {digest.focus} comes first."
    if len(rows) < len(ranked):
        note += f" Only the first {len(rows)} of {len(ranked)} are listed, to keep the page small."
    return Section("cases", "Cases", [Text(note, kind="note"), *blocks])


def _rank(digest: Digest, case: CaseResult) -> float:
    value = at_full_load(case, digest.focus or "", VECTOR)
    return -abs(value) if math.isfinite(value) else -math.inf


def _row(digest: Digest, case: CaseResult, keys: list[str], units: dict[str, str], role: str) -> list[Cell]:
    row = [Cell(case.hash[:8] if keys else digest.case_name(case), role)]
    for key in keys:
        value = case.swept.get(key)
        if value is None:
            row.append(Cell(NOTHING))
        elif isinstance(value, str):
            row.append(Cell(value))
        else:
            row.append(Cell(swept_value(value, units[key]), value=float(value)))
    row.append(Cell(str(len(case.points)), value=float(len(case.points))))
    for model in digest.compared:
        row += [_error(case, model, VECTOR), _error(case, model, DEFORMATION)]
    if digest.compared:
        row += [_own_error(reference_bar(case, metric)) for metric in (VECTOR, DEFORMATION)]
    return row


def _own_error(bar: float) -> Cell:
    return Cell(f"± {percent(bar)}" if math.isfinite(bar) else "not measured", value=bar, tone="muted")


def _error(case: CaseResult, model: str, metric: str) -> Cell:
    value = at_full_load(case, model, metric)
    if math.isfinite(value):
        return Cell(percent(value), value=value)
    result = case.models.get(model)
    if result is not None and failed_steps(result):
        return Cell("failed", tone="bad")
    return Cell(NOTHING, tone="muted")


def failures(digest: Digest) -> Section | None:
    """Cases without a result, models that stopped short, and steps that need care, each with reason and remedy."""
    blocks: list[Block] = []
    if digest.run.failed:
        rows = [
            [
                Cell(entry["label"] or entry["hash"][:8], entry["code"]),
                Cell(entry["message"]),
                Cell(entry["remedy"] or NOTHING),
            ]
            for entry in digest.run.failed
        ]
        blocks.append(Table("failed", "Cases that failed", _failure_columns("Case"), rows))
    if stopped := stopped_models(digest):
        rows = [
            [Cell(m, place), Cell(message), Cell(remedy or NOTHING)] for m, place, message, remedy in stopped
        ]
        columns = _failure_columns("Model and case")
        blocks.append(Table("stopped", "Models that stopped in a finished case", columns, rows))
    if rows := _reservations(digest):
        columns = _failure_columns("Model and case")
        blocks.append(Table("reserved", "Results that their model warns about", columns, rows))
    if digest.run.missing:
        names = [label or "a case" for label in digest.run.missing]
        shown = names if len(names) <= 8 else [*names[:7], f"{len(names) - 7} more"]
        text = f"{plural(len(names), 'case')} not run yet: {listed(shown)}."
        blocks.append(Text(f"{text} Run the study again to do what is missing."))
    return Section("failures", "What failed or is missing", blocks) if blocks else None


def _failure_columns(first: str) -> list[Column]:
    return [Column(title, numeric=False) for title in (first, "What happened", "What to do")]


def stopped_models(digest: Digest) -> list[tuple[str, str, str, str]]:
    """Model, where it stopped in a finished case and how often, why, and what to do: once for each reason."""
    found: dict[tuple[str, str, str], list[tuple[CaseResult, int]]] = {}
    for case in digest.cases:
        for model, result in case.models.items():
            for step in failed_steps(result)[:1]:
                status = result.status[step]
                reason = (model, status.message or status.code, status.remedy)
                found.setdefault(reason, []).append((case, step))
    return [
        (model, _places(digest, places), message, remedy)
        for (model, message, remedy), places in found.items()
    ]


def _reservations(digest: Digest) -> list[list[Cell]]:
    """One row per model and remedy: of steps that can be used, with a message; the last such step of a case."""
    found: dict[tuple[str, str], list[tuple[CaseResult, int]]] = {}
    for case in digest.cases:
        for model, result in case.models.items():
            noted = [step for step, status in enumerate(result.status) if status.ok and status.message]
            if noted:
                found.setdefault((model, result.status[noted[-1]].remedy), []).append((case, noted[-1]))
    rows = []
    for (model, remedy), places in found.items():
        case, step = places[0]
        message = case.models[model].status[step].message
        rows.append([Cell(model, _places(digest, places)), Cell(message), Cell(remedy or NOTHING)])
    return rows


def _places(digest: Digest, places: list[tuple[CaseResult, int]]) -> str:
    case, step = places[0]
    where = f"{digest.case_name(case)}, load factor {float(case.load_factors[step]):g}"
    if len(places) > 1:
        where += f", and in {plural(len(places) - 1, 'other case')}"
    return where
