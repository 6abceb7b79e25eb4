"""The head of the page and of a terminal: a row a family, what to take, what each model is off by and costs."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from ..measures.case import Run
from ..measures.metrics import DEFORMATION, VECTOR
from ..study.registry import Family
from ..verdict.advice import Advice, Figures
from ..verdict.digest import CONTACT, DRIFT, HAUSDORFF, NORMAL, Digest, ModelSummary, Spread, digest_of
from ..verdict.formatting import (
    NOTHING,
    exact_percent,
    measure,
    percent,
    plural,
    quantity,
    with_bar,
)
from ..verdict.verdict import Limit, Verdict, Verdicts
from ..verdict.words import TITLES, said, to_do, why_not
from .blocks import Cell, Field, Section, Table, Text, frame_table, spread_cell
from .section_cost import time_notes

TONES = {"yes": "good", "no": "bad", "not judged": "muted"}


# --- the rows of the families ---


class FamilyRow(NamedTuple):
    """A family on the page: its name, the word, the model that decides and its numbers, or a text instead."""

    title: str
    word: str
    model: str
    colour: int | None
    numbers: tuple[str, ...]
    text: str


def family_rows(verdicts: Verdicts, digest: Digest) -> list[FamilyRow]:
    """A line a family that the study compares."""
    return [_family_row(one, verdicts, digest) for one in verdicts.asked]


def _family_row(one: Verdict, verdicts: Verdicts, digest: Digest) -> FamilyRow:
    title, model, lead = TITLES[Family(one.family)], one.model, one.lead
    colour = digest.colour(model) if model else None
    if not model or one.same or lead is None:
        text = " ".join(said("row", one, verdicts)).removeprefix(f"{model}: ")
        return FamilyRow(title, one.word, model, colour, (), text)
    frame = f"{quantity(one.cost.frame, 's', 2)} a frame" if one.cost and one.cost.frame > 0 else ""
    second = f"change of shape {exact_percent(lead.deformation)}" if math.isfinite(lead.deformation) else ""
    if one.judged > 1:
        second = f"{one.within} of {one.judged} cases within {' '.join(said('within', one))}"
        second += f", {one.undecided} undecided" if one.undecided else ""
    numbers = (f"{lead.name} {with_bar(lead.value, lead.bar)}", second, frame)
    return FamilyRow(title, one.word, model, colour, numbers, "")


# --- what to take instead ---


def what_to_take(verdicts: Verdicts) -> Table | None:
    """A row for each kind of interaction and model to take there."""
    rows: list[tuple[Advice, int, Figures | None]] = [
        (one, k, figures) for one in verdicts.take for k, figures in enumerate(one.take or (None,))
    ]

    def number(name: str, unit: str, digits: int = 3) -> Any:
        def of(row: tuple[Advice, int, Figures | None]) -> Cell | None:
            found = getattr(row[2], name, math.nan) if row[2] is not None else math.nan
            if not math.isfinite(found) or (unit == "1" and row[2] is not None and row[2].same):
                return Cell("")
            return Cell(exact_percent(found) if unit == "1" else quantity(found, unit, digits), value=found)

        return of

    fields = [
        Field("Where", lambda row: Cell("" if row[1] else _sentence(row[0].interaction))),
        Field("Take", lambda row: " ".join(said("take", row[0], row[1]))),
        Field("Displacement error", number("displacement", "1"), "1"),
        Field("Change of shape", number("deformation", "1"), "1"),
        Field("A frame", number("frame", "s", 2), "s"),
        Field("Set-up", number("set_up", "s", 2), "s"),
    ]
    return frame_table(rows, fields, "take", tools=False) if rows else None


# --- against the limits ---


def against_limits(verdicts: Verdicts, digest: Digest) -> Table | None:
    """The models that decide: each limit in the worst case, up to which load it holds, why not, what to do."""
    judged = [one for one in verdicts.asked if one.model]
    if not judged:
        return None

    def limit(key: str) -> Any:
        return lambda one: next((_limit(limit) for limit in one.limits if limit.key == key), None)

    limits = judged[0].limits
    fields = [
        Field("Model that decides", lambda one: Cell(one.model, TITLES[Family(one.family)])),
        *(
            Field(
                f"{one.name[:1].upper()}{one.name[1:]}",
                limit(one.key),
                detail=f"at most {measure(one.allowed, one.unit)}",
            )
            for one in limits
        ),
        Field("Up to which load", lambda one: _sentence(" ".join(said("reached", one)))),
        Field("Why not, and what to do", _why),
    ]
    return frame_table(judged, fields, "acceptance", mark=lambda one: digest.colour(one.model), tools=False)


def _limit(limit: Limit) -> Cell:
    if not math.isfinite(limit.value):
        return Cell("no answer", tone="bad")
    bar = f" ± {measure(limit.bar, limit.unit)}" if math.isfinite(limit.bar) else ""
    counts = (
        (limit.undecided, "undecided"),
        (limit.beyond, "beyond"),
        (limit.unanswered, "without an answer"),
    )
    cases = limit.within + sum(count for count, _ in counts)
    told = [f"{count} of {cases} {what}" for count, what in counts if count and count < cases]
    about = "\n".join([*told, *([limit.case] if limit.case else [])])
    return Cell(f"{measure(limit.value, limit.unit)}{bar}", about, limit.value, TONES.get(limit.word, ""))


def _why(one: Verdict) -> str:
    return " ".join(_sentence(text) for text in [*why_not(one), to_do(one)] if text)


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}"


# --- every model ---


def headline(digest: Digest) -> Section | None:
    """Every model with the measures that lead, and what it costs."""
    if not digest.cases:
        return None
    return Section(
        "headline", "How far off, and at what cost", [_table(digest), Text(_reading(digest), kind="note")]
    )


def _table(digest: Digest) -> Table:
    scalar = any(math.isfinite(digest.floor(summary.name)) for summary in digest.summaries)

    def spread(metric: str, unit: str = "1") -> Any:
        return lambda summary: spread_cell(digest.spread(summary.name, metric), unit)

    fields = [
        Field("Model", lambda summary: Cell(summary.name, _about(summary))),
        *([Field("Normal error", spread(NORMAL), "1")] if scalar else []),
        Field("Contact region", spread(CONTACT), "1"),
        Field("Hausdorff distance", spread(HAUSDORFF, "m"), "m"),
        Field("Displacement error", lambda summary: _displacement(digest, summary), "1"),
        Field("Change of shape", spread(DEFORMATION), "1"),
        Field("Volume drift", lambda summary: _drift(summary.drift), "1", detail="worst"),
        Field("Set-up", lambda summary: _time(summary, summary.seconds_setup), "s"),
        Field("A frame", lambda summary: _time(summary, summary.seconds_per_step, frame=True), "s"),
        Field("Memory", lambda summary: summary.peak_bytes, "B"),
    ]
    return frame_table(digest.summaries, fields, "headline", mark=lambda summary: digest.colour(summary.name))


def _about(summary: ModelSummary) -> str:
    about = ["reference"] if summary.is_reference else []
    about += [f"incomplete in {plural(summary.failed_cases, 'case')}"] if summary.failed_cases else []
    return ", ".join(about)


def _displacement(digest: Digest, summary: ModelSummary) -> Cell | None:
    cell, floor = spread_cell(summary.vector, "1"), digest.floor(summary.name)
    if cell is None or not math.isfinite(floor):
        return cell
    return Cell(cell.text, f"{cell.detail}\nfloor {percent(floor)}", cell.value)


def _drift(spread: Spread | None) -> Cell | None:
    """The largest drift; of the reference's own, which is an estimate, with its bar."""
    if spread is None:
        return None
    bar = f"± {percent(spread.worst_bar)}" if math.isfinite(spread.worst_bar) else ""
    return Cell(percent(spread.worst, signed=True), bar, spread.worst)


