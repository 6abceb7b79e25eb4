"""Regions of a surface: the nodes that they select, in the coordinates of the study and in those of its mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from solver_common.arrays import Array, Mask

from ..body.mesh import Mesh
from ..study.errors import MeshError
from ..study.kinds import Vector3
from ..study.measured import Measured
from ..study.schema import HalfSpace, Region, Study

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


# --- A study's coordinates and those of its mesh: they differ where the study measures from the body's middle ---


AXES = {"x": 0, "y": 1, "z": 2}


def origin(study: Study, centre: Sequence[float]) -> Array:
    """Where the study's coordinates are measured from, (3,) [m], in those of a mesh with this centre (3,) [m]."""
    return np.array(centre) if study.geometry.coordinates == "centred" else np.zeros(3)


def in_mesh_coordinates(study: Study, mesh: Mesh) -> dict[str, Region]:
    """The study's regions in the coordinates of a mesh."""
    by = tuple(origin(study, mesh.centre).tolist())
    return {name: _moved(region, by) if any(by) else region for name, region in study.regions.items()}


def measured_on(study: Study, mesh: Mesh) -> list[Measured]:
    """The study's measured tables in the coordinates of a mesh."""
    by = tuple(origin(study, mesh.centre).tolist())
    return [_measured(table, by) if any(by) else table for table in study.measured or ()]


def _measured(table: Measured, by: tuple[float, ...]) -> Measured:
    points = []
    for point in table.points:
        x, y, z = shifted((point.x, point.y, point.z), by)
        points.append(point.model_copy(update={"x": x, "y": y, "z": z}))
    surface = tuple(shifted(place, by) for place in table.surface)
    return table.model_copy(update={"points": tuple(points), "surface": surface})


def shifted(place: Vector3, by: tuple[float, ...]) -> Vector3:
    """A place moved by (3,) [m]."""
    x, y, z = (a + b for a, b in zip(place, by, strict=True))
    return x, y, z


def _moved(region: Region, by: tuple[float, ...]) -> Region:
    def part(ref: Region | str) -> Region | str:
        return ref if isinstance(ref, str) else _moved(ref, by)

    new: dict[str, Any] = {}
    for key in ("below", "above"):
        plane: HalfSpace | None = getattr(region, key)
        if plane is not None and plane.value is not None:
            new[key] = plane.model_copy(update={"value": plane.value + by[AXES[plane.axis]]})
    if region.ball is not None:
        new["ball"] = region.ball.model_copy(update={"center": shifted(region.ball.center, by)})
    if region.box is not None:
        corners = {"min": shifted(region.box.min, by), "max": shifted(region.box.max, by)}
        new["box"] = region.box.model_copy(update=corners)
    for key in ("all_of", "any_of"):
        if (parts := getattr(region, key)) is not None:
            new[key] = tuple(map(part, parts))
    if region.not_of is not None:
        new["not_of"] = part(region.not_of)
    return region.model_copy(update=new) if new else region
