"""Every case in a table, and the cases that failed, each with what to do about it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from ..measures.bars import reference_bar, where_reached
from ..measures.case import CaseResult
from ..measures.metrics import DEFORMATION, VECTOR
from ..study.registry import Family
from ..verdict.digest import Digest, failed_steps
from ..verdict.formatting import first_of, parameter_name, percent, plural, swept_value
from ..verdict.verdict import Verdict, verdicts
from ..verdict.words import TITLES
from .blocks import Block, Cell, Field, Section, Text, frame_table

_OPEN_ROWS = 12
_MOST_CELLS = 9000  # of the page; the rest is in metrics.csv
_ERRORS = ((VECTOR, "displacement"), (DEFORMATION, "deformation"))


def case_table(digest: Digest) -> Section | None:
    """One row per finished case, the worst of the focus model first."""
    if not digest.cases:
        return None
    roles = {case.hash: role for role, case in digest.key_cases if role}
    fields = [
        Field(
            "Case",
            lambda case: Cell(
                case.hash[:8] if digest.swept_keys else digest.case_name(case), roles.get(case.hash, "")
            ),
        ),
        *(_swept(digest, key) for key in digest.swept_keys),
        Field("Nodes", lambda case: Cell(str(len(case.points)), value=float(len(case.points))), "#"),
        *(
            Field(model, _error(digest, model, metric), "1", what)
            for model in digest.compared
            for metric, what in _ERRORS
        ),
    ]
    fields += [_word(one) for one in verdicts(digest).asked if one.model]
    if digest.compared:
        fields += [Field("Reference's own", _own_error(metric), "1", what) for metric, what in _ERRORS]
    sizes = digest.full_loads(digest.focus or "", VECTOR)
    order = sorted(range(len(sizes)), key=lambda k: -abs(sizes[k]) if math.isfinite(sizes[k]) else -math.inf)
    ranked = [digest.cases[k] for k in order]
    rows = ranked[: max(_OPEN_ROWS, _MOST_CELLS // len(fields))]
    note = "Errors at full load."
    if digest.unreached:
        note += " Where the reference ends before, at the load factor that stands beside them."
    if len(digest.cases) > 1 and digest.focus and digest.compared:
        note += f" The largest displacement error of {digest.focus} comes first."
    if len(rows) < len(ranked):
        note += f" Only the first {len(rows)} of {len(ranked)} are listed, to keep the page small."
    table = frame_table(rows, fields, "cases", open_rows=_OPEN_ROWS)
    return Section("cases", "Cases", [Text(note, kind="note"), table])


def _swept(digest: Digest, key: str) -> Field:
    """The column of a swept key."""
    unit = digest.unit(key)
    texts = any(isinstance(case.swept.get(key), str) for case in digest.cases)

    def value(case: CaseResult) -> Cell | str | None:
        found = case.swept.get(key)
        if found is None or isinstance(found, str):
            return found
        return Cell(swept_value(found, unit), value=float(found))

    return Field(parameter_name(key), value, "" if texts else "#" if unit == "1" else unit)


def _word(one: Verdict) -> Field:
    """The column of a family's words."""
    return Field(
        TITLES[Family(one.family)], lambda case: one.states[case.hash], detail=f"{one.model}, within limits?"
    )


def _own_error(metric: str) -> Callable[[CaseResult], Cell]:
    def of(case: CaseResult) -> Cell:
        bar = reference_bar(case, metric)
        return Cell(f"± {percent(bar)}" if math.isfinite(bar) else "not measured", value=bar, tone="muted")

    return of


def _error(digest: Digest, model: str, metric: str) -> Callable[[CaseResult], Cell | None]:
    def of(case: CaseResult) -> Cell | None:
        value, result = digest.at(case, model, metric), case.models.get(model)
        if math.isfinite(value):
            return Cell(percent(value), value=value)
        if case.reached != case.full_load and math.isfinite(value := where_reached(case, model, metric)):
            factor = float(case.load_factors[case.reached])
            return Cell(f"{percent(value)} at {factor:.3g}", value=value)
        return Cell("failed", tone="bad") if result is not None and failed_steps(result) else None

    return of


# --- what failed ---


class Stopped(NamedTuple):
    """What a model, or a case, says: of which step first and how often, and what to do."""

    model: str
    where: str
    message: str
    remedy: str


def failures(digest: Digest) -> Section | None:
    """Cases without a result and models that stopped short, each with reason and remedy."""
    blocks: list[Block] = []
    failed = [
        Stopped(one["label"] or one["hash"][:8], one["code"], one["message"], one["remedy"])
        for one in digest.run.failed
    ]
    for name, caption, first, rows in (
        ("failed", "Cases that failed", "Case", failed),
        ("stopped", "Models that stopped in a finished case", "Model and case", stopped_models(digest)),
    ):
        fields = [
            Field(first, lambda row: Cell(row.model, row.where)),
            Field("What happened", lambda row: row.message),
            Field("What to do", lambda row: row.remedy),
        ]
        if rows:
            blocks.append(frame_table(rows, fields, name, caption=caption))
    if digest.run.missing:
        names = [label or "a case" for label in digest.run.missing]
        text = f"{plural(len(names), 'case')} not run yet: {first_of(names, 7)}."
        blocks.append(Text(f"{text} Run the study again to do what is missing."))
    return Section("failures", "What failed or is missing", blocks) if blocks else None


def stopped_models(digest: Digest) -> list[Stopped]:
    """Of each model the first step that failed: once for each reason."""
    found: dict[tuple[str, str, str], list[str]] = {}
    for case in digest.cases:
        for model, result in case.models.items():
            for step in failed_steps(result)[:1]:
                status, factor = result.status[step], float(case.load_factors[step])
                reason = (model, status.message or status.code, status.remedy)
                found.setdefault(reason, []).append(f"{digest.case_name(case)}, load factor {factor:g}")
    return [
        Stopped(
            model,
            places[0] + (f", and in {plural(len(places) - 1, 'other case')}" if len(places) > 1 else ""),
            message,
            remedy,
        )
        for (model, message, remedy), places in found.items()
    ]
