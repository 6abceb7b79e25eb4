"""How far a model is from the reference: pure functions on arrays, and the registry of metrics.

Displacements are (N, 3) at the same N surface nodes; norms are weighted by nodal area, so that they do not
depend on how the mesh spreads its nodes. Adding a metric is one decorated function.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .nearest import Neighbourhood

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


# --- surface measures ---


def facet_area_vectors(points: Array, triangles: Index) -> Array:
    """(F, 3) area times unit normal of each facet [m^2]."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return 0.5 * np.cross(b - a, c - a)


def corner_sum(per_corner: Array, triangles: Index, n_nodes: int) -> Array:
    """Sum values given per facet corner at the nodes: (F, 3, ...) -> (N, ...)."""
    out = np.zeros((n_nodes, *per_corner.shape[2:]))
    for corner in range(3):
        np.add.at(out, triangles[:, corner], per_corner[:, corner])
    return out


def nodal_sum(per_facet: Array, triangles: Index, n_nodes: int) -> Array:
    """Spread a third of each facet's value to its three nodes: (F, ...) -> (N, ...)."""
    return corner_sum(np.repeat(per_facet[:, None] / 3.0, 3, axis=1), triangles, n_nodes)


def enclosed_volume(points: Array, triangles: Index) -> float:
    """Exact volume of the closed polyhedron, by the divergence theorem [m^3]."""
    return float(enclosed_volumes(points[None], triangles)[0])


def enclosed_volumes(points: Array, triangles: Index) -> Array:
    """(S,) exact volumes of polyhedra (S, N, 3) of the same facets [m^3]."""
    components = np.ascontiguousarray(np.moveaxis(points - points[:, :1], -1, 0))  # (3, S, N)
    corners = np.ascontiguousarray(triangles.T)
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = ([x[:, nodes] for x in components] for nodes in corners)
    parts = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    return np.asarray(parts.sum(axis=1) / 6.0)


def rigid_motions(points: Array, weights: Array) -> Array:
    """(6, N, 3) rigid motions, infinitesimal and orthonormal by area; zero where one is another's multiple."""
    x = points - np.average(points, axis=0, weights=weights)
    turns = np.array([np.cross(axis, x) for axis in np.eye(3)])
    shifts = np.broadcast_to(np.eye(3)[:, None, :], turns.shape) / np.sqrt(weights.sum())
    # about the centroid a turn and a shift are orthogonal: only the turns need their Gram matrix (of inertia)
    values, vectors = np.linalg.eigh(np.einsum("ani,n,bni->ab", turns, weights, turns))
    proper = values > 1e-14 * values[-1]
    scale = np.where(proper, 1.0 / np.sqrt(np.where(proper, values, 1.0)), 0.0)
    return np.concatenate([shifts, np.einsum("am,m,ani->mni", vectors, scale, turns)])


def rigid_motion_removed(points: Array, displacement: Array, weights: Array) -> Array:
    """(N, 3) displacement less its best-fit infinitesimal rigid motion (area-weighted least squares) [m].

    Infinitesimal, so that the result of a linear model scales with its load.
    """
    return without_motions(rigid_motions(points, weights), displacement[None], weights)[0]


def without_motions(motions: Array, displacements: Array, weights: Array) -> Array:
    """(S, N, 3) displacements less their parts along orthonormal motions (6, N, 3)."""
    shares = np.tensordot(displacements * weights[:, None], motions, axes=((1, 2), (1, 2)))
    return displacements - np.tensordot(shares, motions, axes=1)


def weighted_norm(values: Array, weights: Array) -> float:
    """sqrt(sum_i w_i |v_i|^2) of (N,) or (N, 3) values."""
    squared = values**2 if values.ndim == 1 else np.einsum("ij,ij->i", values, values)
    return float(np.sqrt(weights @ squared))


def relative_l2(values: Array, reference: Array, weights: Array) -> float:
    """||values - reference|| / ||reference||; NaN where the reference is zero."""
    norm = weighted_norm(reference, weights)
    return weighted_norm(values - reference, weights) / norm if norm > 0 else np.nan


