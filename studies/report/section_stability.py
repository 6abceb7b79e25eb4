"""Numerical stability: residual, condition and drift of each solver along each ladder, and where it breaks down."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from matplotlib.axes import Axes

from ..verdict.digest import Digest
from ..verdict.formatting import NOTHING, listed, parameter_name, plural, scale_of, swept_value
from ..verdict.ladders import (
    BEYOND_LINEAR,
    DIFFERENT,
    LEFT,
    MEASURES,
    RESIDUAL,
    SINGLE_RESIDUAL,
    Ladder,
    Reading,
    alike,
    ladders,
)
from .blocks import Block, Cell, Field, Figure, Figures, Section, Table, Text, frame_table
from .plots import Curve, colour, lines, log_axis, name_ticks, place

ONE_AT_A_TIME, CLAIM = "one-at-a-time", 9
_FLOOR = 1e-17  # what is smaller, or zero, is drawn here
_TITLES = {
    "residual": "Relative residual",
    "condition": "Condition estimate",
    "difference": "Difference from the trusted solver",
    "drift": "Volume drift",
    "left": "Displacement left without load",
}


def numerical_stability(digest: Digest) -> Section | None:
    """For a study that raises each parameter alone, or tries claim 9: figures per ladder, a table of breakdowns."""
    asked = digest.run.study.sweep.mode == ONE_AT_A_TIME or CLAIM in digest.run.study.study.claims
    found = ladders(digest) if asked else []
    if not found:
        return None
    blocks: list[Block] = [Text(sentence) for sentence in _verdict(found)]
    blocks.append(_table(digest, found))
    blocks.append(Text(_reading_note(), kind="note"))
    for number, ladder in enumerate(found):
        figures = [
            figure
            for measure in MEASURES
            if (figure := _figure(digest, ladder, measure, f"b{number}{measure[:3]}"))
        ]
        if figures:
            legend = [entry for entry in digest.legend if entry[1] in ladder.readings]
            summary = f"Along the {parameter_name(ladder.key)}, {_ends(ladder)}"
            blocks.append(Figures(figures, legend, summary))
    return Section("stability", "Numerical stability", blocks)


def _ends(ladder: Ladder) -> str:
    return f"{ladder.text(ladder.values[0])} to {ladder.text(ladder.values[-1])}"


def _verdict(found: Sequence[Ladder]) -> list[str]:
    pairs = [(ladder, model) for ladder in found for model in ladder.readings]
    broken = [pair for pair in pairs if pair[0].breakdowns(pair[1])]
    silent = [
        f"{model} at {parameter_name(ladder.key)} {ladder.text(value)}"
        for ladder, model in pairs
        for value, reading in zip(ladder.values, ladder.readings[model], strict=True)
        if reading is not None and reading.silent
    ]
    count = f"{plural(len(pairs), 'pair')} of a solver and a ladder"
    sentences = [
        f"Of {count}, {len(pairs) - len(broken)} are right from end to end and {len(broken)} break down."
    ]
    if silent:
        sentences.append(f"Called converged and not right: {listed(silent)}.")
    else:
        sentences.append(
            "Every breakdown is a status with its remedy; no step that is called converged is wrong."
        )
    return sentences


def _reading_note() -> str:
    return (
        "A ladder raises one parameter alone; the others are those of the study. A solver breaks down where one of "
        "four things happens. A step does not converge. Its relative residual is above "
        f"{RESIDUAL:g} ({SINGLE_RESIDUAL:g} in single precision). Its answer is more than {DIFFERENT:g} of the "
        "displacement away from the trusted solver of the same system: the refined one where the study runs it, "
        f"else the direct one in double precision. More than {LEFT:g} of the displacement is left without load. "
        "A linear answer is beyond-linear where it adds more than "
        f"{100 * BEYOND_LINEAR:g} % to the volume in second order. Crosses mark values at which a solver breaks "
        "down. Every measure is the worst of the load history. Zero is drawn at 1e-17."
    )


# --- the table ---


class _Side(NamedTuple):
    """One end of where models that come out alike are right; `value` is None where they break down nowhere."""

    ladder: Ladder
    models: Sequence[str]
    value: float | None
    reading: Reading | None


def _table(digest: Digest, found: Sequence[Ladder]) -> Table:
    rows = []
    for ladder in found:
        for models in alike(ladder):
            sides = [_Side(ladder, models, *side) for side in ladder.breakdowns(models[0])]
            rows += sides or [_Side(ladder, models, None, None)]

    def right(end: int) -> Any:
        def of(row: _Side) -> Cell:
            sound = row.ladder.sound_range(row.models[0])
            if sound is None:
                return Cell(NOTHING) if end else Cell("nowhere", tone="bad")
            value = row.ladder.values[sound[end]]
            return Cell(row.ladder.text(value), value=value)

        return of

    def breaks(row: _Side) -> Cell:
        return (
            Cell("nowhere", tone="muted")
            if row.value is None
            else Cell(row.ladder.text(row.value), value=row.value)
        )

    def status(row: _Side) -> Cell | None:
        if row.reading is None:
            return None
        return Cell(row.reading.code, row.reading.message, tone="bad" if row.reading.silent else "")

    fields = [
        Field("Ladder", lambda row: parameter_name(row.ladder.key)),
        Field("Solver", lambda row: _who(row.models, row.ladder)),
        Field("Right", right(0), "#", "from"),
        Field("Right", right(1), "#", "to"),
        Field("Breaks down", breaks, "#", "first at"),
        Field("Status", status),
        Field("Remedy", lambda row: row.reading.remedy if row.reading is not None else None),
    ]
    return frame_table(rows, fields, "stability", mark=lambda row: _mark(digest, row.models), open_rows=60)


def _mark(digest: Digest, models: Sequence[str]) -> int | None:
    return digest.mark(models[0]) if len(models) == 1 else None


def _who(models: Sequence[str], ladder: Ladder) -> str:
    return "all" if len(models) == len(ladder.readings) > 1 else ", ".join(models)


# --- the figures ---


def _figure(digest: Digest, ladder: Ladder, measure: str, salt: str) -> Figure | None:
    """One measure of every model along a ladder; None where no model has it."""
    factor, unit = scale_of(ladder.unit, ladder.values)
    kind, where = place([value / factor for value in ladder.values])
    x = [where[value / factor] for value in ladder.values]
    name = parameter_name(ladder.key)
    curves, broken = [], []
    for rank, (model, readings) in enumerate(ladder.readings.items()):
        values = [getattr(r, measure) if r is not None else math.nan for r in readings]
        points = [(a, max(b, _FLOOR)) for a, b in zip(x, values, strict=True) if math.isfinite(b)]
        if points:
            curves.append(Curve(model, *zip(*points, strict=True)))
            at = [a for a, r in zip(x, readings, strict=True) if r is not None and not r.ok]
            broken.append((at, 0.98 - 0.035 * (rank % 12), digest.colour(model)))
    if not curves:
        return None

    def finish(axes: Axes) -> None:
        for at, height, number in broken:
            transform = axes.get_xaxis_transform()
            axes.plot(at, [height] * len(at), "x", color=colour(number), transform=transform)
        log_axis(axes, "y")
        if kind == "log":
            log_axis(axes, "x")
        elif kind == "even":
            name_ticks(axes, [(p, swept_value(value, "1")) for value, p in where.items()])

    title, label = _TITLES[measure], f"{name} [{unit}]" if unit else name
    return lines(digest, curves, label, title, title, salt, finish=finish, shown=lambda value: f"{value:.1e}")
