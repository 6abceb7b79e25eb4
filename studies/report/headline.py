"""The first things to read: what was run, the verdict in a few sentences, one line of numbers per model."""

from __future__ import annotations

import math

from ..case import Run
from ..uncertainty import is_resolved
from .blocks import Cell, Column, Section, Table, Text
from .digest import VECTOR, Digest, ModelSummary, Spread, at_full_load, full_load
from .formatting import NOT_MEASURED, NOTHING, listed, percent, plain, plural, quantity, short_percent

CLOSE = 0.10  # "within 10 %", the threshold that the paper's claim speaks of


def headline_rows(run: Run) -> list[dict[str, str]]:
    """One row per model for a terminal: column title -> text; empty where no case is finished."""
    digest = Digest(run)
    if not digest.cases:
        return []
    rows = []
    for summary in digest.summaries:
        row = {"model": f"{summary.name} (reference)" if summary.is_reference else summary.name}
        if digest.compared:
            row["displacement error"] = _one_line(summary.vector)
            row["deformation error"] = _one_line(summary.deformation)
            row["reference's own"] = _bars_in_words(summary.vector, summary.deformation)
        row["volume drift"] = _drift(summary.drift).text
        row["set-up"] = quantity(summary.seconds_setup, "s")
        row["per frame"] = quantity(summary.seconds_per_step, "s")
        row["memory"] = quantity(summary.peak_bytes, "B")
        rows.append(row)
    return rows


def _one_line(spread: Spread | None) -> str:
    if spread is None:
        return NOTHING
    return (
        percent(spread.median)
        if spread.cases == 1
        else f"{percent(spread.median)}, worst {percent(spread.worst)}"
    )


def _bars_in_words(vector: Spread | None, deformation: Spread | None) -> str:
    """The reference's part in both errors, and whether these stand out from it."""
    spreads = [spread for spread in (vector, deformation) if spread is not None]
    if not spreads:
        return NOTHING
    if not any(spread.measured for spread in spreads):
        return f"± {NOT_MEASURED}"
    bars = " / ".join(percent(spread.median_bar) for spread in spreads)
    verdicts = dict.fromkeys(spread.verdict for spread in spreads)
    return f"± {bars}" if list(verdicts) == ["resolved"] else f"± {bars}, {' / '.join(verdicts)}"


def headline(digest: Digest) -> Section | None:
    """The headline table with how to read it."""
    if not digest.cases:
        return None
    return Section("headline", "Headline", [_table(digest), Text(_reading(digest), kind="note")])


def verdict(digest: Digest) -> list[str]:
    """What came out, in plain sentences made from the numbers."""
    run = digest.run
    asked = len(digest.cases) + len(run.failed) + len(run.missing)
    if not digest.cases:
        return [f"None of the {plural(asked, 'case')} has a result yet, so there is nothing to compare."]
    if digest.reference is None:
        return [
            "The models were run without a reference, so this page shows what they answer "
            "and not how far they are from the truth."
        ]
    candidates = digest.on_trial or digest.compared
    rated = {s.name: s.vector for s in digest.summaries if s.name in candidates and s.vector}
    if not rated or digest.focus not in rated:
        return [f"No model has a result at full load to hold against {digest.reference}."]
    best = next(s for s in digest.summaries if s.name == digest.focus)
    error = rated.pop(best.name)
    sentences = [_accuracy(digest, best, error, among=len(rated) + 1)]
    if rated:
        many = " (medians)" if len(digest.cases) > 1 else ""
        sentences.append(f"The others: {listed(f'{n} {_short(e)}' for n, e in rated.items())}{many}.")
    sentences += [_stops(digest), _resolution(digest, error), _cost(digest, best)]
    return [sentence for sentence in sentences if sentence]


def _short(error: Spread) -> str:
    """A median, named unresolved where the reference's own error was measured and is too wide for it."""
    text = short_percent(error.median)
    resolved = not error.measured or is_resolved(error.median, error.median_bar)
    return text if resolved else f"{text} (unresolved)"


def _accuracy(digest: Digest, best: ModelSummary, error: Spread, among: int) -> str:
    subject = f"{best.name}, the closest of {among} models," if among > 1 else best.name
    text = f"At full load {subject} is {short_percent(error.median)} off {digest.reference} in surface displacement"
    if error.cases > 1:
        text += f" in the median case and {short_percent(error.worst)} in the worst"
    if best.deformation:
        text += (
            f"; with rigid motion taken out of both, {short_percent(best.deformation.median)} in deformation"
        )
    values = [at_full_load(case, best.name, VECTOR) for case in digest.cases]
    within = sum(math.isfinite(v) and v <= CLOSE for v in values)
    limit = short_percent(CLOSE)
    if len(values) == 1:
        return f"{text}. That is {'within' if within else 'outside'} {limit}."
    share = {0: "no case", len(values): "every case"}.get(within, f"{within} of {len(values)} cases")
    return f"{text}. It stays within {limit} in {share}."


def _stops(digest: Digest) -> str:
    """Models that did not reach the end of their load history."""
    parts = [f"{s.name} in {plural(s.failed_cases, 'case')}" for s in digest.summaries if s.failed_cases]
    return f"Stopped before the end of the load: {listed(parts)}; the reasons are below." if parts else ""


