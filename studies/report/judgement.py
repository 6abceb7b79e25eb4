"""What a claim of the paper is, and what comes out of its trial."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from ..measures.bars import reference_bar
from ..measures.case import CaseResult
from ..verdict.digest import Digest
from ..verdict.formatting import listed, short_percent
from .blocks import Figure

HOLDS, WITHIN_LIMITS, FAILS, OPEN = "holds", "holds within limits", "fails", "not decided"


@dataclass(frozen=True)
class Judgement:
    """What came out of one claim's trial."""

    verdict: str  # one of the four above
    number: str  # the figure that decides, for a table
    reason: str  # in a sentence or two
    figures: tuple[Figure, ...] = ()


Judge = Callable[[Sequence[Digest]], Judgement | None]


@dataclass(frozen=True)
class About:
    """Where the paper says a claim and what it says there, how it is tried here, what would change the verdict."""

    place: str
    trial: str
    change: str


@dataclass(frozen=True)
class Claim:
    """One claim: its number in the paper's order, its words, the rule that it is judged by."""

    number: int
    text: str
    rule: str
    judge: Judge
    about: About


@dataclass(frozen=True)
class Change:
    """An error before and after, and what the reference's own error may add to either, or take from it."""

    before: float
    after: float
    bar: float

    @property
    def growth(self) -> float:
        """From the first to the second; infinite where one is not known."""
        return math.inf if math.isnan(self.after - self.before) else self.after - self.before


def in_words(changes: Mapping[str, Change]) -> str:
    """How the error of each model changes."""
    return listed(
        f"{m} from {short_percent(change.before)} to {short_percent(change.after)}"
        for m, change in changes.items()
    )


def either_way(verdict: Callable[[float], str]) -> str:
    """The verdict with the reference's own error against the claim (-1) and for it (1), where both are the same."""
    against, favoured = verdict(-1.0), verdict(1.0)
    return against if against == favoured else OPEN


def own_bar(case: CaseResult) -> float:
    """The reference's own error; one that was not measured counts as none."""
    bar = reference_bar(case)
    return bar if math.isfinite(bar) else 0.0
