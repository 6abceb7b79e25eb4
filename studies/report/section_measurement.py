"""Models against a measurement: what was measured, what each says of it, and whether the error can be told."""

from __future__ import annotations

import math

import numpy as np

from solver_common.arrays import Array

from ..measures.case import CaseResult
from ..measures.measurement import FORCE, Measurement, Quantity
from ..study.measured_file import AXES
from ..verdict.digest import Digest
from ..verdict.formatting import NOTHING, listed, plain, quantity, scale_of, short_percent
from .blocks import Block, Cell, Column, Figure, Figures, Section, Table, Text
from .plots import Plot, draw, name_ticks
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
        blocks.append(_details(case, found, number))
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
    columns = [
        Column("Model", numeric=False),
        Column("Within u_val"),
        Column("rms of E", "of displacements" if unit == "m" else "of forces", unit=unit),
        Column("of rms of D", unit="1"),
        *(Column(part, "rms", unit=unit) for part in ("u_num", "u_input", "u_D")),
        Column("Remains", "largest |E| − u_val", unit=unit),
        Column("Per frame", unit="s"),
    ]
    names = list(found.simulated)
    rows = [_summary_row(case, found, name, unit) for name in names]
    suffix = f"-{unit}" if unit != "m" else ""
    return Table(f"measured-{number}{suffix}", "", columns, rows, marks=digest.marks(names))


def _summary_row(case: CaseResult, found: Measurement, name: str, unit: str) -> list[Cell]:
    errors, data = found.error(name), found.values
    known = np.isfinite(errors) & np.array([one.unit == unit for one in found.quantities])
    told = Cell(name, "came with the measurement" if name in found.others else "")
    if not known.any():
        return [told, Cell("no answer", tone="bad"), *(Cell(NOTHING) for _ in range(7))]
    count, within = int(known.sum()), int(found.within(name)[known].sum())
    moved = known & np.array([one.component in (*AXES, FORCE) for one in found.quantities])
    used = moved if moved.any() else known  # distances of a whole surface are another kind
    rms, size = _rms(errors[used]), _rms(data[used])
    rest = max(0.0, float((np.abs(errors) - found.uncertainty(name))[known].max()))
    frame = float(np.median(case.models[name].seconds_per_step)) if name in case.models else math.nan
    return [
        told,
        Cell(f"{within} of {count}", value=within, tone="" if within == count else "bad"),
        Cell(quantity(rms, unit), value=rms),
        Cell(short_percent(rms / size) if size else NOTHING, value=rms / size if size else None),
        *(_part(part[used], unit) for part in found.parts(name).values()),
        Cell(quantity(rest, unit) if rest else "nothing", value=rest),
        Cell(quantity(frame, "s"), value=frame),
    ]


def _part(values: Array, unit: str) -> Cell:
    """Of u_val, where it is known of every quantity."""
    rms = _rms(values)
    return Cell(quantity(rms, unit, 2), value=rms) if math.isfinite(rms) else Cell(NOTHING)


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def _details(case: CaseResult, found: Measurement, number: int) -> Table:
    names = list(found.simulated)
    errors = {name: found.error(name) for name in names}
    bars = {name: found.uncertainty(name) for name in names}
    within = {name: found.within(name) for name in names}
    rows = []
    for k, one in enumerate(found.quantities):
        measured = Cell(
            quantity(one.value, one.unit), f"± {quantity(one.uncertainty, one.unit, 2)}", one.value
        )
        cells = []
        for name in names:
            error, bar = float(errors[name][k]), float(bars[name][k])
            tone = "" if within[name][k] or math.isnan(error) else "bad"
            detail = "" if math.isnan(error) else f"± {quantity(bar, one.unit, 2)}"
            cells.append(Cell(quantity(error, one.unit), detail, error, tone=tone))
        rows.append([Cell(_named(one, case), one.table), measured, *cells])
    columns = [
        Column("Quantity", "at its load factor" if len(case.load_factors) > 1 else "", numeric=False),
        Column("Measured", "± u_D", unit=" or ".join(_units(found))),
        *(Column(name, "E ± u_val", unit=" or ".join(_units(found))) for name in names),
    ]
    return Table(f"measured-points-{number}", "", columns, rows)


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
        plot = Plot(f"depth [{length_unit}]", f"force [{unit}]", f"curve{number}-{len(figures)}")
        described = []
        with plot as axes:
            values, bars = (
                found.values[mine] / force,
                np.array([found.quantities[k].uncertainty for k in mine]) / force,
            )
            axes.vlines(depths / length, values - bars, values + bars, colors=INK, linewidth=2.2)
            axes.plot(depths / length, values, "_", color=INK, markersize=11)
            for model in (model for model in digest.models if model in found.simulated):
                simulated = found.simulated[model][mine] / force
                draw(axes, digest.colour(model), model, depths / length, simulated, markersize=4)
                described.append(model)
            axes.set_xlim(left=0.0)
            axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
        heading = f"Force of {name} against depth, measured (bars: ± u_D) and simulated"
        figures.append(Figure(plot.drawn(f"{heading}: {listed(described)}."), heading))
    return figures


SECTIONS_FIRST = (against_measurement,)
