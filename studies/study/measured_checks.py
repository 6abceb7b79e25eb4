"""What is wrong with [[measured]] tables, each with the rest of the study."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from .measured_table import Measured, same_load
from .problems import Finding, Loc
from .schema import Study
from .units import shown
from .wording import named_twice, unknown


def check_measured(study: Study) -> Iterator[Finding]:
    """What is wrong with the measured tables, each with the rest of the study."""
    yield from named_twice("measured", study.measured or (), "table")
    for place, table in enumerate(study.measured or ()):
        loc = ("measured", place)
        kinds = [name for name in ("points", "surface", "forces") if getattr(table, name)]
        if not kinds:
            yield loc, "has no values: give path, points, surface or forces"
        if len(kinds) > 1:
            yield loc, f"has {' and '.join(kinds)}; give a table to each"
        own: Sequence[Any] = table.points or [table] * bool(table.surface)
        yield from _check_uncertainty("uncertainty", table.uncertainty, own, loc)
        if table.forces:
            yield from _check_forces(study, table, loc)
        if (table.swept is None) != (table.at is None):
            yield (*loc, "swept"), "swept and at belong together: a swept key and its value"
        yield from _check_factors(study, table, place)


def pushing(study: Study) -> list[str]:
    """Names of the constraints whose force goes with a depth: contacts, indenters, and movements of a region."""
    return [
        part.name
        for part in study.constraints or ()
        if part.kind in ("contact", "indenter")
        or (part.kind == "constrained" and any(part.displacement or ()))
    ]


def _check_forces(study: Study, table: Measured, loc: Loc) -> Iterator[Finding]:
    yield from _check_uncertainty("force_uncertainty", table.force_uncertainty, table.forces, loc)
    names = pushing(study)
    if table.constraint is not None and table.constraint not in names:
        yield (*loc, "constraint"), unknown(table.constraint, names, "contact, indenter or movement")
        return
    if table.constraint is None and len(names) != 1:
        told = f"several push: {', '.join(names)}; name one" if names else "nothing pushes the body"
        yield (*loc, "constraint"), told
        return
    name = table.constraint or names[0]
    part = next(part for part in study.constraints if part.name == name)
    if part.kind == "contact" and part.force is None and part.profile not in (None, "uniform"):
        yield (
            (*loc, "constraint"),
            f"{shown(name)} has a pressure of a {part.profile} profile; give its force instead",
        )


def _check_uncertainty(key: str, given: float | None, rows: Sequence[Any], loc: Loc) -> Iterator[Finding]:
    bare = next((row for row in rows if row.uncertainty is None), None)
    if given is None and bare is not None:
        where = f" (line {bare.line})" if getattr(bare, "line", None) else ""
        text = (
            f"is missing{where}: without u_D nobody can tell an error from noise; give a standard uncertainty"
        )
        yield (*loc, key), text


def check_measured_cases(study: Study, axes: Mapping[str, tuple[Sequence[Any], str]]) -> Iterator[Finding]:
    """Tables that belong to no case; `axes` has the values and the SI unit of each swept key."""
    for place, table in enumerate(study.measured or ()):
        if table.swept is None or table.at is None:
            continue
        if table.swept not in axes:
            told = ", ".join(axes) or "nothing"
            yield ("measured", place, "swept"), f"{shown(table.swept)} is not swept; swept here: {told}"
            continue
        values, unit = axes[table.swept]
        if not any(table.belongs_to({table.swept: value}, {table.swept: unit}) for value in values):
            yield ("measured", place, "at"), f"{shown(str(table.at))} is none of the values of {table.swept}"


def _check_factors(study: Study, table: Measured, place: int) -> Iterator[Finding]:
    if study.load is None or not study.load.factors:
        return
    history = study.load.history
    largest = max(map(abs, history))
    for point in (None, *table.points):
        factor = table.factor(point)
        if factor is not None and not any(same_load(factor, step, largest) for step in history):
            where = f" (line {point.line} of its file)" if point is not None and point.line else ""
            steps = ", ".join(f"{step:g}" for step in history[:8])
            yield (
                ("measured", place, "load_factor"),
                f"{factor:g}{where} is no step of the load history, which has {steps}",
            )
            return
