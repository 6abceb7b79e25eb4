"""Numerical stability: residual, condition and drift of each solver along each ladder, and where it breaks down."""

from __future__ import annotations

import math
from collections.abc import Sequence

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
from .blocks import Block, Cell, Column, Figure, Figures, Section, Table, Text
from .plots import Plot, colour, draw, log_axis, name_ticks, place

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
    blocks.append(_solvers(digest, found))
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


# --- the tables ---


def _solvers(digest: Digest, found: Sequence[Ladder]) -> Table:
    """One row for each solver: how far its measures went where it was right, and where it was not."""
    columns = [
        Column("Solver", numeric=False),
        Column("Condition", "up to"),
        Column("Residual", "up to"),
        Column("From trusted", "up to"),
        Column("Volume drift", "on the study's own values"),
        Column("Left without load", "up to"),
        Column("Breaks down at", numeric=False),
    ]
    rows: list[list[Cell]] = []
    marks: list[int | None] = []
    for model in dict.fromkeys(name for ladder in found for name in ladder.readings):
        on = [ladder for ladder in found if model in ladder.readings]
        right = [r for ladder in on for r in ladder.readings[model] if r is not None and r.ok]
        ends = [
            f"{parameter_name(ladder.key)} {ladder.text(value)}"
            for ladder in on
            for value, _ in ladder.breakdowns(model)
        ]
        measures = [
            _most(right, "condition"),
            _most(right, "residual"),
            _most(right, "difference"),
            _on_base(on, model),
            _most(right, "left"),
        ]
        rows.append(
            [
                Cell(model),
                *(Cell(f"{v:.1e}" if math.isfinite(v) else NOTHING, value=v) for v in measures),
                Cell("; ".join(ends)) if ends else Cell("nowhere", tone="muted"),
            ]
        )
        marks.append(digest.colour(model))
    kept = [k for k in range(len(columns)) if not 0 < k < 6 or any(row[k].text != NOTHING for row in rows)]
    return Table(
        "stability_solvers",
        "What each solver stands",
        [columns[k] for k in kept],
        [[row[k] for k in kept] for row in rows],
        marks,
        open_rows=60,
    )


def _most(readings: Sequence[Reading], measure: str) -> float:
    """The largest finite value, NaN where there is none."""
    values = [getattr(reading, measure) for reading in readings]
    return max((value for value in values if math.isfinite(value)), default=math.nan)


def _on_base(found: Sequence[Ladder], model: str) -> float:
    """The drift of a model in the case that all ladders start from, NaN where it is on none of them."""
    for ladder in found:
        if ladder.base in ladder.values:
            reading = ladder.readings[model][ladder.values.index(ladder.base)]
            return reading.drift if reading is not None and reading.ok else math.nan
    return math.nan


def _table(digest: Digest, found: Sequence[Ladder]) -> Table:
    columns = [
        Column("Ladder", numeric=False),
        Column("Solver", numeric=False),
        Column("Right", "from"),
        Column("Right", "to"),
        Column("Breaks down", "first at"),
        Column("Status", numeric=False),
        Column("Remedy", numeric=False),
    ]
    rows: list[list[Cell]] = []
    marks: list[int | None] = []
    for ladder in found:
        name = parameter_name(ladder.key)
        for models in alike(ladder):
            who = Cell(_who(models, ladder))
            right = _right(ladder, models[0])
            sides = [_breakdown(ladder, *side) for side in ladder.breakdowns(models[0])]
            for side in sides or [(Cell("nowhere", tone="muted"), Cell(NOTHING), Cell(NOTHING))]:
                rows.append([Cell(name), who, *right, *side])
                marks.append(digest.colour(models[0]) if len(models) == 1 else None)
    return Table("stability", "Where, and what the status says", columns, rows, marks, open_rows=60)


def _who(models: Sequence[str], ladder: Ladder) -> str:
    if len(models) == len(ladder.readings) > 1:
        return "all"
    if not ladder.breakdowns(models[0]) and len(ladder.readings) > len(models) > 0.6 * len(ladder.readings):
        return "all others"
    return ", ".join(models)


def _right(ladder: Ladder, model: str) -> list[Cell]:
    sound = ladder.sound_range(model)
    if sound is None:
        return [Cell("nowhere", tone="bad"), Cell(NOTHING)]
    return [Cell(ladder.text(ladder.values[k]), value=ladder.values[k]) for k in sound]


def _breakdown(ladder: Ladder, value: float, reading: Reading) -> tuple[Cell, Cell, Cell]:
    at = Cell(ladder.text(value), value=value)
    tone = "bad" if reading.silent else ""
    return at, Cell(reading.code, reading.message, tone=tone), Cell(reading.remedy or NOTHING)


# --- the figures ---


def _figure(digest: Digest, ladder: Ladder, measure: str, salt: str) -> Figure | None:
    """One measure of every model along a ladder; None where no model has it."""
    factor, unit = scale_of(ladder.unit, ladder.values)
    kind, where = place([value / factor for value in ladder.values])
    x = [where[value / factor] for value in ladder.values]
    name = parameter_name(ladder.key)
    plot = Plot(f"{name} [{unit}]" if unit else name, _TITLES[measure], salt)
    told = []
    with plot as axes:
        for rank, (model, readings) in enumerate(ladder.readings.items()):
            values = [getattr(r, measure) if r is not None else math.nan for r in readings]
            points = [(a, max(b, _FLOOR)) for a, b in zip(x, values, strict=True) if math.isfinite(b)]
            if not points:
                continue
            k = digest.colour(model)
            draw(axes, k, model, *zip(*points, strict=True))
            told.append(f"{model} from {min(b for _, b in points):.1e} to {max(b for _, b in points):.1e}")
            broken = [a for a, r in zip(x, readings, strict=True) if r is not None and not r.ok]
            height = 0.98 - 0.035 * (rank % 12)
            axes.plot(
                broken,
                [height] * len(broken),
                "x",
                color=colour(k),
                transform=axes.get_xaxis_transform(),
            )
        if not told:
            return None
        log_axis(axes, "y")
        if kind == "log":
            log_axis(axes, "x")
        elif kind == "even":
            name_ticks(axes, [(p, swept_value(value, "1")) for value, p in where.items()])
    return Figure(plot.drawn(f"{_TITLES[measure]} against {name}: {listed(told)}."), _TITLES[measure])
