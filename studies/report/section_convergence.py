"""Whether each model comes to rest as the mesh is refined, against one fixed reference."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes

from ..measures.case import CaseResult
from ..measures.uncertainty import CONVERGING, DIVERGING, ErrorEstimate, estimate_limit
from ..verdict.digest import Digest
from ..verdict.formatting import percent, plain, quantity
from .blocks import Cell, Field, Figure, Figures, Section, Table, Text, bar_detail, frame_table
from .plots import Curve, lines, log_axis, percent_axis

MESH_SIZE = "geometry.mesh_size"
WORK = "contact_work"
CHANGED = "another scheme"
_LEVELS = 3  # fewer show no order


@dataclass(frozen=True)
class _Series:
    """The work of the contact on ever finer meshes, the finest first."""

    model: str
    sizes: Sequence[float]
    values: Sequence[float]
    schemes: Sequence[str]  # "" of a model that has one only
    limit: float
    estimate: ErrorEstimate

    @property
    def behaviour(self) -> str:
        """What the levels do; of two schemes nothing is told."""
        return CHANGED if len(set(self.schemes)) > 1 else self.estimate.behaviour


def mesh_convergence(digest: Digest) -> Section | None:
    """Work of the contact against mesh size where only that is swept: order, limit and verdict per model."""
    if digest.swept_keys != [MESH_SIZE]:
        return None
    cases = sorted(digest.cases, key=lambda case: float(case.swept[MESH_SIZE]))
    found = [s for model in digest.models if (s := _series(digest, cases, model)) is not None]
    if not found:
        return None
    fixed = next((s for s in found if s.model == digest.reference and s.behaviour != CHANGED), None)
    reading = (
        "Each figure is the work of the contact at full load on one mesh. The order comes from the three finest "
        "meshes. Where it lies between 0.5 and 4 the limit is extrapolated with it, and ± is the grid convergence "
        "index of the finest mesh: 1.25 times its estimated error. Elsewhere ± is three times the largest "
        "difference between meshes. A model that is another scheme on some meshes has no limit. A model that "
        "converges has one of its own. How far that is from the limit of the reference is its structural error, "
        "which no finer mesh removes."
    )
    figure = Figures([_figure(digest, found, fixed)], digest.legend)
    note = Text(reading, kind="note")
    return Section("convergence", "Mesh convergence", [figure, _table(digest, found, fixed), note])


def _series(digest: Digest, cases: Sequence[CaseResult], model: str) -> _Series | None:
    known = [case for case in cases if math.isfinite(digest.at(case, model, WORK))]
    sizes = [float(case.swept[MESH_SIZE]) for case in known]
    values = [digest.at(case, model, WORK) for case in known]
    schemes = [str(case.models[model].parameters.get("scheme", "")) for case in known]
    if len(set(sizes)) < _LEVELS or len(set(sizes)) < len(sizes):
        return None
    limit, estimate = estimate_limit(values, [b / a for a, b in itertools.pairwise(sizes)])
    return _Series(model, sizes, values, schemes, limit, estimate)


def _table(digest: Digest, found: Sequence[_Series], fixed: _Series | None) -> Table:
    def work(size: float) -> Any:
        return lambda s: dict(zip(s.sizes, s.values, strict=True)).get(size)

    def order(s: _Series) -> Cell | None:
        value = s.estimate.observed_order
        return None if s.behaviour in (DIVERGING, CHANGED) else Cell(plain(value, 3), value=value)

    def limit(s: _Series) -> Cell:
        bar = "" if s.behaviour == CHANGED else f"± {quantity(s.estimate.gci, 'J')}"
        if s.behaviour == CONVERGING:
            return Cell(quantity(s.limit, "J"), bar, s.limit)
        return Cell(s.behaviour, bar, tone="bad")

    def against(s: _Series) -> Cell | None:
        if fixed is None or s is fixed or s.behaviour != CONVERGING:
            return None
        difference = s.limit / fixed.limit - 1.0
        bar = (s.estimate.gci + fixed.estimate.gci) / abs(fixed.limit)
        return Cell(percent(difference, signed=True), bar_detail(difference, bar), difference)

    fields = [
        Field("Model", lambda s: s.model),
        *(
            Field("Work", work(size), "J", quantity(size, "m"))
            for size in sorted({size for s in found for size in s.sizes}, reverse=True)
        ),
        Field("Order", order, "#"),
        Field("Limit", limit, "J"),
        Field("Limit", against, "1", f"against {fixed.model}")
        if fixed
        else Field("Levels", lambda s: s.behaviour),
    ]
    return frame_table(found, fields, "convergence", mark=lambda s: digest.mark(s.model))


def _figure(digest: Digest, found: Sequence[_Series], fixed: _Series | None) -> Figure:
    scale = fixed.limit if fixed else max(abs(value) for s in found for value in s.values)
    label = f"work, of the limit of {fixed.model}" if fixed else "work, of the largest"
    curves = [
        Curve(s.model, [1e3 * h for h in s.sizes[::-1]], [value / scale for value in s.values[::-1]])
        for s in found
    ]

    def finish(axes: Axes) -> None:
        percent_axis(axes, [value / scale for s in found for value in s.values])
        log_axis(axes, "x")
        axes.invert_xaxis()

    title = "Work of the contact against mesh size, refined to the right"
    return lines(digest, curves, "mesh size [mm]", label, title, "g0", finish=finish)