def _resolution(digest: Digest, error: Spread) -> str:
    if not error.measured:
        return (
            f"The error of {digest.reference} itself was not measured, so these figures carry no error bar."
        )
    bar = f"{digest.reference} itself is uncertain by {short_percent(error.median_bar)}"
    if digest.unusual_levels:
        many = len(digest.cases) > 1
        named = [
            f"{name} in {plural(n, 'case')}" if many else name for name, n in digest.unusual_levels.items()
        ]
        bar += f" (its mesh levels are {listed(named)}: the widest margin was taken)"
    if error.resolved == error.cases:
        return f"{bar}, at most a tenth of the difference, which is thereby resolved."
    if not error.resolved:
        return f"{bar}, more than a tenth of the difference, which counts as unresolved."
    return f"{bar}; the difference is resolved in {error.resolved} of {plural(error.cases, 'case')}."


def _cost(digest: Digest, best: ModelSummary) -> str:
    """Against the reference's own model on the same mesh where there is one: a finer mesh costs more by choice."""
    peer = digest.coarse_reference or digest.reference
    reference = next((s for s in digest.summaries if s.name == peer), None)
    if reference is None or not (best.seconds_per_step > 0 and reference.seconds_per_step > 0):
        return ""
    ratio = reference.seconds_per_step / best.seconds_per_step
    text = (
        f"A frame of {best.name} costs {quantity(best.seconds_per_step, 's', 2)} after "
        f"{quantity(best.seconds_setup, 's', 2)} of set-up, one of {peer} "
        f"{quantity(reference.seconds_per_step, 's', 2)} after {quantity(reference.seconds_setup, 's', 2)}"
    )
    if ratio >= 1.5:
        return f"{text}: {plain(ratio, 2)} times faster per frame."
    return (
        f"{text}: {plain(1 / ratio, 2)} times slower per frame."
        if ratio <= 1 / 1.5
        else f"{text}: about the same."
    )


def _table(digest: Digest) -> Table:
    many = len(digest.cases) > 1
    columns = [Column("Model", numeric=False)]
    if digest.compared:
        for title in ("Displacement error", "Deformation error"):
            columns += [
                Column(title, detail, unit="1") for detail in (("median", "worst") if many else ("",))
            ]
    columns.append(Column("Volume drift", "largest" if many else "", unit="1"))
    columns += [Column("Set-up", unit="s"), Column("Per frame", unit="s"), Column("Memory", unit="B")]
    rows = []
    for summary in digest.summaries:
        about = ["reference"] if summary.is_reference else []
        if summary.failed_cases:
            about.append(f"stopped early in {plural(summary.failed_cases, 'case')}")
        row = [Cell(summary.name, ", ".join(about))]
        if digest.compared:
            for spread in (summary.vector, summary.deformation):
                row += [_median(spread), _worst(spread)] if many else [_worst(spread)]
        row += [
            _drift(summary.drift),
            Cell(quantity(summary.seconds_setup, "s"), value=summary.seconds_setup),
            Cell(quantity(summary.seconds_per_step, "s"), value=summary.seconds_per_step),
            Cell(quantity(summary.peak_bytes, "B"), value=summary.peak_bytes),
        ]
        rows.append(row)
    marks = [digest.colour(s.name) for s in digest.summaries]
    return Table(name="headline", caption="", columns=columns, rows=rows, marks=marks)


def _median(spread: Spread | None) -> Cell:
    return Cell(NOTHING) if spread is None else _with_bar(spread.median, spread.median_bar)


def _worst(spread: Spread | None) -> Cell:
    return Cell(NOTHING) if spread is None else _with_bar(spread.worst, spread.worst_bar)


def _with_bar(value: float, bar: float) -> Cell:
    return Cell(percent(value), _bar(value, bar), value)


def _bar(value: float, bar: float) -> str:
    if not math.isfinite(bar):
        return f"± {NOT_MEASURED}"
    return f"± {percent(bar)}" if is_resolved(value, bar) else f"± {percent(bar)}\nunresolved"


def _drift(spread: Spread | None) -> Cell:
    return Cell(NOTHING) if spread is None else Cell(percent(spread.worst, signed=True), value=spread.worst)


def _reading(digest: Digest) -> str:
    parts = []
    loads = {float(case.load_factors[full_load(case)]) for case in digest.cases}
    parts.append(
        "All figures at full load"
        + (f" (load factor {plain(loads.pop())})" if len(loads) == 1 else "")
        + (f", over {len(digest.cases)} cases" if len(digest.cases) > 1 else "")
        + "."
    )
    if digest.compared:
        parts.append(
            "Errors are area-weighted L2 norms over the surface, relative to the reference; deformation error "
            "leaves out the best-fit rigid motion, which a model with a small support gets right almost for free. "
            "± is the reference's own error from its mesh levels: a difference counts as resolved only where that "
            "is at most a tenth of it."
        )
    parts.append(
        "Volume drift is the change of the exact enclosed volume. Times are medians, memory is the largest amount "
        "that the model added."
    )
    return " ".join(parts)
