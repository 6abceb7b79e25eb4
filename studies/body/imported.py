"""Bodies from files: read, cleaned, scaled to metres and checked, before anything is meshed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from solver_common.arrays import Array, Index

from ..study.errors import MeshError
from ..study.shapes import (
    MAX_NODES,
    FileBody,
    check_extent,
    check_mesh_size,
    check_node_budget,
    doubted_extent,
    file_digest,
)
from .mesh import Mesh
from .read_apart import clean_of
from .repair import Clean
from .surface_measures import shells
from .topology import mesh_from_tetrahedra, separate_pieces


def imported_surface(geometry: FileBody, *, volume: bool) -> tuple[Clean, Array]:
    """The surface of a file about its centre, and the centre (3,), both in metres, ready to mesh. Raises MeshError.

    Meshing about the centre loses no digits far from the origin.
    """
    clean = _clean(geometry.path, file_digest(geometry.path), geometry.repair or "")
    points, centre, scale = _in_metres(clean.points, geometry)
    size = geometry.mesh_size or 0.0
    extents = np.ptp(points, axis=0)
    doubt = doubted_extent(geometry, float(extents.max()))
    check_mesh_size(size, float(extents.min()), doubt)
    surface = Clean(
        points, clean.cells, {"scale": scale, "imported_points": float(len(points)), **clean.repairs}
    )
    check_node_budget(surface.area, surface.volume if volume else 0.0, size, f"{doubt}use a larger mesh_size")
    _check_cavities(geometry, clean.points, clean.cells)
    return surface, centre


@lru_cache(maxsize=1)
def _clean(path: Path, digest: str, repair: str) -> Clean:  # noqa: ARG001
    """Content of the file with this digest; a study of several mesh sizes asks for it repeatedly."""
    return clean_of(path, repair)


def imported_tetrahedra(geometry: FileBody) -> Mesh:
    """The tetrahedra of a file, used as they are. Raises MeshError."""
    clean = _clean(geometry.path, file_digest(geometry.path), "")
    if len(clean.points) > MAX_NODES:
        raise MeshError(f"has {len(clean.points)} nodes, more than the {MAX_NODES} allowed; coarsen it")
    points, centre, scale = _in_metres(clean.points, geometry)
    repairs = {"scale": scale, **clean.repairs}
    mesh = mesh_from_tetrahedra(points, clean.cells, groups=clean.groups, quality=repairs)
    _check_cavities(geometry, clean.points[mesh.surface_nodes], mesh.triangles)
    return replace(mesh, points=mesh.points + centre)  # at the file's place


def _check_cavities(geometry: FileBody, points: Array, triangles: Index) -> None:
    """Refuse undeclared cavities, and declared ones that are missing; `points` are those of the file."""
    shell = shells(points, triangles)
    if shell.any() and geometry.cavities is None:
        remedy = ', or say what fills those inside: cavities = "empty" or "fluid"'
        raise separate_pieces(points, triangles, shell, remedy)
    if not shell.any() and geometry.cavities is not None:
        raise MeshError("has no cavity, its surface is one closed piece; leave cavities out", "cavities")


@contextmanager
def named(geometry: FileBody) -> Iterator[None]:
    """Prefix errors with the name of the file."""
    try:
        yield
    except MeshError as error:
        told = str(error).removeprefix(f"{geometry.path.name}: ")  # already named if its bytes cannot be read
        raise MeshError(f"{geometry.path.name}: {told}", *error.place) from error


def centred(points: Array, size: float) -> Array:
    """Points scaled to a largest extent `size`, with the centre of their bounding box in the origin."""
    low, high = points.min(axis=0), points.max(axis=0)
    return (points - 0.5 * (low + high)) * (size / float((high - low).max()))


def _in_metres(points: Array, geometry: FileBody) -> tuple[Array, Array, float]:
    """Points of a file about the centre of their bounding box [m], that centre (3,) [m], and metres per unit."""
    extent = float(np.ptp(points, axis=0).max())
    size, factor = geometry.size, 1.0 if geometry.scale is None else geometry.scale
    if size is None:
        size = factor * extent
        check_extent(
            size, "give geometry.size, its largest extent, or geometry.scale, the file's unit in metres"
        )
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0)) * (size / extent)
    return centred(points, size), centre, size / extent
