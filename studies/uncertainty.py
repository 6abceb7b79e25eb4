"""The reference's own error from mesh levels: observed order, Richardson estimate and GCI. Pure functions.

Levels are named from the finest, 0, each `ratio` times coarser than the one before. The differences of
neighbours d01 = |f0 - f1| and d12 = |f1 - f2| give the observed order p = ln(d12/d01)/ln(ratio), the estimated
error of level 0, d01/(ratio^p - 1), and its grid convergence index, a safety factor times that error
(Roache 1994, doi 10.1115/1.2910291; Celik et al. 2008, doi 10.1115/1.2960953).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

FORMAL_ORDER = 2.0
REASONABLE_ORDERS = (0.5, 4.0)


@dataclass(frozen=True)
class ErrorEstimate:
    """An estimate of the finest level's error, in the unit of the differences that it was made from."""

    error: float
    gci: float
    observed_order: float  # NaN where there are two levels only
    reasonable: bool  # whether the observed order could be used


def estimate_error(differences: Sequence[float], ratio: float = 2.0) -> ErrorEstimate:
    """Error of the finest level from [d01] or [d01, d12].

    With one difference, or an order outside 0.5 to 4, order 2 is assumed and the safety factor is 3, not 1.25.

    Raises
    ------
    ValueError
        no difference, or a ratio that is not above 1.
    """
    if not differences or ratio <= 1.0:
        raise ValueError("an error estimate needs two mesh levels or more, each coarser than the one before")
    first = differences[0]
    order = math.nan
    if len(differences) > 1 and first > 0 and differences[1] > 0:
        order = math.log(differences[1] / first) / math.log(ratio)
    low, high = REASONABLE_ORDERS
    reasonable = low <= order <= high
    error = first / (ratio ** (order if reasonable else FORMAL_ORDER) - 1.0)
    return ErrorEstimate(error, (1.25 if reasonable else 3.0) * error, order, reasonable)
