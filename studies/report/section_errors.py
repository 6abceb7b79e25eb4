"""Error against every swept parameter and against the load; volume drift against the load."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from ..measures.case import CaseResult
from ..measures.metrics import DEFORMATION, VECTOR
from ..verdict.digest import DRIFT, REFERENCE, Digest
from ..verdict.formatting import listed, parameter_name, scale_of, short_percent, swept_value
from .blocks import Block, Figure, Figures, Section, Text
from .plots import (
    Curve,
    Plot,
    colour,
    draw,
    limit_line,
    line,
    lines,
    log_axis,
    name_ticks,
    own_line,
    percent_axis,
    percent_ticks,
    place,
)

QUANTITIES = ((VECTOR, "Displacement error"), (DEFORMATION, "Error in change of shape"))
PARTS = (
    ("relative_l2_normal_error", "Normal component"),
    ("relative_l2_tangential_error", "Tangential component"),
    ("contact_region_error", "Contact region"),
    ("far_field_error", "Far field"),
)
_MOST_POINTS = 240  # per model and figure; beyond, every k-th case is drawn
_ASIDE = 0.05  # between the clouds of two models at a named value, where neighbours are 1 apart
_PARTS_OF = "Normal and tangential component, contact region and far field against"
_FLAT = 5e-4  # of an error: the page prints three digits. A turn that is taken out leaves 2e-6 of quickstart
_DRIFT_FLOOR = 1e-16  # below what double precision can tell from zero
_MOST_MARKED = 25  # points of a line that get a marker; of more, every k-th
_MOST_JOINED = 12  # values of a parameter that a line through medians joins


def error_against_parameters(digest: Digest) -> Section | None:
    """Two groups of figures per swept parameter: vector and deformation; and, folded away, the vector's parts."""
    if not digest.compared or not digest.swept_keys:
        return None
    pairs, flat = [], []
    for k, key in enumerate(digest.swept_keys):
        axis = _axis(digest.cases, key, alone=len(digest.swept_keys) == 1)
        if _is_flat(digest, key):
            flat.append(axis.name)
            continue
        for group, summary in ((QUANTITIES, ""), (PARTS, f"{_PARTS_OF} {axis.name}")):
            shown = [
                figure
                for j, (metric, title) in enumerate(group)
                if (figure := _against_parameter(digest, axis, metric, title, group, f"p{k}{title[:2]}{j}"))
            ]
            pairs += [Figures(shown, digest.legend, summary)] if shown else []
    notes = [f"No error depends on {listed(flat)}: models and reference are linear in it."] if flat else []
    if pairs and len(digest.swept_keys) > 1:
        notes.append(
            "Each point is one case at full load. Lines join the medians of the cases that share a value."
        )
    if (step := _stride(len(digest.cases))) > 1:
        notes.append(f"One case in {step} is drawn, to keep the page small.")
    if not pairs and not notes:
        return None
    blocks: list[Block] = [Text(" ".join(notes), kind="note")] if notes else []
    return Section("parameters", "Error against each swept parameter", [*blocks, *pairs])


def _is_flat(digest: Digest, key: str) -> bool:
    """Whether all cases that differ in this parameter alone have the same errors, of every model, to rounding."""
    groups: dict[object, list[int]] = {}
    for k, case in enumerate(digest.cases):
        groups.setdefault(
            tuple(case.swept.get(other) for other in digest.swept_keys if other != key), []
        ).append(k)
    several = [group for group in groups.values() if len(group) > 1]
    errors = [digest.full_loads(model, metric) for model in digest.compared for metric, _ in QUANTITIES]
    return bool(several) and all(
        np.isfinite(values[group]).all() and np.ptp(values[group]) <= _FLAT * np.abs(values[group]).max()
        for values in errors
        for group in several
        if not np.isnan(values[group]).all()
    )


def _stride(cases: int) -> int:
    return max(1, math.ceil(cases / _MOST_POINTS))


@dataclass(frozen=True)
class _Axis:
    """A swept parameter laid out on an x axis."""

    name: str
    label: str
    kind: str  # "linear", "log", "even" (numbers, evenly spaced) or "names"
    cases: Sequence[int]  # which have the parameter
    positions: Sequence[float]  # one per case
    ticks: Sequence[tuple[float, str]]  # of an even axis or one of names
    alone: bool  # whether nothing else is swept

    def line(self, style: str, points: int, values: int) -> str:
        """`style` where a line through `values` values of `points` cases means something, else "none"."""
        ordered = self.kind != "names"
        return style if ordered and (values <= _MOST_JOINED or (self.alone and values == points)) else "none"


