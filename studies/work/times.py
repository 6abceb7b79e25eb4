"""Chooses what a run times at its end: on each mesh a case, and the models whose time is not known well enough."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..machine import processor_name
from ..measures.case import CaseResult
from ..scene.result import FrameTimes, ModelResult
from ..store.cases import read_case
from ..store.plain import StoreError
from ..study.registry import superposes
from .plan import Plan, PlannedCase

FIRST = 5.0  # times a frame: what a first answer takes on the processor, at most 5.1 of 16 measured
SLOW = 20.0  # s of a set-up and a step: slower models are not solved again for times alone


@dataclass
class ToTime:
    """A case whose frames are timed, the names of its models to time, and what is known of others."""

    case: PlannedCase
    names: list[str] = field(default_factory=list)
    known: dict[str, FrameTimes] = field(default_factory=dict)


def to_time(plan: Plan, cases: Sequence[PlannedCase], *, every: bool, limit: float | None) -> list[ToTime]:
    """For each mesh its first case whose load was reached, with the models that answer one of these cases there.

    Parameters
    ----------
    every : also models that take longer than `SLOW`
    limit : of a frame [s]; a model whose one answer was clearly longer is known. None if every model is to be timed
    """
    models = plan.study.study.models
    found: dict[str, ToTime] = {}
    for planned, case in _reached(plan, cases, found, len(models)):
        one = found.setdefault(planned.mesh, ToTime(planned))
        for name in models:
            result = case.models.get(name)
            if result is None or not result.status[case.full_load].ok or name in (*one.names, *one.known):
                continue
            once = _of_answer(case, name, result)
            if limit is not None and once is not None and once.is_clear(FIRST * limit):
                one.known[name] = once
            elif every or result.seconds_setup + result.seconds_per_step.max() < SLOW:
                one.names.append(name)
    return [one for one in found.values() if one.names or one.known]


def _reached(
    plan: Plan, cases: Sequence[PlannedCase], found: dict[str, ToTime], most: int
) -> Iterator[tuple[PlannedCase, CaseResult]]:
    """The finished cases whose load was reached, on meshes of which not all models are found."""
    for planned in cases:
        one = found.get(planned.mesh)
        if one is not None and len(one.names) + len(one.known) == most:
            continue
        try:
            case = read_case(plan.case_file(planned), planned.hash)
        except StoreError:
            continue
        if case.reached == case.full_load:
            yield planned, case


def _of_answer(case: CaseResult, name: str, result: ModelResult) -> FrameTimes | None:
    """The one round that an answer is of a model whose frames are such solves; None if another machine made it."""
    if superposes(name) or case.provenance.get("processor") != processor_name():
        return None
    step = np.array([np.nanmedian(result.seconds_per_step)])
    setup, nothing = np.array([result.seconds_setup]), np.array([math.nan])
    return FrameTimes(setup, step, nothing, contact_worked=step * result.processor_share)
