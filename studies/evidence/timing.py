"""Times of calls too short for one reading of the clock: medians of samples that are long enough for it."""

from __future__ import annotations

import math
import timeit
from collections.abc import Callable

import numpy as np

from solver_common.arrays import Array

SAMPLE = 1e-3  # seconds of a sample at least: beside it the clock's grain and a call's overhead are nothing
SAMPLES = 5
# seconds that need no second sample in a round: what else the machine does is a small part of them
LONG = 2e-2


def median_seconds(call: Callable[[], object], clock: Callable[[], float] = timeit.default_timer) -> float:
    """Of a call: the median of `SAMPLES` samples, each the mean of as many calls as take `SAMPLE` or longer."""
    timer = timeit.Timer(call, timer=clock)
    number = calls_of_a_sample(min(timer.repeat(SAMPLES, 1)))
    return float(np.median(timer.repeat(SAMPLES, number))) / number


def calls_of_a_sample(seconds: float) -> int:
    """How many calls of so many seconds, the least of several, take `SAMPLE` or longer."""
    return max(1, math.ceil(SAMPLE / max(seconds, 1e-9)))


def median_of_samples(seconds: Array) -> float:
    """The same from single times (k,) of calls one after another, k of them enough for `SAMPLES` samples."""
    return float(np.median([part.mean() for part in np.array_split(seconds, SAMPLES)]))
