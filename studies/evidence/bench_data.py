"""What a benchmark measured, and what follows from it: plain data and pure functions, no solver."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from solver_common.arrays import Array

from ..measures.uncertainty import is_resolved
from ..verdict.formatting import NOTHING, quantity, scale_of

LEAST_SIZES = 4  # of a mesh, for an exponent
SAME = 1.5  # times up to which two costs count as the same: runs differ by as much
FAR_OFF = 0.5  # error from which on an answer is no answer: that of a body that does not move is 1
_DIGITS = 1e-4  # relative difference of errors that are the same answer's
TIMES = ("setup", "frame_all", "frame_local", "columns", "recut")  # (R,) of an entry [s]
YARDSTICK = "fem-linear"  # ratios are over its time in the same round


@dataclass(frozen=True)
class Entry:
    """One model on one mesh. Times are (R,) seconds, one per round; NaN where the model has no such thing.

    Attributes
    ----------
    body : name of the study
    nodes, tetrahedra : of the mesh that all models share
    setup : operators and factors of a new body, mesh given
    frame_all : one load over the whole free surface
    frame_local : one load on the study's contact region, by the cheapest way that the model has: where it is linear
        in the pressure, the product with one column per contact node, the same for all such models
    columns : what `frame_local` needs once per contact region, beyond the set-up
    recut : from a changed mesh to the first answer: set-up and a solve, without columns; no meshing
    ratio_setup, ratio_frame : of set-up and `frame_local` over those of `YARDSTICK` in the same round
    peak_bytes : resident memory that set-up and solve added at their peak
    error, deformation_error : relative L2 against the finest reference, of the contact load
    bar : that reference's own error (GCI)
    iterations : of the contact load
    counts : figures that do not depend on the machine, by name
    """

    body: str
    model: str
    nodes: int
    tetrahedra: int
    setup: Array
    frame_all: Array
    frame_local: Array
    columns: Array
    recut: Array
    ratio_setup: Array
    ratio_frame: Array
    peak_bytes: float
    error: float
    deformation_error: float
    bar: float
    iterations: float
    counts: Mapping[str, float] = field(default_factory=dict)
    status: str = "converged"


@dataclass(frozen=True)
class Growth:
    """A quantity over at least four sizes of one body."""

    what: str
    unit: str
    nodes: Array
    values: Array

    @property
    def exponent(self) -> float:
        """Slope of the least-squares line through the logarithms."""
        return float(np.polyfit(np.log(self.nodes), np.log(self.values), 1)[0])


@dataclass(frozen=True)
class Bench:
    """A whole benchmark: the machine, every model on every mesh, how costs grow."""

    machine: Mapping[str, str]
    entries: Sequence[Entry]
    growths: Sequence[Growth]

    def meshes(self) -> list[tuple[str, int]]:
        """(body, nodes) of each mesh, in the order measured."""
        return list(dict.fromkeys((entry.body, entry.nodes) for entry in self.entries))

    def on(self, mesh: tuple[str, int]) -> list[Entry]:
        """The entries of one mesh."""
        return [entry for entry in self.entries if (entry.body, entry.nodes) == mesh]


def median(values: Array) -> float:
    """Of what was measured; NaN where nothing was."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else math.nan


def spread(values: Array) -> tuple[float, float]:
    """First and third quartile of what was measured."""
    known = values[np.isfinite(values)]
    first, third = np.quantile(known, (0.25, 0.75)).tolist() if known.size else (math.nan, math.nan)
    return first, third


def deviation(bench: Bench) -> tuple[float, float]:
    """Interquartile range of the times of rounds over their median: in the median of all times, and at most."""
    off = [
        (third - first) / median(values)
        for e in bench.entries
        for values in (e.setup, e.frame_all, e.frame_local, e.recut)
        for first, third in [spread(values)]
        if np.isfinite(values).all() and median(values) > 0.0
    ]
    return (float(np.median(off)), max(off)) if off else (math.nan, math.nan)


@dataclass(frozen=True)
class ModelGrowth:
    """How a model's costs grow on one body: set-up, a load over all nodes and memory, None where not measured."""

    body: str
    model: str
    setup: Growth | None
    frame: Growth | None
    memory: Growth | None


