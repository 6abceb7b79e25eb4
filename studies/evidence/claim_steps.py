"""Claims 4 and 5: what small steps are worth, to the answer and to the iterations that it takes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from ..measures.bars import at_full_load
from ..measures.case import CaseResult
from ..measures.metrics import VECTOR
from ..report.blocks import Figure
from ..report.judgement import (
    FAILS,
    HOLDS,
    WITHIN_LIMITS,
    Change,
    Judgement,
    either_way,
    in_words,
    own_bar,
)
from ..verdict.digest import ALONG_NORMALS, NORMAL, Digest
from ..verdict.formatting import listed, plain, short_percent
from .claim_figures import Line, curves
from .claim_shared import CLOSE, DRAMATIC, KEPT, apart, floor_in_words, is_tried, own_error

TOLERANCE = 1e-10  # of the iterative solvers where a study names none
SMALL_STEPS_RULE = (
    f"Holds where an error of more than {short_percent(CLOSE)} in one step falls below that with many; within "
    f"limits where small steps bring it down by {short_percent(KEPT)} at least; fails where the step is not what "
    "the error is made of; not decided where the reference's own error decides. A gain is no larger than a "
    "model's answers are apart, and known better than the errors: where answers are alike, so is what the "
    "reference's own error does to them."
)
WARM_START_RULE = (
    f"Holds where warm starts need {DRAMATIC:g} times fewer iterations over a load history whatever its steps and "
    "its tolerance; within limits where they do for some only; fails where for none."
)


def small_steps(digests: Sequence[Digest]) -> Judgement | None:
    """The judgement of claim 4; None where no model has answers in few and in many steps."""
    changes: dict[str, Change] = {}
    normal: dict[str, Change] = {}
    between: dict[str, float] = {}
    lines: list[Line] = []
    for digest in digests:
        cases = sorted(digest.cases, key=lambda case: len(case.load_factors))
        for model in filter(is_tried, digest.compared):
            errors = [(case, at_full_load(case, model, VECTOR)) for case in cases]
            known = [(case, error) for case, error in errors if math.isfinite(error)]
            if len(known) > 1:
                (first, one), (last, many) = known[0], known[-1]
                changes[model] = Change(one, many, max(map(own_bar, (first, last))))
                between[model] = apart(digest, model, first, last)
                if at_full_load(first, model, "tangential_share") < ALONG_NORMALS:
                    before, after = (at_full_load(case, model, NORMAL) for case in (first, last))
                    normal[model] = Change(before, after, math.nan)
                steps = [float(len(case.load_factors)) for case, _ in known]
                lines.append((model, steps, [error for _, error in known]))
    if not changes:
        return None

    def verdict(way: float) -> str:
        arrived = [change.after - way * change.bar <= CLOSE for change in changes.values()]
        gained = [
            min(way * _bar_of_gain(c, between[m]) - c.growth, between[m]) >= KEPT for m, c in changes.items()
        ]
        return HOLDS if all(arrived) else WITHIN_LIMITS if any(arrived + gained) else FAILS

    reason = (
        f"With the smallest steps instead of the largest the error at full load goes, for {in_words(changes)}. The "
        f"answers themselves are {short_percent(max(between.values()))} apart at most."
    )
    if normal:
        reason += floor_in_words(digests)
        reason += f" In the normal component, which they predict, the error goes, for {in_words(normal)}."
    most = max(abs(change.growth) for change in changes.values())
    figure = curves(digests[0], lines, "load steps", "displacement error at full load", "claim4", log_x=True)
    number = f"{short_percent(most)} at most by small steps{own_error(digests)}"
    return Judgement(either_way(verdict), number, reason, figure)


def _bar_of_gain(change: Change, between: float) -> float:
    """How far the reference's own error can move the difference of two errors, of answers `between` apart.

    A shift d of the reference changes an error |u - r| by e.d, e the direction of u - r; the directions of two
    answers differ by 2 |u - v| / (|u - r| + |v - r|) at most, and by 2.
    """
    both = change.before + change.after
    return change.bar * (min(2.0, 2.0 * between / both) if both else 2.0)


def warm_start(digests: Sequence[Digest]) -> Judgement | None:
    """The judgement of claim 5; None where BiCG has no history of both starts."""
    gains: dict[int, dict[float, float]] = {}  # load steps -> tolerance -> cold over warm iterations
    for case in (case for digest in digests for case in digest.cases):
        warm, cold = (case.models.get(f"vdm-paper:{name}") for name in ("bicg", "bicg-cold"))
        if warm is not None and cold is not None and warm.iterations.sum():
            gain = float(cold.iterations.sum() / warm.iterations.sum())
            gains.setdefault(len(case.load_factors), {})[_tolerance(case)] = gain
    every = [gain for found in gains.values() for gain in found.values()]
    if not every:
        return None
    reached = [gain >= DRAMATIC for gain in every]
    verdict = HOLDS if all(reached) else WITHIN_LIMITS if any(reached) else FAILS
    told = listed(f"over {steps} steps {_curve_in_words(found)}" for steps, found in sorted(gains.items()))
    reason = (
        f"Iterations of BiCG from zero over those with a warm start, to a residual of so much: {told}. The start "
        "saves the digits that neighbouring steps share: a solve to many digits has most of its way still to go."
    )
    figures: tuple[Figure, ...] = ()
    for steps, found in sorted(gains.items(), reverse=True):
        line = ("vdm-paper:bicg", sorted(found), [found[tolerance] for tolerance in sorted(found)])
        drawn = curves(
            digests[0],
            [line],
            "tolerance",
            "cold / warm iterations",
            f"claim5{steps}",
            log_x=True,
            ratio=True,
        )
        figures += tuple(replace(figure, title=f"{figure.title}, {steps} load steps") for figure in drawn)
    return Judgement(verdict, f"{plain(max(every), 3)} times fewer at best", reason, figures)


def _curve_in_words(gains: Mapping[float, float]) -> str:
    return listed(f"{plain(gain, 3)} at {plain(tolerance, 2)}" for tolerance, gain in sorted(gains.items()))


def _tolerance(case: CaseResult) -> float:
    """To which BiCG was solved: what the study says, or the solver's own."""
    return case.study.vdm.tolerance or TOLERANCE
