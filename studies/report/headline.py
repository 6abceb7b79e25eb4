"""The head of the page and of the terminal: verdicts, which model to take, errors and costs of each model."""

from __future__ import annotations

import math
from typing import Any

from ..machine import plain
from ..measures.case import Run
from ..measures.metrics import DEFORMATION, VECTOR
from ..study.errors import plural
from ..study.registry import Family, split
from ..verdict.advice import Advice
from ..verdict.digest import (
    CONTACT,
    DRIFT,
    HAUSDORFF,
    NORMAL,
    Digest,
    Spread,
    digest_of,
    median_known,
)
from ..verdict.formatting import NOTHING, capital, measure, percent, quantity, short_percent
from ..verdict.verdict import Limit, Verdicts, verdicts
from ..verdict.words import TITLES, said, told, why_not
from .blocks import Cell, Field, Section, Table, frame_table, note, spread_cell
from .section_tables import stopped_models

# metric -> column of the table, unit
ERRORS = {
    NORMAL: ("Normal error", "1"),
    CONTACT: ("Contact region", "1"),
    HAUSDORFF: ("Hausdorff distance", "m"),
    VECTOR: ("Displacement error", "1"),
    DEFORMATION: ("Change of shape", "1"),
}
TONES = {"yes": "good", "no": "bad", "not judged": "muted"}


# --- what to take instead ---


def what_to_take(verdicts: Verdicts) -> Table | None:
    """A row for each kind of interaction, with the model to take there."""

    def error(name: str) -> Any:
        def of(one: Advice) -> Cell:
            value = getattr(one.take, name, math.nan)
            if not math.isfinite(value) or (one.take and one.take.same):
                return Cell("")
            bar = getattr(one.take, f"{name}_bar")
            told = f"± {short_percent(bar)}" if math.isfinite(bar) else ""
            return Cell(short_percent(value), told, value, bar=bar)

        return of

    def time(name: str) -> Any:
        def of(one: Advice) -> Cell:
            value = getattr(one.take, name, math.nan)
            return Cell(quantity(value, "s", 2) if math.isfinite(value) else "", value=value)

        return of

    fields = [
        Field("Where", lambda one: capital(one.interaction)),
        Field("Take", lambda one: " ".join(said("take", one))),
        Field("Displacement error", error("displacement"), "1"),
        Field("Change of shape", error("deformation"), "1"),
        Field("A frame", time("frame"), "s"),
        Field("Set-up", time("set_up"), "s"),
    ]
    return frame_table(verdicts.take, fields, "take", tools=False) if verdicts.take else None


# --- against the limits ---


def against_limits(verdicts: Verdicts, digest: Digest) -> Table | None:
    """The models that decide: each limit in the worst case, the load up to which they keep it, and the causes."""
    judged = [one for one in verdicts.asked if one.model]
    if not judged:
        return None

    def limit(key: str) -> Any:
        return lambda one: next((_limit(limit) for limit in one.limits if limit.key == key), None)

    limits = judged[0].limits
    fields = [
        Field("Model that decides", lambda one: Cell(one.model, TITLES[Family(one.family)])),
        *(
            Field(capital(one.name), limit(one.key), detail=f"at most {measure(one.allowed, one.unit)}")
            for one in limits
        ),
        Field("Up to which load", lambda one: capital(" ".join(said("reached", one)))),
        Field("Why not", lambda one: Cell(" ".join(map(capital, why_not(one))) or NOTHING, one.seen_in)),
    ]
    return frame_table(judged, fields, "acceptance", mark=lambda one: digest.colour(one.model), tools=False)


def _limit(limit: Limit) -> Cell:
    if not math.isfinite(limit.value):
        return Cell("no answer", tone="bad")
    cases = sum(limit.counts.values())
    told = [
        f"{n} of {cases} {what}" for what, n in limit.counts.items() if what != "within" and 0 < n < cases
    ]
    about = "\n".join([*told, *([limit.case] if limit.case else [])])
    tone = TONES.get(limit.word, "")
    return Cell(measure(limit.value, limit.unit, limit.bar), about, limit.value, tone, limit.bar)


# --- every model ---


def headline(digest: Digest) -> Section | None:
    """Every model with the leading errors, and its costs."""
    if not digest.cases:
        return None
    along_normals = any(math.isfinite(digest.floor(name)) for name in digest.models)
    finite = any(split(name)[0] == "fem" for name in (*digest.models, digest.reference or ""))
    small_print = note(
        "headline",
        len(digest.cases),
        bool(digest.compared),
        along_normals,
        list(digest.figures.values()),
        finite,
    )
    return Section("headline", "How far off, and at what cost", [_table(digest), small_print])


