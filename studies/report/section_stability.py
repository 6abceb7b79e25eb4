"""Numerical stability: along each parameter that is raised alone, where each solver is right and what ends it."""

from __future__ import annotations

from ..verdict.digest import Digest
from ..verdict.formatting import NOTHING, listed, parameter_name
from ..verdict.ladders import (
    BEYOND_LINEAR,
    DIFFERENT,
    LEFT,
    RESIDUAL,
    SINGLE_RESIDUAL,
    Ladder,
    Reading,
    alike,
    ladders,
)
from .blocks import Cell, Field, Section, Text, frame_table

Row = tuple[Ladder, list[str], tuple[float, Reading] | None]
ONE_AT_A_TIME, CLAIM = "one-at-a-time", 9
_READING = (
    "A solver breaks down where a step does not converge, its relative residual is above "
    f"{RESIDUAL:g} ({SINGLE_RESIDUAL:g} in single precision), its answer is more than {DIFFERENT:g} of the "
    "displacement away from the trusted solver of the same system (refined, else direct), or more than "
    f"{LEFT:g} of the displacement is left without load. A linear answer is beyond-linear where it adds more than "
    f"{100 * BEYOND_LINEAR:g} % to the volume in second order."
)


def numerical_stability(digest: Digest) -> Section | None:
    """A row for each end of what solvers stand, of a study that raises each parameter alone or tries claim 9."""
    asked = digest.run.study.sweep.mode == ONE_AT_A_TIME or CLAIM in digest.run.study.study.claims
    found = ladders(digest) if asked else []
    if not found:
        return None
    silent = [
        f"{model} at {parameter_name(ladder.key)} {ladder.text(value)}"
        for ladder in found
        for model, readings in ladder.readings.items()
        for value, reading in zip(ladder.values, readings, strict=True)
        if reading is not None and reading.silent
    ]
    rows: list[Row] = [
        (ladder, models, side)
        for ladder in found
        for models in alike(ladder)
        for side in ladder.breakdowns(models[0]) or (None,)
    ]

    def right(row: Row) -> str:
        ladder, models, _ = row
        sound = ladder.sound_range(models[0])
        return " to ".join(ladder.text(ladder.values[k]) for k in sound) if sound else "nowhere"

    def status(row: Row) -> Cell:
        side = row[2]
        return (
            Cell(side[1].code, side[1].message, tone="bad" if side[1].silent else "")
            if side
            else Cell(NOTHING)
        )

    fields = [
        Field("Ladder", lambda row: parameter_name(row[0].key)),
        Field("Solver", lambda row: "all" if len(row[1]) == len(row[0].readings) > 1 else ", ".join(row[1])),
        Field("Right", right),
        Field("Breaks down first at", lambda row: row[0].text(row[2][0]) if row[2] else "nowhere"),
        Field("Status", status),
        Field("Remedy", lambda row: row[2][1].remedy if row[2] else None),
    ]
    wrong = (
        f"Called converged and not right: {listed(silent)}."
        if silent
        else "No step called converged is wrong."
    )
    table = frame_table(rows, fields, "stability", open_rows=60)
    return Section("stability", "Numerical stability", [Text(wrong), table, Text(_READING, kind="note")])