def model_growths(bench: Bench) -> list[ModelGrowth]:
    """Of every model that was measured on four meshes or more of a body."""
    pairs = dict.fromkeys((e.body, e.model) for e in bench.entries)
    out = []
    for body, model in pairs:
        entries = [e for e in bench.entries if (e.body, e.model) == (body, model)]
        growths = (
            _grown("set-up", "s", entries, [median(e.setup) for e in entries]),
            _grown("frame", "s", entries, [median(e.frame_all) for e in entries]),
            _grown("memory", "B", entries, [e.peak_bytes for e in entries]),
        )
        if any(growths):
            out.append(ModelGrowth(body, model, *growths))
    return out


def _grown(what: str, unit: str, entries: Sequence[Entry], values: Sequence[float]) -> Growth | None:
    known = [(e.nodes, value) for e, value in zip(entries, values, strict=True) if value > 0.0]
    if len(known) < LEAST_SIZES:
        return None
    nodes, measured = np.array(known, dtype=float).T
    return Growth(what, unit, nodes, measured)


_COSTS: dict[str, Callable[[Entry], float]] = {
    "frame of a contact": lambda e: median(e.frame_local),
    "frame with all nodes loaded": lambda e: median(e.frame_all),
    "set-up with the contact's columns": lambda e: median(e.setup + e.columns),
    "re-cut": lambda e: median(e.recut),
}


def answers(bench: Bench) -> list[dict[str, str]]:
    """What is fastest, what is most accurate, where a surface model wins: question, and an answer per body.

    On the finest mesh of each body; a model that is far off answers nothing. Of a form with several solvers the
    plain one answers: others change the time more than the error. What the reference's own error leaves open is
    named as undecided.
    """
    finest = {mesh[0]: mesh for mesh in bench.meshes()}.values()
    asked: dict[str, Callable[[Sequence[Entry]], str]] = {}
    for limit in (0.1, 0.25):
        for what, cost in _COSTS.items():
            asked[f"Fastest {what} at an error of at most {100 * limit:g} %"] = partial(
                _fastest, limit=limit, cost=cost
            )
    for time in (1e-3, 1 / 60):  # a frame of haptics and one of graphics
        most = f"Most accurate at {seconds(time)} a frame of a contact"
        asked[most] = partial(_most_accurate, time=time, cut=False)
        asked[f"{most} with a re-cut in each"] = partial(_most_accurate, time=time, cut=True)
    for what, cost in _COSTS.items():
        asked[f"Surface models whose {what} no elements as close match"] = partial(_unmatched, cost=cost)
    usable = {}
    for mesh in finest:
        measured = {e.model: e for e in bench.on(mesh)}
        usable[f"{mesh[0]}, {mesh[1]:,} nodes"] = [
            e
            for e in measured.values()
            if e.error < FAR_OFF and (":" not in e.model or e.model.partition(":")[0] not in measured)
        ]
    return [
        {"question": question} | {mesh: answer(entries) for mesh, entries in usable.items()}
        for question, answer in asked.items()
    ]


def _fastest(entries: Sequence[Entry], *, limit: float, cost: Callable[[Entry], float]) -> str:
    """All surely within that take about the same, with the time of the fastest; and as fast ones perhaps within."""
    timed = sorted((e for e in entries if math.isfinite(cost(e))), key=lambda e: (cost(e), e.model))
    sure = [e for e in timed if e.error + e.bar <= limit]
    least = cost(sure[0]) if sure else math.inf
    alike = [e.model for e in sure if cost(e) <= SAME * least]
    perhaps = [
        e.model
        for e in timed
        if not (e.error + e.bar <= limit or e.error - e.bar > limit) and cost(e) <= SAME * least
    ]
    return _answer([*alike, seconds(least)] if sure else [], perhaps)


def _most_accurate(entries: Sequence[Entry], *, time: float, cut: bool) -> str:
    """The one of least error and those of the same; undecided where others are closer to it than the bar."""
    within = [e for e in entries if median(e.frame_local) <= time and not (cut and median(e.recut) > time)]
    if not within:
        return "none"
    best = min(within, key=lambda e: e.error)
    alike = [e.model for e in within if e.error <= (1.0 + _DIGITS) * best.error]
    near = [e.model for e in within if e.model not in alike and not e.error - best.error >= best.bar]
    if near:
        return _answer([], [*alike, *near, f"{error_text(best)} at best"])
    return _answer([*alike, error_text(best)], [])