def weighted_quantiles(values: Array, weights: Array, quantile: float) -> Array:
    """(S,) of each row of (S, N) values the smallest at or below which at least `quantile` of the weight lies."""
    order = np.argsort(values, axis=1)
    cumulative = np.cumsum(weights[order], axis=1)
    below = cumulative < quantile * cumulative[:, -1:] * (1 - 1e-12)
    position = np.minimum(below.sum(axis=1, keepdims=True), order.shape[1] - 1)
    return np.take_along_axis(values, np.take_along_axis(order, position, axis=1), axis=1)[:, 0]


def _relative_l2(values: Array, reference: Array, weights: Array) -> Array:
    """(S,) `relative_l2` of each step of (S, N, ...) fields."""
    return _ratio(_norms(values - reference, weights), _norms(reference, weights))


def _norms(values: Array, weights: Array) -> Array:
    return np.sqrt(np.einsum("sni,sni->sn", values, values) @ weights)


def _ratio(part: Array, whole: Array) -> Array:
    """(S,) part / whole, NaN where the whole is zero."""
    return np.divide(part, whole, out=np.full(len(whole), np.nan), where=whole > 0)


# --- one model beside the reference ---


@dataclass(frozen=True)
class Surface:
    """The undeformed surface with its measures."""

    points: Array
    triangles: Index
    contact: Mask = field(default_factory=lambda: np.zeros(0, dtype=bool))  # (N,) nodes under contact
    contact_force: Array = field(default_factory=lambda: np.zeros((0, 3)))  # (N, 3) at load factor 1

    @cached_property
    def areas(self) -> Array:
        """(N,) nodal areas A_i [m^2] (eq. 1)."""
        facets = np.linalg.norm(facet_area_vectors(self.points, self.triangles), axis=1)
        return nodal_sum(facets, self.triangles, len(self.points))

    @cached_property
    def volume_gradient(self) -> Array:
        """(N, 3) exact gradient g_i of the enclosed volume [m^2]."""
        return nodal_sum(facet_area_vectors(self.points, self.triangles), self.triangles, len(self.points))

    @cached_property
    def normals(self) -> Array:
        """(N, 3) outward unit normals g_i/|g_i|."""
        return self.volume_gradient / np.linalg.norm(self.volume_gradient, axis=1, keepdims=True)

    @cached_property
    def rigid_motions(self) -> Array:
        """(6, N, 3), see `rigid_motions`."""
        return rigid_motions(self.points, self.areas)

    @cached_property
    def volume(self) -> float:
        """Enclosed volume [m^3]."""
        return enclosed_volume(self.points, self.triangles)

    @cached_property
    def neighbourhood(self) -> Neighbourhood:
        """For distances between deformed surfaces."""
        return Neighbourhood(self.points, self.triangles)

    def under(self, contact: Mask, contact_force: Array) -> Surface:
        """The same surface in another contact; what is measured of it is measured once."""
        other = replace(self, contact=contact, contact_force=contact_force)
        for name in ("areas", "volume_gradient", "normals", "rigid_motions", "volume", "neighbourhood"):
            other.__dict__[name] = getattr(self, name)
        return other


@dataclass(frozen=True)
class History:
    """What a metric needs of one model: S steps."""

    displacement: Array  # (S, N, 3)
    reaction_force: Array  # (S, N, 3)
    load_factors: Array  # (S,)
    # at full load: (N,) from the nodes to the reference's surface, and the largest either way; see `evaluate_all`
    distances: tuple[Array, float] | None = None
    volume: Array | None = None  # (S,) enclosed volumes [m^3], where they are known

    @cached_property
    def largest(self) -> Array:
        """(S,) largest displacement [m]; NaN where nothing moves."""
        largest = np.linalg.norm(self.displacement, axis=2).max(axis=1)
        return np.where(largest > 0, largest, np.nan)