def _is_placed(value: float | str | None) -> bool:
    return isinstance(value, str) or (value is not None and math.isfinite(value))


def _axis(all_cases: Sequence[CaseResult], key: str, *, alone: bool) -> _Axis:
    cases = [k for k, case in enumerate(all_cases) if _is_placed(case.swept.get(key))]
    values = [all_cases[k].swept[key] for k in cases]
    name = parameter_name(key)
    numbers = [float(value) for value in values if not isinstance(value, str)]
    if len(numbers) < len(values):
        at = {text: float(k) for k, text in enumerate(dict.fromkeys(str(value) for value in values))}
        ticks = [(x, text) for text, x in at.items()]
        return _Axis(name, name, "names", cases, [at[str(value)] for value in values], ticks, alone)
    factor, unit = scale_of(next((all_cases[k].swept_units.get(key, "1") for k in cases), "1"), numbers)
    kind, where = place([value / factor for value in numbers])
    return _Axis(
        name=name,
        label=f"{name} [{unit}]" if unit else name,
        kind=kind,
        cases=cases,
        positions=[where[value / factor] for value in numbers],
        ticks=[(x, swept_value(value, "1")) for value, x in where.items()],
        alone=alone,
    )


def _against_parameter(
    digest: Digest,
    axis: _Axis,
    metric: str,
    title: str,
    group: Sequence[tuple[str, str]],
    salt: str,
) -> Figure | None:
    """One measure against a parameter, on the scale that its group shares."""
    described = []
    plot = Plot(axis.label, title, salt)
    with plot as axes:
        for rank, model in enumerate(digest.compared):
            errors = digest.full_loads(model, metric)[axis.cases].tolist()
            points = [
                (x, y, case)
                for x, y, case in zip(axis.positions, errors, axis.cases, strict=True)
                if math.isfinite(y)
            ]
            if not points:
                continue
            aside = rank - (len(digest.compared) - 1) / 2
            _draw_model(axes, axis, points, digest.colour(model), _ASIDE * aside, model)
            low, high = min(y for _, y, _ in points), max(y for _, y, _ in points)
            described.append(f"{model} from {short_percent(low)} to {short_percent(high)}")
        if not described:
            return None
        bars = zip(axis.positions, digest.bars(metric)[axis.cases].tolist(), strict=True)
        if known := _medians((x, bar) for x, bar in bars if math.isfinite(bar)):
            style = axis.line("--", len(axis.cases), len(known))
            x, y = zip(*known, strict=True)
            axes.plot(
                x,
                y,
                linestyle=style,
                color=colour(REFERENCE),
                linewidth=1.0,
                marker="o",
                markersize=2.5,
                markevery=_every(style, known),
            )
        if axis.kind in ("even", "names"):
            name_ticks(axes, axis.ticks)
        elif axis.kind == "log":
            log_axis(axes, "x")
        limit_line(axes, digest.allowed(metric))
        both = [
            digest.full_loads(model, other)[axis.cases] for model in digest.compared for other, _ in group
        ]
        bars_of = (digest.bars(other)[axis.cases] for other, _ in group)
        limits = [digest.allowed(other) for other, _ in group]
        percent_axis(axes, np.concatenate([*both, *bars_of, limits]))
    heading = f"{title} against {axis.name}"
    return Figure(plot.drawn(f"{heading}: {listed(described)}."), heading)


def _draw_model(
    axes: Axes,
    axis: _Axis,
    points: Sequence[tuple[float, float, int]],
    number: int,
    aside: float,
    model: str,
) -> None:
    """The cases of one model, and the medians over the cases that share a value where they do or form a line."""
    medians = _medians((x, y) for x, y, _ in points)
    style = axis.line(line(number), len(points), len(medians))
    shared = len(medians) < len(points)
    if shared or (style == "none" and axis.kind != "names"):
        shift = aside if axis.kind in ("even", "names") else 0.0
        x, y, drawn = zip(*points[:: _stride(len(axis.cases))], strict=True)
        at = [position + shift for position in x]
        faint = {"linestyle": "none", "markersize": 2.6, "alpha": 0.45}
        draw(axes, number, model, at, y, cases=drawn, named=False, **faint)
    if style != "none" or axis.kind == "names":
        every = _every(style, medians)
        cases = None if shared else [case for _, _, case in sorted(points)][::every]
        x, y = zip(*medians, strict=True)
        draw(axes, number, model, x, y, cases=cases, linestyle=style, markevery=every)


def _every(style: str, points: Sequence[tuple[float, float]]) -> int:
    """Of how many points one is marked: of all, unless a line shows where they are."""
    return 1 if style == "none" else math.ceil(len(points) / _MOST_MARKED)


