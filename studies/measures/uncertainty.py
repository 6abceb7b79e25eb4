"""The error of a result from mesh levels: observed order, Richardson estimate and GCI. Pure functions.

Levels are named from the finest, 0; the mesh size grows by a ratio r from each to the next. The differences of
neighbours are d01 = f1 - f0 and d12 = f2 - f1. The observed order p follows from d12 / d01 = r^p. The estimated
error of level 0 is |d01| / (r^p - 1). Its grid convergence index (GCI) is a safety factor times that error (Roache
1994, doi 10.1115/1.2910291; Celik et al. 2008, doi 10.1115/1.2960953). The behaviour of the levels decides how far
the estimate can be trusted:

| behaviour | is | error | factor |
| --- | --- | --- | --- |
| converging | p from 0.5 to 4, on four levels twice the same within 1 | by p | 1.25 |
| two levels | one difference | by order 1 | 1.25 |
| unsteady | p from 0.5 to 4, on four levels not the same | by the smaller of p and 2 | 3 |
| too fast | p above 4 | by order 2 | 3 |
| too slow | p below 0.5 | the largest difference between levels | 3 |
| oscillating | differences that shrink and change sign | the largest difference between levels | 3 |
| diverging | differences that do not shrink | the largest difference between levels | 3 |

Two levels show no order. On bodies used for no tuning the median observed order is 1.1, at the rims of supports
and contacts; 1 is therefore assumed (`results/error-bars.md` has its coverage).

The last three rows follow Eca and Hoekstra (2014, doi 10.1016/j.jcp.2014.01.006). A diverging result has no true
error bar: the word is printed beside the number.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver_common.arrays import Array

VERSION = 2  # of these rules; raised whenever a bar changes
FORMAL_ORDER = 2.0
ASSUMED_ORDER = 1.0  # of two levels
SAFETY, WIDE_SAFETY = 1.25, 3.0
REASONABLE_ORDERS = (0.5, 4.0)
STEADY = 1.0  # largest difference of two observed orders
RESOLUTION = 0.1  # a discrepancy is resolved where the bar is at most this share of it

INDENTATION_FORCE = "indentation_force_error"
STRAINS = ("mean_strain_x", "mean_strain_y", "mean_strain_z")
# figures that two meshes may share by chance
SIGNED = (INDENTATION_FORCE, "volume_drift", "volume_drift_of_displaced", *STRAINS, "contact_work")

CONVERGING, TWO_LEVELS, UNSTEADY = "converging", "two levels", "unsteady"
TOO_FAST, TOO_SLOW = "too fast", "too slow"
OSCILLATING, DIVERGING = "oscillating", "diverging"


@dataclass(frozen=True)
class ErrorEstimate:
    """An estimate of the finest level's error, in the unit of the given differences."""

    error: float
    gci: float
    observed_order: float  # NaN where there are two levels only
    behaviour: str  # one of the words above

    @property
    def reasonable(self) -> bool:
        """Whether the observed order could be used."""
        return self.behaviour == CONVERGING


def is_resolved(discrepancy: float | Array, bar: float | Array) -> Any:
    """Whether discrepancies exceed the error bars of their reference, for numbers or arrays.

    Tables, verdicts, limits and gates all use this definition. False where either is not finite.
    """
    return np.isfinite(bar) & np.isfinite(discrepancy) & (bar <= RESOLUTION * np.abs(discrepancy))


def reference_bar(reference_error: Mapping[str, float], metric: str) -> float:
    """The part of a metric's value that may be the reference's own error; NaN if not measured.

    Parameters
    ----------
    reference_error : of a case, see `vdmbench.measures.reference.own_error`
    metric : a name of `vdmbench.measures.metrics.METRICS`
    """
    return reference_error.get(f"gci:{metric}", math.nan)


