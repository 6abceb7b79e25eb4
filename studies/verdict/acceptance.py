"""The limits of [acceptance], how numbers stand against them, and up to which load a model keeps them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver_common.arrays import Array

from ..body.surface_measures import Surface
from ..machine import processor_name
from ..measures.case import CaseResult
from ..measures.metrics import DEFORMATION, VECTOR, max_nodal_error
from ..measures.pushed import Answer, Pushed
from ..scene.result import ModelResult
from ..study.loads import Constraint
from ..study.registry import SCANNED
from ..study.schema import Study, extras_of, has_weight

NODAL, FRAME_TIME = max_nodal_error.__name__, "frame_time"
# how a model stands against a limit; of several limits the largest state decides
NOT_ASKED, WITHIN, OPEN, BEYOND, LOST = -1, 0, 1, 2, 3
YES, UNDECIDED, NO, NOT_JUDGED = "yes", "undecided", "no", "not judged"
WORDS = (YES, UNDECIDED, NO, NOT_JUDGED)  # the best first
WORD = {WITHIN: YES, OPEN: UNDECIDED, BEYOND: NO, LOST: NO}  # for one case
States = NDArray[np.int8]


@dataclass(frozen=True)
class Criterion:
    """One limit of [acceptance].

    Attributes
    ----------
    key, name : key in the study file; name in words
    metric : the metric that is limited; FRAME_TIME for the time of a frame
    allowed : the limit, in `unit`
    """

    key: str
    name: str
    metric: str
    allowed: float
    unit: str = "1"

    @property
    def of_load(self) -> bool:
        """Whether the limited metric depends on the load: all but the time of a frame."""
        return self.metric != FRAME_TIME


def criteria(study: Study) -> tuple[Criterion, ...]:
    """The limits of a study. Those of the displacement error and of the change of shape come first."""
    given = study.acceptance
    found = [
        Criterion("displacement_error", "displacement error", VECTOR, given.displacement_error),
        Criterion("deformation_error", "change of shape", DEFORMATION, given.deformation_error),
    ]
    if (most := given.largest_difference) is not None:
        found.append(Criterion("largest_difference", "largest difference", NODAL, most, "m"))
    if (most := given.frame_time) is not None:
        found.append(Criterion(FRAME_TIME, "time per frame", FRAME_TIME, most, "s"))
    return tuple(found)


def states_of(values: Array, bars: Array, allowed: float | Array) -> States:
    """WITHIN or BEYOND if the error bar of the reference cannot change that, else OPEN. LOST if not finite.

    `values`, `bars` and `allowed` are in one unit. An error bar that was not measured counts as zero.
    """
    bars = np.where(np.isfinite(bars), bars, 0.0)
    found = np.where(values + bars <= allowed, WITHIN, np.where(values - bars > allowed, BEYOND, OPEN))
    return np.where(np.isfinite(values), found, LOST).astype(np.int8)


def time_state(result: ModelResult | None, allowed: float) -> int:
    """How a model's times of a frame stand against a limit [s]. A busy machine makes times longer, never shorter.

    WITHIN if three of four rounds keep the limit, BEYOND if the processor alone takes longer in all of at least
    `LEAST_ROUNDS`, or `CLEAR` times as long in one, else OPEN. OPEN too if the frames were not measured when the
    run ended, or on another machine.
    """
    frames = result.frames if result is not None else None
    if frames is None or frames.processor != processor_name():
        return OPEN
    times = frames.contact[np.isfinite(frames.contact)]
    if not len(times):
        return OPEN
    if np.quantile(times, 0.75, method="lower") <= allowed:
        return WITHIN
    return BEYOND if frames.is_beyond(allowed) else OPEN


def counted(states: States) -> dict[str, int]:
    """How many of a model's states (C,) are of each kind."""
    kinds = {"within": WITHIN, "undecided": OPEN, "beyond": BEYOND, "without an answer": LOST}
    return {name: int((states == kind).sum()) for name, kind in kinds.items()}


def word_of(states: Iterable[int]) -> str:
    """The word of the worst of a model's states in the judged cases; "not judged" if there are none."""
    return max((WORD[state] for state in states), key=WORDS.index, default=NOT_JUDGED)


_SAME = 1e-9  # relative difference below which two loads are equal


def kind_of(constraint: Constraint) -> str:
    """The kind of a constraint; a prescribed displacement of zero is "fixed"."""
    held = constraint.kind == "constrained" and not np.any(constraint.displacement or 0.0)
    return "fixed" if held else constraint.kind


def supports(case: CaseResult) -> NDArray[np.bool_]:
    """(N,) mask of the nodes that supports hold or move."""
    mask = np.zeros(len(case.points), dtype=bool)
    for constraint in case.study.constraints:
        if constraint.kind in ("fixed", "constrained"):
            mask |= case.regions[constraint.region]
    return mask


