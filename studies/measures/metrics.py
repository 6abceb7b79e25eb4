"""The registry of metrics: pure functions on arrays that compare a model with the reference.

Displacements are (N, 3) at the same N surface nodes. Norms are weighted by nodal area, so that they do not depend
on the distribution of nodes. A new metric is one decorated function, here or in a file `metric_NAME.py` beside
this one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, wraps
from typing import Any, Literal

import numpy as np

from solver_common.arrays import Array, Mask
from solver_common.solution import NO_MOTION

from ..body.nearest import distances_and_farthest
from ..body.surface_measures import (
    Surface,
    deformations,
    enclosed_volumes,
    ratio,
    relative_l2_steps,
    rigid_parts,
    weighted_norms,
    weighted_quantiles,
)
from ..study.registry import load_all

# an error; the signed deviation of a conserved quantity; neither good nor bad
Sense = Literal["error", "conserved", "descriptive"]


@dataclass(frozen=True)
class History:
    """Input of a metric from one model: S steps."""

    displacement: Array  # (S, N, 3)
    reaction_force: Array  # (S, N, 3)
    load_factors: Array  # (S,)
    # at full load: (N,) distances of nodes to the reference's surface, and the largest either way; see `evaluate`
    distances: tuple[Array, float] | None = None
    volume: Array | None = None  # (S,) enclosed volumes [m^3], if known
    measurement: Array | None = None  # (S,) rms of E, see `measurement.step_rms`

    @cached_property
    def largest(self) -> Array:
        """(S,) largest displacement [m]; NaN where nothing moves."""
        largest = np.linalg.norm(self.displacement, axis=2).max(axis=1)
        return np.where(largest > 0, largest, np.nan)


@dataclass(frozen=True)
class Metric:
    """A named measure; `version` changes whenever its values do.

    If all displacements and forces of model and reference are multiplied by c > 0, the metric is multiplied by
    c^`degree`; None if there is no such degree. `vdmbench.gate` judges it by its `sense`.
    """

    name: str
    unit: str
    definition: str
    function: Callable[..., Array]
    degree: int | None
    version: int = 1
    sense: Sense = "error"
    needs_reference: bool = True
    needs_contact: bool = False
    needs_measurement: bool = False


METRICS: dict[str, Metric] = {}
_NO_LOAD = 1e-12  # of the largest load factor: equal load factors differ by rounding
_LOST = 1e-6  # of a whole: a smaller part is solver error


def full_load_step(load_factors: Array) -> int:
    """The step of the largest load, the last of several."""
    return int(len(load_factors) - 1 - np.abs(load_factors)[::-1].argmax())


Function = Callable[..., Array]


def metric(
    unit: str, definition: str, *, degree: int | None, relative: bool = False, **about: Any
) -> Callable[[Function], Function]:
    """Register a function as the metric of its name; `about` are further fields of `Metric`.

    Raises ValueError for a name in use.
    """

    def register(function: Function) -> Function:
        name = function.__name__
        if name in METRICS:
            raise ValueError(f"a metric {name!r} is registered already")
        function = _not_at_rest(function) if relative or degree == 0 else function
        METRICS[name] = Metric(name, unit, definition, function, degree, **about)
        return function

    return register


def _not_at_rest(function: Function) -> Function:
    """A relative measure that is NaN at steps without load or motion, where only rounding remains."""

    @wraps(function)
    def measure(surface: Surface, model: History, *reference: History) -> Array:
        factors = np.abs(model.load_factors)
        rests = (factors <= _NO_LOAD * factors.max()) & (not surface.sags)
        # a uniform pressure all around, or in a cavity that is full, moves nothing
        judge = reference[0] if reference else model
        rests |= judge.largest <= NO_MOTION * np.ptp(surface.points, axis=0).max()
        return np.where(rests, np.nan, function(surface, model, *reference))

    return measure


Compare = Callable[[Surface, Array, Array], Array]  # of displacements (S, N, 3): (S,)


def _each_step(surface: Surface, model: History, reference: History, compare: Compare) -> Array:
    """(S,) results of `compare`; NaN where a step of either failed."""
    u, r = model.displacement, reference.displacement
    usable = np.isfinite(u).all(axis=(1, 2)) & np.isfinite(r).all(axis=(1, 2))
    if usable.all():
        return compare(surface, u, r)
    out = np.full(len(u), np.nan)
    if usable.any():
        out[usable] = compare(surface, u[usable], r[usable])
    return out


@metric("1", "area-weighted ||u - r|| / ||r|| of the displacement vector", degree=0, version=2)
def relative_l2_displacement_error(surface: Surface, model: History, reference: History) -> Array:
    return _each_step(surface, model, reference, lambda s, u, r: relative_l2_steps(u, r, s.areas))


@metric(
    "1",
    "as the displacement error, the best-fit rigid motion, of a finite rotation, removed from model and reference "
    "alike; none where the reference moves as a rigid body",
    degree=None,
    relative=True,
    version=3,
)
def relative_l2_deformation_error(surface: Surface, model: History, reference: History) -> Array:
    def compare(s: Surface, u: Array, r: Array) -> Array:
        return _of_parts(r, s.areas, *(deformations(s.points, v, s.areas) for v in (u, r)))

    return _each_step(surface, model, reference, compare)


VECTOR, DEFORMATION = relative_l2_displacement_error.__name__, relative_l2_deformation_error.__name__


@metric("1", "as the displacement error, for the component along the undeformed normal", degree=0, version=2)
def relative_l2_normal_error(surface: Surface, model: History, reference: History) -> Array:
    def compare(s: Surface, u: Array, r: Array) -> Array:
        return _of_parts(r, s.areas, *(along(v, s.normals) for v in (u, r)))

    return _each_step(surface, model, reference, compare)


@metric("1", "as the displacement error, for the component in the undeformed surface", degree=0, version=2)
def relative_l2_tangential_error(surface: Surface, model: History, reference: History) -> Array:
    def compare(s: Surface, u: Array, r: Array) -> Array:
        return _of_parts(r, s.areas, *(v - along(v, s.normals) * s.normals for v in (u, r)))

    return _each_step(surface, model, reference, compare)


@metric("m", "largest |u - r| of any surface node", degree=1)
def max_nodal_error(surface: Surface, model: History, reference: History) -> Array:
    return _each_step(surface, model, reference, lambda _, u, r: _nodal_error(u, r).max(axis=1))


@metric("1", "largest |u - r| over largest |r|", degree=0, version=2)
def max_nodal_error_relative(surface: Surface, model: History, reference: History) -> Array:
    return max_nodal_error(surface, model, reference) / reference.largest


@metric("m", "|u - r| that 95 % of the surface area stays below", degree=1)
def p95_nodal_error(surface: Surface, model: History, reference: History) -> Array:
    return _each_step(
        surface, model, reference, lambda s, u, r: weighted_quantiles(_nodal_error(u, r), s.areas, 0.95)
    )


@metric("1", "|u - r| that 95 % of the surface area stays below, over largest |r|", degree=0, version=2)
def p95_nodal_error_relative(surface: Surface, model: History, reference: History) -> Array:
    return p95_nodal_error(surface, model, reference) / reference.largest


@metric("1", "displacement error over the loaded nodes only", degree=0, version=2, needs_contact=True)
def contact_region_error(surface: Surface, model: History, reference: History) -> Array:
    return _regional(surface, model, reference, surface.contact)


@metric(
    "1", "displacement error over the nodes that carry no contact", degree=0, version=2, needs_contact=True
)
def far_field_error(surface: Surface, model: History, reference: History) -> Array:
    return _regional(surface, model, reference, ~surface.contact)


# distances of two surfaces cost more than all other metrics together: they are evaluated at full load only


@metric(
    "m",
    "area-weighted mean distance of the model's deformed nodes to the reference's deformed surface, at full load",
    degree=None,
    version=2,
)
def mean_surface_distance(surface: Surface, model: History, reference: History) -> Array:
    return _of_distances(
        surface, model, reference, lambda there, _: float(np.average(there, weights=surface.areas))
    )


@metric(
    "m",
    "larger of the two one-sided maximal distances between the deformed surfaces at their nodes, at full load",
    degree=None,
    version=2,
)
def hausdorff_distance(surface: Surface, model: History, reference: History) -> Array:
    return _of_distances(surface, model, reference, lambda _, farthest: farthest)


def _of_distances(
    surface: Surface, model: History, reference: History, measure: Callable[[Array, float], float]
) -> Array:
    """(S,) NaN except at the step of the largest load, and there if a result failed."""
    step = full_load_step(model.load_factors)
    out = np.full(len(model.load_factors), np.nan)
    if found := model.distances or _distances(surface, model, reference):
        out[step] = measure(*found)
    return out


def _distances(surface: Surface, model: History, reference: History) -> tuple[Array, float] | None:
    """See `History.distances`; None where either's step failed."""
    step = full_load_step(model.load_factors)
    u, r = model.displacement[step], reference.displacement[step]
    if not np.isfinite(u).all() or not np.isfinite(r).all():
        return None
    return distances_and_farthest(surface.points + u, surface.points + r, surface.triangles)