def least_bar(metric: str, figures: Mapping[str, float], relative: float) -> float:
    """Least bar of a signed figure; NaN for a norm, and where it is unknown.

    Two meshes may agree on a signed figure by chance, if their errors at the contact and at the support have
    opposite signs. A norm of differences has no signs. Relative to its parts, no such figure therefore counts as
    more accurate than the displacement.

    Parameters
    ----------
    figures : metrics of the same model and load: strains, drift or work of the reference, or the indentation force
    relative : the reference's own relative error in displacement
    """
    value = figures.get(metric, math.nan)
    if metric == INDENTATION_FORCE:  # a ratio of forces, proportional to the reference's depth
        return relative * abs(1.0 + value)
    if metric == "contact_work":
        return relative * abs(value)
    if metric in STRAINS:
        return relative * max(abs(figures.get(strain, math.nan)) for strain in STRAINS)
    of_displaced = figures.get("volume_drift_of_displaced", math.nan)
    if metric == "volume_drift":  # over volume_drift_of_displaced it is the displaced volume over the volume
        return relative * abs(value / of_displaced) if of_displaced else math.nan
    return relative if metric == "volume_drift_of_displaced" else math.nan


def stored_estimate(reference_error: Mapping[str, float]) -> ErrorEstimate | None:
    """The estimate behind a case's `reference_error`; None if not measured or not finite."""
    differences = [
        reference_error[key]
        for key in ("difference_01", "difference_12", "difference_23")
        if key in reference_error
    ]
    return estimate_error(differences) if differences and all(map(math.isfinite, differences)) else None


def estimate_error(differences: Sequence[float], ratio: float = 2.0) -> ErrorEstimate:
    """Error of the finest level from [d01], [d01, d12] or more.

    Parameters
    ----------
    differences : signed; for a field norms, each with the sign of its product with d01
    ratio : of neighbouring mesh sizes

    Raises
    ------
    ValueError
        no difference, one that is not finite, a ratio that is not above 1.
    """
    if not differences or ratio <= 1.0:
        raise ValueError("an error estimate needs two mesh levels or more, each coarser than the one before")
    if not all(math.isfinite(d) for d in differences):
        raise ValueError("an error estimate needs finite differences; a mesh level has no result")
    first = abs(differences[0])
    if len(differences) == 1:
        error = first / (ratio**ASSUMED_ORDER - 1.0)
        return ErrorEstimate(error, SAFETY * error, math.nan, TWO_LEVELS)
    orders = [_order(fine, coarse, ratio) for fine, coarse in itertools.pairwise(differences)]
    order = orders[0]
    behaviour = _behaviour(differences, orders)
    if behaviour in (TOO_SLOW, OSCILLATING, DIVERGING):
        error = _largest_difference(differences)
    else:
        used = {CONVERGING: order, UNSTEADY: min(order, FORMAL_ORDER), TOO_FAST: FORMAL_ORDER}[behaviour]
        error = first / (ratio**used - 1.0)
    return ErrorEstimate(
        error, (SAFETY if behaviour == CONVERGING else WIDE_SAFETY) * error, order, behaviour
    )


def estimate_limit(values: Sequence[float], ratio: float = 2.0) -> tuple[float, ErrorEstimate]:
    """Richardson's extrapolation of a number on ever coarser meshes, finest first, and the finest's error.

    If the levels do not converge, the finest value itself.
    """
    differences = [coarse - fine for fine, coarse in itertools.pairwise(values)]
    estimate = estimate_error(differences, ratio)
    shift = math.copysign(estimate.error, differences[0]) if estimate.reasonable else 0.0
    return values[0] - shift, estimate


def _behaviour(differences: Sequence[float], orders: Sequence[float]) -> str:
    order, (low, high) = orders[0], REASONABLE_ORDERS
    if not any(differences):
        return CONVERGING
    if order <= 0.0:
        return DIVERGING
    if differences[0] * differences[1] < 0.0:
        return OSCILLATING
    if order < low:
        return TOO_SLOW
    if order > high:
        return TOO_FAST
    return CONVERGING if all(abs(other - order) <= STEADY for other in orders[1:]) else UNSTEADY


def _order(d01: float, d12: float, ratio: float) -> float:
    """Observed order, infinite where d01 alone is zero; 0 or less where the differences do not shrink."""
    if d01 == 0.0:
        return math.inf if d12 else FORMAL_ORDER
    growth = abs(d12 / d01)
    return math.log(growth) / math.log(ratio) if growth else -math.inf


def _largest_difference(differences: Sequence[float]) -> float:
    """Largest difference between any two levels, in the units of the differences."""
    places = list(itertools.accumulate(differences, initial=0.0))
    return max(places) - min(places)
