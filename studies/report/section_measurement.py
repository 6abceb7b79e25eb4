"""Models against a measurement, and the effect of uncertain inputs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from solver_common.arrays import Array, Index

from ..measures.case import CaseResult
from ..measures.measurement import FORCE, STRAIGHT, InputSpread, Measurement, Quantity
from ..measures.metrics import VECTOR
from ..study.measured import AXES
from ..verdict.digest import SAME_NUMBERS, Digest
from ..verdict.formatting import (
    NOTHING,
    input_name,
    percent,
    plain,
    quantity,
    scale_of,
    short_percent,
    swept_value,
)
from .blocks import Block, Cell, Field, Figure, Figures, Section, Table, frame_table, note
from .plots import INK, Curve, from_origin, lines, name_ticks

_MOST_DRAWN = 40  # most quantities in a figure


def against_measurement(digest: Digest) -> Section | None:
    """Tables and figures of every case with a measurement; None if there is none."""
    cases = [(case, case.measurement) for case in digest.cases if case.measurement is not None]
    blocks: list[Block] = []
    for number, (case, found) in enumerate(cases):
        name = digest.case_name(case) if len(digest.cases) > 1 else ""
        farthest = max(one.distance for one in found.quantities)
        blocks.append(note("measured_by", name, found.sources, farthest, kind="plain"))
        units = list(dict.fromkeys(one.unit for one in found.quantities))
        blocks += [_summary(digest, found, number, unit) for unit in units]
        if figures := list(_figures(digest, case, found, number)):
            blocks.append(Figures(figures))
        blocks.append(_details(case, found, number, " or ".join(units)))
    if not blocks:
        return None
    return Section("measurement", "Against measurement", [*blocks, note("measurement")])


def _summary(digest: Digest, found: Measurement, number: int, unit: str) -> Table:
    of_unit = np.array([one.unit == unit for one in found.quantities])
    moved = np.array([one.component in (*AXES, FORCE) for one in found.quantities]) & of_unit

    def rows(name: str) -> Index:
        """The quantities for which a model has an answer."""
        return np.flatnonzero(np.isfinite(found.error(name)) & of_unit)

    def used(name: str, values: Array) -> float:
        """Root mean square over displacements and forces; over distances of surfaces if there are no others."""
        known = rows(name)
        chosen = known[moved[known]] if moved[known].any() else known
        return float(np.sqrt((values[chosen] ** 2).mean())) if len(chosen) else math.nan

    def within(name: str) -> Cell:
        count, inside = len(rows(name)), int(found.within(name)[rows(name)].sum())
        if not count:
            return Cell("no answer", tone="bad")
        return Cell(f"{inside} of {count}", value=inside, tone="" if inside == count else "bad")

    def beside(other: str) -> Callable[[str], Cell | None]:
        def of(name: str) -> Cell | None:
            both = np.intersect1d(rows(name), rows(other))
            both = both[np.isfinite(found.numerical[other][both])]
            if name == other or not len(both):
                return None
            inside = int(found.as_good_as(name, other)[both].sum())
            return Cell(f"{inside} of {len(both)}", value=inside)

        return of

    def share(name: str) -> Cell:
        size = used(name, found.values)
        ratio = used(name, found.error(name)) / size if size else math.nan
        return Cell(short_percent(ratio) if math.isfinite(ratio) else NOTHING, value=ratio)

    def part(which: str) -> Any:
        return lambda name: used(name, found.parts(name)[which])

    def remains(name: str) -> Cell | None:
        if not len(rows(name)):
            return None
        rest = max(0.0, float((np.abs(found.error(name)) - found.uncertainty(name))[rows(name)].max()))
        return Cell(quantity(rest, unit) if rest else "nothing", value=rest)

    names = list(found.simulated)
    fields = [
        Field("Model", lambda name: Cell(name, "came with the measurement" if name in found.others else "")),
        Field("Within u_val", within, "#"),
        *(Field(f"Within u_num of {other}", beside(other), "#") for other in found.with_levels),
        Field(
            "rms of E",
            lambda name: used(name, found.error(name)),
            unit,
            "of displacements" if unit == "m" else "of forces",
        ),
        Field("of rms of D", share, "1"),
        *(Field(which, part(which), unit, "rms") for which in found.parts(names[0])),
        Field("Remains", remains, unit, "largest |E| − u_val"),
    ]
    suffix = f"-{unit}" if unit != "m" else ""
    return frame_table(names, fields, f"measured-{number}{suffix}", mark=digest.mark)


def _details(case: CaseResult, found: Measurement, number: int, units: str) -> Table:
    def error(name: str) -> Callable[[int], Cell]:
        errors, bars, within = found.error(name), found.uncertainty(name), found.within(name)

        def of(k: int) -> Cell:
            unit, value = found.quantities[k].unit, float(errors[k])
            known = math.isfinite(value)
            detail = f"± {quantity(float(bars[k]), unit, 2)}" if known else ""
            tone = "bad" if known and not within[k] else ""
            return Cell(quantity(value, unit), detail, value, tone, float(bars[k]))

        return of

    def measured(k: int) -> Cell:
        one = found.quantities[k]
        told = f"± {quantity(one.uncertainty, one.unit, 2)}"
        return Cell(quantity(one.value, one.unit), told, one.value, bar=one.uncertainty)

    at_factor = "at its load factor" if len(case.load_factors) > 1 else ""
    fields = [
        Field(
            "Quantity",
            lambda k: Cell(_named(found.quantities[k], case), found.quantities[k].table),
            detail=at_factor,
        ),
        Field("Measured", measured, units, "± u_D"),
        *(Field(name, error(name), units, "E ± u_val") for name in found.simulated),
    ]
    return frame_table(range(len(found.quantities)), fields, f"measured-points-{number}")


def _named(one: Quantity, case: CaseResult) -> str:
    if one.component == FORCE:
        return f"force of {one.point} at {quantity(one.depth, 'm')}"
    name = " ".join(filter(None, (one.point, one.component)))
    return f"{name} at {plain(float(case.load_factors[one.step]))}" if len(case.load_factors) > 1 else name


def _figures(digest: Digest, case: CaseResult, found: Measurement, number: int) -> Iterator[Figure]:
    """A figure of the displacements at points, and one of force against depth for each measured force."""
    groups: dict[str, list[int]] = {}
    for k, one in enumerate(found.quantities):
        if one.component in (*AXES, FORCE):
            groups.setdefault(one.point if one.component == FORCE else "", []).append(k)
    models = [model for model in digest.models if model in found.simulated]
    for force_of, rows in groups.items():
        mine = sorted(rows, key=lambda k: found.quantities[k].depth)[:_MOST_DRAWN]
        quantities, values = [found.quantities[k] for k in mine], found.values[mine]
        size, unit = scale_of(quantities[0].unit, values)
        if force_of:
            depths = np.array([one.depth for one in quantities])
            length, length_unit = scale_of("m", depths)
            x, gap, names, look = depths / length, 0.0, [], {}
            title, labels = (
                f"Force of {force_of} against depth, measured",
                (f"depth [{length_unit}]", "force"),
            )
        else:  # the models' points are beside the measured one, before that of the next quantity
            x, gap, look = np.arange(len(mine), dtype=float), 0.8 / (1 + len(models)), {"linestyle": "none"}
            names = [(float(k), _named(one, case)) for k, one in enumerate(quantities)]
            title, labels = "Measured", ("measured quantity", "displacement")
        curves = [
            Curve(
                model, x + gap * (1 + k), found.simulated[model][mine] / size, look={"markersize": 4} | look
            )
            for k, model in enumerate(models)
        ]
        bars = np.array([one.uncertainty for one in quantities])
        yield lines(
            digest,
            curves,
            labels[0],
            f"{labels[1]} [{unit}]",
            f"{title} (bars: ± u_D) and simulated",
            f"measured{number}-{force_of or 'points'}",
            finish=partial(_draw_measured, x=x, values=values / size, bars=bars / size, names=names),
        )


def _draw_measured(axes: Axes, x: Array, values: Array, bars: Array, names: list[tuple[float, str]]) -> None:
    axes.vlines(x, values - bars, values + bars, colors=INK, linewidth=2.2)
    axes.plot(x, values, "_", color=INK, markersize=11)
    if names:
        name_ticks(axes, names)
    else:
        from_origin(axes)


def inputs(digest: Digest) -> Section | None:
    """The effect of uncertain inputs in the first case that has it, a key case if possible; None if none has it."""
    cases = [*(case for _, case in digest.key_cases), *digest.cases]
    case = next((case for case in cases if case.inputs is not None), None)
    if case is None or (first := case.inputs) is None:
        return None
    caption = digest.case_name(case) if len(digest.cases) > 1 else ""
    bent = any(model.bend > STRAIGHT for model in first.models.values())
    blocks: list[Block] = [
        _table(digest, case, first, "inputs", caption),
        note("inputs", bent, _moves_nothing(first)),
    ]
    return Section("inputs", "What is not known of the inputs", blocks)


def _moves_nothing(spread: InputSpread) -> list[str]:
    """Inputs of regions' shapes that change no answer by more than rounding."""
    return [
        key
        for k, key in enumerate(spread.keys)
        if key.startswith("regions.") and all(one.parts[k] <= SAME_NUMBERS for one in spread.models.values())
    ]


def _table(digest: Digest, case: CaseResult, spread: InputSpread, name: str, caption: str) -> Table:
    def part(k: int) -> Any:
        return lambda model: float(spread.models[model].parts[k])

    def error(model: str) -> Cell:
        value = digest.at(case, model, VECTOR)
        lost = math.isfinite(value) and value < spread.models[model].displacement
        return Cell(percent(value), "below what is not known" if lost else "", value)

    fields = [Field("Model", lambda model: model)]
    for k, (key, unit) in enumerate(zip(spread.keys, spread.units, strict=True)):
        value, deviation = float(spread.values[k]), float(f"{spread.deviations[k]:.3g}")
        known = f"{swept_value(value, unit)} ± {swept_value(deviation, unit)}"
        fields.append(Field(input_name(key), part(k), "1", known))
    fields += [
        Field("All inputs", lambda model: spread.models[model].displacement, "1", "of the displacement"),
        Field("All inputs", lambda model: spread.models[model].deformation, "1", "of the change of shape"),
        Field("Its error", error, "1", "against the reference"),
    ]
    return frame_table(list(spread.models), fields, name, caption=caption, mark=digest.mark)
