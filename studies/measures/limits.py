"""The small-strain limits: the load up to which a model's error does not grow.

There are three different quantities. The structural error e0 of a model is its error against the finite-strain
reference in the limit of a small load. Its growth limit is the load at which error - e0 reaches a threshold. For
the linear finite elements e0 is zero, and the growth limit is the linearisation limit: small-strain theory
departs from finite strain on the same mesh.

The axis is the strain that 95 % of the volume does not exceed. Three meshes of a scene agree on it, whereas the
largest strain of any point grows with each refinement (`fem_reference.outputs.SHARE`).

A search ends at `LARGEST` times the study's load, or at `MOST_STRAIN`. A largest principal Green-Lagrange strain
of 4 is a fibre three times as long as at rest, more than any soft tissue bears. Solves beyond it cost more than
all others.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice

from .case import Limit, ModelLimits
from .uncertainty import estimate_error

SMALL = 1.0 / 512.0  # of the study's load: for the structural error
LARGEST = 64.0  # times the study's load: end of a search
MOST_STRAIN = 4.0  # largest principal Green-Lagrange strain of the reference: end of a search
_AT_THE_END = 0.9  # of that strain: close enough for a search to end
_AIM = 0.95  # of that strain: the next target of a search that would exceed it
CLOSE = 0.02  # relative to a threshold: accuracy of a crossing, part of a limit's bar
_MOST_STEPS = 12  # bisections of one crossing
_POWER_LAW_STEPS = 5  # of these
_RETREATS = 4  # bisections towards the load at which a solution stops


@dataclass(frozen=True)
class LoadPoint:
    """Results at one load. `error` is NaN for a model without a solution there; it is computed when read."""

    error: Mapping[str, float]
    indentation: float
    strain: float
    largest_strain: float


class LoadPath:
    """Errors along a rising load, each load evaluated once for all models.

    Parameters
    ----------
    evaluate : factor of the study's loads -> LoadPoint; None where the reference has no solution
    """

    def __init__(self, evaluate: Callable[[float], LoadPoint | None]) -> None:
        self._evaluate = evaluate
        self._points: dict[float, LoadPoint | None] = {}
        self._after: dict[float, float] = {}

    def at(self, factor: float) -> LoadPoint | None:
        """The point at `factor` times the study's loads."""
        if factor not in self._points:
            self._points[factor] = self._evaluate(factor)
        return self._points[factor]

    def usable(self, factor: float) -> bool:
        """Whether the reference has a solution at a factor, within the strain bound. An unknown strain passes."""
        point = self.at(factor)
        return point is not None and not point.largest_strain > MOST_STRAIN

    def at_end(self, factor: float) -> bool:
        """Whether a usable factor is the last of a search."""
        point = self.at(factor)
        return factor >= LARGEST or (point is not None and point.largest_strain >= _AT_THE_END * MOST_STRAIN)

    def reaches(self, factor: float) -> bool:
        """Whether no known result keeps a search from a factor."""
        return factor <= LARGEST and all(self.usable(other) for other in self._points if other <= factor)

    def after(self, factor: float) -> float:
        """The factor to try after a usable one: twice it, or less where the strain would exceed its bound.

        It is the same for every model and threshold, and does not depend on later evaluations.
        """
        if factor not in self._after:
            further, point = 2.0, self.at(factor)
            if point is not None and point.largest_strain > 0:
                growth = max(self.slope(lambda other: other.largest_strain, factor), 0.5)
                further = min(further, (_AIM * MOST_STRAIN / point.largest_strain) ** (1.0 / growth))
            self._after[factor] = further * factor
        return self._after[factor]

    def structural_error(self, model: str) -> float:
        """e0 of a model; NaN where it or the reference has no solution at a small load."""
        point = self.at(SMALL)
        return point.error[model] if point is not None else math.nan

    def departure(self, model: str, factor: float) -> float:
        """Error less e0; NaN where the model or the reference has no solution, or too large a strain."""
        point = self.at(factor)
        if point is None or not self.usable(factor):
            return math.nan
        return point.error[model] - self.structural_error(model)

    def between(self, low: float, high: float) -> list[float]:
        """All factors evaluated so far between two, rising."""
        return [factor for factor in sorted(self._points) if low < factor < high]

    def slope(self, value: Callable[[LoadPoint], float], factor: float) -> float:
        """d ln(value) / d ln(load) around a factor, from the nearest loads on either side; 1 where there are none.

        It uses loads evaluated so far with a positive value: two at or below the factor, and one above.
        """

        def nearest(factors: Iterable[float], count: int) -> list[tuple[float, float]]:
            points = ((at, self._points[at]) for at in factors if self.usable(at))
            pairs = ((at, value(point)) for at, point in points if point is not None)
            return list(islice((pair for pair in pairs if pair[1] > 0), count))

        rising = sorted(self._points)
        above = bisect_right(rising, factor)
        near = [*nearest(reversed(rising[:above]), 2)[::-1], *nearest(rising[above:], 1)]
        if len(near) < 2:
            return 1.0
        (x0, y0), (x1, y1) = near[0], near[-1]
        return math.log(y1 / y0) / math.log(x1 / x0)


def model_limits(path: LoadPath, model: str, thresholds: Sequence[float]) -> ModelLimits:
    """e0 and the growth limit of a model at each threshold, without error bars."""
    return ModelLimits(
        path.structural_error(model),
        math.nan,
        tuple(_limit(path, model, threshold) for threshold in sorted(thresholds)),
    )


