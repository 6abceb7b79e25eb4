"""How far off a model may be: the limits of [acceptance], and where numbers stand against them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver_common.arrays import Array

from ..machine import processor_name
from ..measures.metrics import DEFORMATION, VECTOR, max_nodal_error
from ..scene.result import ModelResult
from ..study.schema import Study

LEAST_TIMES = 3  # measured times, from which on none within is no chance
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
    region : that it is restricted to, "" for none
    """

    key: str
    name: str
    metric: str
    allowed: float
    unit: str = "1"
    region: str = ""

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
        region = given.region or ""
        name = f"largest difference in {region}" if region else "largest difference"
        found.append(Criterion("largest_difference", name, NODAL, most, "m", region))
    if (most := given.frame_time) is not None:
        found.append(Criterion(FRAME_TIME, "time per frame", FRAME_TIME, most, "s"))
    return tuple(found)


def states_of(values: Array, bars: Array, allowed: float) -> States:
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
    return BEYOND if len(times) >= LEAST_TIMES and times.min() > allowed else OPEN


def frame_time(result: ModelResult | None) -> float:
    """The median time of a frame of the contact; NaN where none was measured."""
    times = result.frames.contact if result is not None and result.frames is not None else np.zeros(0)
    known = times[np.isfinite(times)]
    return float(np.median(known)) if len(known) else math.nan


def word_of(states: Iterable[int]) -> str:
    """The answer to "is it good enough?" from a model's state in each judged case: that of the worst of them."""
    return max((WORD[state] for state in states), key=WORDS.index, default=NOT_JUDGED)
