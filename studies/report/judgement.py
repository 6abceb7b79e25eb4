"""What a claim of the paper is, and what comes out of its trial."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .blocks import Figure
from .digest import Digest

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
class Claim:
    """One claim: its number in the paper's order, its words, the rule that it is judged by."""

    number: int
    text: str
    rule: str
    judge: Judge