@dataclass(frozen=True)
class Metric:
    """A named measure; `version` changes whenever its numbers do."""

    name: str
    unit: str
    definition: str
    version: int
    function: Callable[..., Array]
    needs_reference: bool
    needs_contact: bool


METRICS: dict[str, Metric] = {}


def full_load_step(load_factors: Array) -> int:
    """The step of the largest load, the last of several."""
    return int(len(load_factors) - 1 - np.abs(load_factors)[::-1].argmax())


Function = Callable[..., Array]


def _metric(
    unit: str, definition: str, *, version: int = 1, needs_reference: bool = True, needs_contact: bool = False
) -> Callable[[Function], Function]:
    def register(function: Function) -> Function:
        name = function.__name__
        METRICS[name] = Metric(name, unit, definition, version, function, needs_reference, needs_contact)
        return function

    return register


Compare = Callable[[Surface, Array, Array], Array]  # of displacements (S, N, 3): (S,)


def _each_step(surface: Surface, model: History, reference: History, compare: Compare) -> Array:
    """(S,) what `compare` finds; NaN where a step of either failed."""
    u, r = model.displacement, reference.displacement
    usable = np.isfinite(u).all(axis=(1, 2)) & np.isfinite(r).all(axis=(1, 2))
    if usable.all():
        return compare(surface, u, r)
    out = np.full(len(u), np.nan)
    if usable.any():
        out[usable] = compare(surface, u[usable], r[usable])
    return out


@_metric("1", "area-weighted ||u - r|| / ||r|| of the displacement vector")
def relative_l2_displacement_error(surface: Surface, model: History, reference: History) -> Array:
    return _each_step(surface, model, reference, lambda s, u, r: _relative_l2(u, r, s.areas))


@_metric("1", "as the displacement error, the best-fit rigid motion removed from model and reference alike")
def relative_l2_deformation_error(surface: Surface, model: History, reference: History) -> Array:
    def compare(s: Surface, u: Array, r: Array) -> Array:
        u, r = (without_motions(s.rigid_motions, v, s.areas) for v in (u, r))
        return _relative_l2(u, r, s.areas)

    return _each_step(surface, model, reference, compare)


@_metric("1", "as the displacement error, for the component along the undeformed normal")
def relative_l2_normal_error(surface: Surface, model: History, reference: History) -> Array:
    def compare(s: Surface, u: Array, r: Array) -> Array:
        u, r = (_along(v, s.normals) for v in (u, r))
        return _relative_l2(u, r, s.areas)

    return _each_step(surface, model, reference, compare)


@_metric("1", "as the displacement error, for the component in the undeformed surface")
def relative_l2_tangential_error(surface: Surface, model: History, reference: History) -> Array:
    def compare(s: Surface, u: Array, r: Array) -> Array:
        u, r = (v - _along(v, s.normals) * s.normals for v in (u, r))
        return _relative_l2(u, r, s.areas)

    return _each_step(surface, model, reference, compare)


@_metric("m", "largest |u - r| of any surface node")
def max_nodal_error(surface: Surface, model: History, reference: History) -> Array:
    return _each_step(surface, model, reference, lambda _, u, r: _nodal_error(u, r).max(axis=1))


@_metric("1", "largest |u - r| over largest |r|")
def max_nodal_error_relative(surface: Surface, model: History, reference: History) -> Array:
    return max_nodal_error(surface, model, reference) / reference.largest


@_metric("m", "|u - r| that 95 % of the surface area stays below")
def p95_nodal_error(surface: Surface, model: History, reference: History) -> Array:
    return _each_step(
        surface, model, reference, lambda s, u, r: weighted_quantiles(_nodal_error(u, r), s.areas, 0.95)
    )


@_metric("1", "|u - r| that 95 % of the surface area stays below, over largest |r|")
def p95_nodal_error_relative(surface: Surface, model: History, reference: History) -> Array:
    return p95_nodal_error(surface, model, reference) / reference.largest


