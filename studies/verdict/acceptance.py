"""The limits of [acceptance], where numbers stand against them, and up to which load of what pushes a body."""

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
from ..scene.result import LEAST_ROUNDS, ModelResult
from ..study.loads import Constraint
from ..study.schema import Study

NODAL, FRAME_TIME = max_nodal_error.__name__, "frame_time"
# where a model stands; of several limits the largest decides
NOT_ASKED, WITHIN, OPEN, BEYOND, LOST = -1, 0, 1, 2, 3
YES, UNDECIDED, NO, NOT_JUDGED = "yes", "undecided", "no", "not judged"
WORDS = (YES, UNDECIDED, NO, NOT_JUDGED)  # the best first
WORD = {WITHIN: YES, OPEN: UNDECIDED, BEYOND: NO, LOST: NO}  # of one case
States = NDArray[np.int8]


@dataclass(frozen=True)
class Criterion:
    """One limit of [acceptance].

    Attributes
    ----------
    key, name : in the study file, and in words
    metric : what is limited, FRAME_TIME for the time of a frame
    allowed : the most that is accepted, in `unit`
    """

    key: str
    name: str
    metric: str
    allowed: float
    unit: str = "1"

    @property
    def of_load(self) -> bool:
        """Whether what it limits grows with the load."""
        return self.metric != FRAME_TIME


def criteria(study: Study) -> tuple[Criterion, ...]:
    """The limits of a study, those of its two errors first."""
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
    """WITHIN or BEYOND, whatever the reference's own error is; else OPEN. LOST of what is not finite.

    An error of the reference that was not measured counts as none.
    """
    bars = np.where(np.isfinite(bars), bars, 0.0)
    found = np.where(values + bars <= allowed, WITHIN, np.where(values - bars > allowed, BEYOND, OPEN))
    return np.where(np.isfinite(values), found, LOST).astype(np.int8)


def time_state(result: ModelResult | None, allowed: float) -> int:
    """Where a model's times stand: a busy machine makes them longer, never shorter.

    WITHIN where three in four rounds keep the limit, BEYOND where none of at least three does, else OPEN. What was
    not measured anew in turns with the others, or on another machine, decides nothing.
    """
    frames = result.frames if result is not None else None
    if frames is None or frames.processor != processor_name():
        return OPEN
    times = frames.contact[np.isfinite(frames.contact)]
    if not len(times):
        return OPEN
    if np.quantile(times, 0.75, method="lower") <= allowed:
        return WITHIN
    return BEYOND if len(times) >= LEAST_ROUNDS and times.min() > allowed else OPEN


def counted(states: States) -> dict[str, int]:
    """How many of a model's states in the judged cases are of each kind."""
    kinds = {"within": WITHIN, "undecided": OPEN, "beyond": BEYOND, "without an answer": LOST}
    return {name: int((states == kind).sum()) for name, kind in kinds.items()}


def word_of(states: Iterable[int]) -> str:
    """The answer to "is it good enough?" from a model's state in each judged case: that of the worst of them."""
    return max((WORD[state] for state in states), key=WORDS.index, default=NOT_JUDGED)


_SAME = 1e-9  # of a load: the difference of two that are one


def kind_of(constraint: Constraint) -> str:
    """Its kind; what is moved by nothing is held."""
    held = constraint.kind == "constrained" and not np.any(constraint.displacement or 0.0)
    return "fixed" if held else constraint.kind


def supports(case: CaseResult) -> NDArray[np.bool_]:
    """(N,) nodes that a support holds or moves."""
    mask = np.zeros(len(case.points), dtype=bool)
    for constraint in case.study.constraints:
        if constraint.kind in ("fixed", "constrained"):
            mask |= case.regions[constraint.region]
    return mask


def pushes(case: CaseResult, surface: Surface) -> list[Pushed]:
    """What pushes or moves a body: its contacts, indenters and moved regions."""
    return [
        Pushed(case.study, constraint, mask, surface, case.load_factors)
        for constraint in case.study.constraints
        if kind_of(constraint) in ("contact", "indenter", "constrained")
        and (mask := case.regions[constraint.region]).any()
    ]


# --- up to which load ---


@dataclass(frozen=True)
class UpTo:
    """The largest load up to which every case and every step that was tried is within the limits.

    Attributes
    ----------
    load, unit : that load, NaN where there is none; its unit, "1" where it is told as a share of the full load
    depth : how far the reference gives way there, in every case at least [m]; NaN where not known or none
    least, most : the smallest and the largest load tried
    open : whether the next load is undecided, not beyond
    """

    load: float
    unit: str
    depth: float
    least: float
    most: float
    open: bool

    @property
    def none(self) -> bool:
        """Whether there is no such load."""
        return math.isnan(self.load)

    @property
    def all(self) -> bool:
        """Whether it is the largest tried."""
        return not self.none and self.load >= self.most


@dataclass(frozen=True)
class KnownLoads:
    """The K steps of all cases that carry a load: unit, (K,) loads, (K,) depths [m], (K,) cases and steps."""

    unit: str
    loads: Array
    depths: Array
    cases: NDArray[np.int64]
    steps: NDArray[np.int64]


def known_loads(cases: Sequence[CaseResult], surfaces: Sequence[Surface]) -> KnownLoads:
    """The loads of each case's only contact, else of the one thing that pushes it, as its reference answers.

    They are shares of the full load, "1", where the cases do not tell them in one unit.
    """
    units, curves = set(), []
    for case, surface in zip(cases, surfaces, strict=True):
        every, reference = pushes(case, surface), case.models.get(str(case.reference))
        chosen = [one for one in every if one.constraint.kind == "contact"] or every
        alone = len(chosen) == 1 and reference is not None
        units.add(chosen[0].unit if alone else "1")
        nothing = np.full(len(case.load_factors), math.nan)
        curves.append(chosen[0].curve(Answer.of(reference)) if alone and reference else (nothing, nothing))
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
    """Of all steps that carry a load, from the (C, S) states of a model; None where it answers at none."""
    if (states[known.cases, known.steps] == LOST).all():
        return None
    order = np.argsort(known.loads, kind="stable")
    loads, depths = known.loads[order], known.depths[order]
    states = states[known.cases[order], known.steps[order]]
    # points of one load are one group, of which the worst decides
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
    )
