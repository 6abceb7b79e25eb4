"""Up to which load small strain, and each model, hold against finite strain: the small-strain limits in words."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import starmap

from ..measures.case import CaseResult, Limit, ModelLimits
from .digest import Digest
from .formatting import listed, quantity, short_percent

LINEAR = "fem-linear"  # whose growth limit is the linearisation limit
PAPER_STRAIN = 0.10  # "small deformations and small strains (< 10 %)"


@dataclass(frozen=True)
class LimitRow:
    """One model's limit at one threshold in one case."""

    case: CaseResult
    model: str
    entry: ModelLimits
    unit: str
    limit: Limit


def is_measured(limit: Limit) -> bool:
    """Whether some mesh has the limit."""
    return limit.state in ("found", "unresolved")


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


def strain_in_words(limit: Limit) -> str:
    """A limit's strain with its bar where that was measured."""
    return _with_bar(limit.strain, limit.strain * limit.strain_bar)


def limit_rows(cases: Iterable[CaseResult]) -> Iterator[LimitRow]:
    for case in cases:
        if case.small_strain is None:
            continue
        for model, entry in case.small_strain.models.items():
            for limit in entry.limits:
                yield LimitRow(case, model, entry, case.small_strain.unit, limit)


def against_the_paper(digest: Digest) -> str:
    """Where small-strain theory departs from finite strain, and on which side of the paper's bound it is; or ""."""
    rows = list(limit_rows(digest.cases))
    found, denied = (
        [row for row in rows if row.model == LINEAR and row.limit.state == state]
        for state in ("found", "unresolved")
    )
    theory = f"small-strain theory ({LINEAR}) departs from finite strain"
    if not found:
        return f"Where {theory} is not known: a finer mesh does not confirm it." if denied else ""
    parts = []
    for threshold in sorted({row.limit.threshold for row in found}):
        mine = [row.limit for row in found if row.limit.threshold == threshold]
        ends = [min(mine, key=lambda limit: limit.strain), max(mine, key=lambda limit: limit.strain)]
        parts.append(f"{short_percent(threshold)} at a strain of {_span(map(strain_in_words, ends))}")
    sides = [strain_side(row.limit) for row in found]
    below, open_ = sides.count(-1), sides.count(0)
    bound = f"the paper's bound of {short_percent(PAPER_STRAIN)} strain"
    told = [f"{below} of these {len(found)} limits lie below {bound}"] if below else []
    told += (
        [f"of {open_} of these {len(found)} it is unresolved on which side of {bound} they lie"]
        if open_
        else []
    )
    told = told or [f"all of these lie above {bound}"]
    told += [f"a finer mesh does not confirm {len(denied)} more"] if denied else []
    verdict = listed(told)
    return f"S{theory[1:]} by {listed(parts)}. {verdict[0].upper()}{verdict[1:]}."


def growth_of(digest: Digest, model: str) -> str:
    """What the limits say of a model at the smallest threshold, in a sentence; "" where they say nothing.

    Every number is of the finest mesh there is, or says that it is not.
    """
    own = [row for row in limit_rows(digest.cases) if row.model == model]
    own = [row for row in own if math.isfinite(row.entry.structural_error)]
    if not own or model == LINEAR:
        return ""
    errors = sorted((row.entry.structural_error, row.entry.structural_bar) for row in own)
    text = f"{model} is {_span(starmap(_with_bar, (errors[0], errors[-1])))} off at small loads already"
    threshold = min(row.limit.threshold for row in own)
    asked = [row for row in own if row.limit.threshold == threshold]
    finer = any(math.isfinite(row.entry.structural_bar) for row in own)
    coarse = " on the case's own mesh" if finer else ""
    more = f"it is {short_percent(threshold)} further off at"
    no_more = f"it is less than {short_percent(threshold)} further off up to"
    for state, before, after in (
        ("found", more, ""),
        ("unresolved", more, f"{coarse}, which a finer mesh does not confirm"),
        ("beyond", no_more, f"{coarse}, as far as was looked"),
        ("model-stopped", no_more, f"{coarse}, where its solver stops"),
        ("reference-stopped", no_more, f"{coarse}, where the reference stops"),
    ):
        if some := [row for row in asked if row.limit.state == state]:
            text += f"; {before} {_loads_in_words(some, len(asked))}{after}"
    (first, *others) = asked
    if others or first.limit.state != "found":
        return f"{text}."
    if math.isfinite(first.limit.indentation):
        depth, bar = first.limit.indentation, first.limit.indentation_bar
        text += f" ({quantity(depth, 'm')}"
        text += f" ± {quantity(abs(depth) * bar, 'm')}" if math.isfinite(bar) else ""
        text += " of mean indentation)"
    total = first.entry.structural_error + threshold
    return f"{text}, where it is {_with_bar(total, first.entry.structural_bar)} off."


def _loads_in_words(some: list[LimitRow], asked: int) -> str:
    """The loads of some limits with their bars, from least to most, and of how many of the cases they are."""
    ends = sorted(some, key=lambda row: abs(row.limit.load))
    loads = []
    for row in (ends[0], ends[-1]):
        bar = f" ± {short_percent(row.limit.bar)}" if math.isfinite(row.limit.bar) else ""
        times = " times the study's loads" if row.unit == "1" else ""
        loads.append(f"{quantity(row.limit.load, row.unit)}{times}{bar}")
    return _span(loads) + (f" in {len(some)} of {asked} cases" if len(some) < asked else "")


def _span(ends: Iterable[str]) -> str:
    """`low to high`, one of them where they look alike."""
    return " to ".join(dict.fromkeys(ends))


def _with_bar(share: float, bar: float) -> str:
    return short_percent(share) + (f" ± {short_percent(bar)}" if math.isfinite(bar) else "")
