"""If a model fails on the way to a load step, all models answer at the load that it reached."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from solver_common.arrays import Array
from solver_common.solution import CONVERGED, Status

from ..body.refine import Hierarchy
from ..measures.reference import level_scene, restricted
from ..models import run_model
from ..models.model import BROKEN
from ..scene.result import REFUSED, ModelResult, answered, joined, steps_of
from ..scene.scene import Scene
from ..study.registry import SCANNED
from ..study.schema import Study
from .keys import Wanted

# parts of a load step: without a stored state, a model answers at the last whole part, which a path from rest
# also reaches
_PARTS = 20

Found = list[tuple[Wanted, ModelResult]]


def at_what_was_reached(
    study: Study, scene: Scene, found: Found, meshes: Callable[[int], Hierarchy]
) -> tuple[Array, Found]:
    """Places along the load history and the results there: its steps, and the loads at which models stopped.

    A model that kept its last state answers with it. All others are solved again at that place. A model on
    several mesh levels ends where the first of them does, as its error is unknown beyond; on the case's own mesh
    it keeps its answers up to there.

    Parameters
    ----------
    meshes : mesh level -> the case's mesh with its refinements

    Returns
    -------
    places : (S + R,) see `Scene.factors_at`; R of them are not whole numbers
    found : the results at these places
    """
    steps = np.arange(1.0, len(scene.load_factors) + 1.0)
    ends: dict[
        str, tuple[float, Status]
    ] = {}  # steps that each model went, the last in part, and its status there
    for want, result in found:
        end = _end(result)
        ends[want.name] = min(ends.get(want.name, end), end, key=lambda one: one[0])
    if all(math.isinf(end) for end, _ in ends.values()):
        return steps, found
    # on the way to the first step a scanned body differs from its scan
    least = 1.0 if SCANNED in scene.extras else 0.0
    reached = {end for end, _ in ends.values() if least < end < math.inf and end % 1.0}
    places = np.array(sorted({*steps.tolist(), *reached}))
    merged = []
    for want, result in found:
        own = [steps_of(result, [math.ceil(place) - 1]) for place in places]
        last, status = ends[want.name]
        lost = places > last
        between = places % 1.0 > 0.0
        for k in np.flatnonzero(between & ~lost).tolist():
            if places[k] == _end(result)[0] and _is_kept(own[k]):
                own[k] = dataclasses.replace(own[k], status=(CONVERGED,))
                continue
            there = meshes(want.level)
            own[k] = run_model(level_scene(study, there).at(places[k]), want.name)
            own[k] = restricted(own[k], there) if want.level else own[k]
        # a model that solves each load separately may answer at a larger one
        for k in np.flatnonzero(lost & (between | (want.level > 0))).tolist():
            if own[k].status[0].ok:
                own[k] = dataclasses.replace(own[k], status=(status,))
        merged.append((want, answered(joined(result, own))))
    return places, merged


def _end(result: ModelResult) -> tuple[float, Status]:
    failed = [step for step, status in enumerate(result.status) if not status.ok]
    if not failed:
        return math.inf, result.status[-1]
    step, status = failed[0], result.status[failed[0]]
    share = result.scalars.get("load_factor")
    if share is None or status.code in (REFUSED, BROKEN):
        return float(step), status
    kept = _is_kept(steps_of(result, [step]))
    return step + (float(share[step]) if kept else math.floor(_PARTS * share[step]) / _PARTS), status


def _is_kept(step: ModelResult) -> bool:
    """Whether a failed step holds the last state on the way to it."""
    return bool(np.isfinite(step.displacement).all())
