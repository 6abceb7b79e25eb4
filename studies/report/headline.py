"""One line of numbers per model, for the page and for a terminal."""

from __future__ import annotations

import math
from typing import Any

from ..measures.case import Run
from ..measures.metrics import DEFORMATION, VECTOR
from ..verdict.digest import Digest, ModelSummary, Spread
from ..verdict.formatting import NOT_MEASURED, NOTHING, percent, plain, plural, quantity
from ..verdict.motion import along_normals
from .blocks import Cell, Column, Section, Table, Text, bar_detail
from .section_cost import time_notes

_ERRORS = ("displacement", "change of shape")


def headline_rows(run: Run) -> list[dict[str, str]]:
    """One row per model for a terminal: column title -> text; empty where no case is finished."""
    digest = Digest(run)
    if not digest.cases:
        return []
    rows = []
    for summary in digest.summaries:
        about = _about_model(summary)
        row = {"model": f"{summary.name} ({about})" if about else summary.name}
        if digest.compared:
            row["displacement error"] = _one_line(summary.vector)
            row["deformation error"] = _one_line(summary.deformation)
            row["reference's own"] = _bars_in_words(summary.vector, summary.deformation)
            row["along normals"] = _along_normals(digest, summary)
        drift = _drift(summary.drift)
        row["volume drift"] = " ".join(filter(None, (drift.text, drift.detail)))
        marked = f" ({', '.join(summary.marks)})" if summary.marks else ""
        row["set-up"] = quantity(summary.seconds_setup, "s") + marked
        row["per frame"] = quantity(summary.seconds_per_step, "s") + marked
        row["per frame, all nodes"] = quantity(summary.seconds_everywhere, "s")
        row["memory"] = quantity(summary.peak_bytes, "B")
        rows.append(row)
    return rows


def terminal_rows(digest: Digest) -> list[dict[str, str]]:
    """The rows of a table that fits 80 columns: a line a model, and one each for the worst case and for notes."""
    rows: list[dict[str, str]] = []
    for summary in digest.summaries:
        vector, shape = summary.vector, summary.deformation
        times = {
            "set-up": quantity(summary.seconds_setup, "s"),
            "per frame": quantity(summary.seconds_per_step, "s"),
        }
        rows.append({"model": summary.name, **_terminal_errors(digest, summary), **times})
        further = [{"model": f"  {note}"} for note in _terminal_notes(digest, summary)]
        if vector is not None and vector.cases > 1:
            errors = [percent(spread.worst) if spread else NOTHING for spread in (vector, shape)]
            further.insert(0, {"model": "  worst case", **dict(zip(_ERRORS, errors, strict=True))})
        rows += [dict.fromkeys(rows[-1], "") | row for row in further]
    return rows


def _terminal_errors(digest: Digest, summary: ModelSummary) -> dict[str, str]:
    """Of a model its median errors, of the reference its own."""
    if not digest.compared:
        return {}
    spreads: tuple[Spread | None, ...] = (summary.vector, summary.deformation)
    texts = [percent(spread.median) if spread else NOTHING for spread in spreads]
    if summary.is_reference:
        texts = [f"± {percent(digest.own_error(metric))}" for metric in (VECTOR, DEFORMATION)]
    return dict(zip(_ERRORS, texts, strict=True))


def _terminal_notes(digest: Digest, summary: ModelSummary) -> list[str]:
    notes = ["reference, own error"] if summary.is_reference else []
    notes += filter(None, [_about_form(digest, summary)])
    notes += [f"no answer in {plural(summary.failed_cases, 'case')}"] if summary.failed_cases else []
    return notes + ([f"times: {', '.join(summary.marks)}"] if summary.marks else [])


def _along_normals(digest: Digest, summary: ModelSummary) -> str:
    """The floor of a form that moves nodes along normals, and its error in what it predicts; "" of any other."""
    found = along_normals(digest, summary.name)
    return f"at least {percent(found[0])}, normal component {percent(found[1])}" if found else ""


def headline_metrics(run: Run) -> dict[str, dict[str, dict[str, Any]]]:
    """The numbers of `headline_rows`: model -> measure -> value (median), worst, bars, unit; None for none.

    Times have "measured" too: what stands beside them there.
    """
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for summary in Digest(run).summaries:
        spreads = {VECTOR: summary.vector, DEFORMATION: summary.deformation, "volume_drift": summary.drift}
        single = {
            "seconds_setup": (summary.seconds_setup, "s"),
            "seconds_per_step": (summary.seconds_per_step, "s"),
            "seconds_everywhere": (summary.seconds_everywhere, "s"),
            "peak_bytes": (summary.peak_bytes, "B"),
        }
        found[summary.name] = {
            **{
                name: _numbers(spread.median, spread.worst, spread.median_bar, spread.worst_bar, unit="1")
                for name, spread in spreads.items()
                if spread is not None
            },
            **{name: _numbers(value, unit=unit) for name, (value, unit) in single.items()},
        }
        for name in ("seconds_setup", "seconds_per_step"):
            found[summary.name][name]["measured"] = list(summary.marks)
    return found


