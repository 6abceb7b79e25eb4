"""How far off a model may be: the limits of [acceptance], and where a model stands against each in a case."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from solver_common.arrays import Array

from ..machine.processors import processor_name
from ..measures.bars import reference_bar, series
from ..measures.case import CaseResult
from ..measures.metrics import DEFORMATION, VECTOR, max_nodal_error
from ..scene.result import ModelResult
from ..study.schema import Study

CLOSE = 0.10  # of both errors where a study says nothing: the "within 10 %" that the paper's claim speaks of
LEAST_TIMES = 3  # measured times, from which on none within is no chance
NODAL = max_nodal_error.__name__
WITHIN, OPEN, BEYOND, LOST = "within", "open", "beyond", "lost"
NOT_ASKED = ""  # of a limit that a case has nothing to hold against
YES, UNDECIDED, NO, NOT_JUDGED = "yes", "undecided", "no", "not judged"
_WORDS = (YES, UNDECIDED, NO, NOT_JUDGED)  # the best first
WORD = {WITHIN: YES, OPEN: UNDECIDED, BEYOND: NO, LOST: NO}  # of one case


@dataclass(frozen=True)
class Criterion:
    """One limit of [acceptance].

    Attributes
    ----------
    key, name : in the study file, and in words
    allowed : the most that is accepted, in `unit`
    of_load : whether what it limits grows with the load
    values : case, model -> (S,) what is limited at each step, NaN where there is none
    bar : case -> the reference's own part in it, NaN where not measured
    """

    key: str
    name: str
    allowed: float
    unit: str
    of_load: bool
    values: Callable[[CaseResult, str], Array]
    bar: Callable[[CaseResult], float]
    region: str = ""

    def at(self, case: CaseResult, model: str, step: int) -> float:
        """What is limited, at one step."""
        return float(self.values(case, model)[step])

    def state(self, case: CaseResult, model: str, step: int) -> str:
        """WITHIN or BEYOND, whatever the reference's own error is; else OPEN. LOST without an answer.

        An error of the reference that was not measured counts as none. A reference that moves as a rigid body has
        no change of shape, and a model's error in that is NOT_ASKED.
        """
        value, bar = self.at(case, model, step), self.bar(case)
        if self.key == "frame_time":
            answered = math.isfinite(_series(case, model, VECTOR)[step])
            return _time_state(case.models[model], self.allowed) if answered else LOST
        bar = bar if math.isfinite(bar) else 0.0
        if not math.isfinite(value):
            answered = math.isfinite(_series(case, model, VECTOR)[step])
            return NOT_ASKED if answered and self.key == "deformation_error" else LOST
        if value + bar <= self.allowed:
            return WITHIN
        return BEYOND if value - bar > self.allowed else OPEN


@dataclass(frozen=True)
class Acceptance:
    """The limits of a study, those of its errors first."""

    criteria: tuple[Criterion, ...]

    @property
    def of_load(self) -> Acceptance:
        """Those that a larger load can break."""
        return Acceptance(tuple(one for one in self.criteria if one.of_load))

    def state(self, case: CaseResult, model: str, step: int) -> str:
        """The worst of the limits' states."""
        states = {one.state(case, model, step) for one in self.criteria}
        return next(state for state in (LOST, BEYOND, OPEN, WITHIN) if state in states)

    def share(self, case: CaseResult, model: str) -> float:
        """The largest of what is limited over its limit at full load; infinite without an answer."""
        shares = np.array([one.at(case, model, case.full_load) / one.allowed for one in self.criteria])
        return float(np.nanmax(shares)) if math.isfinite(shares[0]) else math.inf


def acceptance(study: Study) -> Acceptance:
    """The limits of a study."""
    given = study.acceptance
    found = [
        _error("displacement_error", "displacement error", VECTOR, given.displacement_error),
        _error("deformation_error", "change of shape", DEFORMATION, given.deformation_error),
    ]
    if given.largest_difference is not None:
        found.append(_largest_difference(given.largest_difference, given.region or ""))
    if (most := given.frame_time) is not None:
        found.append(
            Criterion("frame_time", "time per frame", most, "s", False, _frame_times, lambda _: math.nan)
        )
    return Acceptance(tuple(found))


