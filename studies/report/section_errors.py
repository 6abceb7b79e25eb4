"""Errors against every swept parameter and against the load, with the volume drift: medians, and their range."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes

from ..measures.frame import at_full_load
from ..measures.metrics import DEFORMATION, VECTOR
from ..verdict.digest import DRIFT, REFERENCE, Digest
from ..verdict.formatting import listed, parameter_name, scale_of, swept_value
from .blocks import Block, Figure, Figures, Section, Text
from .plots import Curve, colour, limit_line, lines, log_axis, name_ticks, own_line, percent_axis, place

if TYPE_CHECKING:
    from pandas import DataFrame

MESH_SIZE = "geometry.mesh_size"
QUANTITIES = {VECTOR: "Displacement error", DEFORMATION: "Error in change of shape"}
_FLAT = 5e-4  # of an error: the page prints three digits. A turn that is taken out leaves 2e-6 of quickstart
_DRIFT_FLOOR = 1e-16  # below what double precision can tell from zero
_MOST_JOINED = 12  # values of a parameter that a line through medians joins
_MOST_POINTS = 240  # of a curve that is none; beyond, every k-th value is drawn
_ASIDE = 0.05  # between two models at a name, where neighbours are 1 apart


@dataclass(frozen=True)
class _Axis:
    """What varies, laid out on an x axis: its column in the frame, and where each value is."""

    key: str
    name: str
    label: str
    kind: str  # "linear", "log", "even" (numbers, evenly spaced) or "names"
    at: Mapping[float | str, float]
    ticks: Sequence[tuple[float, str]] = ()  # of an even axis or one of names
    joined: bool = True  # whether a line between values means something


def error_against_parameters(digest: Digest) -> Section | None:
    """Two charts for each swept parameter."""
    if not digest.compared or not digest.swept_keys:
        return None
    rows = _rows(digest, at_full_load(digest.table))
    blocks: list[Block] = []
    flat, notes = [], []
    for k, key in enumerate(digest.swept_keys):
        axis = _axis(digest, key)
        if _is_flat(rows, [other for other in digest.swept_keys if other != key]):
            flat.append(axis.name)
        elif figures := _charts(digest, rows, axis, f"p{k}"):
            blocks.append(Figures(figures, digest.legend))
            if key == MESH_SIZE and (told := _orders(digest, rows)):
                notes.append(f"Observed order of the displacement error in the mesh size: {told}.")
            if (step := _stride(axis)) > 1:
                notes.append(f"Of {axis.name} one value in {step} is drawn, to keep the page small.")
    if blocks and len(digest.swept_keys) > 1:
        notes.insert(0, "Medians over the cases that share a value, and their range, at full load.")
    if flat:
        notes.insert(0, f"No error depends on {listed(flat)}: models and reference are linear in it.")
    if notes:
        blocks.insert(0, Text(" ".join(notes), kind="note"))
    return Section("parameters", "Error against each swept parameter", blocks) if blocks else None


def _orders(digest: Digest, rows: DataFrame) -> str:
    """The slope of each model's median error against the mesh size, both logarithmic; "" of one size."""
    found = []
    for model in digest.compared:
        mine = rows[(rows["model"] == model) & (rows["metric"] == VECTOR) & (rows["value"] > 0.0)]
        at = mine.groupby(MESH_SIZE)["value"].median()
        if len(at) > 1:
            found.append(f"{model} {np.polyfit(np.log(at.index), np.log(at), 1)[0]:.2f}")
    return listed(found)


def error_against_load(digest: Digest) -> Section | None:
    """Both errors step by step, and the volume drift of every model."""
    if all(len(case.load_factors) == 1 for case in digest.cases):
        return None
    loaded = digest.table[digest.table["load_factor"] != 0.0]
    axis = _Axis(
        "load_factor", "load", "load factor", "linear", {x: x for x in loaded["load_factor"].unique()}
    )
    rows, notes, figures = _rows(digest, loaded), [], []
    if not rows.empty and _is_flat(rows, ["case"]):
        notes.append("No error depends on the load: models and reference are linear.")
    else:
        figures += _charts(digest, rows, axis, "l")
    drift = loaded[loaded["metric"] == DRIFT]
    drift = drift.assign(value=drift["value"].abs().clip(lower=_DRIFT_FLOOR), bar=math.nan)
    figures += _charts(digest, drift, axis, "v", {DRIFT: "Volume drift"})
    if figures and len(digest.cases) > 1:
        notes.append("Lines are medians over the cases. Bands reach from the best case to the worst.")
    if figures:
        notes.append("The reference's volume drifts too: no model can be told to keep it better than that.")
    blocks: list[Block] = [Text(" ".join(notes), kind="note")]
    blocks += [Figures(figures, digest.legend)] if figures else []
    return Section("load", "Error against load", blocks) if notes else None


