"""A study's coordinates and those of its mesh: they differ where the study measures from the body's middle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from solver_common.arrays import Array

from ..body.mesh import Mesh
from ..study.kinds import Vector3
from ..study.measured import Measured
from ..study.schema import HalfSpace, Region, Study

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