@metric(
    "1",
    "|R - R_ref| / |R_ref| of the total force that the supports exert; none where their forces cancel",
    degree=0,
    version=2,
)
def reaction_force_error(surface: Surface, model: History, reference: History) -> Array:  # noqa: ARG001
    total, total_reference = (history.reaction_force.sum(axis=1) for history in (model, reference))
    norm = np.linalg.norm(total_reference, axis=1)
    of_nodes = np.linalg.norm(reference.reaction_force, axis=2).sum(axis=1)
    return ratio(np.linalg.norm(total - total_reference, axis=1), _unless_lost(norm, of_nodes))


@metric(
    "1",
    "force that the model needs for the reference's indentation depth (mean displacement along the contact force, "
    "weighted by it), over the reference's, less one; of a body with a weight only where a step has no load",
    degree=0,
    version=4,
    needs_contact=True,
)
def indentation_force_error(surface: Surface, model: History, reference: History) -> Array:
    depth, goals = (mean_indentation(surface, h.displacement) for h in (model, reference))
    factors = model.load_factors
    return np.array(
        [
            _factor_at(goal, depth, factors, rests=not surface.sags) / factor - 1 if factor else np.nan
            for goal, factor in zip(goals, factors, strict=True)
        ]
    )


@metric(
    "1",
    "(V - V0)/V0 of the exact polyhedral volume",
    degree=None,
    needs_reference=False,
    sense="conserved",
)
def volume_drift(surface: Surface, model: History) -> Array:
    volume = model.volume
    if volume is None:
        volume = enclosed_volumes(surface.points + model.displacement, surface.triangles)
    return volume / surface.volume - 1