@_metric("1", "displacement error over the loaded nodes only", needs_contact=True)
def contact_region_error(surface: Surface, model: History, reference: History) -> Array:
    return _regional(surface, model, reference, surface.contact)


@_metric("1", "displacement error over the nodes that carry no contact", needs_contact=True)
def far_field_error(surface: Surface, model: History, reference: History) -> Array:
    return _regional(surface, model, reference, ~surface.contact)


# distances of two surfaces cost more than all other metrics together and are read at full load only


@_metric(
    "m",
    "area-weighted mean distance of the model's deformed nodes to the reference's deformed surface, at full load",
    version=2,
)
def mean_surface_distance(surface: Surface, model: History, reference: History) -> Array:
    return _of_distances(
        surface, model, reference, lambda there, _: float(np.average(there, weights=surface.areas))
    )


@_metric(
    "m",
    "larger of the two one-sided maximal distances between the deformed surfaces at their nodes, at full load",
    version=2,
)
def hausdorff_distance(surface: Surface, model: History, reference: History) -> Array:
    return _of_distances(surface, model, reference, lambda _, farthest: farthest)


def _of_distances(
    surface: Surface, model: History, reference: History, measure: Callable[[Array, float], float]
) -> Array:
    """(S,) NaN but at the step of the largest load."""
    out = np.full(len(model.load_factors), np.nan)
    if model.distances is None:
        (model,) = _with_distances(surface, [model], reference)
    if model.distances is not None:
        out[full_load_step(model.load_factors)] = measure(*model.distances)
    return out


def _with_distances(surface: Surface, models: Sequence[History], reference: History) -> list[History]:
    """The models with their distances from the reference, found in one pass; None where either's step failed."""
    step = full_load_step(reference.load_factors)
    r = reference.displacement[step]
    found = list(models)
    usable = [
        place
        for place, model in enumerate(models)
        if np.isfinite(model.displacement[step]).all() and np.isfinite(r).all()
    ]
    if usable:
        deformed = surface.points + np.stack([models[place].displacement[step] for place in usable])
        there, farthest = surface.neighbourhood.distances_and_farthest(deformed, surface.points + r)
        for place, distance, most in zip(usable, there, farthest, strict=True):
            found[place] = replace(models[place], distances=(distance, float(most)))
    return found


@_metric("1", "|R - R_ref| / |R_ref| of the total force that the supports exert")
def reaction_force_error(surface: Surface, model: History, reference: History) -> Array:  # noqa: ARG001
    total, total_reference = (history.reaction_force.sum(axis=1) for history in (model, reference))
    norm = np.linalg.norm(total_reference, axis=1)
    return _ratio(np.linalg.norm(total - total_reference, axis=1), norm)


@_metric(
    "1",
    "force that the model needs for the reference's indentation depth, over the reference's, less one",
    needs_contact=True,
)
def indentation_force_error(surface: Surface, model: History, reference: History) -> Array:
    depth, goals = (mean_indentation(surface, h.displacement) for h in (model, reference))
    factors = model.load_factors
    return np.array(
        [
            _factor_at(goal, depth, factors) / factor - 1 if factor else np.nan
            for goal, factor in zip(goals, factors, strict=True)
        ]
    )


@_metric("1", "(V - V0)/V0 of the exact polyhedral volume", needs_reference=False)
def volume_drift(surface: Surface, model: History) -> Array:
    volume = model.volume
    if volume is None:
        volume = enclosed_volumes(surface.points + model.displacement, surface.triangles)
    return volume / surface.volume - 1


@_metric("1", "(V - V0) over the displaced volume, half of sum |g_i . u_i|", needs_reference=False)
def volume_drift_of_displaced(surface: Surface, model: History) -> Array:
    displaced = 0.5 * np.abs(np.einsum("sij,ij->si", model.displacement, surface.volume_gradient)).sum(axis=1)
    return _ratio(volume_drift(surface, model) * surface.volume, displaced)


