"""Models against a measurement: what was measured, what each says of it, and whether the error can be told."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes

from solver_common.arrays import Array, Mask

from ..measures.case import CaseResult
from ..measures.measurement import FORCE, Measurement, Quantity
from ..study.measured import AXES
from ..verdict.digest import Digest
from ..verdict.formatting import NOTHING, listed, plain, quantity, scale_of, short_percent
from .blocks import Block, Cell, Field, Figure, Figures, Section, Table, Text, frame_table
from .plots import Curve, Plot, draw, lines, name_ticks
from .svg import INK

_MOST_DRAWN = 40  # quantities of a figure
_ON = 1e-9  # m: closer is rounding
_READING = (
    "E is the answer of a model less what was measured. ± is the validation uncertainty u_val (ASME V&V 20-2009), "
    "√(u_num² + u_input² + u_D²). Where |E| is at most u_val, model and measurement agree as far as anybody can "
    "tell. Where it is larger, at least |E| − u_val is an error of the model{inputs}. Each part is told by its "
    "root mean square. u_num is known of the reference alone, from its mesh levels. {known}"
)
_KNOWN = (
    "u_input is what comes of not knowing the inputs better than [inputs] says. Where a part is not known, u_val "
    "is too small, and less is within it."
)
_NOT_KNOWN = "u_input is not counted: this study does not tell how well its inputs are known."


def against_measurement(digest: Digest) -> Section | None:
    """Every case that was measured: a table of its quantities by model, and a figure; None where none was."""
    cases = [case for case in digest.cases if case.measurement is not None]
    if not cases:
        return None
    blocks: list[Block] = []
    for number, case in enumerate(cases):
        found = case.measurement
        if found is None:
            continue
        name = digest.case_name(case) if len(digest.cases) > 1 else ""
        blocks.append(Text(_sentence(found, name)))
        blocks += [_summary(digest, case, found, number, unit) for unit in _units(found)]
        if figures := [figure for make in (_figure, _curves) for figure in make(digest, case, found, number)]:
            blocks.append(Figures(figures, digest.legend))
        blocks.append(_details(digest, case, found, number))
    known = any(case.measurement is not None and case.measurement.inputs for case in cases)
    told = {"inputs": "", "known": _KNOWN} if known else {"inputs": " or of its inputs", "known": _NOT_KNOWN}
    blocks.append(Text(_READING.format(**told), kind="note"))
    return Section("measurement", "Against measurement", blocks)


def _sentence(found: Measurement, name: str) -> str:
    sources = listed(f"{table} ({source})" if source else table for table, source in found.sources.items())
    farthest = max(one.distance for one in found.quantities)
    off = f"at most {quantity(farthest, 'm', 2)} off" if farthest > _ON else "on"
    mapped = (
        f" All points are {off} the mesh." if any(one.component in AXES for one in found.quantities) else ""
    )
    return f"{name + ': ' if name else ''}Measured by {sources}.{mapped}"


def _units(found: Measurement) -> list[str]:
    return list(dict.fromkeys(one.unit for one in found.quantities))


def _summary(digest: Digest, case: CaseResult, found: Measurement, number: int, unit: str) -> Table:
    of_unit = np.array([one.unit == unit for one in found.quantities])
    moved = np.array([one.component in (*AXES, FORCE) for one in found.quantities])

    def known(name: str) -> Mask:
        return np.isfinite(found.error(name)) & of_unit

    def used(name: str) -> Mask:
        """Without distances of a whole surface, which are another kind, where there is something else."""
        return known(name) & moved if (known(name) & moved).any() else known(name)

    def answered(of: Callable[[str], Cell]) -> Callable[[str], Cell | None]:
        return lambda name: of(name) if known(name).any() else None

    def within(name: str) -> Cell:
        count, inside = int(known(name).sum()), int(found.within(name)[known(name)].sum())
        if not count:
            return Cell("no answer", tone="bad")
        return Cell(f"{inside} of {count}", value=inside, tone="" if inside == count else "bad")

    def rms(name: str) -> Cell:
        value = _rms(found.error(name)[used(name)])
        return Cell(quantity(value, unit), value=value)

    def share(name: str) -> Cell:
        size = _rms(found.values[used(name)])
        value = _rms(found.error(name)[used(name)]) / size if size else math.nan
        return Cell(short_percent(value) if size else NOTHING, value=value)

    def part(which: str) -> Callable[[str], Cell]:
        return lambda name: _part(found.parts(name)[which][used(name)], unit)

    def remains(name: str) -> Cell:
        rest = max(0.0, float((np.abs(found.error(name)) - found.uncertainty(name))[known(name)].max()))
        return Cell(quantity(rest, unit) if rest else "nothing", value=rest)

    def frame(name: str) -> float:
        return float(np.median(case.models[name].seconds_per_step)) if name in case.models else math.nan

    names = [name for name in found.simulated if name not in digest.twins]
    fields = [
        Field("Model", lambda name: Cell(name, "came with the measurement" if name in found.others else "")),
        Field("Within u_val", within, "#"),
        Field("rms of E", answered(rms), unit, "of displacements" if unit == "m" else "of forces"),
        Field("of rms of D", answered(share), "1"),
        *(Field(which, answered(part(which)), unit, "rms") for which in found.parts(names[0])),
        Field("Remains", answered(remains), unit, "largest |E| − u_val"),
        Field("Per frame", frame, "s"),
    ]
    suffix = f"-{unit}" if unit != "m" else ""
    return frame_table(names, fields, f"measured-{number}{suffix}", mark=digest.mark)


def _part(values: Array, unit: str) -> Cell:
    """Of u_val, where it is known of every quantity."""
    rms = _rms(values)
    return Cell(quantity(rms, unit, 2), value=rms) if math.isfinite(rms) else Cell(NOTHING)


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def _details(digest: Digest, case: CaseResult, found: Measurement, number: int) -> Table:
    units = " or ".join(_units(found))

    def error(name: str) -> Callable[[int], Cell]:
        errors, bars, within = found.error(name), found.uncertainty(name), found.within(name)

        def of(k: int) -> Cell:
            unit, value = found.quantities[k].unit, float(errors[k])
            known = math.isfinite(value)
            detail = f"± {quantity(float(bars[k]), unit, 2)}" if known else ""
            return Cell(quantity(value, unit), detail, value, tone="bad" if known and not within[k] else "")

        return of

    def measured(k: int) -> Cell:
        one = found.quantities[k]
        return Cell(quantity(one.value, one.unit), f"± {quantity(one.uncertainty, one.unit, 2)}", one.value)

    fields = [
        Field(
            "Quantity",
            lambda k: Cell(_named(found.quantities[k], case), found.quantities[k].table),
            detail="at its load factor" if len(case.load_factors) > 1 else "",
        ),
        Field("Measured", measured, units, "± u_D"),
        *(
            Field(name, error(name), units, "E ± u_val")
            for name in found.simulated
            if name not in digest.twins
        ),
    ]
    return frame_table(range(len(found.quantities)), fields, f"measured-points-{number}")


def _named(one: Quantity, case: CaseResult) -> str:
    if one.component == FORCE:
        return f"force of {one.point} at {quantity(one.depth, 'm')}"
    name = " ".join(filter(None, (one.point, one.component)))
    return f"{name} at {plain(float(case.load_factors[one.step]))}" if len(case.load_factors) > 1 else name


def _figure(digest: Digest, case: CaseResult, found: Measurement, number: int) -> list[Figure]:
    """Bars of the components that were measured at points."""
    drawn = [k for k, one in enumerate(found.quantities) if one.component in AXES][:_MOST_DRAWN]
    if not drawn:
        return []
    places = np.arange(len(drawn), dtype=float)
    data = 1e3 * found.values[drawn]
    bars = [1e3 * found.quantities[k].uncertainty for k in drawn]
    plot = Plot("measured quantity", "displacement [mm]", f"measured{number}")
    described = []
    gap = 0.8 / (1 + len(digest.models))  # a quantity's models end before the next quantity
    with plot as axes:
        axes.vlines(places, data - bars, data + bars, colors=INK, linewidth=2.2)
        axes.plot(places, data, "_", color=INK, markersize=11)
        for name in found.simulated:
            if name not in digest.models:
                continue
            x, y = places + gap * (1 + digest.models.index(name)), 1e3 * found.simulated[name][drawn]
            draw(axes, digest.colour(name), name, x, y, named=False, linestyle="none", markersize=4)
            described.append(name)
        ticks = [(float(x), _named(found.quantities[k], case)) for x, k in zip(places, drawn, strict=True)]
        name_ticks(axes, ticks)
    heading = "Measured (bars: ± u_D) and simulated"
    return [Figure(plot.drawn(f"{heading}: {listed(described)}."), heading)]


def _curves(digest: Digest, _: CaseResult, found: Measurement, number: int) -> list[Figure]:
    """Of each constraint whose force was measured the force against depth, measured and simulated."""
    figures: list[Figure] = []
    for name in dict.fromkeys(one.point for one in found.quantities if one.component == FORCE):
        mine = [k for k, one in enumerate(found.quantities) if (one.point, one.component) == (name, FORCE)]
        depths = np.array([found.quantities[k].depth for k in mine])
        order = np.argsort(depths)
        mine, depths = [mine[k] for k in order], depths[order]
        force, unit = scale_of("N", [found.quantities[k].value for k in mine])
        length, length_unit = scale_of("m", depths)
        curves = [
            Curve(model, depths / length, found.simulated[model][mine] / force, look={"markersize": 4})
            for model in digest.models
            if model in found.simulated
        ]
        values = found.values[mine] / force
        bars = np.array([found.quantities[k].uncertainty for k in mine]) / force

        def finish(
            axes: Axes, x: Array = depths / length, values: Array = values, bars: Array = bars
        ) -> None:
            axes.vlines(x, values - bars, values + bars, colors=INK, linewidth=2.2)
            axes.plot(x, values, "_", color=INK, markersize=11)
            axes.set_xlim(left=0.0)
            axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))

        title = f"Force of {name} against depth, measured (bars: ± u_D) and simulated"
        labels = f"depth [{length_unit}]", f"force [{unit}]"
        salt = f"curve{number}-{len(figures)}"
        figures.append(
            lines(digest, curves, *labels, title, salt, finish=finish, shown=lambda f: plain(f, 3))
        )
    return figures


SECTIONS_FIRST = (against_measurement,)
