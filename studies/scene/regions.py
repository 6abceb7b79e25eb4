"""Regions of a surface: the nodes that they select on a mesh."""

from __future__ import annotations

import numpy as np

from solver_common.arrays import Array, Mask

from ..body.mesh import Mesh
from ..study.errors import MeshError
from ..study.schema import Ball, Cap, HalfSpace, Region

AXES = {"x": 0, "y": 1, "z": 2}
_TOLERANCE = 1e-9  # of the body's size: nodes on the border of a region belong to it


def select(region: Region, mesh: Mesh) -> Mask:
    """(N,) mask of the surface nodes for which all keys of a region hold.

    Raises
    ------
    MeshError
        the mesh has no group of the wanted name.
    """
    points = mesh.surface_points
    found = np.ones(len(points), dtype=bool)
    if region.cavity is not None or region.group is None:
        found &= mesh.in_cavity if region.cavity else ~mesh.in_cavity
    if region.below is not None:
        found &= _beyond(region.below, mesh, sign=-1.0)
    if region.above is not None:
        found &= _beyond(region.above, mesh, sign=1.0)
    if region.box is not None:
        low, high = np.array(region.box.min) - _margin(mesh), np.array(region.box.max) + _margin(mesh)
        found &= np.all((points >= low) & (points <= high), axis=1)
    if region.group is not None:
        if region.group not in mesh.groups:
            known = ", ".join(sorted(mesh.groups)) or "none"
            raise MeshError(f"the mesh has no group {region.group!r}; it has: {known}")
        found &= mesh.groups[region.group]
    if region.ball is not None:
        found &= _from_ball(region.ball, points) <= 1 + _TOLERANCE
    if region.cap is not None:
        found &= _from_cap(region.cap, mesh, points) <= 1 + _TOLERANCE
    return found


def lies_outside(region: Region, low: Array, high: Array) -> bool:
    """Whether a half-space, box or ball of a region does not meet the body's bounding box, (3,) and (3,)."""
    below, above, box, ball = region.below, region.above, region.box, region.ball
    return bool(
        (below and below.value is not None and below.value < low[AXES[below.axis]])
        or (above and above.value is not None and above.value > high[AXES[above.axis]])
        or (box and (np.any(np.array(box.min) > high) or np.any(np.array(box.max) < low)))
        or (ball and _from_ball(ball, np.clip(ball.center, low, high)) > 1.0)
    )


def body_extent(low: Array, high: Array) -> str:
    """What to tell beside a region that lies outside."""
    extent = ", ".join(f"{a} from {p:.3g} to {q:.3g}" for a, p, q in zip("xyz", low, high, strict=True))
    return f"the body has {extent} m; a mixed-up unit? A bare number is in metres"


def _beyond(plane: HalfSpace, mesh: Mesh, sign: float) -> Mask:
    """Nodes above (sign 1) or below (-1) a plane, those on it included."""
    coordinate = mesh.surface_points[:, AXES[plane.axis]]
    level = plane.value
    if level is None:
        level = float(coordinate.min() + (plane.fraction or 0.0) * np.ptp(coordinate))
    return sign * (coordinate - level) >= -_margin(mesh)


def _margin(mesh: Mesh) -> float:
    return _TOLERANCE * float(np.ptp(mesh.surface_points, axis=0).max())


def profile_coordinate(region: Region, mesh: Mesh, points: Array) -> Array:
    """Distance (...,) of points (..., 3) from the middle of a cap or ball, 1 at its rim.

    In a cap: the angle seen from the body's centroid over the cap's; in a ball: the distance over its radius.

    Raises
    ------
    MeshError
        another kind of region, which has no middle.
    """
    if region.ball is not None:
        return _from_ball(region.ball, points)
    if region.cap is not None:
        return _from_cap(region.cap, mesh, points)
    raise MeshError("only a cap or a ball has a middle; give the contact such a region")


def _from_ball(ball: Ball, points: Array) -> Array:
    """Distance (...,) of points (..., 3) from the centre over the radius."""
    return _length(points - np.array(ball.center)) / ball.radius


def _from_cap(cap: Cap, mesh: Mesh, points: Array) -> Array:
    """Angle (...,) between points (..., 3) and the axis, seen from the body's centroid, over the cap's."""
    offset = points - _centroid(mesh)
    direction = np.array(cap.direction) / np.linalg.norm(cap.direction)
    along = offset @ direction
    across = _length(offset - along[..., None] * direction)
    return np.arctan2(across, along) / cap.angle


def profile_slope(region: Region, mesh: Mesh, points: Array) -> Array:
    """Largest change (...,) of `profile_coordinate` per length at points (..., 3) [1/m]."""
    if region.ball is not None:
        return np.full(points.shape[:-1], 1.0 / region.ball.radius)
    if region.cap is None:
        raise MeshError("only a cap or a ball has a middle; give the contact such a region")
    distance = _length(points - _centroid(mesh))
    return np.asarray(1.0 / (region.cap.angle * np.maximum(distance, _margin(mesh))))


def _length(vectors: Array) -> Array:
    """(...,) of vectors (..., 3): `np.linalg.norm`, several times as fast for many short ones."""
    return np.asarray(np.sqrt(np.einsum("...k,...k->...", vectors, vectors)))


def _centroid(mesh: Mesh) -> Array:
    """Centre of the enclosed volume, by the divergence theorem: (3,) [m]."""
    points = mesh.surface_points
    origin = points.mean(axis=0)
    a, b, c = (points[mesh.triangles[:, k]] - origin for k in range(3))
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    return origin + np.einsum("i,ij->j", volumes, a + b + c) / (4.0 * volumes.sum())