def _unmatched(entries: Sequence[Entry], *, cost: Callable[[Entry], float]) -> str:
    """Surface models that no other surface model equals in both error and time, and no element model.

    Undecided where the closest elements of the same time differ by less than the bar.
    """
    elements = [e for e in entries if e.model.startswith("fem")]
    surface = [e for e in entries if not e.model.startswith("fem") and math.isfinite(cost(e))]
    sure, perhaps = [], []
    for e in surface:
        if any(o.error < e.error and cost(o) <= cost(e) for o in surface):
            continue
        closest = min((o.error for o in elements if cost(o) <= SAME * cost(e)), default=math.inf)
        if closest == math.inf or closest - e.error >= e.bar:
            sure.append(f"{e.model} ({error_text(e)}, {seconds(cost(e))})")
        elif not closest - e.error <= -e.bar:
            perhaps.append(e.model)
    return _answer(sure, perhaps)


def _answer(sure: Sequence[str], perhaps: Sequence[str]) -> str:
    parts = [", ".join(sure)] if sure else []
    if perhaps:
        parts.append(f"undecided: {', '.join(perhaps)}")
    return "; ".join(parts) or "none"


def pareto(entries: Iterable[Entry]) -> list[Entry]:
    """Those that no other beats in both error and time per local frame, the fastest first."""
    front: list[Entry] = []
    usable = (e for e in entries if math.isfinite(e.error) and math.isfinite(median(e.frame_local)))
    for entry in sorted(usable, key=lambda e: (median(e.frame_local), e.error)):
        if not front or entry.error < front[-1].error:
            front.append(entry)
    return front


def seconds(value: float) -> str:
    """A time with the unit that suits it."""
    if math.isnan(value):
        return NOTHING
    factor, unit = scale_of("s", [value])
    return f"{value / factor:.3g} {unit}"


def amount(value: float, unit: str) -> str:
    """A time, a size in memory or a number of non-zeros or operations."""
    if unit == "s":
        return seconds(value)
    return quantity(value, unit) if unit == "B" else f"{value / 1e6:.3g} million"


def error_text(e: Entry) -> str:
    """Error ± the reference's own, after a ~ where that is more than a tenth; the status of what has no answer."""
    if not math.isfinite(e.error):
        return e.status
    unresolved = "" if is_resolved(e.error, e.bar) else "~"
    return f"{unresolved}{100 * e.error:.3g} % ± {100 * e.bar:.2g} %"


def rows(bench: Bench) -> list[dict[str, str]]:
    """The printed table: column title -> text."""

    def timed(values: Array) -> str:
        low, high = spread(values)
        return f"{seconds(median(values))} [{seconds(low)}, {seconds(high)}]" if low == low else "–"

    return [
        {
            "model": e.model,
            "body": e.body,
            "nodes": f"{e.nodes:,}",
            "set-up": timed(e.setup),
            "frame, all nodes": timed(e.frame_all),
            "frame, contact": timed(e.frame_local),
            "columns": timed(e.columns),
            "re-cut": timed(e.recut),
            "set-up ratio": _ratio(e.ratio_setup),
            "frame ratio": _ratio(e.ratio_frame),
            "memory": amount(e.peak_bytes, "B"),
            "error": error_text(e),
        }
        for e in bench.entries
    ]


def _ratio(values: Array) -> str:
    """The median of the ratios of all rounds, and between which two they lie."""
    ratio, (low, high) = median(values), spread(values)
    return "–" if math.isnan(ratio) else f"{ratio:.2g} [{low:.2g}, {high:.2g}]"


def machine_independent(bench: Bench) -> dict[str, float]:
    """Every figure that another machine must find too, by name."""
    out: dict[str, float] = {}
    for e in bench.entries:
        at = f"{e.body}/{e.nodes}/{e.model}"
        if math.isfinite(e.error):
            out |= {f"{at}/error": e.error, f"{at}/deformation_error": e.deformation_error}
        out[f"{at}/iterations"] = e.iterations
        out |= {f"{at}/{name}": value for name, value in e.counts.items()}
    for growth in bench.growths:
        if growth.unit == "1":
            out[f"growth/{growth.what}"] = growth.exponent
            out[f"growth/{growth.what}/{int(growth.nodes[-1])}"] = float(growth.values[-1])
    return out
