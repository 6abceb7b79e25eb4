"""Models against a measurement: what was measured, what each says of it, and whether the error can be told."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes

from solver_common.arrays import Array, Mask

from ..measures.case import CaseResult
from ..measures.measurement import FORCE, Measurement, Quantity
from ..study.measured import AXES
from ..verdict.digest import Digest
from ..verdict.formatting import NOTHING, listed, plain, quantity, scale_of, short_percent
from .blocks import Block, Cell, Field, Figure, Figures, Section, Table, Text, frame_table
from .plots import Curve, lines, name_ticks
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
        if figures := list(_figures(digest, case, found, number)):
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

    names = list(found.simulated)
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


def _details(case: CaseResult, found: Measurement, number: int) -> Table:
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
        *(Field(name, error(name), units, "E ± u_val") for name in found.simulated),
    ]
    return frame_table(range(len(found.quantities)), fields, f"measured-points-{number}")


def _named(one: Quantity, case: CaseResult) -> str:
    if one.component == FORCE:
        return f"force of {one.point} at {quantity(one.depth, 'm')}"
    name = " ".join(filter(None, (one.point, one.component)))
    return f"{name} at {plain(float(case.load_factors[one.step]))}" if len(case.load_factors) > 1 else name


def _figures(digest: Digest, case: CaseResult, found: Measurement, number: int) -> Iterator[Figure]:
    """Displacements at points side by side; of each constraint whose force was measured the force against depth."""
    groups: dict[str, list[int]] = {}
    for k, one in enumerate(found.quantities):
        if one.component in (*AXES, FORCE):
            groups.setdefault(one.point if one.component == FORCE else "", []).append(k)
    models = [model for model in digest.models if model in found.simulated]
    for force_of, mine in groups.items():
        if force_of:
            mine.sort(key=lambda k: found.quantities[k].depth)
        quantities = [found.quantities[k] for k in mine[:_MOST_DRAWN]]
        mine = mine[: len(quantities)]
        size, unit = scale_of(quantities[0].unit, found.values[mine])
        depths = np.array([one.depth for one in quantities])
        length, length_unit = scale_of("m", depths) if force_of else (1.0, "")
        x = depths / length if force_of else np.arange(len(mine), dtype=float)
        # the models of a quantity stand beside it and end before the next one
        gap = 0.0 if force_of else 0.8 / (1 + len(models))
        look = {"markersize": 4} | ({} if force_of else {"named": False, "linestyle": "none"})
        curves = [
            Curve(model, x + gap * (1 + k), found.simulated[model][mine] / size, look=look)
            for k, model in enumerate(models)
        ]
        data = found.values[mine] / size
        bars = np.array([one.uncertainty for one in quantities]) / size
        names = (
            []
            if force_of
            else [(float(at), _named(one, case)) for at, one in zip(x, quantities, strict=True)]
        )

        def finish(
            axes: Axes,
            x: Array = x,
            data: Array = data,
            bars: Array = bars,
            names: Sequence[tuple[float, str]] = names,
        ) -> None:
            axes.vlines(x, data - bars, data + bars, colors=INK, linewidth=2.2)
            axes.plot(x, data, "_", color=INK, markersize=11)
            if names:
                name_ticks(axes, names)
            else:
                axes.set_xlim(left=0.0)
                axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))

        what = f"Force of {force_of} against depth, measured" if force_of else "Measured"
        labels = (f"depth [{length_unit}]", "force") if force_of else ("measured quantity", "displacement")
        yield lines(
            digest,
            curves,
            labels[0],
            f"{labels[1]} [{unit}]",
            f"{what} (bars: ± u_D) and simulated",
            f"measured{number}-{force_of or 'points'}",
            finish=finish,
            shown=lambda value: plain(value, 3),
        )
