"""Smooth contact profiles on flat facets: integrated, so that their resultant belongs to no mesh."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..body.mesh import Array, Index, Mask, Mesh
from ..study.profiles import PROFILES
from ..study.schema import Region
from .regions import profile_coordinate, profile_slope

_FINEST = 4e-3  # change of rho over a cell that is not split further: leaves less than 1e-6 of the resultant
_SMOOTH = 0.25  # the same far from the rim, where the rule on a facet leaves less than that
_FROM_RIM = 3.0  # such changes between a cell and the rim, where the Hertz profile has an infinite slope
# the products of two barycentric coordinates span the polynomials of second degree, with which loads are integrated
_PRODUCTS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))


def on_facets(profile: str, region: Region, mesh: Mesh, rule: tuple[Array, Array]) -> Array:
    """(F, Q) values at the quadrature points of a facet whose sums are the profile's integrals.

    The rule's sums with all polynomials of second degree are those of the profile itself over the flat facet, to
    1e-6 of the whole. Loads on linear and quadratic elements are thereby exact, whatever the mesh; near the rim the
    values are no samples of the profile, and may be a little below zero.

    Parameters
    ----------
    rule : (Q, 3) barycentric coordinates and (Q,) weights of a rule of Q = 6 points, exact to degree 4
    """
    barycentric, weights = rule
    moments = np.zeros((len(mesh.triangles), len(_PRODUCTS)))
    facets = np.arange(len(mesh.triangles))
    cells = np.broadcast_to(np.eye(3), (len(facets), 3, 3))  # barycentric coordinates of their corners
    share = 1.0  # of a cell in its facet
    while len(facets):
        split = _are_split(region, mesh, facets, cells)
        moments += share * _moments(PROFILES[profile], region, mesh, facets[~split], cells[~split], rule)
        facets, cells = np.repeat(facets[split], 4), _quarters(cells[split])
        share /= 4.0
    return np.asarray(np.linalg.solve((_products(barycentric) * weights[:, None]).T, moments.T).T)


def _are_split(region: Region, mesh: Mesh, facets: Index, cells: Array) -> Mask:
    """(C,) cells over which the profile is not smooth enough for the rule."""
    corners = cells @ mesh.surface_points[mesh.triangles[facets]]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    rho = profile_coordinate(region, mesh, corners)
    change = longest * profile_slope(region, mesh, corners).max(axis=1)
    outside = rho.min(axis=1) - change > 1.0
    smooth = (change < _SMOOTH) & (1.0 - rho.max(axis=1) > _FROM_RIM * change)
    found: Mask = ~(outside | smooth | (change < _FINEST))
    return found


def _moments(
    profile: Callable[[Array], Array],
    region: Region,
    mesh: Mesh,
    facets: Index,
    cells: Array,
    rule: tuple[Array, Array],
) -> Array:
    """(F, 6) integrals of the profile times the products, over the cells' area, summed by facet."""
    barycentric, weights = rule
    places = barycentric @ cells
    pressure = profile(profile_coordinate(region, mesh, places @ mesh.surface_points[mesh.triangles[facets]]))
    found = np.einsum("cq,cqk->ck", pressure * weights, _products(places))
    sums = [np.bincount(facets, column, len(mesh.triangles)) for column in found.T]
    return np.stack(sums, axis=1)


def _products(barycentric: Array) -> Array:
    """(..., 6) of barycentric coordinates (..., 3)."""
    return np.stack([barycentric[..., a] * barycentric[..., b] for a, b in _PRODUCTS], axis=-1)


def _quarters(cells: Array) -> Array:
    """(4 C, 3, 3) of cells (C, 3, 3), by the middles of their edges."""
    a, b, c = cells[:, 0], cells[:, 1], cells[:, 2]
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(part, axis=1) for part in parts], axis=1).reshape(-1, 3, 3)
