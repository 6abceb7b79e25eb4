"""How far off a model may be: the limits of [acceptance], and where a model stands against each in a case."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from solver_common.arrays import Array

from ..machine import processor_name
from ..measures.bars import reference_bar, series
from ..measures.case import CaseResult
from ..measures.metrics import DEFORMATION, VECTOR, max_nodal_error
from ..scene.result import ModelResult
from ..study.schema import Study

CLOSE = 0.10  # of both errors where a study says nothing: the "within 10 %" that the paper's claim speaks of
LEAST_TIMES = 3  # measured times, from which on none within is no chance
NODAL = max_nodal_error.__name__
FRAME_TIME = "frame_time"
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
    allowed : the most that is accepted, in `unit`
    values : case, model -> (S,) what is limited at each step, NaN where there is none
    bar : case -> the reference's own part in it, NaN where not measured
    region : that it is restricted to, "" for none
    """

    key: str
    name: str
    allowed: float
    unit: str
    values: Callable[[CaseResult, str], Array]
    bar: Callable[[CaseResult], float]
    region: str = ""

    @property
    def of_load(self) -> bool:
        """Whether what it limits grows with the load."""
        return self.key != FRAME_TIME

    def at(self, case: CaseResult, model: str, step: int) -> float:
        """What is limited, at one step."""
        return float(self.values(case, model)[step])

    def states(self, case: CaseResult, model: str) -> States:
        """(S,) WITHIN or BEYOND, whatever the reference's own error is; else OPEN. LOST without an answer.

        An error of the reference that was not measured counts as none. A reference that moves as a rigid body has
        no change of shape, and a model's error in that is NOT_ASKED.
        """
        values, bar = self.values(case, model), self.bar(case)
        if self.key == FRAME_TIME:
            answered = np.isfinite(_series(case, model, VECTOR))
            state = _time_state(case.models[model], self.allowed) if answered.any() else LOST
            return np.where(answered, state, LOST).astype(np.int8)
        bar = bar if math.isfinite(bar) else 0.0
        known = np.isfinite(values)
        found = np.where(
            values + bar <= self.allowed, WITHIN, np.where(values - bar > self.allowed, BEYOND, OPEN)
        )
        found[~known] = LOST
        if self.key == "deformation_error":
            found[~known & np.isfinite(_series(case, model, VECTOR))] = NOT_ASKED
        return found.astype(np.int8)

    def state(self, case: CaseResult, model: str, step: int) -> int:
        """The state at one step."""
        return int(self.states(case, model)[step])


@dataclass(frozen=True)
class Acceptance:
    """The limits of a study, those of its errors first. What was looked up once is remembered."""

    criteria: tuple[Criterion, ...]
    _known: dict[tuple[str, str, str], object] = field(default_factory=dict, compare=False, repr=False)

    @property
    def of_load(self) -> tuple[Criterion, ...]:
        """Those that a larger load can break."""
        return tuple(one for one in self.criteria if one.of_load)

    def states(self, case: CaseResult, model: str, *, of_load: bool = False) -> States:
        """(S,) the worst of the limits' states; `of_load` leaves out what no load can break."""
        key = (case.hash, model, f"states {of_load}")
        if key not in self._known:
            criteria = self.of_load if of_load else self.criteria
            self._known[key] = np.max([one.states(case, model) for one in criteria], axis=0)
        return self._known[key]  # type: ignore[return-value]

    def state(self, case: CaseResult, model: str, *, of_load: bool = False) -> int:
        """The worst of the limits' states at full load."""
        return int(self.states(case, model, of_load=of_load)[case.full_load])

    def share(self, case: CaseResult, model: str) -> float:
        """The largest error over its limit at full load, whatever the time; infinite without an answer."""
        key = (case.hash, model, "share")
        if key not in self._known:
            shares = [one.at(case, model, case.full_load) / one.allowed for one in self.of_load]
            self._known[key] = float(np.nanmax(shares)) if math.isfinite(shares[0]) else math.inf
        return self._known[key]  # type: ignore[return-value]

    def usual_share(self, cases: Sequence[CaseResult], model: str) -> float:
        """Median of `share` over the cases; infinite if most have none."""
        return float(np.median([self.share(case, model) for case in cases])) if cases else math.inf

    def standing(self, cases: Sequence[CaseResult], model: str) -> tuple[float, ...]:
        """Sorts the models of a family, the one that decides first: by the answer, then by error, never by time.

        Of equal ones, or where half the cases or more have no answer, by how many have one. So one more model in
        a family never makes its answer a worse one.
        """
        word = word_of(self.state(case, model) for case in cases)
        known = [share for case in cases if math.isfinite(share := self.share(case, model))]
        usual = float(np.median(known)) if known else math.inf
        return WORDS.index(word), self.usual_share(cases, model), -len(known), usual


def acceptance(study: Study) -> Acceptance:
    """The limits of a study."""
    given = study.acceptance
    found = [
        _error("displacement_error", "displacement error", VECTOR, given.displacement_error),
        _error("deformation_error", "change of shape", DEFORMATION, given.deformation_error),
    ]
    if (most := given.largest_difference) is not None:
        region = given.region or ""
        name = f"largest difference in {region}" if region else "largest difference"

        def differences(case: CaseResult, model: str) -> Array:
            return _differences(case, model, region) if region else _series(case, model, NODAL)

        # the reference's own part in a region is no more than at any node
        bar = lambda case: reference_bar(case, NODAL)  # noqa: E731
        found.append(Criterion("largest_difference", name, most, "m", differences, bar, region))
    if (most := given.frame_time) is not None:
        found.append(Criterion(FRAME_TIME, "time per frame", most, "s", _frame_times, lambda _: math.nan))
    return Acceptance(tuple(found))


def _error(key: str, name: str, metric: str, allowed: float) -> Criterion:
    return Criterion(
        key,
        name,
        allowed,
        "1",
        lambda case, model: _series(case, model, metric),
        lambda case: reference_bar(case, metric),
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


def _time_state(result: ModelResult, allowed: float) -> int:
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


def word_of(states: Iterable[int]) -> str:
    """The answer to "is it good enough?" from a model's state in each judged case: that of the worst of them."""
    return max((WORD[state] for state in states), key=WORDS.index, default=NOT_JUDGED)
