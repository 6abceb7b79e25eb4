"""A rigid indenter on its mesh: where its tip first touches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from solver_common.arrays import Mask

from ..body.mesh import Mesh
from ..body.surface_measures import facet_area_vectors
from ..study.errors import Loc
from ..study.loads import Pushed
from .placed import SceneError

if TYPE_CHECKING:
    from fem_reference.indenter import Indenter

_LEAST = 1e-6  # of a region's area, below which its facets have no mean normal


@dataclass(frozen=True)
class PlacedIndenter:
    """An indenter that touches at depth zero, (F,) facets that it can touch, and its depth at load factor 1 [m]."""

    indenter: Indenter
    facets: Mask
    depth: float


def place_indenter(pushed: Pushed, mesh: Mesh, place: Loc) -> PlacedIndenter:
    """The indenter of a constraint, its axis through the middle of the region's area.

    Raises
    ------
    SceneError
        a region without a mean normal where no push is given, or an indenter that cannot be.
    """
    from fem_reference.indenter import Capsule, FlatPunch, Indenter, Sphere
    from solver_common.solution import SolverError

    triangles = mesh.triangles[pushed.facets]
    vectors = facet_area_vectors(mesh.surface_points, triangles)
    areas = np.linalg.norm(vectors, axis=1)
    direction = -vectors.sum(axis=0) if pushed.direction is None else np.array(pushed.direction)
    if np.linalg.norm(direction) < _LEAST * areas.sum():
        raise SceneError(
            "the region of the indenter faces every way; give push, or a region on one side", place
        )
    middle = areas @ mesh.surface_points[triangles].mean(axis=1) / areas.sum()
    try:
        if pushed.shape == "capsule":
            x, y, z = pushed.along or (0.0, 0.0, 0.0)
            shape: Capsule | FlatPunch | Sphere = Capsule(pushed.radius, pushed.length, (x, y, z))
        else:
            shape = (FlatPunch if pushed.shape == "flat-punch" else Sphere)(pushed.radius)
        there = Indenter(shape, middle, direction)
        gap = there.gap(mesh.surface_points[np.unique(triangles)]).min()
        if not np.isfinite(gap):
            raise SceneError("the indenter passes by all nodes of its region; take a finer mesh", place)
        return PlacedIndenter(
            Indenter(shape, middle + gap * there.axis, direction), pushed.facets, pushed.depth
        )
    except SolverError as error:
        raise SceneError(f"{error.status.message}; {error.status.remedy}", place) from None