def _time(summary: ModelSummary, seconds: float, *, frame: bool = False) -> Cell | None:
    marks = [mark.removesuffix(" run") for mark in summary.marks]
    how = ["iterative"] if frame and summary.iterative else []
    if frame and math.isfinite(summary.seconds_everywhere):
        how.append(f"{quantity(summary.seconds_everywhere, 's')} all nodes")
    return Cell(quantity(seconds, "s"), "\n".join([*how, *marks]), seconds)


def _reading(digest: Digest) -> str:
    parts = [
        f"All figures at full load, over {plural(len(digest.cases), 'case')}: medians, and the worst case."
    ]
    if digest.compared:
        parts.append(
            "An error is the area-weighted L2 norm of the difference over that of the reference. The error in "
            "change of shape leaves out the rigid motion. ± is the reference's own error; a difference is resolved "
            "where that is at most a tenth of it."
        )
    if any(math.isfinite(digest.floor(name)) for name in digest.models):
        parts.append(
            "A form that moves nodes along normals predicts the normal component alone. The floor is the "
            "displacement error of the reference itself, moved so: no such form is closer."
        )
    parts.append(
        "Volume drift is the change of the enclosed volume. A linear answer adds some in second order; elements "
        "add the tissue's compression and what flat facets leave out: read it beside the reference's own."
    )
    return " ".join([*parts, *time_notes(digest.summaries)])