def _rows(digest: Digest, table: DataFrame) -> DataFrame:
    """The errors of the models that are compared."""
    return table[table["metric"].isin(list(QUANTITIES)) & table["model"].isin(digest.compared)]


def _is_flat(rows: DataFrame, others: Sequence[str]) -> bool:
    """Whether all rows that are alike in `others` have the same error, of every model, to rounding."""
    groups = rows.groupby(["model", "metric", *others], observed=True, dropna=False)["value"]
    found = groups.agg(["min", "max", "count", "size"])
    found = found[(found["size"] > 1) & (found["count"] > 0)]
    alike = (found["max"] - found["min"] <= _FLAT * found["max"]) & (found["count"] == found["size"])
    return len(found) > 0 and bool(alike.all())


def _axis(digest: Digest, key: str) -> _Axis:
    values = [value for case in digest.cases if (value := case.swept.get(key)) == value and value is not None]
    name, alone = parameter_name(key), len(digest.swept_keys) == 1
    numbers = [float(value) for value in values if not isinstance(value, str) and math.isfinite(value)]
    if any(isinstance(value, str) for value in values):
        at: dict[float | str, float] = {value: float(k) for k, value in enumerate(dict.fromkeys(values))}
        return _Axis(key, name, name, "names", at, [(x, str(text)) for text, x in at.items()], joined=False)
    unit = next((case.swept_units[key] for case in digest.cases if key in case.swept_units), "1")
    factor, unit = scale_of(unit, numbers)
    kind, where = place([value / factor for value in numbers])
    return _Axis(
        key,
        name,
        f"{name} [{unit}]" if unit else name,
        kind,
        {value: where[value / factor] for value in numbers},
        [(x, swept_value(value, "1")) for value, x in where.items()],
        alone or len(where) <= _MOST_JOINED,
    )


def _stride(axis: _Axis) -> int:
    return 1 if axis.joined or axis.kind == "names" else math.ceil(len(axis.at) / _MOST_POINTS)


def _charts(
    digest: Digest, rows: DataFrame, axis: _Axis, salt: str, titles: Mapping[str, str] = QUANTITIES
) -> list[Figure]:
    """A chart a metric, all on one scale; none where there is one place on the axis alone."""
    rows = rows[np.isfinite(rows["value"])]
    rows = rows.assign(x=rows[axis.key].map(axis.at), number=rows["case"].map(digest.place))
    heights = [*rows["value"], *rows["bar"], *map(digest.allowed, titles)]
    found = []
    for k, (metric, title) in enumerate(titles.items()):
        own = rows[rows["metric"] == metric]
        if own["x"].nunique() > 1:
            found.append(_chart(digest, own, axis, metric, title, heights, f"{salt}{k}"))
    return found


def _chart(
    digest: Digest,
    rows: DataFrame,
    axis: _Axis,
    metric: str,
    title: str,
    heights: Sequence[float],
    salt: str,
) -> Figure:
    models = [name for name in digest.models if (rows["model"] == name).any()]
    curves = []
    for rank, model in enumerate(models):
        groups = rows[rows["model"] == model].groupby("x")
        at = groups["value"].agg(["median", "min", "max", "count"])[:: _stride(axis)]
        cases = groups["number"].first()[:: _stride(axis)].tolist() if (at["count"] == 1).all() else None
        aside = _ASIDE * (rank - (len(models) - 1) / 2) if axis.kind == "names" else 0.0
        look = {} if axis.joined else {"linestyle": "none"}
        curves.append(Curve(model, at.index + aside, at["median"], cases, look, (at["min"], at["max"])))
    bars = rows.groupby("x")["bar"].median().dropna()

    def finish(axes: Axes) -> None:
        if len(bars) > 1:
            style = "--" if axis.joined else "none"
            dots: dict[str, Any] = {
                "marker": "o",
                "markersize": 2.5,
                "linewidth": 1.0,
                "color": colour(REFERENCE),
            }
            axes.plot(bars.index, bars, linestyle=style, markevery=-(-len(bars) // 25), **dots)
        elif len(bars):
            own_line(axes, float(bars.iloc[0]))
        limit_line(axes, digest.allowed(metric))
        if axis.kind in ("even", "names"):
            name_ticks(axes, axis.ticks)
        elif axis.kind == "log":
            log_axis(axes, "x")
        if axis.key == "load_factor":
            axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
        percent_axis(axes, heights)

    return lines(digest, curves, axis.label, title, f"{title} against {axis.name}", salt, finish=finish)
