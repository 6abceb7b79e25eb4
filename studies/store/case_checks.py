"""Whether the arrays of a case fit each other, as the report takes for granted: checked on writing and reading."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..measures.case import CaseResult
from ..measures.measurement import FORCE, Measurement
from ..scene.result import ModelResult
from .shapes import LARGEST


def check_case(case: CaseResult) -> None:
    """Raises ValueError, with what is wrong, for a case whose arrays or names do not fit each other."""
    wrong = next(_faults(case), None)
    if wrong:
        raise ValueError(wrong)


def _faults(case: CaseResult) -> Iterator[str]:
    n_nodes, n_steps = len(case.points), len(case.load_factors)
    if not n_steps or case.load_factors.shape != (n_steps,) or not np.isfinite(case.load_factors).all():
        yield "its load factors are not finite numbers"
    if case.points.shape != (n_nodes, 3) or not n_nodes or not np.isfinite(case.points).all():
        yield "its nodes are not finite points"
    facets = case.triangles
    if facets.size and (facets.min() < 0 or facets.max() >= n_nodes):
        yield "a facet has a node that is not there"
    if case.reference is not None and case.reference not in case.models:
        yield "its reference is none of its models"
    for name, mask in case.regions.items():
        if mask.shape != (n_nodes,):
            yield f"region {name} is not one of its nodes"
    if case.moved is not None and (case.moved.shape != (n_nodes,) or not np.isfinite(case.moved).all()):
        yield "how far its surface was moved is not a finite number for each node"
    for entry in case.study.constraints:
        if entry.region not in case.regions:
            yield f"a constraint is on region {entry.region!r}, which is not there"
    for name, model in case.models.items():
        if not _fits(model, n_steps, n_nodes):
            yield f"the arrays of {name} do not fit its steps and nodes"
    for name, metrics in case.metrics.items():
        if any(series.values.shape != (n_steps,) for series in metrics.values()):
            yield f"the metrics of {name} do not fit its steps"
    if case.measurement is not None:
        yield from _measurement_faults(case.measurement, n_steps, len(facets))
    if _are_too_large(np.concatenate([values.ravel() for values in _numbers(case)])):
        yield f"a number beyond {LARGEST:g}"


def _measurement_faults(found: Measurement, n_steps: int, n_facets: int) -> Iterator[str]:
    count = len(found.quantities)
    series = [*found.simulated.values(), *found.numerical.values()]
    if found.simulated.keys() != found.numerical.keys() or any(v.shape != (count,) for v in series):
        yield "its models do not fit what was measured"
    if any(not 0 <= quantity.step < n_steps for quantity in found.quantities):
        yield "a value was measured at a step that is not there"
    if not np.isfinite([(q.value, q.uncertainty, q.distance) for q in found.quantities]).all():
        yield "a measured value is not a finite number"
    if any(not -1 <= q.facet < n_facets or not np.isfinite(q.weights).all() for q in found.quantities):
        yield "a point was measured on a facet that is not there"
    if not all(np.isfinite(q.depth) for q in found.quantities if q.component == FORCE):
        yield "a force was measured at a depth that is not a finite number"


def _fits(model: ModelResult, n_steps: int, n_nodes: int) -> bool:
    fields = (model.displacement, model.reaction_force)
    series = (
        model.fluid_pressure,
        model.energy,
        model.volume,
        model.iterations,
        model.seconds_per_step,
        *model.scalars.values(),
    )
    return (
        all(values.shape == (n_steps, n_nodes, 3) for values in fields)
        and all(values.shape == (n_steps,) for values in series)
        and len(model.status) == n_steps
    )


def _numbers(case: CaseResult) -> Iterator[NDArray[np.float64]]:
    yield case.points
    yield case.load_factors
    for model in case.models.values():
        yield from (
            model.displacement,
            model.reaction_force,
            model.fluid_pressure,
            model.energy,
            model.volume,
        )
        yield from model.scalars.values()
    if case.measurement is not None:
        yield case.measurement.values
        yield from case.measurement.simulated.values()
        yield from case.measurement.numerical.values()
    for metrics in case.metrics.values():
        yield from (series.values for series in metrics.values())


def _are_too_large(values: NDArray[np.float64]) -> bool:
    """Whether a finite number is; NaN and infinity stand for what there is not."""
    size = np.abs(values)
    return bool(((size > LARGEST) & (size < np.inf)).any())
