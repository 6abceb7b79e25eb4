"""Regions of a surface: the nodes that they select on a mesh in the coordinates of its study."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from solver_common.arrays import Array, Mask

from ..body.mesh import Mesh
from ..study.errors import MeshError
from ..study.schema import HalfSpace, Region, Study

AXES = {"x": 0, "y": 1, "z": 2}
_TOLERANCE = 1e-9  # of the body's size: nodes on the border of a region belong to it


def of_study(mesh: Mesh, study: Study) -> Mesh:
    """A mesh in the coordinates of a study: those of its file, or from the middle of the file's bounding box."""
    return mesh.about_centre if study.geometry.coordinates == "centred" else mesh


def select(region: Region | str, mesh: Mesh, named: Mapping[str, Region]) -> Mask:
    """(N,) mask of the surface nodes in a region, which may be the name of one of the study's.

    Raises
    ------
    MeshError
        the mesh has no group of the wanted name.
    """
    if isinstance(region, str):
        return select(named[region], mesh, named)
    found = _selected(region, mesh, named)
    if region.all_of is None and region.any_of is None and region.group is None:
        found = found & (mesh.in_cavity if region.cavity else ~mesh.in_cavity)
    return found


def _selected(region: Region, mesh: Mesh, named: Mapping[str, Region]) -> Mask:
    """The same on all of the surface."""
    if region.below is not None:
        return _beyond(region.below, mesh, sign=-1.0)
    if region.above is not None:
        return _beyond(region.above, mesh, sign=1.0)
    if region.box is not None:
        points, margin = mesh.surface_points, _margin(mesh)
        low, high = np.array(region.box.min), np.array(region.box.max)
        return np.all((points >= low - margin) & (points <= high + margin), axis=1)
    if region.group is not None:
        if region.group not in mesh.groups:
            known = ", ".join(sorted(mesh.groups)) or "none"
            raise MeshError(f"the mesh has no group {region.group!r}; it has: {known}")
        return mesh.groups[region.group]
    if region.all_of is not None:
        return np.logical_and.reduce([select(part, mesh, named) for part in region.all_of])
    if region.any_of is not None:
        return np.logical_or.reduce([select(part, mesh, named) for part in region.any_of])
    if region.not_of is not None:
        return ~select(region.not_of, mesh, named)
    if region.ball is None and region.cap is None:  # the walls of cavities, or the outer surface, whole
        return np.ones(len(mesh.surface_nodes), dtype=bool)
    return profile_coordinate(region, mesh, mesh.surface_points) <= 1 + _TOLERANCE


def lies_outside(region: Region, low: Array, high: Array) -> bool:
    """Whether a half-space, box or ball does not meet the body's bounding box, (3,) and (3,); of others False."""
    if region.below is not None and region.below.value is not None:
        return bool(region.below.value < low[AXES[region.below.axis]])
    if region.above is not None and region.above.value is not None:
        return bool(region.above.value > high[AXES[region.above.axis]])
    if region.box is not None:
        return bool(np.any(np.array(region.box.min) > high) or np.any(np.array(region.box.max) < low))
    if region.ball is not None:
        center = np.array(region.ball.center)
        return bool(np.linalg.norm(center - np.clip(center, low, high)) > region.ball.radius)
    return False


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
        return _length(points - np.array(region.ball.center)) / region.ball.radius
    if region.cap is None:
        raise MeshError("only a cap or a ball has a middle; give the contact such a region")
    offset = points - _centroid(mesh)
    direction = np.array(region.cap.direction) / np.linalg.norm(region.cap.direction)
    along = offset @ direction
    across = _length(offset - along[..., None] * direction)
    return np.arctan2(across, along) / region.cap.angle


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
