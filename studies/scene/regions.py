"""Regions of a surface: their nodes on a mesh."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from solver_common.arrays import Array, Mask

from ..body.mesh import Mesh
from ..study.errors import InputError
from ..study.schema import Ball, Cap, HalfSpace, Places, Region

AXES = {"x": 0, "y": 1, "z": 2}
_TOLERANCE = 1e-9  # of the body's size: nodes on a region's border belong to it


class SceneError(InputError):
    """A scene that does not fit its mesh; the message names the part and the remedy."""


def select(region: Region, mesh: Mesh) -> Mask:
    """(N,) mask of the surface nodes for which all keys of a region hold.

    Raises
    ------
    SceneError
        the mesh has no group of the wanted name.
    """
    found = holds(region, mesh, mesh.surface_points)
    if region.cavity is not None or region.group is None:
        found &= mesh.in_cavity if region.cavity else ~mesh.in_cavity
    return found & in_group(region.group, mesh.groups) if region.group is not None else found


def holds(part: Places, mesh: Mesh, points: Array) -> Mask:
    """(n,) which points (n, 3) satisfy all keys of a region or an inclusion, except its group."""
    found = np.ones(len(points), dtype=bool)
    if part.below is not None:
        found &= _beyond(part.below, mesh, points, sign=-1.0)
    if part.above is not None:
        found &= _beyond(part.above, mesh, points, sign=1.0)
    if part.box is not None:
        low, high = np.array(part.box.min) - _margin(mesh), np.array(part.box.max) + _margin(mesh)
        found &= np.all((points >= low) & (points <= high), axis=1)
    if part.ball is not None:
        found &= _from_ball(part.ball, points) <= 1 + _TOLERANCE
    if part.cap is not None:
        found &= _from_cap(part.cap, mesh, points) <= 1 + _TOLERANCE
    return found


def in_group(name: str, groups: Mapping[str, Mask], *place: str | int) -> Mask:
    """The mask of a named group of a mesh file; `place` is the place in the study for errors. Raises SceneError."""
    if name not in groups:
        known = ", ".join(sorted(groups)) or "none"
        raise SceneError(f"the mesh has no group {name!r}; it has: {known}", *place)
    return groups[name]


def body_extent(mesh: Mesh) -> str:
    """The body's extent, for messages on places outside it."""
    low, high = mesh.surface_points.min(axis=0), mesh.surface_points.max(axis=0)
    extent = ", ".join(f"{a} from {p:.3g} to {q:.3g}" for a, p, q in zip("xyz", low, high, strict=True))
    return f"the body has {extent} m; a mixed-up unit? A bare number is in metres"


def _beyond(plane: HalfSpace, mesh: Mesh, points: Array, sign: float) -> Mask:
    """Points above (sign 1) or below (-1) a plane, those on it included."""
    axis, level = AXES[plane.axis], plane.value
    if level is None:
        coordinate = mesh.surface_points[:, axis]
        level = float(coordinate.min() + (plane.fraction or 0.0) * np.ptp(coordinate))
    return sign * (points[:, axis] - level) >= -_margin(mesh)


def _margin(mesh: Mesh) -> float:
    return _TOLERANCE * float(np.ptp(mesh.surface_points, axis=0).max())


def profile_coordinate(region: Region, mesh: Mesh, points: Array) -> Array:
    """(...,) distance of points (..., 3) from the middle of a cap or ball, 1 at its rim.

    In a cap: the angle seen from the body's centroid over the cap's angle. In a ball: the distance over the radius.
    """
    if region.ball is not None:
        return _from_ball(region.ball, points)
    assert region.cap is not None  # a study refuses profiles on other regions
    return _from_cap(region.cap, mesh, points)


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
    assert region.cap is not None
    distance = _length(points - _centroid(mesh))
    return np.asarray(1.0 / (region.cap.angle * np.maximum(distance, _margin(mesh))))


def _length(vectors: Array) -> Array:
    """(...,) lengths of vectors (..., 3); several times faster than `np.linalg.norm` for many short ones."""
    return np.asarray(np.sqrt(np.einsum("...k,...k->...", vectors, vectors)))


def _centroid(mesh: Mesh) -> Array:
    """Centre of the enclosed volume, by the divergence theorem: (3,) [m]."""
    points = mesh.surface_points
    origin = points.mean(axis=0)
    a, b, c = (points[mesh.triangles[:, k]] - origin for k in range(3))
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    return origin + np.einsum("i,ij->j", volumes, a + b + c) / (4.0 * volumes.sum())