def _table(digest: Digest) -> Table:
    def error(metric: str) -> Field:
        title, unit = ERRORS[metric]

        def of(name: str) -> Cell | None:
            floor = digest.floor(name) if metric == VECTOR else math.nan
            return spread_cell(digest.spread(name, metric), unit, floor)

        return Field(title, of, unit)

    def seconds(title: str, which: str) -> Field:
        def of(name: str) -> Cell:
            known = digest.figures[name]
            everywhere = [f"{quantity(known.everywhere, 's')} all nodes"] if known.everywhere > 0.0 else []
            detail = "\n".join([*(everywhere if which == "frame" else []), *known.marks])
            return Cell(quantity(getattr(known, which), "s"), detail, getattr(known, which))

        return Field(title, of, "s")

    scalar = any(math.isfinite(digest.floor(name)) for name in digest.models)
    fields = [
        Field("Model", lambda name: Cell(name, _about(digest, name))),
        *(error(metric) for metric in ERRORS if scalar or metric != NORMAL),
        Field("Volume drift", lambda name: _drift(digest.spread(name, DRIFT)), "1", detail="worst"),
        seconds("Set-up", "set_up"),
        seconds("A frame", "frame"),
        Field("Memory", lambda name: digest.figures[name].memory, "B"),
    ]
    return frame_table(digest.models, fields, "headline", mark=digest.mark)


def _about(digest: Digest, name: str) -> str:
    about = ["reference"] if name == digest.reference else []
    stopped = digest.stopped(name)
    return ", ".join([*about, *([f"incomplete in {plural(stopped, 'case')}"] if stopped else [])])


def _drift(spread: Spread | None) -> Cell | None:
    """The worst drift, with an error bar for the reference, whose drift is an estimate."""
    if spread is None:
        return None
    bar = f"± {percent(spread.worst_bar)}" if math.isfinite(spread.worst_bar) else ""
    return Cell(percent(spread.worst, signed=True), bar, spread.worst, bar=spread.worst_bar)


# --- for a terminal and for programs ---


def summary(run: Run) -> dict[str, Any]:
    """Which cases are done, the numbers of every model, and the verdicts, as plain data that the run keeps."""
    digest = digest_of(run)
    found = verdicts(digest)
    return {
        "done": len(run.cases),
        "failed": list(run.failed),
        "missing": list(run.missing),
        "stopped": [one._asdict() for one in stopped_models(digest)],
        "unanswered": digest.unanswered,
        "metrics": headline_metrics(run),
        "answers": told(found),
        "table": terminal_rows(digest),  # for the terminal; the JSON output leaves it out
    } | found.as_data()


def terminal_rows(digest: Digest) -> list[dict[str, str]]:
    """Rows of a table in 80 columns: a line for each model, and one for the worst of several cases."""
    rows: list[dict[str, str]] = []
    metrics = {"displacement": VECTOR, "change of shape": DEFORMATION} if digest.compared else {}
    for name, cost in digest.figures.items():
        spreads = {key: digest.spread(name, metric) for key, metric in metrics.items()}
        errors = {key: percent(spread.value) if spread else NOTHING for key, spread in spreads.items()}
        if name == digest.reference:
            bars = {key: median_known(digest.bars(of)) for key, of in metrics.items()}
            errors = {
                key: f"± {percent(bar)}" if math.isfinite(bar) else NOTHING for key, bar in bars.items()
            }
        times = {"set-up": quantity(cost.set_up, "s"), "per frame": quantity(cost.frame, "s")}
        rows.append({"model": name, **errors, **times})
        if any(spread and spread.cases > 1 for spread in spreads.values()):
            worst = {key: percent(spread.worst) if spread else NOTHING for key, spread in spreads.items()}
            rows.append({"model": "  worst case", **worst, **dict.fromkeys(times, "")})
    return rows


def headline_metrics(run: Run) -> dict[str, dict[str, dict[str, Any]]]:
    """Model -> measure -> median `value`, worst, error bars, unit and number of cases; None for unknown numbers.

    Times also have "measured": the remarks beside them in the table.
    """
    digest = digest_of(run)
    units = {metric: unit for metric, (_, unit) in ERRORS.items()} | {DRIFT: "1"}
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for name, known in digest.figures.items():
        times = {"seconds_setup": known.set_up, "seconds_per_step": known.frame}
        costs = {key: (value, "s") for key, value in times.items()}
        costs |= {"seconds_everywhere": (known.everywhere, "s"), "peak_bytes": (known.memory, "B")}
        spreads = {metric: (digest.spread(name, metric), unit) for metric, unit in units.items()}
        spreads |= {key: (Spread(value, cases=known.cases), unit) for key, (value, unit) in costs.items()}
        found[name] = {
            key: plain(spread) | {"unit": unit}
            for key, (spread, unit) in spreads.items()
            if spread is not None
        }
        for key in times:
            found[name][key]["measured"] = list(known.marks)
    return found
