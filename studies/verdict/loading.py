"""What pushes a body, how hard, how far it gives way, and up to which load a model is within its limits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver_common.arrays import Array

from ..body.surface_measures import Surface
from ..measures.case import CaseResult
from ..measures.pushed import Answer, Pushed
from ..study.loads import Constraint
from .acceptance import BEYOND, OPEN, WITHIN, States

_SAME = 1e-9  # of a load: the difference of two that are one


def name_of(constraint: Constraint) -> str:
    return constraint.name or constraint.region


def kind_of(constraint: Constraint) -> str:
    """Its kind; what is moved by nothing is held."""
    held = constraint.kind == "constrained" and not np.any(constraint.displacement or 0.0)
    return "fixed" if held else constraint.kind


def supports(case: CaseResult) -> NDArray[np.bool_]:
    """(N,) nodes that a support holds or moves."""
    mask = np.zeros(len(case.points), dtype=bool)
    for constraint in case.study.constraints:
        if constraint.kind in ("fixed", "constrained"):
            mask |= case.regions[constraint.region]
    return mask


def pushes(case: CaseResult, surface: Surface) -> list[Pushed]:
    """What pushes or moves a body: its contacts, indenters and moved regions."""
    return [
        Pushed(case.study, constraint, mask, surface, case.load_factors)
        for constraint in case.study.constraints
        if kind_of(constraint) in ("contact", "indenter", "constrained")
        and (mask := case.regions[constraint.region]).any()
    ]


# --- up to which load ---


@dataclass(frozen=True)
class UpTo:
    """The largest load up to which every case and every step that was tried is within the limits.

    Attributes
    ----------
    load, unit : that load, NaN where there is none; its unit, "1" where it is told as a share of the full load
    depth : how far the reference gives way there, in every case at least [m]; NaN where not known or none
    least, most : the smallest and the largest load tried
    open : whether the next load is undecided, not beyond
    """

    load: float
    unit: str
    depth: float
    least: float
    most: float
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
class KnownLoads:
    """The K steps of all cases that carry a load: unit, (K,) loads, (K,) depths [m], (K,) cases and steps."""

    unit: str
    loads: Array
    depths: Array
    cases: NDArray[np.int64]
    steps: NDArray[np.int64]


def known_loads(cases: Sequence[CaseResult], surfaces: Sequence[Surface]) -> KnownLoads:
    """The loads of each case's only contact, else of the one thing that pushes it, as its reference answers.

    They are shares of the full load, "1", where the cases do not tell them in one unit.
    """
    units, curves = set(), []
    for case, surface in zip(cases, surfaces, strict=True):
        every, reference = pushes(case, surface), case.models.get(str(case.reference))
        chosen = [one for one in every if one.constraint.kind == "contact"] or every
        alone = len(chosen) == 1 and reference is not None
        units.add(chosen[0].unit if alone else "1")
        nothing = np.full(len(case.load_factors), math.nan)
        curves.append(chosen[0].curve(Answer.of(reference)) if alone and reference else (nothing, nothing))
    unit = units.pop() if len(units) == 1 else "1"
    rows = []
    for k, (case, (depths, loads)) in enumerate(zip(cases, curves, strict=True)):
        sizes = np.abs(case.load_factors)
        told = sizes / max(sizes.max(), np.finfo(float).tiny) if unit == "1" else np.abs(loads)
        steps = np.flatnonzero((sizes > 0.0) & (told > 0.0) & np.isfinite(told))
        rows += [(told[step], depths[step], k, step) for step in steps]
    loads, depths, numbers, steps = np.array(rows or np.zeros((0, 4))).T
    return KnownLoads(unit, loads, depths, numbers.astype(int), steps.astype(int))


def up_to(known: KnownLoads, states: States) -> UpTo | None:
    """Of all steps that carry a load, from the (C, S) states of a model; None where no step carries any."""
    if not len(known.loads):
        return None
    order = np.argsort(known.loads, kind="stable")
    loads, depths = known.loads[order], known.depths[order]
    states = states[known.cases[order], known.steps[order]]
    # points of one load are one group, of which the worst decides
    starts = np.flatnonzero(np.concatenate([[True], np.diff(loads) > _SAME * loads[1:]]))
    worst = np.maximum.reduceat(states, starts)
    within = int(np.argmin(np.append(worst, BEYOND) == WITHIN))  # groups before the first that is not
    last = slice(starts[within - 1], starts[within] if within < len(starts) else None)
    reached = np.abs(depths[last]) if within else np.zeros(0)
    return UpTo(
        load=float(loads[starts[within - 1]]) if within else math.nan,
        unit=known.unit,
        depth=min((depth for depth in reached.tolist() if math.isfinite(depth)), default=math.nan),
        least=float(loads[0]),
        most=float(loads[starts[-1]]),
        open=within < len(starts) and int(worst[within]) == OPEN,
    )
