"""Places of measured points on a mesh: the nearest point of its surface, in barycentric coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_common.arrays import Array, Index

from ..body.mesh import Mesh
from ..body.nearest import nearest_on_surface
from ..study.measured import Measured, MeasuredPoint
from ..study.schema import Study
from .regions import SceneError, body_extent

# of the mean edge: largest distance of a measured point from the surface; flat facets on a round body need less
MOST_OFF = 0.5
_UNITS = 10.0  # a surface this many times larger or smaller than the body has another unit


@dataclass(frozen=True)
class Placed:
    """The P points of one table on a surface of F facets.

    Attributes
    ----------
    facet : (P,) the facet that each is on
    weights : (P, 3) barycentric coordinates in it
    distance : (P,) from the measured place to that point [m]
    """

    facet: Index
    weights: Array
    distance: Array


def place_measured(study: Study, mesh: Mesh) -> list[Placed]:
    """The places of each measured table of a study on a mesh; none for a table with a deformed surface.

    Raises
    ------
    SceneError
        a point off the body, a measured surface in another unit, more points than the mesh has nodes.
    """
    return [_placed(table, k, mesh) for k, table in enumerate(study.measured or ())]


def _placed(table: Measured, number: int, mesh: Mesh) -> Placed:
    points = np.array([(p.x, p.y, p.z) for p in table.points], dtype=float).reshape(-1, 3)
    place = ("measured", number)
    if len(points) > len(mesh.surface_points):
        raise SceneError(
            f"{table.name!r} has {len(points):,} points, the mesh {len(mesh.surface_points):,} surface nodes; "
            "take a smaller mesh_size or fewer points",
            *place,
        )
    if table.surface:
        own = float(np.ptp(np.array(table.surface), axis=0).max())
        body = float(np.ptp(mesh.surface_points, axis=0).max())
        if not body / _UNITS <= own <= body * _UNITS:
            text = f"surface {table.name!r} is {own:.3g} m across, the body {body:.3g} m: a mixed-up unit?"
            raise SceneError(text, *place)
    if not len(points):
        return Placed(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros(0))
    distance, facet, weights = nearest_on_surface(points, mesh.surface_points, mesh.triangles)
    corners = mesh.surface_points[mesh.triangles]
    edge = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean())
    worst = int(distance.argmax())
    if distance[worst] > MOST_OFF * edge:
        raise SceneError(
            f"{_named(table.points[worst], worst)} of {table.name!r} is {distance[worst]:.3g} m off the body, more "
            f"than {MOST_OFF:g} of the mesh's edges ({edge:.3g} m): another origin? {body_extent(mesh)}",
            *place,
        )
    return Placed(facet, weights, distance)


def _named(point: MeasuredPoint, number: int) -> str:
    name = f"point {point.name!r}" if point.name else f"point {number + 1}"
    return f"{name} (line {point.line} of its file)" if point.line else name
