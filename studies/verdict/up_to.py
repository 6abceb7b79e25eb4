"""Up to which load a model is within its limits, in newtons and millimetres."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..measures.case import CaseResult
from .acceptance import BEYOND, LOST, OPEN, WITHIN
from .digest import Digest
from .loading import depths_of, load_unit, loads_of

_SAME = 1e-9  # of a load: the difference of two that are one


@dataclass(frozen=True)
class UpTo:
    """The largest load up to which every case and every step that was tried is within the limits.

    Attributes
    ----------
    load, unit : that load, NaN where there is none; its unit, "1" where it is told as a share of the full load
    depth : how far the reference gives way there, in every case at least [m]; NaN where not known or none
    least, most : the smallest and the largest load tried
    deepest : how far the reference gives way at most, at any load tried [m]
    loads : how many loads were tried
    open : whether the next load is undecided, not beyond
    """

    load: float
    unit: str
    depth: float
    least: float
    most: float
    deepest: float
    loads: int
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
class _Point:
    """One step of one case."""

    load: float
    depth: float
    state: str


def up_to(digest: Digest, model: str) -> UpTo | None:
    """Of all steps that carry a load; a share of the full one, "1", where cases do not tell it in the same unit."""
    units = {load_unit(case) for case in digest.cases}
    unit = units.pop() or "1" if len(units) == 1 else "1"
    points = [point for case in digest.cases for point in _points(digest, case, model, unit)]
    if not points:
        return None
    found: list[_Point] = []
    states = {WITHIN}
    groups = _by_load(points)
    for group in groups:
        states = {point.state for point in group}
        if states != {WITHIN}:
            break
        found = group
    depths = [abs(point.depth) for point in points if math.isfinite(point.depth)]
    reached = [abs(point.depth) for point in found if math.isfinite(point.depth)]
    return UpTo(
        load=found[0].load if found else math.nan,
        unit=unit,
        depth=min(reached, default=math.nan),
        least=groups[0][0].load,
        most=groups[-1][0].load,
        deepest=max(depths, default=math.nan),
        loads=len(groups),
        open=OPEN in states and not {BEYOND, LOST} & states,
    )


def _by_load(points: Sequence[_Point]) -> list[list[_Point]]:
    """The points of each load, in rising order."""
    groups: list[list[_Point]] = []
    for point in sorted(points, key=lambda point: point.load):
        if groups and math.isclose(point.load, groups[-1][0].load, rel_tol=_SAME):
            groups[-1].append(point)
        else:
            groups.append([point])
    return groups


def _points(digest: Digest, case: CaseResult, model: str, unit: str) -> list[_Point]:
    loads, depths = np.abs(loads_of(case, unit)), depths_of(case, digest.surfaces[case.hash].normals)
    limits = digest.limits.of_load
    return [
        _Point(float(loads[step]), float(depths[step]), limits.state(case, model, int(step)))
        for step in np.flatnonzero(case.load_factors)
        if math.isfinite(loads[step]) and loads[step] > 0.0
    ]
