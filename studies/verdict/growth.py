"""Up to which load small strain, and each model, hold against finite strain: the small-strain limits of a run."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from ..measures.case import CaseResult, Limit, ModelLimits
from .digest import Digest

LINEAR = "fem-linear"  # whose growth limit is the linearisation limit
PAPER_STRAIN = 0.10  # "small deformations and small strains (< 10 %)"
STATES = ("found", "unresolved", "beyond", "model-stopped", "reference-stopped")
Ends = tuple[tuple[float, float], tuple[float, float]]  # the least and the most, each with its bar


@dataclass(frozen=True)
class LimitRow:
    """One model's limit at one threshold in one case."""

    case: CaseResult
    model: str
    entry: ModelLimits
    unit: str
    limit: Limit


@dataclass(frozen=True)
class Reached:
    """The limits of one state at the smallest threshold: in how many cases, and at which loads."""

    state: str
    cases: int
    loads: Ends


@dataclass(frozen=True)
class Growth:
    """What the limits say of a model.

    Attributes
    ----------
    errors : at small loads already
    threshold : by which the error grows
    reached : at which loads, by state
    unit : of the loads, "1" for multiples of the study's
    asked : cases
    finer : whether a finer mesh confirms what is found
    depth, depth_bar : mean indentation there [m], relative bar; of one case alone, else NaN
    """

    model: str
    errors: Ends
    threshold: float
    reached: tuple[Reached, ...]
    unit: str
    asked: int
    finer: bool
    depth: float = math.nan
    depth_bar: float = math.nan


@dataclass(frozen=True)
class PaperBound:
    """Where small-strain theory departs from finite strain, beside the paper's bound of strain.

    Attributes
    ----------
    strains : threshold -> the least and the largest strain at which it departs by it
    found, below, open, denied : limits; below the bound; on an unresolved side of it; not confirmed by a finer mesh
    """

    strains: dict[float, Ends]
    found: int
    below: int
    open: int
    denied: int


def strain_side(limit: Limit) -> int:
    """Where a limit's strain lies of the paper's bound: -1 below, 1 above, 0 where that is unresolved.

    A bar that was not measured counts as none, one that straddles the bound as unresolved.
    """
    if limit.state == "unresolved":
        return 0
    low, high = strain_range(limit)
    return 1 if low >= PAPER_STRAIN else -1 if high < PAPER_STRAIN else 0


def strain_range(limit: Limit) -> tuple[float, float]:
    """The ends of a limit's bar of strain."""
    half = limit.strain * limit.strain_bar if math.isfinite(limit.strain_bar) else 0.0
    return limit.strain - half, limit.strain + half


def limit_rows(cases: Iterable[CaseResult]) -> Iterator[LimitRow]:
    """Every limit of every case."""
    for case in cases:
        found = case.small_strain
        for model, entry in found.models.items() if found is not None else ():
            for limit in entry.limits:
                yield LimitRow(case, model, entry, found.unit if found is not None else "1", limit)


def paper_bound(digest: Digest) -> PaperBound | None:
    """None where the linearisation limit was not searched, or no load has it."""
    own = [row.limit for row in limit_rows(digest.cases) if row.model == LINEAR]
    found = [limit for limit in own if limit.state == "found"]
    denied = [limit for limit in own if limit.state == "unresolved"]
    if not found and not denied:
        return None
    strains = {
        threshold: _ends([(n.strain, n.strain * n.strain_bar) for n in found if n.threshold == threshold])
        for threshold in sorted({limit.threshold for limit in found})
    }
    sides = [strain_side(limit) for limit in found]
    return PaperBound(strains, len(found), sides.count(-1), sides.count(0), len(denied))


def growth_of(digest: Digest, model: str) -> Growth | None:
    """What the limits say of a model at the smallest threshold; None where they say nothing.

    Every number is of the finest mesh there is, or says that it is not.
    """
    own = [row for row in limit_rows(digest.cases) if row.model == model]
    own = [row for row in own if math.isfinite(row.entry.structural_error)]
    if not own or model == LINEAR:
        return None
    threshold = min(row.limit.threshold for row in own)
    asked = [row for row in own if row.limit.threshold == threshold]
    reached = [
        Reached(state, len(mine), _ends([(row.limit.load, row.limit.bar) for row in mine]))
        for state in STATES
        if (mine := [row for row in asked if row.limit.state == state])
    ]
    only = asked[0].limit if len(asked) == 1 and asked[0].limit.state == "found" else None
    return Growth(
        model,
        _ends([(row.entry.structural_error, row.entry.structural_bar) for row in own]),
        threshold,
        tuple(reached),
        asked[0].unit,
        len(asked),
        any(math.isfinite(row.entry.structural_bar) for row in own),
        *((only.indentation, only.indentation_bar) if only is not None else ()),
    )


def _ends(values: Sequence[tuple[float, float]]) -> Ends:
    ordered = sorted(values, key=lambda value: abs(value[0]))
    return ordered[0], ordered[-1]
