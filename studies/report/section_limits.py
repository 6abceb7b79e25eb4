"""The small-strain limits: up to which load small strain, and each model, hold against finite strain."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import starmap

from ..measures.case import CaseResult, Limit, ModelLimits
from ..measures.limits import LARGEST, MOST_STRAIN
from ..measures.uncertainty import is_resolved
from ..verdict.digest import Digest
from ..verdict.formatting import NOT_MEASURED, NOTHING, listed, percent, quantity, short_percent
from .blocks import Block, Cell, Column, Section, Table, Text

LINEAR = "fem-linear"  # whose growth limit is the linearisation limit
PAPER_STRAIN = 0.10  # "small deformations and small strains (< 10 %)"
_WHY = {
    "unresolved": "unresolved: a finer mesh does not bear it out",
    "beyond": "not reached",
    "model-stopped": "the model has no solution beyond",
    "reference-stopped": "the reference has no solution beyond",
}


@dataclass(frozen=True)
class _Row:
    """One model's limit at one threshold in one case."""

    case: CaseResult
    model: str
    entry: ModelLimits
    unit: str
    limit: Limit


def small_strain_limits(digest: Digest) -> Section | None:
    """Structural error and growth limits per model and case, and how they compare with the paper's 10 % strain."""
    rows = list(_rows(digest.cases))
    if not rows:
        return None
    found = [case.small_strain for case in digest.cases if case.small_strain is not None]
    raised = listed(sorted({"every load, in proportion" if one.unit == "1" else one.along for one in found}))
    blocks: list[Block] = [Text(sentence) for sentence in limits_in_words(digest)]
    reading = (
        f"Raised: {raised}. Structural error: relative L2 displacement error against the "
        "finite-strain reference in the limit of a small load. Limit: where the error has grown from there by the "
        f"threshold; of {LINEAR} this is the linearisation limit, where small-strain theory departs from finite "
        "strain on the same mesh. Indentation (mean displacement along the contact force, weighted by it) and "
        "largest principal Green-Lagrange strain are the reference's at that load; the largest strain is a local "
        "one, at the rim of the contact or of the support. Figures with a bar are those of a mesh with every "
        "tetrahedron split into eight, and bars follow from what that changes: in a limit's load, and, at the same "
        "load, in indentation and strain, whose bars count the load's in. A load's bar is relative, all others are "
        "in the unit of their figure. A limit that the case's mesh has and the finer mesh has not is unresolved, "
        f"with the figures of the case's mesh. A search ends at {LARGEST:g} times the study's load, and at a "
        f"largest strain of {short_percent(MOST_STRAIN)}: no soft tissue bears to be three times as long."
    )
    return Section(
        "limits", "Small-strain limits", [*blocks, _table(digest, rows), Text(reading, kind="note")]
    )


def limits_in_words(digest: Digest) -> list[str]:
    """What the limits say of the focus model and of small-strain theory, for the top of the page."""
    rows = list(_rows(digest.cases))
    return [sentence for sentence in (_growth(digest, rows), _against_the_paper(rows)) if sentence]


def is_measured(limit: Limit) -> bool:
    """Whether some mesh has the limit."""
    return limit.state in ("found", "unresolved")


def strain_side(limit: Limit) -> int:
    """Where a limit's strain lies of the paper's bound: -1 below, 1 above, 0 where that is unresolved.

    A bar that was not measured counts as none, one that straddles the bound as unresolved.
    """
    if limit.state == "unresolved":
        return 0
    low, high = strain_range(limit)
    return 1 if low >= PAPER_STRAIN else -1 if high < PAPER_STRAIN else 0


def strain_range(limit: Limit) -> tuple[float, float]:
    """The ends of a limit's bar of strain."""
    half = limit.strain * limit.strain_bar if math.isfinite(limit.strain_bar) else 0.0
    return limit.strain - half, limit.strain + half


def strain_in_words(limit: Limit) -> str:
    """A limit's strain with its bar where that was measured."""
    return _with_bar(limit.strain, limit.strain * limit.strain_bar)


def _rows(cases: Iterable[CaseResult]) -> Iterator[_Row]:
    for case in cases:
        if case.small_strain is None:
            continue
        for model, entry in case.small_strain.models.items():
            for limit in entry.limits:
                yield _Row(case, model, entry, case.small_strain.unit, limit)


def _against_the_paper(rows: list[_Row]) -> str:
    found, denied = (
        [row for row in rows if row.model == LINEAR and row.limit.state == state]
        for state in ("found", "unresolved")
    )
    theory = f"small-strain theory ({LINEAR}) departs from finite strain"
    if not found:
        return f"Where {theory} is unresolved: a finer mesh does not bear it out." if denied else ""
    parts = []
    for threshold in sorted({row.limit.threshold for row in found}):
        mine = [row.limit for row in found if row.limit.threshold == threshold]
        ends = [min(mine, key=lambda limit: limit.strain), max(mine, key=lambda limit: limit.strain)]
        parts.append(
            f"{short_percent(threshold)} at a largest principal strain of {_span(map(strain_in_words, ends))}"
        )
    sides = [strain_side(row.limit) for row in found]
    below, open_ = sides.count(-1), sides.count(0)
    bound = f"the paper's bound of {short_percent(PAPER_STRAIN)} strain"
    told = [f"{below} of these {len(found)} limits lie below {bound}"] if below else []
    told += (
        [f"of {open_} of these {len(found)} it is unresolved on which side of {bound} they lie"]
        if open_
        else []
    )
    told = told or [f"all of these lie above {bound}"]
    told += [f"a finer mesh does not bear out {len(denied)} more, unresolved"] if denied else []
    verdict = listed(told)
    return f"S{theory[1:]} by {listed(parts)}. {verdict[0].upper()}{verdict[1:]}."


