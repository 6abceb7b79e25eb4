"""How far a model is from the reference: pure functions on arrays, and the registry of metrics.

Displacements are (N, 3) at the same N surface nodes; norms are weighted by nodal area, so that they do not
depend on how the mesh spreads its nodes. Adding a metric is one decorated function.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

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
    a, b, c = (points[triangles[:, k]] - points[0] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


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
    return _without(rigid_motions(points, weights), displacement, weights)


def _without(motions: Array, displacement: Array, weights: Array) -> Array:
    shares = np.tensordot(motions, displacement * weights[:, None], axes=2)
    return displacement - np.tensordot(shares, motions, axes=1)


def weighted_norm(values: Array, weights: Array) -> float:
    """sqrt(sum_i w_i |v_i|^2) of (N,) or (N, 3) values."""
    squared = values**2 if values.ndim == 1 else np.einsum("ij,ij->i", values, values)
    return float(np.sqrt(weights @ squared))


def relative_l2(values: Array, reference: Array, weights: Array) -> float:
    """||values - reference|| / ||reference||; NaN where the reference is zero."""
    norm = weighted_norm(reference, weights)
    return weighted_norm(values - reference, weights) / norm if norm > 0 else np.nan


def weighted_quantile(values: Array, weights: Array, quantile: float) -> float:
    """The smallest value below or at which at least `quantile` of the weight lies."""
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    position = int(np.searchsorted(cumulative, quantile * cumulative[-1] * (1 - 1e-12)))
    return float(values[order[min(position, len(order) - 1)]])


def nearest_on_surface(queries: Array, points: Array, triangles: Index) -> tuple[Array, Index, Array]:
    """The point of a triangle surface nearest to each of Q queries, exactly.

    Returns
    -------
    distance : (Q,) [m]
    facet : (Q,) index of the facet that holds the nearest point
    weights : (Q, 3) barycentric coordinates of the nearest point in that facet
    """
    corners = points[triangles]
    centroids = corners.mean(axis=1)
    reach = float(np.linalg.norm(corners - centroids[:, None], axis=2).max())
    from scipy.spatial import cKDTree  # slow to load, and reading results needs none

    tree = cKDTree(centroids, balanced_tree=False, compact_nodes=False)  # made for one query
    facets = _Facets(corners)
    distance = np.full(len(queries), np.inf)
    facet = np.zeros(len(queries), dtype=np.int64)
    weights = np.zeros((len(queries), 3))
    pending = np.arange(len(queries))
    k = min(8, len(triangles))
    while len(pending):
        found = tree.query(queries[pending], k=k)
        centroid_distance, candidates = (np.reshape(part, (len(pending), k)) for part in found)
        gaps, along_u, along_v = facets.nearest(queries[pending], candidates)
        rows, best = np.arange(len(pending)), np.argmin(gaps, axis=1)
        distance[pending] = np.sqrt(gaps[rows, best])
        facet[pending] = candidates[rows, best]
        u, v = along_u[rows, best], along_v[rows, best]
        weights[pending] = np.stack([1 - u - v, u, v], axis=1)
        if k == len(triangles):
            break
        # a facet further away than this by its centroid cannot be nearer
        pending = pending[centroid_distance[:, -1] < distance[pending] + reach]
        k = min(4 * k, len(triangles))
    return distance, facet, weights


class _Facets:
    """Triangles as a corner a and the edges u = b - a and v = c - a, component by component."""

    def __init__(self, corners: Array) -> None:
        self.a, b, c = (np.ascontiguousarray(corners[:, i].T) for i in range(3))
        self.u, self.v = b - self.a, c - self.a
        self.uu, self.uv, self.vv = (
            np.einsum("if,if->f", x, y) for x, y in ((self.u, self.u), (self.u, self.v), (self.v, self.v))
        )

    def nearest(self, queries: Array, candidates: Index) -> tuple[Array, Array, Array]:
        """For Q queries (Q, 3) and facets (Q, k): squared distance, and s and t of the nearest point a + s u + t v.

        By the regions of the plane that a corner, an edge or the inside is nearest to (Ericson, Real-Time Collision
        Detection, section 5.1.5).
        """
        w = [queries[:, i, None] - self.a[i][candidates] for i in range(3)]
        u, v = ([edge[i][candidates] for i in range(3)] for edge in (self.u, self.v))
        uu, uv, vv = (part[candidates] for part in (self.uu, self.uv, self.vv))
        d1, d2 = (x[0] * w[0] + x[1] * w[1] + x[2] * w[2] for x in (u, v))
        d3, d4, d5, d6 = d1 - uu, d2 - uv, d1 - uv, d2 - vv
        from_c, from_b, from_a = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
        s, t = _share(from_b, from_a + from_b + from_c), _share(from_c, from_a + from_b + from_c)
        beyond_b, beyond_c = d4 - d3, d5 - d6
        # the regions, the strongest condition last; an edge without length is no region
        bc = (from_a <= 0) & (beyond_b >= 0) & (beyond_c >= 0)
        along = _share(beyond_b, beyond_b + beyond_c)
        s, t = np.where(bc, 1 - along, s), np.where(bc, along, t)
        ac = (from_b <= 0) & (d2 >= 0) & (d6 <= 0) & (vv > 0)
        s, t = np.where(ac, 0.0, s), np.where(ac, _share(d2, d2 - d6), t)
        at_c = (d6 >= 0) & (d5 <= d6)
        s, t = np.where(at_c, 0.0, s), np.where(at_c, 1.0, t)
        ab = (from_c <= 0) & (d1 >= 0) & (d3 <= 0) & (uu > 0)
        s, t = np.where(ab, _share(d1, d1 - d3), s), np.where(ab, 0.0, t)
        at_b = (d3 >= 0) & (d4 <= d3)
        s, t = np.where(at_b, 1.0, s), np.where(at_b, 0.0, t)
        at_a = (d1 <= 0) & (d2 <= 0)
        s, t = np.where(at_a, 0.0, s), np.where(at_a, 0.0, t)
        gap = [w[i] - s * u[i] - t * v[i] for i in range(3)]
        return gap[0] ** 2 + gap[1] ** 2 + gap[2] ** 2, s, t


def _share(part: Array, whole: Array) -> Array:
    """part / whole, 0 where there is nothing to share."""
    return np.divide(part, whole, out=np.zeros_like(part), where=whole != 0)


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


@dataclass(frozen=True)
class History:
    """What a metric needs of one model: S steps."""

    displacement: Array  # (S, N, 3)
    reaction_force: Array  # (S, N, 3)
    load_factors: Array  # (S,)


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
    return int(len(load_factors) - 1 - np.argmax(np.abs(load_factors)[::-1]))


Function = Callable[..., Array]


def _metric(
    unit: str, definition: str, *, version: int = 1, needs_reference: bool = True, needs_contact: bool = False
) -> Callable[[Function], Function]:
    def register(function: Function) -> Function:
        name = function.__name__
        METRICS[name] = Metric(name, unit, definition, version, function, needs_reference, needs_contact)
        return function

    return register


Compare = Callable[[Surface, Array, Array], float]


def _each_step(surface: Surface, model: History, reference: History, compare: Compare) -> Array:
    pairs = zip(model.displacement, reference.displacement, strict=True)
    return np.array([compare(surface, u, r) if _finite(u, r) else np.nan for u, r in pairs])


def _at_full_load(surface: Surface, model: History, reference: History, compare: Compare) -> Array:
    """(S,) NaN but at the step of the largest load."""
    out, step = np.full(len(model.load_factors), np.nan), full_load_step(model.load_factors)
    u, r = model.displacement[step], reference.displacement[step]
    if _finite(u, r):
        out[step] = compare(surface, u, r)
    return out


def _finite(*arrays: Array) -> bool:
    return all(bool(np.isfinite(array).all()) for array in arrays)


@_metric("1", "area-weighted ||u - r|| / ||r|| of the displacement vector")
def relative_l2_displacement_error(surface: Surface, model: History, reference: History) -> Array:
    return _each_step(surface, model, reference, lambda s, u, r: relative_l2(u, r, s.areas))


@_metric("1", "as the displacement error, the best-fit rigid motion removed from model and reference alike")
def relative_l2_deformation_error(surface: Surface, model: History, reference: History) -> Array:
    def compare(s: Surface, u: Array, r: Array) -> float:
        u, r = (_without(s.rigid_motions, v, s.areas) for v in (u, r))
        return relative_l2(u, r, s.areas)

    return _each_step(surface, model, reference, compare)


@_metric("1", "as the displacement error, for the component along the undeformed normal")
def relative_l2_normal_error(surface: Surface, model: History, reference: History) -> Array:
    def compare(s: Surface, u: Array, r: Array) -> float:
        u, r = (np.einsum("ij,ij->i", v, s.normals) for v in (u, r))
        return relative_l2(u, r, s.areas)

    return _each_step(surface, model, reference, compare)


@_metric("1", "as the displacement error, for the component in the undeformed surface")
def relative_l2_tangential_error(surface: Surface, model: History, reference: History) -> Array:
    def compare(s: Surface, u: Array, r: Array) -> float:
        n = s.normals
        u, r = (v - np.einsum("ij,ij->i", v, n)[:, None] * n for v in (u, r))
        return relative_l2(u, r, s.areas)

    return _each_step(surface, model, reference, compare)


@_metric("m", "largest |u - r| of any surface node")
def max_nodal_error(surface: Surface, model: History, reference: History) -> Array:
    return _each_step(surface, model, reference, lambda _, u, r: float(_nodal_error(u, r).max()))


@_metric("1", "largest |u - r| over largest |r|")
def max_nodal_error_relative(surface: Surface, model: History, reference: History) -> Array:
    return max_nodal_error(surface, model, reference) / _largest(reference)


@_metric("m", "|u - r| that 95 % of the surface area stays below")
def p95_nodal_error(surface: Surface, model: History, reference: History) -> Array:
    return _each_step(
        surface, model, reference, lambda s, u, r: weighted_quantile(_nodal_error(u, r), s.areas, 0.95)
    )


@_metric("1", "|u - r| that 95 % of the surface area stays below, over largest |r|")
def p95_nodal_error_relative(surface: Surface, model: History, reference: History) -> Array:
    return p95_nodal_error(surface, model, reference) / _largest(reference)


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
    def compare(s: Surface, u: Array, r: Array) -> float:
        there = nearest_on_surface(s.points + u, s.points + r, s.triangles)[0]
        return float(np.average(there, weights=s.areas))

    return _at_full_load(surface, model, reference, compare)


@_metric(
    "m",
    "larger of the two one-sided maximal distances between the deformed surfaces at their nodes, at full load",
    version=2,
)
def hausdorff_distance(surface: Surface, model: History, reference: History) -> Array:
    def compare(s: Surface, u: Array, r: Array) -> float:
        there = nearest_on_surface(s.points + u, s.points + r, s.triangles)[0]
        back = nearest_on_surface(s.points + r, s.points + u, s.triangles)[0]
        return float(max(there.max(), back.max()))

    return _at_full_load(surface, model, reference, compare)


@_metric("1", "|R - R_ref| / |R_ref| of the total force that the supports exert")
def reaction_force_error(surface: Surface, model: History, reference: History) -> Array:  # noqa: ARG001
    total, total_reference = (history.reaction_force.sum(axis=1) for history in (model, reference))
    norm = np.linalg.norm(total_reference, axis=1)
    gap = np.linalg.norm(total - total_reference, axis=1)
    return np.divide(gap, norm, out=np.full(len(norm), np.nan), where=norm > 0)


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
    deformed = [enclosed_volume(surface.points + u, surface.triangles) for u in model.displacement]
    return np.array(deformed) / surface.volume - 1


@_metric("1", "(V - V0) over the displaced volume, half of sum |g_i . u_i|", needs_reference=False)
def volume_drift_of_displaced(surface: Surface, model: History) -> Array:
    displaced = 0.5 * np.abs(np.einsum("sij,ij->si", model.displacement, surface.volume_gradient)).sum(axis=1)
    change = volume_drift(surface, model) * surface.volume
    return np.divide(change, displaced, out=np.full(len(change), np.nan), where=displaced > 0)


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


def _nodal_error(u: Array, r: Array) -> Array:
    return np.linalg.norm(u - r, axis=1)


def _largest(reference: History) -> Array:
    """(S,) largest |r|; NaN where the reference does not move."""
    largest = np.linalg.norm(reference.displacement, axis=2).max(axis=1)
    return np.where(largest > 0, largest, np.nan)


def _regional(surface: Surface, model: History, reference: History, mask: Mask) -> Array:
    weights = np.where(mask, surface.areas, 0.0)
    return _each_step(surface, model, reference, lambda _, u, r: relative_l2(u, r, weights))


def _factor_at(depth: float, depths: Array, factors: Array) -> float:
    """Load factor at which a model reaches `depth`, linear between its steps and beyond the outer ones."""
    order = np.argsort(factors)
    x, y = np.concatenate([[0.0], depths[order]]), np.concatenate([[0.0], factors[order]])
    if not np.isfinite(x).all() or not np.isfinite(depth) or np.any(np.diff(x) <= 0):
        return np.nan
    if depth > x[-1]:
        return float(y[-1] + (depth - x[-1]) * (y[-1] - y[-2]) / (x[-1] - x[-2]))
    return float(np.interp(depth, x, y))
