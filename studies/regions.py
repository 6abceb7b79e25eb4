"""Regions of a surface: the nodes that they select, and the profile coordinate of the round ones."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .config import Region
from .mesh import Array, Mask, Mesh, MeshError

_AXES = {"x": 0, "y": 1, "z": 2}
_TOLERANCE = 1e-9  # of the body's size: nodes on the border of a region belong to it


def select(region: Region | str, mesh: Mesh, named: Mapping[str, Region]) -> Mask:
    """(N,) mask of the surface nodes in a region, which may be the name of one of the study's.

    Raises
    ------
    MeshError
        the mesh has no group of the wanted name.
    """
    if isinstance(region, str):
        return select(named[region], mesh, named)
    points = mesh.surface_points
    margin = _TOLERANCE * float(np.ptp(points, axis=0).max())
    if region.below is not None or region.above is not None:
        half_space = region.below or region.above
        coordinate = points[:, _AXES[half_space.axis]]
        level = half_space.value
        if level is None:
            level = coordinate.min() + half_space.fraction * np.ptp(coordinate)
        return coordinate <= level + margin if region.below is not None else coordinate >= level - margin
    if region.ball is not None or region.cap is not None:
        return profile_coordinate(region, mesh, points) <= 1 + _TOLERANCE
    if region.box is not None:
        low, high = np.array(region.box.min), np.array(region.box.max)
        return ((points >= low - margin) & (points <= high + margin)).all(axis=1)
    if region.group is not None:
        if region.group not in mesh.groups:
            known = ", ".join(sorted(mesh.groups)) or "none"
            raise MeshError(f"the mesh has no group {region.group!r}; it has: {known}")
        return mesh.groups[region.group]
    if region.all_of is not None:
        return np.all([select(part, mesh, named) for part in region.all_of], axis=0)
    if region.any_of is not None:
        return np.any([select(part, mesh, named) for part in region.any_of], axis=0)
    return ~select(region.not_of, mesh, named)


def profile_coordinate(region: Region, mesh: Mesh, points: Array) -> Array:
    """Distance (...,) of points (..., 3) from the middle of a cap or ball, 1 at its rim.

    In a cap: the angle seen from the body's centroid over the cap's; in a ball: the distance over its radius.
    """
    if region.ball is not None:
        return np.linalg.norm(points - np.array(region.ball.center), axis=-1) / region.ball.radius
    offset = points - _centroid(mesh)
    direction = np.array(region.cap.direction) / np.linalg.norm(region.cap.direction)
    along = offset @ direction
    across = np.linalg.norm(offset - along[..., None] * direction, axis=-1)
    return np.arctan2(across, along) / region.cap.angle


def _centroid(mesh: Mesh) -> Array:
    """Centre of the enclosed volume, by the divergence theorem: (3,) [m]."""
    points = mesh.surface_points
    origin = points.mean(axis=0)
    a, b, c = (points[mesh.triangles[:, k]] - origin for k in range(3))
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    return origin + np.einsum("i,ij->j", volumes, a + b + c) / (4.0 * volumes.sum())
