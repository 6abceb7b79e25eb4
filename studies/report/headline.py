"""The first things to read: what was run, the verdict in a few sentences, one line of numbers per model."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from ..case import Run
from .blocks import Block, Cell, Column, Section, Table, Text
from .digest import RESOLUTION, Digest, ModelSummary, Spread, at_full_load, full_load
from .digest import VECTOR as VECTOR_ERROR
from .formatting import NOT_MEASURED, NOTHING, listed, number, percent, plural, quantity

CLOSE = 0.10  # "within 10 %", the threshold that the paper's claim speaks of


def headline_rows(run: Run) -> list[dict[str, str]]:
    """One row per model for a terminal: column title -> text; empty where no case is finished."""
    digest = Digest(run)
    if not digest.cases:
        return []
    table = _table(digest)
    rows = []
    for row in table.rows:
        texts = [f"{cell.text} {cell.detail}".strip() for cell in row]
        titles = [
            f"{column.title}, {column.detail}" if column.detail else column.title for column in table.columns
        ]
        rows.append(dict(zip(titles, texts, strict=True)))
    return rows


def headline(digest: Digest) -> Section:
    """The headline table with how to read it."""
    blocks: list[Block] = []
    if digest.cases:
        blocks.append(_table(digest))
        blocks.append(Text(_reading(digest), kind="note"))
    return Section("headline", "Headline", blocks)


def verdict(digest: Digest) -> list[str]:
    """What came out, in plain sentences made from the numbers."""
    run = digest.run
    asked = len(digest.cases) + len(run.failed) + len(run.missing)
    if not digest.cases:
        return [f"None of the {plural(asked, 'case')} has a result yet, so there is nothing to compare."]
    if not digest.compared:
        return [
            "The models were run without a reference, so this page shows what they answer "
            "and not how far they are from the truth."
        ]
    rated = [s for s in digest.summaries if s.name in digest.compared and s.vector]
    if not rated:
        return [f"No model reached full load, so none can be compared with {digest.reference}."]
    best = next(s for s in rated if s.name == digest.focus)
    sentences = [_accuracy(digest, best, among=len(rated))]
    if others := [s for s in rated if s is not best]:
        sentences.append(_others(others))
    sentences += [_resolution(digest, best), _cost(digest, best)]
    return [sentence for sentence in sentences if sentence]


def _accuracy(digest: Digest, best: ModelSummary, among: int) -> str:
    error = best.vector
    if error is None:
        return ""
    subject = f"{best.name}, the closest of {among} models," if among > 1 else best.name
    if len(digest.cases) == 1:
        text = f"At full load {subject} is {percent(error.median)} off {digest.reference} in surface displacement"
    else:
        text = (
            f"At full load {subject} is {percent(error.median)} off {digest.reference} in surface displacement in "
            f"the median case and {percent(error.worst)} in the worst"
        )
    if best.deformation:
        text += f"; with rigid motion taken out of both, {percent(best.deformation.median)} in deformation"
    values = [at_full_load(case, best.name, VECTOR_ERROR) for case in digest.cases]
    within = sum(math.isfinite(v) and v <= CLOSE for v in values)
    if len(values) == 1:
        return f"{text}. That is {'within' if within else 'outside'} {percent(CLOSE)}."
    share = (
        "every case"
        if within == len(values)
        else "no case"
        if not within
        else f"{within} of {len(values)} cases"
    )
    return f"{text}. It stays within {percent(CLOSE)} in {share}."


def _others(others: Sequence[ModelSummary]) -> str:
    parts = [f"{s.name} {percent(s.vector.median)}" for s in others if s.vector]
    return f"The others: {listed(parts)}{' (medians)' if any(s.vector and s.vector.cases > 1 for s in others) else ''}."


def _resolution(digest: Digest, best: ModelSummary) -> str:
    error = best.vector
    if error is None or not error.measured:
        return (
            f"The error of {digest.reference} itself was not measured, so these figures carry no error bar."
        )
    bar = f"{digest.reference} itself is uncertain by {percent(error.median_bar)}"
    if error.resolved == error.cases:
        return f"{bar}, small enough to resolve the difference."
    if not error.resolved:
        return f"{bar}, too much to resolve the difference: take it as unresolved."
    return f"{bar}; the difference is resolved in {error.resolved} of {plural(error.cases, 'case')}."


def _cost(digest: Digest, best: ModelSummary) -> str:
    reference = next((s for s in digest.summaries if s.is_reference), None)
    if reference is None or not (best.seconds_per_step > 0 and reference.seconds_per_step > 0):
        return ""
    ratio = reference.seconds_per_step / best.seconds_per_step
    text = (
        f"A frame costs {quantity(best.seconds_per_step, 's')} after {quantity(best.seconds_setup, 's')} of set-up, "
        f"against {quantity(reference.seconds_per_step, 's')} for {digest.reference}"
    )
    if ratio >= 1.5:
        return f"{text}: {number(ratio, 2)} times faster."
    return f"{text}: {number(1 / ratio, 2)} times slower." if ratio <= 1 / 1.5 else f"{text}: about the same."


def _table(digest: Digest) -> Table:
    many = len(digest.cases) > 1
    bars = bool(digest.compared)
    columns = [Column("Model", numeric=False)]
    makers: list[Callable[[ModelSummary], Cell]] = [
        lambda s: Cell(s.name, "reference" if s.is_reference else "")
    ]

    def add(title: str, detail: str, unit: str, make: Callable[[ModelSummary], Cell]) -> None:
        columns.append(Column(title, detail, unit=unit))
        makers.append(make)

    if bars:
        for title, pick in (
            ("Displacement error", lambda s: s.vector),
            ("Deformation error", lambda s: s.deformation),
        ):
            if many:
                add(title, "median", "1", lambda s, pick=pick: _median(pick(s), s.is_reference))
                add(title, "worst", "1", lambda s, pick=pick: _worst(pick(s), s.is_reference))
            else:
                add(title, "", "1", lambda s, pick=pick: _worst(pick(s), s.is_reference))
    add("Volume drift", "largest" if many else "", "1", lambda s: _drift(s.drift))
    add("Set-up", "", "s", lambda s: _quantity(s.seconds_setup, "s"))
    add("Per frame", "", "s", lambda s: _quantity(s.seconds_per_step, "s"))
    add("Memory", "", "B", lambda s: _quantity(s.peak_bytes, "B"))
    if any(s.failed_cases for s in digest.summaries):
        add("Failed", "", "", _failures)
    return Table(
        name="headline",
        caption="",
        columns=columns,
        rows=[[make(s) for make in makers] for s in digest.summaries],
        marks=[-1 if s.is_reference else digest.colour(s.name) for s in digest.summaries],
    )


def _median(spread: Spread | None, is_reference: bool) -> Cell:
    if spread is None:
        return Cell(NOTHING, "is the reference" if is_reference else "")
    return Cell(percent(spread.median), _bar(spread.median, spread.median_bar), spread.median)


def _worst(spread: Spread | None, is_reference: bool) -> Cell:
    if spread is None:
        return Cell(NOTHING, "is the reference" if is_reference else "")
    return Cell(percent(spread.worst), _bar(spread.worst, spread.worst_bar), spread.worst)


def _bar(value: float, bar: float) -> str:
    if not math.isfinite(bar):
        return f"± {NOT_MEASURED}"
    return f"± {percent(bar)}" if bar <= RESOLUTION * abs(value) else f"± {percent(bar)}, unresolved"


def _drift(spread: Spread | None) -> Cell:
    return Cell(NOTHING) if spread is None else Cell(percent(spread.worst, signed=True), value=spread.worst)


def _quantity(value: float, unit: str) -> Cell:
    return Cell(quantity(value, unit), value=value)


def _failures(summary: ModelSummary) -> Cell:
    count = summary.failed_cases
    return Cell(plural(count, "case"), value=float(count), tone="bad") if count else Cell(NOTHING, value=0.0)


def _reading(digest: Digest) -> str:
    parts = []
    loads = {float(case.load_factors[full_load(case)]) for case in digest.cases}
    parts.append(
        "All figures at full load"
        + (f" (load factor {number(loads.pop())})" if len(loads) == 1 else "")
        + (f", over {len(digest.cases)} cases" if len(digest.cases) > 1 else "")
        + "."
    )
    if digest.compared:
        parts.append(
            "Errors are area-weighted L2 norms over the surface, relative to the reference; deformation error "
            "leaves out the best-fit rigid motion, which a model with a small support gets right almost for free. "
            "± is the reference's own error from its mesh levels: a difference counts as resolved only where that "
            f"is at most a tenth of it."
        )
    parts.append(
        "Volume drift is the change of the exact enclosed volume. Times are medians, memory is the largest amount "
        "that the model added."
    )
    return " ".join(parts)