@metric(
    "1",
    "(V - V0) over the displaced volume, half of sum |g_i . u_i|; none without a load",
    degree=None,
    version=2,
    relative=True,
    needs_reference=False,
    sense="conserved",
)
def volume_drift_of_displaced(surface: Surface, model: History) -> Array:
    displaced = 0.5 * np.abs(np.einsum("sij,ij->si", model.displacement, surface.volume_gradient)).sum(axis=1)
    return ratio(volume_drift(surface, model) * surface.volume, displaced)


def _mean_strain(axis: int) -> Function:
    def measure(surface: Surface, model: History) -> Array:
        """(S,) volume mean of du/dx along an axis: the integral of u n over the surface, u linear on each facet."""
        return np.asarray(model.displacement[:, :, axis] @ surface.volume_gradient[:, axis] / surface.volume)

    measure.__name__ = f"mean_strain_{'xyz'[axis]}"
    return measure


for _axis, _name in enumerate("xyz"):
    metric(
        "1",
        f"mean of du_{_name}/d{_name} over the body's volume",
        degree=1,
        needs_reference=False,
        sense="descriptive",
    )(_mean_strain(_axis))


@metric(
    "J",
    "work of the contact forces on the displacement",
    degree=2,
    needs_reference=False,
    needs_contact=True,
    sense="descriptive",
)
def contact_work(surface: Surface, model: History) -> Array:
    if not len(surface.contact_force):
        return np.full(len(model.load_factors), np.nan)
    return model.load_factors * np.einsum("ij,sij->s", surface.contact_force, model.displacement)


@metric(
    "m",
    "root mean square of S - D over the measured components of the step",
    degree=None,
    needs_reference=False,
    needs_measurement=True,
)
def measurement_error(surface: Surface, model: History) -> Array:  # noqa: ARG001
    assert model.measurement is not None
    return model.measurement


@metric(
    "1",
    "area-weighted ||w|| / ||u|| of the best-fit rigid motion w, of a finite rotation, of the answer itself",
    degree=None,
    relative=True,
    version=2,
    needs_reference=False,
    sense="descriptive",
)
def rigid_share(surface: Surface, model: History) -> Array:
    u = model.displacement
    out = np.full(len(u), np.nan)
    solved = np.isfinite(u).all(axis=(1, 2))
    rigid = rigid_parts(surface.points, u[solved], surface.areas)
    out[solved] = ratio(weighted_norms(rigid, surface.areas), weighted_norms(u[solved], surface.areas))
    return out


