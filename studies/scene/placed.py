"""A constraint on its mesh, from which the kinds of constraints make pressures, lines and indenters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from solver_common.arrays import Array, Index, Mask
from solver_common.quadrature import facet_quadrature

from ..body.mesh import Mesh
from ..body.surface_measures import facet_area_vectors
from ..body.topology import half_edges
from ..study.errors import Loc
from ..study.loads import PROFILES, Constraint
from ..study.loads import Indenter as IndenterTable
from ..study.schema import Region
from .regions import SceneError, profile_coordinate, profile_slope

if TYPE_CHECKING:
    from fem_reference.indenter import Indenter


_LEAST_RESULTANT = 1e-6  # of a contact, over the sum of its facets' forces: smaller is rounding or chance


@dataclass(frozen=True)
class PlacedConstraint:
    """A constraint on a mesh of N surface nodes and F facets with Q quadrature points each.

    `place` is its place in the study, `nodes` (N,) the mask of its `region`.
    """

    constraint: Constraint
    place: Loc
    region: Region
    mesh: Mesh
    nodes: Mask

    @property
    def points(self) -> Array:
        """(N, 3) surface nodes [m]."""
        return self.mesh.surface_points

    @property
    def triangles(self) -> Index:
        """(F, 3) nodes of the facets."""
        return self.mesh.triangles

    def pressure(self, profile: str) -> Array:
        """(F, Q) pressure of peak 1 over the region.

        A uniform pressure acts on the facets with three nodes in the region. A smooth profile is integrated over
        the facets (`on_facets`): its resultant depends neither on the mesh level nor on the model.
        """
        asked = ("pressure", profile, self.region.model_dump_json(), self.nodes.tobytes())
        shape = self.mesh.remembered(asked, lambda: self._shape(profile))
        if not shape.any():
            raise self._error("loads no facet; enlarge its region or take a smaller mesh_size")
        return shape

    def resultant(self, pressure: Array) -> float:
        """Size of the resultant of a pressure, over its unit [m^2]."""
        vectors = facet_area_vectors(self.points, self.triangles)
        areas = pressure @ facet_quadrature()[1]
        resultant = float(np.linalg.norm(areas @ vectors))
        total = float(np.abs(areas) @ np.linalg.norm(vectors, axis=1))
        if resultant < _LEAST_RESULTANT * total:
            raise self._error(
                "presses from all sides, so that its pressures have no resultant to be given by force; give "
                "pressure, or a region on one side"
            )
        return resultant

    def edges(self) -> Index:
        """(k, 2) surface edges between the nodes of a region without a facet."""
        triangles, mask = self.triangles, self.nodes
        sides = np.sort(half_edges(triangles), axis=1)
        edges = np.unique(sides[mask[sides].all(axis=1)], axis=0)
        if not len(edges):
            raise self._error("has no edge between its nodes; enlarge its region")
        if (count := int(mask[triangles].all(axis=1).sum())) > 0:
            raise self._error(f"covers {count} facets; a line is one node wide: make its region narrower")
        return np.asarray(edges, dtype=np.int64)

    def facets(self) -> Mask:
        """(F,) mask of the facets whose three nodes are in the region."""
        inside = np.all(self.nodes[self.triangles], axis=1)
        if not inside.any():
            raise self._error("has no facet; enlarge its region or take a smaller mesh_size")
        return np.asarray(inside)

    def _shape(self, profile: str) -> Array:
        barycentric, weights = facet_quadrature()
        if profile == "uniform":
            inside = np.all(self.nodes[self.triangles], axis=1)
            return np.repeat(inside[:, None].astype(float), len(weights), axis=1)
        return on_facets(profile, self.region, self.mesh, (barycentric, weights))

    def _error(self, text: str) -> SceneError:
        return SceneError(f"{self.constraint.kind} {self.constraint.name!r} {text}", *self.place)


# --- a rigid indenter on its mesh: the place where its tip first touches ---


_HALVINGS = 8  # of a facet's edges: the gap's error is their (1/512)^2 over twice the radius
_NEAREST = 1000  # quarters that are refined further
_LEAST = 1e-6  # of a region's area: smaller area vectors give no mean normal


@dataclass(frozen=True)
class PlacedIndenter:
    """An indenter that touches at depth zero, (F,) facets within its reach, and its depth at load factor 1 [m]."""

    indenter: Indenter
    facets: Mask
    depth: float


def place_indenter(facets: Mask, pushed: IndenterTable, mesh: Mesh, place: Loc) -> PlacedIndenter:
    """The indenter of a constraint, its axis through the middle of the region's area.

    Raises
    ------
    SceneError
        a region without a mean normal where no push is given, or an impossible indenter.
    """
    from fem_reference.indenter import Capsule, FlatPunch, Indenter, Sphere
    from solver_common.solution import SolverError

    triangles = mesh.triangles[facets]
    vectors = facet_area_vectors(mesh.surface_points, triangles)
    areas = np.linalg.norm(vectors, axis=1)
    direction = -vectors.sum(axis=0) if pushed.push is None else np.array(pushed.push)
    if np.linalg.norm(direction) < _LEAST * areas.sum():
        raise SceneError(
            "the region of the indenter faces every way; give push, or a region on one side", *place
        )
    middle = areas @ mesh.surface_points[triangles].mean(axis=1) / areas.sum()
    try:
        if pushed.shape == "capsule":
            along = pushed.along or (0.0, 0.0, 0.0)
            shape: Capsule | FlatPunch | Sphere = Capsule(pushed.radius, pushed.length or 0.0, along)
        else:
            shape = (FlatPunch if pushed.shape == "flat-punch" else Sphere)(pushed.radius)
        there = Indenter(shape, middle, direction)
        gap = _least_gap(there, mesh.surface_points[triangles].transpose(1, 0, 2))
        if not np.isfinite(gap):
            raise SceneError(
                "the indenter meets no point of its region; take a finer mesh, or another region", *place
            )
        return PlacedIndenter(Indenter(shape, middle + gap * there.axis, direction), facets, pushed.depth)
    except SolverError as error:
        raise SceneError(f"{error.status.message}; {error.status.remedy}", *place) from None


def _least_gap(there: Indenter, corners: Array) -> float:
    """Least gap [m] on flat facets with corners (3, F, 3), on a lattice that is finer where the gap is small."""
    for _ in range(_HALVINGS):
        corners = _quarters(corners)
        nearest = np.argsort(there.gap(corners).min(axis=0))
        corners = corners[:, nearest[:_NEAREST]]
    return float(there.gap(corners).min())


# --- smooth contact profiles on flat facets, integrated so that their resultant does not depend on the mesh ---


_FINEST = 4e-3  # change of rho over a cell that is not split: its error is below 1e-6 of the resultant
_SMOOTH = 0.25  # the same far from the rim, where the facet's rule is that accurate
_FROM_RIM = 3.0  # such changes from a cell to the rim, where the Hertz profile has an infinite slope
# the products of two barycentric coordinates span the polynomials of second degree, which load integrals need
_PRODUCTS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))


def on_facets(profile: str, region: Region, mesh: Mesh, rule: tuple[Array, Array]) -> Array:
    """(F, Q) values at the quadrature points of a facet whose sums are the profile's integrals.

    The rule's sums with all polynomials of second degree equal the profile's integrals over the flat facet, to
    1e-6 of the whole. Loads on linear and quadratic elements are thus exact on any mesh. Near the rim the values
    are not samples of the profile, and may be slightly negative.

    Parameters
    ----------
    rule : (Q, 3) barycentric coordinates and (Q,) weights of a rule of Q = 6 points, exact to degree 4
    """
    moments = np.zeros((len(mesh.triangles), len(_PRODUCTS)))
    facets = np.arange(len(mesh.triangles))
    corners = mesh.surface_points[mesh.triangles].transpose(
        1, 0, 2
    )  # (3, C, 3) of the cells, at first the facets
    cells = np.broadcast_to(
        np.eye(3)[:, None], corners.shape
    )  # the same in barycentric coordinates of the facet
    share = 1.0  # area of a cell over that of its facet
    while len(facets):
        split, whole = _are_split(region, mesh, corners)
        values = PROFILES[profile](profile_coordinate(region, mesh, _at(rule[0], corners[:, whole])))
        moments += share * _moments(values, cells[:, whole], facets[whole], rule, len(moments))
        facets = np.tile(facets[split], 4)
        corners, cells = _quarters(corners[:, split]), _quarters(cells[:, split])
        share /= 4.0
    barycentric, weights = rule
    return np.asarray(np.linalg.solve(_products(barycentric) * weights, moments.T).T)


def _are_split(region: Region, mesh: Mesh, corners: Array) -> tuple[Mask, Mask]:
    """(C,) cells where the profile is too rough for the rule, and (C,) cells where it is smooth enough.

    Cells beyond the rim are in neither.
    """
    sides = corners - np.roll(corners, 1, axis=0)
    longest = np.sqrt(np.einsum("kci,kci->kc", sides, sides).max(axis=0))
    rho = profile_coordinate(region, mesh, corners)
    change = longest * profile_slope(region, mesh, corners).max(axis=0)
    outside = rho.min(axis=0) - change > 1.0
    smooth = (change < _SMOOTH) & (1.0 - rho.max(axis=0) > _FROM_RIM * change)
    whole = smooth | (change < _FINEST)
    return ~(outside | whole), whole & ~outside


def _at(barycentric: Array, corners: Array) -> Array:
    """(Q, C, 3) points of cells with corners (3, C, 3)."""
    return np.asarray(np.tensordot(barycentric, corners, axes=1))


def _moments(values: Array, cells: Array, facets: Index, rule: tuple[Array, Array], count: int) -> Array:
    """(F, 6) integrals of values (Q, C) times the products, over the cells' area, summed by facet."""
    barycentric, weights = rule
    found = np.einsum("qc,kqc->kc", values * weights[:, None], _products(_at(barycentric, cells)))
    return np.stack([np.bincount(facets, row, count) for row in found], axis=1)


def _products(barycentric: Array) -> Array:
    """(6, ...) products of barycentric coordinates (..., 3)."""
    return np.stack([barycentric[..., a] * barycentric[..., b] for a, b in _PRODUCTS])


def _quarters(cells: Array) -> Array:
    """(3, 4 C, 3) quarters of cells (3, C, 3), by the middles of their edges."""
    a, b, c = cells
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part) for part in parts], axis=1)