def _mean_strain(surface: Surface, model: History, axis: int) -> Array:
    """(S,) volume mean of du/dx along an axis: the integral of u n over the surface, u linear on each facet."""
    return np.asarray(model.displacement[:, :, axis] @ surface.volume_gradient[:, axis] / surface.volume)


@_metric("1", "mean of du_x/dx over the body's volume", needs_reference=False)
def mean_strain_x(surface: Surface, model: History) -> Array:
    return _mean_strain(surface, model, 0)


@_metric("1", "mean of du_y/dy over the body's volume", needs_reference=False)
def mean_strain_y(surface: Surface, model: History) -> Array:
    return _mean_strain(surface, model, 1)


@_metric("1", "mean of du_z/dz over the body's volume", needs_reference=False)
def mean_strain_z(surface: Surface, model: History) -> Array:
    return _mean_strain(surface, model, 2)


@_metric(
    "J",
    "work of the contact forces on the displacement",
    needs_reference=False,
    needs_contact=True,
)
def contact_work(surface: Surface, model: History) -> Array:
    if not len(surface.contact_force):
        return np.full(len(model.load_factors), np.nan)
    return model.load_factors * np.einsum("ij,sij->s", surface.contact_force, model.displacement)


def mean_indentation(surface: Surface, displacement: Array) -> Array:
    """(S,) area-weighted mean inward normal displacement of the loaded nodes [m]; NaN without any."""
    loaded = surface.contact
    if not loaded.any():
        return np.full(len(displacement), np.nan)
    inward = -np.einsum("sij,ij->si", displacement[:, loaded], surface.normals[loaded])
    return np.average(inward, axis=1, weights=surface.areas[loaded])


def evaluate(surface: Surface, model: History, reference: History | None) -> dict[str, Array]:
    """Every metric that has what it needs: name -> (S,) values."""
    out = {}
    for metric in METRICS.values():
        if metric.needs_contact and not surface.contact.any():
            continue
        if not metric.needs_reference:
            out[metric.name] = metric.function(surface, model)
        elif reference is not None:
            out[metric.name] = metric.function(surface, model, reference)
    return out


def evaluate_all(
    surface: Surface, models: Mapping[str, History], reference: str | None
) -> dict[str, dict[str, Array]]:
    """`evaluate` of each model against one of them, which is itself compared with nothing."""
    models = {
        name: replace(model, volume=enclosed_volumes(surface.points + model.displacement, surface.triangles))
        for name, model in models.items()
    }
    if reference is None:
        return {name: evaluate(surface, model, None) for name, model in models.items()}
    others = [name for name in models if name != reference]
    measured = _with_distances(surface, [models[name] for name in others], models[reference])
    ready = dict(zip(others, measured, strict=True))
    return {
        name: evaluate(surface, ready.get(name, model), models[reference] if name in ready else None)
        for name, model in models.items()
    }


def _along(displacements: Array, normals: Array) -> Array:
    """(S, N, 1) components along the normals (N, 3)."""
    return np.einsum("sni,ni->sn", displacements, normals)[:, :, None]


def _nodal_error(u: Array, r: Array) -> Array:
    """(S, N) |u - r|."""
    return np.linalg.norm(u - r, axis=2)


def _regional(surface: Surface, model: History, reference: History, mask: Mask) -> Array:
    weights = np.where(mask, surface.areas, 0.0)
    return _each_step(surface, model, reference, lambda _, u, r: _relative_l2(u, r, weights))


def _factor_at(depth: float, depths: Array, factors: Array) -> float:
    """Load factor at which a model reaches `depth`, linear between its steps and beyond the outer ones."""
    order = np.argsort(factors)
    x, y = np.concatenate([[0.0], depths[order]]), np.concatenate([[0.0], factors[order]])
    if not np.isfinite(x).all() or not np.isfinite(depth) or np.any(np.diff(x) <= 0):
        return np.nan
    if depth > x[-1]:
        return float(y[-1] + (depth - x[-1]) * (y[-1] - y[-2]) / (x[-1] - x[-2]))
    return float(np.interp(depth, x, y))
