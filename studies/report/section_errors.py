"""Error against every swept parameter and against the load, and all measures in one table."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..case import CaseResult
from .blocks import Block, Cell, Column, Figure, Figures, Section, Table, Text
from .digest import DEFORMATION, VECTOR, Digest, at_full_load, reference_bar, series
from .formatting import NOTHING, listed, of_unit, percent, scale_of, swept_value
from .plots import Plot, colour, line, log_axis, marker, name_ticks, percent_axis, place

QUANTITIES = ((VECTOR, "Displacement error"), (DEFORMATION, "Deformation error"))
_MOST_POINTS = 240  # per figure; beyond, every k-th case is drawn
_HIDDEN_MEASURES = frozenset({"volume_drift"})  # shown in the headline


def parameter_name(key: str) -> str:
    """A swept key as words: `tissue.poisson_ratio` is "Poisson ratio"."""
    parts = key.split(".")
    words = parts[-1].replace("_", " ")
    words = words.replace("poisson", "Poisson").replace("youngs", "Young's")
    if len(parts) > 2:
        words = f"{words} of {parts[-2]}"
    return words


def error_against_parameters(digest: Digest) -> Section | None:
    """One pair of figures per swept parameter, full vector and deformation."""
    if not digest.compared or not digest.swept_keys:
        return None
    blocks: list[Block] = []
    if len(digest.swept_keys) > 1:
        blocks.append(
            Text(
                "Each point is one case at full load; lines join the medians over the cases that share a value.",
                kind="note",
            )
        )
    for number_, key in enumerate(digest.swept_keys):
        figures = [
            _against_parameter(digest, key, metric, title, f"p{number_}{kind}")
            for kind, (metric, title) in enumerate(QUANTITIES)
        ]
        shown = [figure for figure in figures if figure is not None]
        if shown:
            blocks.append(Figures(shown, digest.legend))
    step = _stride(digest.cases)
    if step > 1:
        blocks.append(Text(f"To keep the page small only every {step}th case is drawn.", kind="note"))
    return Section("parameters", "Error against each swept parameter", blocks)


def _stride(cases: Sequence[CaseResult]) -> int:
    return max(1, math.ceil(len(cases) / _MOST_POINTS))


def _against_parameter(digest: Digest, key: str, metric: str, title: str, salt: str) -> Figure | None:
    cases = [case for case in digest.cases if key in case.swept]
    values = [case.swept[key] for case in cases]
    texts = any(isinstance(value, str) for value in values)
    unit = next((case.swept_units.get(key, "1") for case in cases), "1")
    factor, shown_unit = (1.0, "") if texts else scale_of(unit, [float(v) for v in values])
    if texts:
        names = sorted({str(value) for value in values})
        kind, positions = "even", {name: float(k) for k, name in enumerate(names)}
    else:
        kind, numeric = place([float(value) / factor for value in values])
        positions = {}
        names = []
        for value in sorted({float(value) for value in values}):
            positions[str(value)] = numeric[value / factor]
            names.append(swept_value(value / factor, "1"))
    xs = [positions[str(value) if texts else str(float(value))] for value in values]
    name = parameter_name(key)
    label = f"{name} [{shown_unit}]" if shown_unit else name
    distinct = sorted(set(xs))
    heights: list[float] = []
    described = []
    plot = Plot(label, title, salt)
    with plot as axes:
        for model in digest.compared:
            ys = [at_full_load(case, model, metric) for case in cases]
            finite = [(x, y) for x, y in zip(xs, ys, strict=True) if math.isfinite(y)]
            if not finite:
                continue
            k = digest.colour(model)
            heights += [y for _, y in finite]
            medians = [
                (x, float(np.median([y for xx, y in finite if xx == x])))
                for x in distinct
                if any(xx == x for xx, _ in finite)
            ]
            lone = len(medians) == len(finite)
            joined = len(distinct) <= 12 or lone
            if not lone or not joined:
                drawn = finite[:: _stride(cases)]
                axes.plot(
                    *zip(*drawn, strict=True),
                    linestyle="none",
                    marker=marker(k),
                    color=colour(k),
                    markersize=2.6,
                    alpha=0.45,
                )
            if joined:
                axes.plot(*zip(*medians, strict=True), line(k), marker=marker(k), color=colour(k))
            described.append(
                f"{model} from {percent(min(y for _, y in finite))} to {percent(max(y for _, y in finite))}"
            )
        if not heights:
            return None
        bars = [
            (x, b)
            for x, b in zip(xs, [reference_bar(c, metric) for c in cases], strict=True)
            if math.isfinite(b)
        ]
        if bars:
            medians = [
                (x, float(np.median([b for xx, b in bars if xx == x]))) for x in sorted({x for x, _ in bars})
            ]
            axes.plot(
                *zip(*medians, strict=True), "--", marker="o", markersize=2.5, color=colour(-1), linewidth=1.0
            )
        if kind == "even":
            name_ticks(axes, [positions[key_] for key_ in positions], names)
        elif kind == "log":
            log_axis(axes, "x")
        percent_axis(axes, heights)
    heading = f"{title} against {name}"
    caption = "Dashed grey: the reference's own error." if bars else ""
    plot_alt = f"{heading}: {listed(described)}."
    return Figure(plot.drawn(plot_alt), heading, caption)


def error_against_load(digest: Digest) -> Section | None:
    """Median over cases and their range, step by step."""
    if not digest.compared or not digest.has_steps:
        return None
    figures = [
        figure
        for kind, (metric, title) in enumerate(QUANTITIES)
        if (figure := _against_load(digest, metric, title, f"l{kind}")) is not None
    ]
    if not figures:
        return None
    blocks: list[Block] = []
    if len(digest.cases) > 1:
        blocks.append(
            Text(
                "Lines are medians over the cases, bands reach from the best to the worst case.", kind="note"
            )
        )
    blocks.append(Figures(figures, digest.legend))
    return Section("load", "Error against load", blocks)


def _against_load(digest: Digest, metric: str, title: str, salt: str) -> Figure | None:
    heights: list[float] = []
    described = []
    plot = Plot("load factor", title, salt)
    with plot as axes:
        for model in digest.compared:
            table: dict[float, list[float]] = {}
            for case in digest.cases:
                values = series(case, model, metric)
                if values is None:
                    continue
                for factor, value in zip(case.load_factors, values, strict=True):
                    if math.isfinite(value):
                        table.setdefault(float(factor), []).append(float(value))
            if not table:
                continue
            k = digest.colour(model)
            factors = sorted(table)
            low, mid, high = ([float(f(table[x])) for x in factors] for f in (min, np.median, max))
            heights += high + low
            if any(h > lo for h, lo in zip(high, low, strict=True)):
                axes.fill_between(factors, low, high, color=colour(k), alpha=0.14, linewidth=0)
            axes.plot(factors, mid, line(k), marker=marker(k), color=colour(k))
            described.append(f"{model} from {percent(mid[0])} to {percent(mid[-1])}")
        if not heights:
            return None
        axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
        percent_axis(axes, heights)
    heading = f"{title} against load"
    return Figure(plot.drawn(f"{heading}: {listed(described)}."), heading)


def all_measures(digest: Digest) -> Section | None:
    """Every metric of every compared model at full load, with its definition."""
    if not digest.compared:
        return None
    many = len(digest.cases) > 1
    first: dict[str, tuple[str, str]] = {}
    for case in digest.cases:
        for model in digest.compared:
            for name, entry in case.metrics.get(model, {}).items():
                first.setdefault(name, (entry.unit, entry.definition))
    rows = []
    for name, (unit, definition) in first.items():
        if name in _HIDDEN_MEASURES:
            continue
        row = [Cell(measure_name(name), definition)]
        for model in digest.compared:
            spread = digest.spread(model, name)
            if spread is None:
                row.append(Cell(NOTHING))
                continue
            text = of_unit(spread.median, unit)
            row.append(Cell(text, f"worst {of_unit(spread.worst, unit)}" if many else "", spread.median))
        rows.append(row)
    if not rows:
        return None
    columns = [
        Column("Measure", numeric=False),
        *(Column(model, "median" if many else "") for model in digest.compared),
    ]
    return Section("measures", "All measures at full load", [Table("measures", "", columns, rows)])


def measure_name(metric: str) -> str:
    """A metric's name as words."""
    words = metric.replace("relative_l2_", "").replace("p95_", "95 % ").replace("_", " ")
    return words[:1].upper() + words[1:]