def on_finer_mesh(limits: ModelLimits, path: LoadPath, fine: LoadPath, model: str) -> ModelLimits:
    """The limits on a finer mesh, with the bars of that mesh: its grid convergence index for two levels.

    `fine` is evaluated at a small load and once for each limit, at the load that `path` found for it. Around
    there the departure grows like load^p, with p its slope on `path`, at least 1/2. Indentation and strain have
    slopes of their own. These lead from the finer mesh's results at that load to its own limit.

    The bars of indentation and strain include their own change at the same load, and the bar of the load times
    their slope. A limit is unresolved if the finer mesh does not confirm it: no solution within the strain bound
    at that load, no growth of the error there, or an extrapolated limit beyond the loads of the search. If the
    finer mesh has no structural error, all limits stay unchanged, without bars.
    """
    e0 = fine.structural_error(model)
    if not math.isfinite(e0):
        return limits
    found = tuple(
        _on_finer_mesh(limit, path, fine, model) if limit.state == "found" else limit
        for limit in limits.limits
    )
    return ModelLimits(e0, _index(e0 - limits.structural_error), found)


def _on_finer_mesh(limit: Limit, path: LoadPath, fine: LoadPath, model: str) -> Limit:
    factor = limit.load
    own, other = path.at(factor), fine.at(factor)
    departure = fine.departure(model, factor)
    unresolved = replace(limit, state="unresolved")
    if own is None or other is None or not departure > 0:
        return unresolved
    e0 = path.structural_error(model)
    power = 1.0 / max(path.slope(lambda point: point.error[model] - e0, factor), 0.5)
    bar = _index(1.0 - (departure / path.departure(model, factor)) ** power) + CLOSE * power
    further = (limit.threshold / departure) ** power  # the finer mesh's limit load over this one
    indentation = path.slope(lambda point: abs(point.indentation), factor)
    strain = path.slope(lambda point: point.strain, factor)
    largest = other.largest_strain * further ** path.slope(lambda point: point.largest_strain, factor)
    if not path.reaches(further * factor) or largest > MOST_STRAIN:
        return unresolved
    return replace(
        limit,
        load=limit.load * further,
        bar=bar,
        indentation=other.indentation * further**indentation,
        indentation_bar=_index(1.0 - own.indentation / other.indentation) + abs(indentation) * bar,
        strain=other.strain * further**strain,
        strain_bar=_index(1.0 - own.strain / other.strain) + abs(strain) * bar,
        largest_strain=largest,
    )


def _index(difference: float) -> float:
    """GCI of the finer of two meshes, one refined once from the other; NaN for NaN."""
    return estimate_error([difference]).gci if math.isfinite(difference) else math.nan


def _limit(path: LoadPath, model: str, threshold: float) -> Limit:
    if not math.isfinite(path.structural_error(model)):
        return Limit(threshold, _why_not(path, SMALL), math.nan, math.nan, math.nan, math.nan)
    low, high, state = _bracket(path, model, threshold)
    factor = low if high is None else _crossing(path, model, threshold, low, high)
    point = path.at(factor)
    if point is None or not math.isfinite(path.departure(model, factor)):  # between two loads that have them
        return Limit(threshold, _why_not(path, factor), factor, math.nan, math.nan, math.nan)
    return Limit(
        threshold,
        state,
        factor,
        math.nan,
        point.indentation,
        point.strain,
        largest_strain=point.largest_strain,
    )


def _bracket(path: LoadPath, model: str, threshold: float) -> tuple[float, float | None, str]:
    """(low, high, state): departures below and above the threshold; high is None if no load exceeds it."""
    low, factor, stopped, retreats = SMALL, 1.0, math.inf, 0
    while True:
        departure = path.departure(model, factor)
        if departure >= threshold:
            return low, factor, "found"
        if math.isfinite(departure):
            low = factor
            if path.at_end(factor):
                return low, None, "beyond"
        else:
            stopped = factor
        if math.isinf(stopped):
            factor = path.after(factor)
        elif retreats < _RETREATS:
            retreats += 1
            factor = math.sqrt(low * stopped)
        else:
            return low, None, _why_not(path, stopped)


def _why_not(path: LoadPath, factor: float) -> str:
    """The state of a limit without a departure at a factor."""
    if path.at(factor) is None:
        return "reference-stopped"
    return "model-stopped" if path.usable(factor) else "beyond"


def _crossing(path: LoadPath, model: str, threshold: float, low: float, high: float) -> float:
    """Factor at which the departure is the threshold to 2 %: bisection, its first steps along a power law."""
    for factor in path.between(low, high):  # loads already evaluated for other models
        departure = path.departure(model, factor)
        if low < factor < high and math.isfinite(departure):
            low, high = (factor, high) if departure < threshold else (low, factor)
    for step in range(_MOST_STEPS):
        below, above = path.departure(model, low), path.departure(model, high)
        if above - threshold <= CLOSE * threshold:
            return high
        if threshold - below <= CLOSE * threshold:
            return low
        share = 0.5
        if below > 0 and step < _POWER_LAW_STEPS:
            share = math.log(threshold / below) / math.log(above / below)
        factor = low * (high / low) ** min(max(share, 0.1), 0.9)
        departure = path.departure(model, factor)
        if not math.isfinite(departure):
            return factor
        low, high = (factor, high) if departure < threshold else (low, factor)
    return high
