"""Chooses what a run times at its end: on each mesh a case, and the models that answer there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from ..measures.case import CaseResult
from ..store.cases import read_case
from ..store.plain import StoreError
from .plan import Plan, PlannedCase

SLOW = 20.0  # s of a set-up and a step: slower models are not solved again for times alone


@dataclass
class ToTime:
    """A case whose frames are timed, and the names of its models to time."""

    case: PlannedCase
    names: list[str] = field(default_factory=list)


def to_time(plan: Plan, cases: Sequence[PlannedCase], *, every: bool) -> list[ToTime]:
    """For each mesh its first case whose load was reached, with the models that answer one of these cases there.

    Unless `every` time is wanted, models that take longer than `SLOW` are left out.
    """
    models = plan.study.study.models
    found: dict[str, ToTime] = {}
    for planned, case in _reached(plan, cases, found, len(models)):
        one = found.setdefault(planned.mesh, ToTime(planned))
        for name in models:
            result = case.models.get(name)
            if result is None or not result.status[case.full_load].ok or name in one.names:
                continue
            if every or result.seconds_setup + result.seconds_per_step.max() < SLOW:
                one.names.append(name)
    return [one for one in found.values() if one.names]


def _reached(
    plan: Plan, cases: Sequence[PlannedCase], found: dict[str, ToTime], most: int
) -> Iterator[tuple[PlannedCase, CaseResult]]:
    """The finished cases whose load was reached, on meshes of which not all models are found."""
    for planned in cases:
        one = found.get(planned.mesh)
        if one is not None and len(one.names) == most:
            continue
        try:
            case = read_case(plan.case_file(planned), planned.hash)
        except StoreError:
            continue
        if case.reached == case.full_load:
            yield planned, case