# --- for a terminal and for programs ---


def terminal_rows(digest: Digest) -> list[dict[str, str]]:
    """The rows of a table that fits 80 columns: a line a model, and one each for the worst case and for notes."""
    rows: list[dict[str, str]] = []
    for summary in digest.summaries:
        spreads = {"displacement": summary.vector, "change of shape": summary.deformation}
        errors = {key: percent(spread.median) if spread else NOTHING for key, spread in spreads.items()}
        if summary.is_reference:
            own = map(digest.own_error, (VECTOR, DEFORMATION))
            errors = {key: f"± {percent(bar)}" for key, bar in zip(spreads, own, strict=True)}
        times = {
            "set-up": quantity(summary.seconds_setup, "s"),
            "per frame": quantity(summary.seconds_per_step, "s"),
        }
        rows.append({"model": summary.name, **(errors if digest.compared else {}), **times})
        further = [{"model": f"  {note}"} for note in _terminal_notes(digest, summary)]
        if summary.vector is not None and summary.vector.cases > 1:
            worst = {key: percent(spread.worst) if spread else NOTHING for key, spread in spreads.items()}
            further.insert(0, {"model": "  worst case", **worst})
        rows += [dict.fromkeys(rows[-1], "") | row for row in further]
    return rows


def _terminal_notes(digest: Digest, summary: ModelSummary) -> list[str]:
    notes = ["reference, own error"] if summary.is_reference else []
    if math.isfinite(floor := digest.floor(summary.name)):
        normal = digest.median(summary.name, NORMAL)
        notes.append(f"along normals: {percent(normal)} off, floor of displacement {percent(floor)}")
    notes += [f"no answer in {plural(summary.failed_cases, 'case')}"] if summary.failed_cases else []
    return notes + ([f"times: {', '.join(summary.marks)}"] if summary.marks else [])


def headline_rows(run: Run) -> list[dict[str, str]]:
    """One row per model for a notebook: column title -> text; empty where no case is finished."""
    digest = digest_of(run)
    if not digest.cases:
        return []
    table = _table(digest)
    titles = [column.title for column in table.columns]
    return [
        {
            title.lower(): " ".join([cell.text, *cell.detail.split("\n")]).strip()
            for title, cell in zip(titles, row, strict=True)
        }
        for row in table.rows
    ]


def headline_metrics(run: Run) -> dict[str, dict[str, dict[str, Any]]]:
    """The numbers of the table: model -> measure -> value (median), worst, bars, unit; None for none.

    Times have "measured" too: what stands beside them there.
    """
    digest = digest_of(run)
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for summary in digest.summaries:
        units = {VECTOR: "1", DEFORMATION: "1", NORMAL: "1", CONTACT: "1", HAUSDORFF: "m", DRIFT: "1"}
        spreads = {name: (digest.spread(summary.name, name), unit) for name, unit in units.items()}
        costs = {"seconds_setup": "s", "seconds_per_step": "s", "seconds_everywhere": "s", "peak_bytes": "B"}
        found[summary.name] = {
            **{
                name: _numbers(spread.median, spread.worst, spread.median_bar, spread.worst_bar, unit=unit)
                for name, (spread, unit) in spreads.items()
                if spread is not None
            },
            **{name: _numbers(getattr(summary, name), unit=unit) for name, unit in costs.items()},
        }
        for name in ("seconds_setup", "seconds_per_step"):
            found[summary.name][name]["measured"] = list(summary.marks)
    return found


def _numbers(
    value: float, worst: float = math.nan, bar: float = math.nan, worst_bar: float = math.nan, *, unit: str
) -> dict[str, Any]:
    numbers = {"value": value, "worst": worst, "bar": bar, "worst_bar": worst_bar}
    return {key: float(n) if math.isfinite(n) else None for key, n in numbers.items()} | {"unit": unit}