def _medians(points: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """(x, median of the y at this x), in ascending x."""
    gathered: dict[float, list[float]] = {}
    for x, y in points:
        gathered.setdefault(x, []).append(y)
    # most have one value, which numpy's median takes its time for
    return [(x, float(np.median(ys)) if len(ys) > 1 else ys[0]) for x, ys in sorted(gathered.items())]


def error_against_load(digest: Digest) -> Section | None:
    """Median over cases and their range, step by step; full vector and deformation on the same scale."""
    if not digest.compared or not digest.has_steps:
        return None
    curves = {metric: digest.over_load(digest.compared, metric) for metric, _ in QUANTITIES}
    heights = [
        y for by_model in curves.values() for table in by_model.values() for ys in table.values() for y in ys
    ]
    if _is_constant(curves.values()):
        text = "No error depends on the load: models and reference are linear."
        return Section("load", "Error against load", [Text(text, kind="note")])
    heights += [digest.allowed(metric) for metric in curves]
    figures = [
        _against_load(digest, curves[metric], metric, title, heights, f"l{k}")
        for k, (metric, title) in enumerate(QUANTITIES)
        if any(len(table) > 1 for table in curves[metric].values())  # one load is no curve
    ]
    if not figures:
        return None
    note = "Lines are medians over the cases. Bands reach from the best case to the worst."
    blocks: list[Block] = [Text(note, kind="note")] if len(digest.cases) > 1 else []
    return Section("load", "Error against load", [*blocks, Figures(figures, digest.legend)])


Curves = dict[str, dict[float, list[float]]]  # model -> load factor -> values over the cases


def _is_constant(curves: Iterable[Curves]) -> bool:
    """Whether each model has the same errors at every load, to rounding."""
    for table in (table for by_model in curves for table in by_model.values()):
        medians = np.array([np.median(values) for factor, values in table.items() if factor])
        if len(table) < 2 or np.ptp(medians) > _FLAT * np.abs(medians).max():
            return False
    return True


def _against_load(
    digest: Digest, curves: Curves, metric: str, title: str, heights: Sequence[float], salt: str
) -> Figure:
    own = digest.own_error(metric)
    found, bands = [], []
    for model, table in curves.items():
        factors = sorted(table)
        low, middle, high = ([float(f(table[x])) for x in factors] for f in (min, np.median, max))
        bands.append((factors, low, high, digest.colour(model)))
        cases = [0] * len(factors) if len(digest.cases) == 1 else None
        found.append(Curve(model, factors, middle, cases))

    def finish(axes: Axes) -> None:
        for factors, low, high, number in bands:
            if high != low:
                axes.fill_between(factors, low, high, color=colour(number), alpha=0.14, linewidth=0)
        own_line(axes, own)
        limit_line(axes, digest.allowed(metric))
        axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
        percent_axis(axes, [*heights, *([own] if own > 0.0 else [])])

    return lines(digest, found, "load factor", title, f"{title} against load", salt, finish=finish)


def volume_drift(digest: Digest) -> Section | None:
    """Change of the exact enclosed volume, as a share of the volume and of the displaced volume."""
    if not digest.has_steps:
        return None  # one point per model: the headline has it
    quantities = (
        (DRIFT, "|V − V0| / V0", "Drift as a share of the volume"),
        (
            "volume_drift_of_displaced",
            "|V − V0| / displaced volume",
            "Drift as a share of the displaced volume",
        ),
    )
    figures = [
        figure
        for k, (metric, label, title) in enumerate(quantities)
        if (figure := _drift(digest, metric, label, title, f"v{k}")) is not None
    ]
    if not figures:
        return None
    note = (
        "The reference drifts too: a model that is held against it cannot be told to keep the volume better."
    )
    if len(digest.cases) > 1:
        note = f"The largest drift of all cases at each load, without its sign. {note}"
    blocks: list[Block] = [Text(note, kind="note"), Figures(figures, digest.legend)]
    return Section("volume", "Volume drift against load", blocks)


def _drift(digest: Digest, metric: str, label: str, title: str, salt: str) -> Figure | None:
    curves = digest.over_load(digest.models, metric)
    if not any(len(curve) > 1 for curve in curves.values()):
        return None  # one load is no curve
    found = []
    for model, curve in curves.items():
        factors = sorted(curve)
        found.append(
            Curve(model, factors, [max(_DRIFT_FLOOR, *map(abs, curve[factor])) for factor in factors])
        )

    def finish(axes: Axes) -> None:
        log_axis(axes, "y")
        percent_ticks(axes)
        axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))

    return lines(digest, found, "load factor", label, title, salt, finish=finish)
