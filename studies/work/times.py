"""Chooses what a run times at its end: on each mesh a case, and the models that answer there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ..measures.case import CaseResult
from ..store.cases import read_case
from ..store.plain import StoreError
from .plan import Plan, PlannedCase

SLOW = 20.0  # s of a set-up and a step: slower models are not solved again for times alone


@dataclass
class ToTime:
    """A case whose frames are timed, and the names of its models to time."""

    case: PlannedCase
    names: list[str]


def to_time(plan: Plan, cases: Sequence[PlannedCase], *, every: bool) -> list[ToTime]:
    """For each mesh its first case whose load was reached, with the models that answer there.

    A model that answers only later cases there is timed on the first of them. Unless `every` time is wanted, models
    that take longer than `SLOW` on it are left out.
    """
    models = plan.study.study.models
    found: dict[str, set[str]] = {}
    chosen = []
    for planned, case in _reached(plan, cases, found, len(models)):
        known, names = found.setdefault(planned.mesh, set()), []
        for name in models:
            result = case.models.get(name)
            if result is None or not result.status[case.full_load].ok or name in known:
                continue
            known.add(name)
            if every or result.seconds_setup + result.seconds_per_step.max() < SLOW:
                names.append(name)
        if names:
            chosen.append(ToTime(planned, names))
    return chosen


def _reached(
    plan: Plan, cases: Sequence[PlannedCase], found: dict[str, set[str]], most: int
) -> Iterator[tuple[PlannedCase, CaseResult]]:
    """The finished cases whose load was reached, on meshes of which not all models are found."""
    for planned in cases:
        if len(found.get(planned.mesh, ())) == most:
            continue
        try:
            case = read_case(plan.case_file(planned), planned.hash)
        except StoreError:
            continue
        if case.reached == case.full_load:
            yield planned, case