def _numbers(
    value: float, worst: float = math.nan, bar: float = math.nan, worst_bar: float = math.nan, *, unit: str
) -> dict[str, Any]:
    numbers = {"value": value, "worst": worst, "bar": bar, "worst_bar": worst_bar}
    return {key: float(n) if math.isfinite(n) else None for key, n in numbers.items()} | {"unit": unit}


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


def _table(digest: Digest) -> Table:
    many = len(digest.cases) > 1
    columns = [Column("Model", numeric=False)]
    if digest.compared:
        for title in ("Displacement error", "Change of shape"):
            columns += [
                Column(title, detail, unit="1") for detail in (("median", "worst") if many else ("",))
            ]
    columns.append(Column("Volume drift", "largest" if many else "", unit="1"))
    columns += [Column("Set-up", unit="s"), Column("Per frame", unit="s"), Column("Memory", unit="B")]
    rows = []
    for summary in digest.summaries:
        marks = [mark.removesuffix(" run") for mark in summary.marks]
        how = ["iterative"] if summary.iterative else []
        if math.isfinite(summary.seconds_everywhere):
            how.append(f"{quantity(summary.seconds_everywhere, 's')} all nodes")
        row = [
            Cell(summary.name, "\n".join(filter(None, (_about_model(summary), _about_form(digest, summary)))))
        ]
        if digest.compared:
            for spread in (summary.vector, summary.deformation):
                row += [_median(spread), _worst(spread)] if many else [_worst(spread)]
        row += [
            _drift(summary.drift),
            Cell(quantity(summary.seconds_setup, "s"), "\n".join(marks), summary.seconds_setup),
            Cell(
                quantity(summary.seconds_per_step, "s"), "\n".join([*how, *marks]), summary.seconds_per_step
            ),
            Cell(quantity(summary.peak_bytes, "B"), value=summary.peak_bytes),
        ]
        rows.append(row)
    return Table("headline", "", columns, rows, digest.marks(digest.models))


def _about_model(summary: ModelSummary) -> str:
    about = ["reference"] if summary.is_reference else []
    if summary.failed_cases:
        about.append(f"incomplete in {plural(summary.failed_cases, 'case')}")
    return ", ".join(about)


def _about_form(digest: Digest, summary: ModelSummary) -> str:
    told = _along_normals(digest, summary)
    return f"along normals: {told}" if told else ""


def _median(spread: Spread | None) -> Cell:
    return Cell(NOTHING) if spread is None else _with_bar(spread.median, spread.median_bar)


def _worst(spread: Spread | None) -> Cell:
    return Cell(NOTHING) if spread is None else _with_bar(spread.worst, spread.worst_bar)


def _with_bar(value: float, bar: float) -> Cell:
    return Cell(percent(value), bar_detail(value, bar), value)


def _drift(spread: Spread | None) -> Cell:
    """The largest drift; of the reference's own, which is an estimate, with its bar."""
    if spread is None:
        return Cell(NOTHING)
    bar = f"± {percent(spread.worst_bar)}" if math.isfinite(spread.worst_bar) else ""
    return Cell(percent(spread.worst, signed=True), bar, spread.worst)


def _reading(digest: Digest) -> str:
    parts = []
    loads = {float(case.load_factors[case.full_load]) for case in digest.cases}
    parts.append(
        "All figures at full load"
        + (f" (load factor {plain(loads.pop())})" if len(loads) == 1 else "")
        + (f", over {len(digest.cases)} cases" if len(digest.cases) > 1 else "")
        + "."
    )
    if digest.compared:
        parts.append(
            "An error is the area-weighted L2 norm of the difference over that of the reference. The error "
            "in change of shape leaves out the rigid motion, which most models get right. "
            "± is the reference's own error. A difference is resolved where that is at most a tenth of it."
        )
    if any(along_normals(digest, summary.name) for summary in digest.summaries):
        parts.append(
            "A form along normals cannot have a displacement error below the one named: that of the reference "
            "itself, moved so. The normal component is what it predicts."
        )
    parts.append(
        "Volume drift is the change of the enclosed volume, in the worst case. A linear answer adds some in second "
        "order; elements add the tissue's compression and what flat facets leave out. Its ± covers the compression "
        "alone. Times are medians. Memory is the most that a model added."
    )
    if digest.compared:
        marked = any(s.marks or s.iterative for s in digest.summaries)
        parts += ["Run time against error explains the marks below a time."] if marked else []
    else:
        parts += time_notes(digest.summaries)
    return " ".join(parts)