def _growth(digest: Digest, rows: list[_Row]) -> str:
    """One sentence on the model that the page looks at closely, at the smallest threshold.

    Every number is of the finest mesh there is, or says that it is not.
    """
    own = [row for row in rows if row.model == digest.focus and math.isfinite(row.entry.structural_error)]
    if not own or digest.focus == LINEAR:
        return ""
    errors = sorted((row.entry.structural_error, row.entry.structural_bar) for row in own)
    text = (
        f"{digest.focus} is {_span(starmap(_with_bar, (errors[0], errors[-1])))} off already at small loads"
    )
    threshold = min(row.limit.threshold for row in own)
    asked = [row for row in own if row.limit.threshold == threshold]
    finer = any(math.isfinite(row.entry.structural_bar) for row in own)
    coarse = " on the case's own mesh" if finer else ""
    more = f"{short_percent(threshold)} more come on top by"
    no_more = f"that does not grow by {short_percent(threshold)} up to"
    for state, before, after in (
        ("found", more, ""),
        ("unresolved", more, f"{coarse}, which a finer mesh does not bear out: unresolved"),
        ("beyond", no_more, f"{coarse}, as far as was looked"),
        ("model-stopped", no_more, f"{coarse}, where its solver stops"),
        ("reference-stopped", no_more, f"{coarse}, where the reference stops"),
    ):
        if some := [row for row in asked if row.limit.state == state]:
            text += f"; {before} {_loads_in_words(some, len(asked))}{after}"
    (first, *others) = asked
    if others or first.limit.state != "found":
        return f"{text}."
    if math.isfinite(first.limit.indentation):
        depth, bar = first.limit.indentation, first.limit.indentation_bar
        text += f" ({quantity(depth, 'm')}"
        text += f" ± {quantity(abs(depth) * bar, 'm')}" if math.isfinite(bar) else ""
        text += " of mean indentation)"
    total = first.entry.structural_error + threshold
    return f"{text}, where it is {_with_bar(total, first.entry.structural_bar)} off."


def _loads_in_words(some: list[_Row], asked: int) -> str:
    """The loads of some limits with their bars, from least to most, and of how many of the cases they are."""
    ends = sorted(some, key=lambda row: abs(row.limit.load))
    loads = []
    for row in (ends[0], ends[-1]):
        bar = f" ± {short_percent(row.limit.bar)}" if math.isfinite(row.limit.bar) else ""
        times = " times the study's loads" if row.unit == "1" else ""
        loads.append(f"{quantity(row.limit.load, row.unit)}{times}{bar}")
    return _span(loads) + (f" in {len(some)} of {asked} cases" if len(some) < asked else "")


def _span(ends: Iterable[str]) -> str:
    """`low to high`, one of them where they look alike."""
    return " to ".join(dict.fromkeys(ends))


def _with_bar(share: float, bar: float) -> str:
    return short_percent(share) + (f" ± {short_percent(bar)}" if math.isfinite(bar) else "")


def _table(digest: Digest, rows: list[_Row]) -> Table:
    many = len({row.case.hash for row in rows}) > 1
    columns = [
        *([Column("Case", numeric=False)] if many else []),
        Column("Model", numeric=False),
        Column("Structural error", unit="1"),
        Column("Growth", unit="1"),
        Column("Load", unit=rows[0].unit) if rows[0].unit != "1" else Column("Times the study's loads"),
        Column("Indentation", unit="m"),
        Column("Largest strain", unit="1"),
    ]
    cells = []
    for row in rows:
        limit = row.limit
        cells.append(
            [
                *([Cell(digest.case_name(row.case))] if many else []),
                Cell(row.model),
                _structural(row.entry),
                Cell(f"+ {short_percent(limit.threshold)}", value=limit.threshold),
                _load(limit, row.unit),
                _found(limit, limit.indentation, limit.indentation_bar, "m"),
                _found(limit, limit.strain, limit.strain_bar, "%"),
            ]
        )
    marks = [digest.colour(row.model) for row in rows]
    return Table(name="limits", caption="", columns=columns, rows=cells, marks=marks)


def _load(limit: Limit, unit: str) -> Cell:
    if math.isnan(limit.load):
        return Cell(NOTHING, _WHY[limit.state], tone="muted")
    text = quantity(limit.load, unit)
    if limit.state == "found":
        return Cell(text, _bar(limit.bar), limit.load)
    prefix = {"beyond": "≥ ", "unresolved": ""}.get(limit.state, "to ")
    return Cell(f"{prefix}{text}", _WHY[limit.state], limit.load, tone="muted")


def _found(limit: Limit, value: float, bar: float, unit: str) -> Cell:
    """An indentation or a strain with its bar; that of a limit not found has none."""

    def text(number: float) -> str:
        return percent(number) if unit == "%" else quantity(number, unit)

    if limit.state != "found" or not math.isfinite(value):
        return Cell(text(value), value=value)
    if not math.isfinite(bar):
        return Cell(text(value), _bar(bar), value)
    return Cell(
        text(value), f"± {text(bar * abs(value))}" + ("" if is_resolved(1.0, bar) else "\nunresolved"), value
    )


def _bar(bar: float) -> str:
    if math.isnan(bar):
        return f"± {NOT_MEASURED}"
    return f"± {percent(bar)}" if is_resolved(1.0, bar) else f"± {percent(bar)}\nunresolved"


def _structural(entry: ModelLimits) -> Cell:
    error, bar = entry.structural_error, entry.structural_bar
    if not math.isfinite(bar):
        return Cell(percent(error), f"± {NOT_MEASURED}", error)
    detail = f"± {percent(bar)}" + ("" if is_resolved(error, bar) else "\nunresolved")
    return Cell(percent(error), detail, error)