def _error(key: str, name: str, metric: str, allowed: float) -> Criterion:
    return Criterion(
        key,
        name,
        allowed,
        "1",
        True,
        lambda case, model: _series(case, model, metric),
        lambda case: reference_bar(case, metric),
    )


def _largest_difference(most: float, region: str) -> Criterion:
    """At any node, or at those of a region: the reference's own part in that is no more than at any node."""
    return Criterion(
        "largest_difference",
        f"largest difference in {region}" if region else "largest difference",
        most,
        "m",
        True,
        lambda case, model: _differences(case, model, region) if region else _series(case, model, NODAL),
        lambda case: reference_bar(case, NODAL),
        region,
    )


def _series(case: CaseResult, model: str, metric: str) -> Array:
    values = series(case, model, metric)
    return _nothing(case) if values is None or not len(values) else values


def _differences(case: CaseResult, model: str, region: str) -> Array:
    """(S,) largest |u - r| of a region's nodes [m]."""
    mask = case.regions.get(region)
    reference = case.models.get(str(case.reference))
    if mask is None or not mask.any() or reference is None or model not in case.models:
        return _nothing(case)
    gaps = case.models[model].displacement[:, mask] - reference.displacement[:, mask]
    return np.linalg.norm(gaps, axis=2).max(axis=1)


def _frame_times(case: CaseResult, model: str) -> Array:
    """(S,) the median time of a frame of the contact, the same for all steps."""
    result = case.models.get(model)
    times = result.frames.contact if result is not None and result.frames is not None else np.zeros(0)
    known = times[np.isfinite(times)]
    return np.full(len(case.load_factors), np.median(known) if len(known) else math.nan)


def _time_state(result: ModelResult, allowed: float) -> str:
    """Where a model's times stand: a busy machine makes them longer, never shorter.

    WITHIN where three in four rounds keep the limit, BEYOND where none of at least three does, else OPEN. What was
    not measured anew in turns with the others, or on another machine, decides nothing.
    """
    frames = result.frames
    if frames is None or frames.processor != processor_name():
        return OPEN
    times = frames.contact[np.isfinite(frames.contact)]
    if not len(times):
        return OPEN
    if np.quantile(times, 0.75, method="lower") <= allowed:
        return WITHIN
    return BEYOND if len(times) >= LEAST_TIMES and times.min() > allowed else OPEN


def _nothing(case: CaseResult) -> Array:
    return np.full(len(case.load_factors), math.nan)


# --- over all cases ---


def word_of(states: Iterable[str]) -> str:
    """The answer to "is it good enough?" from a model's state in each judged case: that of the worst of them."""
    return max((WORD[state] for state in states), key=_WORDS.index, default=NOT_JUDGED)


def usual_share(cases: Sequence[CaseResult], model: str, limits: Acceptance) -> float:
    """Median over the cases of the largest error over its limit, whatever the time; infinite if most have none."""
    shares = [limits.of_load.share(case, model) for case in cases]
    return float(np.median(shares)) if shares else math.inf


def standing(cases: Sequence[CaseResult], model: str, limits: Acceptance) -> tuple[float, ...]:
    """Sorts the models of a family, the one that decides first: by the answer, then by error alone, never by time.

    Of equal ones, or where half the cases or more have no answer, by how many have one. So one more model in a
    family never makes its answer a worse one.
    """
    word = word_of(limits.state(case, model, case.full_load) for case in cases)
    shares = np.array([limits.of_load.share(case, model) for case in cases])
    known = shares[np.isfinite(shares)]
    usual = float(np.median(known)) if len(known) else math.inf
    return _WORDS.index(word), usual_share(cases, model, limits), -len(known), usual
