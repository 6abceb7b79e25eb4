"""The charts: errors against swept parameters and load, force against indentation, run time against error."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes

from solver_common.arrays import Array

from ..measures.case import CaseResult
from ..measures.frame import at_full_load
from ..measures.metrics import DEFORMATION, VECTOR
from ..measures.pushed import Answer, Pushed
from ..verdict.acceptance import pushes
from ..verdict.digest import DRIFT, REFERENCE, Digest, frame_of, median_known
from ..verdict.formatting import parameter_name, scale_of, swept_value
from .blocks import Block, Figure, Figures, Section, note
from .plots import (
    Curve,
    colour,
    from_origin,
    level_line,
    lines,
    log_axis,
    name_ticks,
    percent_axis,
    place,
    time_axis,
)

if TYPE_CHECKING:
    from pandas import DataFrame

MESH_SIZE = "geometry.mesh_size"
QUANTITIES = {VECTOR: "Displacement error", DEFORMATION: "Error in change of shape"}
_DRIFT_FLOOR = 1e-16  # smaller drifts are zero in double precision
_FLAT = (
    5e-4  # relative change of an error that three printed digits do not show; a removed rotation leaves 2e-6
)
_MOST_JOINED = 12  # most values of a parameter with a line through the medians
_MOST_POINTS = 240  # most points without a line; beyond, every k-th value is drawn
_ASIDE = 0.05  # distance of two models on an axis of names, on which neighbours are 1 apart


@dataclass(frozen=True)
class _Axis:
    """A quantity that varies, laid out on an x axis: its column in the frame, and the position of each value."""

    key: str
    name: str
    label: str
    kind: str  # "linear", "log", "even" (numbers, evenly spaced) or "names"
    at: Mapping[float | str, float]
    ticks: Sequence[tuple[float, str]] = ()  # for the kinds "even" and "names"
    joined: bool = True  # whether a line between values means something


def errors(digest: Digest) -> Section | None:
    """Two charts for each swept parameter, and for the load if there are several steps."""
    blocks: list[Block] = []
    flat, orders, strides = [], list[str](), {}
    for k, (axis, rows, others) in enumerate(_varied(digest) if digest.compared else ()):
        if _is_flat(rows, others):
            flat.append(axis.name)
        elif figures := _charts(digest, rows, axis, f"p{k}"):
            blocks.append(Figures(figures))
            orders = orders or (_orders(digest, rows) if axis.key == MESH_SIZE else [])
            if (step := _stride(axis)) > 1:
                strides[axis.name] = step
    small_print = note("parameters", flat, blocks and len(digest.cases) > 1, orders, strides)
    blocks = [*([small_print] if small_print.text else []), *blocks]
    return Section("parameters", "Error against parameters and load", blocks) if blocks else None


def _varied(digest: Digest) -> Iterator[tuple[_Axis, DataFrame, list[str]]]:
    """Each quantity that varies, with the errors of the compared models, and what else these may depend on."""
    table, keys = digest.table, digest.swept_keys
    rows = table[table["metric"].isin(list(QUANTITIES)) & table["model"].isin(digest.compared)]
    for key in keys:
        yield _axis(digest, key), at_full_load(rows), [other for other in keys if other != key]
    loaded = rows[rows["load_factor"] != 0.0]
    axis = _load_axis(loaded)
    if len(axis.at) > 1:
        yield axis, loaded, ["case"]


def volume_drift(digest: Digest) -> Section | None:
    """Absolute volume drift of every model, and of the reference, against the load, if there are several steps."""
    rows = digest.table[(digest.table["metric"] == DRIFT) & (digest.table["load_factor"] != 0.0)]
    rows = rows.assign(value=rows["value"].abs().clip(lower=_DRIFT_FLOOR), bar=math.nan)
    figures = _charts(digest, rows, _load_axis(rows), "v", {DRIFT: "Volume drift"})
    return Section("drift", "Volume drift", [Figures(figures)]) if figures else None


def _load_axis(rows: DataFrame) -> _Axis:
    at: dict[float | str, float] = {x: x for x in rows["load_factor"].unique()}
    return _Axis("load_factor", "load", "load factor", "linear", at)


def _orders(digest: Digest, rows: DataFrame) -> list[str]:
    """The order of each model: the slope of log median error over log mesh size; none for a single size."""
    found = []
    for model in digest.compared:
        mine = rows[(rows["model"] == model) & (rows["metric"] == VECTOR) & (rows["value"] > 0.0)]
        at = mine.groupby(MESH_SIZE)["value"].median()
        if len(at) > 1:
            found.append(f"{model} {np.polyfit(np.log(at.index), np.log(at), 1)[0]:.2f}")
    return found


def _is_flat(rows: DataFrame, others: Sequence[str]) -> bool:
    """Whether rows with equal `others` have equal errors, up to printed digits, for every model."""
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
    factor, unit = scale_of(digest.unit(key), numbers)
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
    """Every `_stride`-th value is drawn."""
    return 1 if axis.joined or axis.kind == "names" else math.ceil(len(axis.at) / _MOST_POINTS)


def _charts(
    digest: Digest, rows: DataFrame, axis: _Axis, salt: str, titles: Mapping[str, str] = QUANTITIES
) -> list[Figure]:
    """A chart of each metric, all on one scale; none if all points have the same x."""
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
            about: Any = {"markevery": -(-len(bars) // 25), "label": "the reference's own"}
            axes.plot(bars.index, bars, linestyle=style, **about, **dots)
        elif len(bars):
            level_line(axes, float(bars.iloc[0]), "reference's own", "--")
        level_line(axes, digest.allowed(metric), "accepted", "-.")
        if axis.kind in ("even", "names"):
            name_ticks(axes, axis.ticks)
        elif axis.kind == "log":
            log_axis(axes, "x")
        if axis.key == "load_factor":
            axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
        percent_axis(axes, heights)

    return lines(digest, curves, axis.label, title, f"{title} against {axis.name}", salt, finish=finish)


# kind of a constraint -> names of its depth and its force
_KINDS = {
    "contact": ("indentation", "contact force"),
    "indenter": ("depth", "indenter force"),
    "constrained": ("prescribed displacement", "reaction force"),
}


def force_against_indentation(digest: Digest) -> Section | None:
    """Force against indentation in the first key case, if that has a load history."""
    role, case = digest.key_cases[0] if digest.cases else ("", None)
    if case is None or len(case.load_factors) == 1:
        return None
    title = f"{digest.case_name(case)}{f' ({role})' if role else ''}"
    figures: list[Figure] = []
    shown: list[Pushed] = []
    for pushed in pushes(case, digest.surfaces[case.hash]):
        curves = {
            name: np.array(pushed.curve(Answer.of(case.models[name])))
            for name in digest.models
            if name in case.models
        }
        known = {name: curve[:, np.isfinite(curve).all(axis=0)] for name, curve in curves.items()}
        if known := {name: curve for name, curve in known.items() if curve.size}:
            place = ", ".join(filter(None, [pushed.constraint.name, title]))
            figures.append(_force_chart(digest, case, pushed, known, place, f"f{len(figures)}"))
            shown.append(pushed)
    if not figures:
        return None
    kinds = list(dict.fromkeys(pushed.constraint.kind for pushed in shown))
    weighs = not all(pushed.rests for pushed in shown)
    return Section("force", "Force against indentation", [note("force", kinds, weighs), Figures(figures)])


def _force_chart(
    digest: Digest, case: CaseResult, pushed: Pushed, known: Mapping[str, Array], place: str, salt: str
) -> Figure:
    """`known`: model -> (2, K) depths [m] and forces [N], or pressures [Pa]."""
    depth, force = _KINDS[pushed.constraint.kind]
    force = "contact pressure" if pushed.unit == "Pa" else force
    every = np.concatenate(list(known.values()), axis=1)
    (length, length_unit), (load, load_unit) = map(scale_of, ("m", pushed.unit), every)
    number = digest.place[case.hash]
    curves = [Curve(name, x / length, y / load, [number] * len(x)) for name, (x, y) in known.items()]

    labels = f"{depth} [{length_unit}]", f"{force} [{load_unit}]"
    title = f"{force.capitalize()} against {depth}, {place}"
    return replace(lines(digest, curves, *labels, title, salt, finish=from_origin), title=place)


BUDGETS = {
    "haptic device, 1 ms": 1e-3,
    "screen, 16.7 ms": 1.0 / 60.0,
}  # device -> time that it leaves for a frame [s]


def run_time_against_error(digest: Digest) -> Section | None:
    """Time of a frame against the median error at full load: a point for each mesh, joined by lines."""
    meshes: dict[int, list[CaseResult]] = {}  # cases on one mesh share its surface
    for case in digest.cases:
        meshes.setdefault(id(digest.surfaces[case.hash]), []).append(case)
    parts = sorted(meshes.values(), key=lambda part: len(part[0].points))
    charts = [_pareto(digest, metric, parts, f"c{k}") for k, metric in enumerate(QUANTITIES)]
    figures = [chart for chart in charts if chart is not None]
    if not figures:
        return None
    blocks: list[Block] = [note("cost", len(parts)), Figures(figures)]
    return Section("cost", "Run time against error", blocks)


def _pareto(digest: Digest, metric: str, parts: Sequence[Sequence[CaseResult]], salt: str) -> Figure | None:
    curves, look = [], {"markersize": 6.5, **({} if len(parts) > 1 else {"linestyle": "none"})}
    for name in digest.compared:
        measured = [p for p in parts if any(c.models[name].frames is not None for c in p if name in c.models)]
        points = np.array([_time_and_error(digest, name, metric, part) for part in measured or parts])
        known = points[np.isfinite(points).all(axis=1)]
        if len(known):
            curves.append(Curve(name, known[:, 0], known[:, 1], look=look))
    if not curves:
        return None

    def finish(axes: Axes) -> None:
        for name, seconds in BUDGETS.items():
            level_line(axes, seconds, name, ":", "x")
        level_line(axes, digest.allowed(metric), "accepted", "-.")
        time_axis(axes)
        percent_axis(axes, [*np.concatenate([curve.y for curve in curves]), digest.allowed(metric)])

    title = QUANTITIES[metric]
    heading = f"Run time against {title.lower()}"
    return lines(digest, curves, "time of a frame", title, heading, salt, finish=finish)


def _time_and_error(
    digest: Digest, name: str, metric: str, cases: Sequence[CaseResult]
) -> tuple[float, float]:
    results = [case.models[name] for case in cases if name in case.models]
    errors = np.abs([digest.at(case, name, metric) for case in cases])
    return frame_of(results), median_known(errors)