def pushes(case: CaseResult, surface: Surface) -> list[Pushed]:
    """The contacts, indenters and moved regions of a case, without those that have no nodes."""
    return [
        Pushed(case.study, constraint, mask, surface, case.load_factors)
        for constraint in case.study.constraints
        if kind_of(constraint) in ("contact", "indenter", "constrained")
        and (mask := case.regions[constraint.region]).any()
    ]


# --- up to which load ---


@dataclass(frozen=True)
class UpTo:
    """The largest load up to which a model is within the limits at all steps of all cases.

    Attributes
    ----------
    load, unit : that load, NaN if there is none; its unit, "1" for a share of the full load
    depth : least indentation of the reference at that load over the cases [m]; NaN if not known
    least, most : the smallest and the largest load of the study
    open : whether the next load is undecided, not beyond the limits
    some : whether a case is within the limits at a load
    """

    load: float
    unit: str
    depth: float
    least: float
    most: float
    open: bool
    some: bool

    @property
    def none(self) -> bool:
        """Whether there is no such load."""
        return math.isnan(self.load)

    @property
    def all(self) -> bool:
        """Whether it is the largest load of the study."""
        return not self.none and self.load >= self.most


@dataclass(frozen=True)
class KnownLoads:
    """The K steps of all cases with a load: (K,) loads in `unit`, (K,) depths [m], (K,) cases and steps."""

    unit: str
    loads: Array
    depths: Array
    cases: NDArray[np.int64]
    steps: NDArray[np.int64]


def known_loads(cases: Sequence[CaseResult], surfaces: Sequence[Surface]) -> KnownLoads:
    """The load of each step: that of the case's only contact, or of the only thing that pushes it.

    The reference's answer gives load and depth. The depth is NaN if the sag under a weight, or the motion of
    another region, adds to it. If the cases have no common unit, loads are shares of the full load, in the unit
    "1".
    """
    units, curves = set(), []
    for case, surface in zip(cases, surfaces, strict=True):
        every, reference = pushes(case, surface), case.models.get(str(case.reference))
        chosen = [one for one in every if one.constraint.kind == "contact"] or every
        alone = len(chosen) == 1 and reference is not None
        units.add(chosen[0].unit if alone else "1")
        nothing = np.full(len(case.load_factors), math.nan)
        depths, loads = chosen[0].curve(Answer.of(reference)) if alone and reference else (nothing, nothing)
        sags = has_weight(case.study) and SCANNED not in extras_of(case.study)
        if alone and chosen[0].constraint.kind == "contact" and (sags or len(every) > 1):
            depths = nothing
        curves.append((depths, loads))
    unit = units.pop() if len(units) == 1 else "1"
    rows = []
    for k, (case, (depths, loads)) in enumerate(zip(cases, curves, strict=True)):
        sizes = np.abs(case.load_factors)
        told = sizes / max(sizes.max(), np.finfo(float).tiny) if unit == "1" else np.abs(loads)
        steps = np.flatnonzero((sizes > 0.0) & (told > 0.0) & np.isfinite(told))
        rows += [(told[step], depths[step], k, step) for step in steps]
    loads, depths, numbers, steps = np.array(rows or np.zeros((0, 4))).T
    return KnownLoads(unit, loads, depths, numbers.astype(int), steps.astype(int))


def up_to(known: KnownLoads, states: States) -> UpTo | None:
    """`UpTo` of a model from its states (C, S); None if it has no answer at any step with a load."""
    if (states[known.cases, known.steps] == LOST).all():
        return None
    order = np.argsort(known.loads, kind="stable")
    loads, depths = known.loads[order], known.depths[order]
    states = states[known.cases[order], known.steps[order]]
    # steps with equal loads form one group; its worst state decides
    starts = np.flatnonzero(np.concatenate([[True], np.diff(loads) > _SAME * loads[1:]]))
    worst = np.maximum.reduceat(states, starts)
    within = int(np.argmin(np.append(worst, BEYOND) == WITHIN))  # groups before the first that is not
    last = slice(starts[within - 1], starts[within] if within < len(starts) else None)
    reached = np.abs(depths[last]) if within else np.zeros(0)
    return UpTo(
        load=float(loads[starts[within - 1]]) if within else math.nan,
        unit=known.unit,
        depth=min((depth for depth in reached.tolist() if math.isfinite(depth)), default=math.nan),
        least=float(loads[0]),
        most=float(loads[starts[-1]]),
        open=within < len(starts) and int(worst[within]) == OPEN,
        some=bool((states == WITHIN).any()),
    )