@metric(
    "1",
    "area-weighted ||t|| / ||u|| of the component t of the answer itself in the undeformed surface: of the exact "
    "answer, the least displacement error of a model that moves nodes along normals",
    degree=0,
    needs_reference=False,
    sense="descriptive",
)
def tangential_share(surface: Surface, model: History) -> Array:
    u = model.displacement
    inside = u - along(u, surface.normals) * surface.normals
    return np.asarray(ratio(weighted_norms(inside, surface.areas), weighted_norms(u, surface.areas)))


def mean_indentation(surface: Surface, displacement: Array) -> Array:
    """(S,) mean displacement along the contact force, weighted by it [m]; NaN without any.

    It is work over force. Weights by nodal area would make it depend on the mesh as well as on the body.
    """
    sizes = np.linalg.norm(surface.contact_force, axis=1)
    if not sizes.any():
        return np.full(len(displacement), np.nan)
    return np.asarray(np.einsum("ij,sij->s", surface.contact_force, displacement) / sizes.sum())


def evaluate(surface: Surface, model: History, reference: History | None) -> dict[str, Array]:
    """Every metric whose input is available: name -> (S,) values."""
    if reference is not None:  # once for all metrics that use them
        model = replace(model, distances=_distances(surface, model, reference))
    out = {}
    for one in METRICS.values():
        if one.needs_contact and not surface.contact.any():
            continue
        if one.needs_measurement and model.measurement is None:
            continue
        if not one.needs_reference:
            out[one.name] = one.function(surface, model)
        elif reference is not None:
            out[one.name] = one.function(surface, model, reference)
    return out


def evaluate_all(
    surface: Surface, models: Mapping[str, History], reference: str | None
) -> dict[str, dict[str, Array]]:
    """`evaluate` of each model against the reference, which itself is compared with nothing."""
    held_against = models[reference] if reference is not None else None
    return {
        name: evaluate(surface, model, held_against if name != reference else None)
        for name, model in models.items()
    }


def along(displacements: Array, normals: Array) -> Array:
    """(S, N, 1) components along the normals (N, 3)."""
    return np.einsum("sni,ni->sn", displacements, normals)[:, :, None]


def _of_parts(whole: Array, weights: Array, u: Array, r: Array) -> Array:
    """(S,) `relative_l2` of components of fields; NaN where that of the reference `whole` is negligible."""
    norm = _unless_lost(weighted_norms(r, weights), weighted_norms(whole, weights))
    return ratio(weighted_norms(u - r, weights), norm)


def _unless_lost(part: Array, whole: Array) -> Array:
    return np.where(part > _LOST * whole, part, 0.0)


def _nodal_error(u: Array, r: Array) -> Array:
    """(S, N) |u - r|."""
    return np.linalg.norm(u - r, axis=2)


def _regional(surface: Surface, model: History, reference: History, mask: Mask) -> Array:
    weights = np.where(mask, surface.areas, 0.0)
    return _each_step(surface, model, reference, lambda _, u, r: relative_l2_steps(u, r, weights))


def _factor_at(depth: float, depths: Array, factors: Array, *, rests: bool) -> float:
    """Load factor at which a model reaches `depth`, linear between its steps and beyond the outer ones.

    Of equal factors the first step counts. Without a step of zero load, its depth is zero for a body that `rests`
    then, and otherwise unknown: NaN.
    """
    rounded = np.round(factors / np.abs(factors).max() / _NO_LOAD)
    _, first = np.unique(rounded, return_index=True)
    x, y = depths[first], factors[first]
    if rounded.all():
        if not rests:
            return np.nan
        place = np.searchsorted(y, 0.0)
        x, y = np.insert(x, place, 0.0), np.insert(y, place, 0.0)
    if not np.isfinite(x).all() or not np.isfinite(depth) or np.any(np.diff(x) <= 0):
        return np.nan
    k = int(np.clip(np.searchsorted(x, depth), 1, len(x) - 1))
    return float(y[k - 1] + (depth - x[k - 1]) * (y[k] - y[k - 1]) / (x[k] - x[k - 1]))


load_all("vdmbench.measures", "metric_")  # last: these files use the definitions above
