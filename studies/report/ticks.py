"""Where an axis has its ticks, and what they are called."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

from .formatting import plain

Name = Callable[[float], str]
_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)
_MOST_DECADES = 7
_PLAIN = 1e6  # from here on a number has a power of ten


def linear_ticks(low: float, high: float, most: int) -> list[float]:
    """Multiples of a round step from `low` to `high`, at most `most` steps apart."""
    rough = (high - low) / most
    if not (rough > 0.0 and math.isfinite(rough)):
        return [low]
    decade = 10.0 ** math.floor(math.log10(rough))
    step = next((s * decade for s in _STEPS if s * decade >= rough * (1.0 - 1e-9)), 10.0 * decade)
    slack = 1e-9 * (high - low) / step
    first, last = math.ceil(low / step - slack), math.floor(high / step + slack)
    return [k * step for k in range(first, last + 1)]


def log_ticks(low: float, high: float) -> list[float]:
    """Powers of ten between positive ends; 1-2-5 steps below two decades, round ones where these are too few."""
    if high < 100.0 * low:
        powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
        ticks = [s * 10.0**k for k in powers for s in (1.0, 2.0, 5.0) if low <= s * 10.0**k <= high]
        return ticks if len(ticks) > 1 else linear_ticks(low, high, 4)
    first, last = math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9)
    stride = -(-(last - first + 1) // _MOST_DECADES)
    return [10.0**k for k in range(first, last + 1, stride)]


def names_of(ticks: Sequence[float]) -> list[str]:
    """Numbers with the decimals that tell neighbours apart, none of them in vain."""
    step = min((b - a for a, b in pairwise(ticks)), default=0.0)
    largest = max(map(abs, ticks), default=0.0)
    if step <= 0.0 or largest >= _PLAIN or step < 1e-4:
        return [plain(tick, 6) for tick in ticks]
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    if any(abs(round(tick, decimals) - tick) > 1e-6 * step for tick in ticks):
        decimals += 1  # steps of two and a half
    return [f"{tick + 0.0:.{decimals}f}".replace("-", "−") for tick in ticks]
