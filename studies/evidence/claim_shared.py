"""Thresholds of the claims' rules, and what several rules measure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ..body.surface_measures import weighted_norm
from ..measures.bars import at_full_load, reference_bar
from ..measures.case import CaseResult
from ..study.registry import is_surface, split
from ..verdict.digest import Digest
from ..verdict.formatting import short_percent

PRINTED = "vdm-paper"
EXACT = 1e-10  # relative volume drift that counts as none
SMALL_DRIFT = 0.05  # of the displaced volume
CLOSE = 0.10  # displacement error that counts as the reference's result
ORDER = 10.0  # of magnitude
DRAMATIC = 2.0  # times fewer iterations
KEPT = 0.05  # growth of an error that counts as little
FIT = 2.0  # factor within which a displacement is of the right size
SAME = 1e-6  # difference of two solvers of one system that counts as none

SMALL_STRAIN = 0.10  # largest principal strain up to which the paper means the linear solvers


def largest(values: Mapping[str, float]) -> str:
    """The name of the largest value; of solvers of one system the first, whichever rounding puts on top."""
    top = max(values.values())
    return next(name for name, value in values.items() if value >= (1.0 - SAME) * top)


def apart(digest: Digest, model: str, one: CaseResult, other: CaseResult) -> float:
    """Norm of the difference of a model's answers at full load over the reference's; infinite on another mesh."""
    surface, same = digest.surfaces[one.hash], digest.surfaces[other.hash]
    if one.reference is None or len(surface.areas) != len(same.areas):
        return math.inf
    u, v = (case.models[model].displacement[case.full_load] for case in (one, other))
    true = one.models[one.reference].displacement[one.full_load]
    return weighted_norm(u - v, surface.areas) / weighted_norm(true, surface.areas)


def own_error(digests: Sequence[Digest]) -> str:
    """The reference's own error, where every case has it, behind a number that is from errors against it."""
    bars = [reference_bar(case) for digest in digests for case in digest.cases if case.reference is not None]
    largest = float(np.max(bars)) if bars else math.nan  # NaN where one is
    return (
        f" (reference's own error {short_percent(largest)})"
        if math.isfinite(largest)
        else " (bar not measured)"
    )


def floor_in_words(digests: Sequence[Digest]) -> str:
    """What the reference itself is off where it is moved along normals, as a further sentence; "" if not known."""
    floors = [
        at_full_load(case, str(case.reference), "tangential_share") for d in digests for case in d.cases
    ]
    known = [floor for floor in floors if math.isfinite(floor)]
    if not known:
        return ""
    low, high = (short_percent(found) for found in (min(known), max(known)))
    told = low if low == high else f"{low} to {high}"
    return f" The reference itself, moved along normals, is {told} off: no form along normals can be better."


def is_tried(name: str) -> bool:
    """Whether the claims' rules are about a model: all surface models but mass-spring, which came later."""
    return is_surface(name) and split(name)[0] != "mass-spring"
