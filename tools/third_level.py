"""Tries a study's bars on one more mesh level: does each hold the distance of its number from the best estimate?

The best estimate of a number is what it is against Richardson's extrapolation of the reference's displacement, from
its finest level and two coarser ones, by the order that they show. No model is solved again for that.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from vdmbench.body.mesh_cache import mesh_from_cache
from vdmbench.body.surface_measures import Surface, weighted_norm
from vdmbench.measures.bars import value_bar
from vdmbench.measures.case import CaseResult
from vdmbench.measures.metrics import DEFORMATION, METRICS, VECTOR, History, evaluate_all, full_load_step
from vdmbench.measures.uncertainty import REASONABLE_ORDERS, estimate_error
from vdmbench.scene.result import ModelResult
from vdmbench.scene.scene import build_scene
from vdmbench.study.registry import REFINED
from vdmbench.study.schema import MOST_LEVELS
from vdmbench.work.case import Block
from vdmbench.work.plan import Plan, PlannedCase

HEADLINE = (VECTOR, DEFORMATION)
COVERED = 0.95  # share of the two errors' bars that are to hold
ROUNDING = 1e-9  # a distance up to this, of a number with a unit times the number, is the solver's tolerance


class AuditError(ValueError):
    """A study whose bars cannot be tried; the message says why and what to do."""


@dataclass(frozen=True)
class Bar:
    """A number of a case with its bar, and its best estimate."""

    model: str
    metric: str
    value: float
    bar: float
    best: float

    @property
    def used(self) -> float:
        """Distance over bar, at most 1 where the bar holds."""
        distance = abs(self.value - self.best)
        if distance <= ROUNDING * (1.0 if METRICS[self.metric].unit == "1" else abs(self.value)):
            return 0.0
        return distance / self.bar if self.bar else math.inf


@dataclass(frozen=True)
class Audited:
    """A case: the order that its reference shows in displacement, and its bars."""

    label: str
    order: float
    bars: tuple[Bar, ...]


def one_more_level(plan: Plan) -> int:
    """How many levels try a study's bars. Raises AuditError where it has none, or as many as there can be."""
    levels = {case.study.uncertainty.levels if case.study.uncertainty else 1 for case in plan.cases}
    if plan.study.study.reference is None or levels == {1}:
        raise AuditError("the study has no bars: name a reference, and ask for them by [uncertainty]")
    if len(levels) > 1:
        raise AuditError("the study sweeps uncertainty.levels: audit it with one number of levels")
    (level,) = levels
    if level == MOST_LEVELS:
        raise AuditError(
            f"the study has {level} mesh levels, the most there are: nothing finer tries its bars"
        )
    return level + 1


def audited(plan: Plan, case: PlannedCase, found: CaseResult, finer: CaseResult) -> Audited:
    """The bars of a finished case tried by the same case with one more level."""
    reference = str(plan.study.study.reference)
    mesh = mesh_from_cache(plan.meshes[case.mesh].geometry, plan.cache, volume=plan.meshes[case.mesh].volume)
    surface = Block(mesh).surface(build_scene(case.study, mesh))
    levels = [
        found.models[reference],
        found.models[reference + REFINED],
        finer.models[reference + REFINED],
    ]
    coarser = found.reference_error["levels"] - 1.0  # splits between the study's own mesh and its finest
    order, best = extrapolated(surface, levels, found.load_factors, 2.0**coarser)
    histories = {
        name: History(result.displacement, result.reaction_force, found.load_factors)
        for name, result in found.models.items()
    }
    estimates = evaluate_all(surface, {**histories, reference + REFINED: best}, reference + REFINED)
    step, bars = found.full_load, []
    for model, metrics in found.metrics.items():
        for metric, series in metrics.items():
            if metric in estimates[model]:
                value, bar = float(series.values[step]), value_bar(found, model, metric)
                estimate = float(estimates[model][metric][step])
                if all(map(math.isfinite, (value, bar, estimate))):
                    bars.append(Bar(model, metric, value, bar, estimate))
    return Audited(case.label, order, tuple(bars))


def extrapolated(
    surface: Surface, levels: Sequence[ModelResult], load_factors: np.ndarray, ratio: float = 2.0
) -> tuple[float, History]:
    """The order that three levels show in displacement at full load, and the best estimate of the reference.

    Parameters
    ----------
    levels : of the reference, coarse first; the finest is the second split once
    ratio : of the mesh sizes of the first and the second
    """
    step = full_load_step(load_factors)
    coarse, fine, finest = levels
    gaps = [
        weighted_norm(a.displacement[step] - b.displacement[step], surface.areas)
        for a, b in ((fine, finest), (coarse, fine))
    ]
    order = estimate_error(gaps, [2.0, ratio]).observed_order
    low, high = REASONABLE_ORDERS
    share = 1.0 / (2.0 ** min(max(order, low), high) - 1.0)
    displacement = finest.displacement + share * (finest.displacement - fine.displacement)
    force = finest.reaction_force + share * (finest.reaction_force - fine.reaction_force)
    return order, History(displacement, force, load_factors)


def held(cases: Iterable[Audited], metrics: Iterable[str] = METRICS) -> tuple[int, int]:
    """How many bars of some metrics hold, of how many."""
    wanted = {*metrics}
    shares = [bar.used for case in cases for bar in case.bars if bar.metric in wanted]
    return sum(share <= 1.0 for share in shares), len(shares)


def hold(cases: Sequence[Audited]) -> bool:
    """The answer: whether enough bars of the two errors hold."""
    count, of = held(cases, HEADLINE)
    return of > 0 and count >= COVERED * of
