"""Smooth contact profiles on flat facets: integrated, so that their resultant belongs to no mesh."""

from __future__ import annotations

import numpy as np

from solver_common.arrays import Array, Index, Mask

from ..body.mesh import Mesh
from ..study.loads import PROFILES
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
    moments = np.zeros((len(mesh.triangles), len(_PRODUCTS)))
    facets = np.arange(len(mesh.triangles))
    corners = mesh.surface_points[mesh.triangles].transpose(
        1, 0, 2
    )  # (3, C, 3) of the cells, at first the facets
    cells = np.broadcast_to(
        np.eye(3)[:, None], corners.shape
    )  # the same in the facet's barycentric coordinates
    share = 1.0  # of a cell in its facet
    while len(facets):
        split, whole = _are_split(region, mesh, corners)
        values = PROFILES[profile](profile_coordinate(region, mesh, _at(rule[0], corners[:, whole])))
        moments += share * _moments(values, cells[:, whole], facets[whole], rule, len(moments))
        facets = np.tile(facets[split], 4)
        corners, cells = _quarters(corners[:, split]), _quarters(cells[:, split])
        share /= 4.0
    barycentric, weights = rule
    return np.asarray(np.linalg.solve(_products(barycentric) * weights, moments.T).T)


def sampled(profile: str, region: Region, mesh: Mesh, barycentric: Array) -> Array:
    """(F, Q) values of the profile at the places (Q, 3) of each facet."""
    corners = mesh.surface_points[mesh.triangles].transpose(1, 0, 2)
    return PROFILES[profile](profile_coordinate(region, mesh, _at(barycentric, corners))).T


def _are_split(region: Region, mesh: Mesh, corners: Array) -> tuple[Mask, Mask]:
    """(C,) cells over which the profile is not smooth enough for the rule, and those over which it is.

    In neither are those that lie beyond the rim.
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
    """(Q, C, 3) places in cells whose corners are (3, C, 3)."""
    return np.asarray(np.tensordot(barycentric, corners, axes=1))


def _moments(values: Array, cells: Array, facets: Index, rule: tuple[Array, Array], count: int) -> Array:
    """(F, 6) integrals of (Q, C) values times the products, over the cells' area, summed by facet."""
    barycentric, weights = rule
    found = np.einsum("qc,kqc->kc", values * weights[:, None], _products(_at(barycentric, cells)))
    return np.stack([np.bincount(facets, row, count) for row in found], axis=1)


def _products(barycentric: Array) -> Array:
    """(6, ...) of barycentric coordinates (..., 3)."""
    return np.stack([barycentric[..., a] * barycentric[..., b] for a, b in _PRODUCTS])


def _quarters(cells: Array) -> Array:
    """(3, 4 C, 3) of cells (3, C, 3), by the middles of their edges."""
    a, b, c = cells
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part) for part in parts], axis=1)
