"""What is to be meshed, as plain values: checks, size estimate and content key. Imports no mesher."""

from __future__ import annotations

import hashlib
import json
import math
from importlib.metadata import version
from pathlib import Path

from .errors import MeshError
from .shapes import FILE, SHAPES
from .shapes import VOLUME_SUFFIXES as VOLUME_SUFFIXES
from .shapes import Geometry as Geometry

MESHER_VERSION = "2"  # raise it with every change that alters a mesh

SURFACE_SUFFIXES = (".stl", ".obj", ".ply", ".vtp")

SMALLEST_EXTENT = 1e-3  # m; outside these two a length in the wrong unit is far likelier than such an organ
MAX_NODES = 2_000_000  # of a mesh
LARGEST_EXTENT = 10.0  # m

DISTORTIONS = ("slivers", "perturbation", "seed")  # what any shape may have, see `vdmbench.body.distort`
LEAST_SLIVERS, MOST_PERTURBATION = 2.0, 0.5


def extents(geometry: Geometry) -> tuple[float, float, float]:
    """Extents along x, y and z [m] of a shape that is not a file."""
    return SHAPES[geometry.shape].extents(geometry)


def extent_key(geometry: Geometry) -> str:
    """The key that decides the largest extent of a shape that is not a file: that which changes it most."""
    lengths = [name for name, about in SHAPES[geometry.shape].parameters.items() if about.is_length]
    return max(lengths, key=lambda name: max(extents(geometry.scaled(1.01, name))))


def check_extent(extent: float, remedy: str, key: str = "") -> None:
    """Raise MeshError about `key`, ending with `remedy`, for a largest extent [m] that no organ has."""
    if not SMALLEST_EXTENT * (1 - 1e-9) <= extent <= LARGEST_EXTENT * (1 + 1e-9):
        raise MeshError(
            f"the largest extent is {extent:.6g} m, which looks like a mixed-up unit; {remedy}", key
        )


def check_mesh_size(mesh_size: float, smallest_extent: float) -> None:
    """Raise MeshError where an edge would be longer than half of the body's smallest extent."""
    if mesh_size > 0.5 * smallest_extent * (1 + 1e-9):
        raise MeshError(
            f"mesh_size {mesh_size:g} m is too large for a body whose smallest extent is {smallest_extent:g} m; "
            f"use at most {0.5 * smallest_extent:g} m",
            "mesh_size",
        )


def area_and_volume(geometry: Geometry) -> tuple[float, float]:
    """Surface area [m^2] and volume [m^3] of a shape that is not a file, see `BodyShape`."""
    return SHAPES[geometry.shape].area_and_volume(geometry)


def estimated_nodes(area: float, volume: float, mesh_size: float) -> float:
    """Nodes of a uniform mesh: those on `area` plus those inside `volume` (0 where only the surface is meshed).

    Equilateral triangles of edge h give area / (h^2 sqrt(3)/2) surface nodes. The number inside is a fit to
    meshes of this module from 400 to 90,000 nodes: gmsh leaves the inside somewhat coarser than the surface.
    """
    on_surface = 2 / math.sqrt(3) * area / mesh_size**2
    return on_surface + max(0.0, 0.6 * volume / mesh_size**3 - 0.37 * area / mesh_size**2)


def expected_size(area: float, volume: float, mesh_size: float) -> tuple[float, float]:
    """Surface nodes and tetrahedra of a uniform mesh; of those none where `volume` is 0.

    A tetrahedral mesh with many nodes has about six cells to a node, on the surface about two.
    """
    on_surface = estimated_nodes(area, 0.0, mesh_size)
    inside = max(0.0, estimated_nodes(area, volume, mesh_size) - on_surface)
    return on_surface, 2.6 * on_surface + 6.5 * inside if volume else 0.0


def check_node_budget(
    area: float, volume: float, mesh_size: float, remedy: str = "use a larger mesh_size"
) -> None:
    """Raise MeshError where the estimated number of nodes exceeds `MAX_NODES`."""
    nodes = estimated_nodes(area, volume, mesh_size)
    if nodes > MAX_NODES:
        raise MeshError(
            f"mesh_size {mesh_size:g} m would give about {nodes:.2g} nodes, more than the {MAX_NODES} allowed; "
            f"{remedy}",
            "mesh_size",
        )


def fewer_nodes(geometry: Geometry, extent: float) -> str:
    """What to do about a mesh with too many nodes of a body this long [m], whose unit may be mixed up."""
    given = [key for key in ("size", "scale") if key in geometry.parameters]
    told = "if that is wrong correct " + (given[0] if given else "its lengths")
    if geometry.shape == FILE and not given:
        told = "if the file is not in metres give scale or size"
    last = "coarsen it" if geometry.has_own_tetrahedra else "use a larger mesh_size"
    return f"the body is {extent:.3g} m across: {told}, else {last}"


def geometry_key(geometry: Geometry, *, volume: bool) -> str:
    """SHA-256 (hex) of all that decides the mesh: resolved inputs, the file's bytes and the mesher's versions.

    A file counts by its content and kind, not by its path. Raises MeshError where the file cannot be read.
    """
    inputs: dict[str, object] = {
        name: value if isinstance(value, str) else [v.hex() for v in geometry.numbers(name)]
        for name, value in geometry.parameters.items()
        if name != "path"
    }
    if geometry.shape != FILE:
        shape = SHAPES[geometry.shape]
        inputs |= {name: geometry.choice(name) for name, about in shape.parameters.items() if about.choices}
        inputs["version"] = shape.version
    else:
        inputs["file"] = file_digest(geometry.path)
        inputs["kind"] = geometry.path.suffix.lower()
        inputs["origin"] = "file"  # until version 0.2 a body was moved to the origin
        if "size" not in inputs:
            inputs.setdefault("scale", [(1.0).hex()])
    if not geometry.has_own_tetrahedra:
        inputs["mesh_size"] = float(geometry.mesh_size).hex()
    described = {
        "shape": geometry.shape,
        "inputs": inputs,
        "volume": volume,
        "mesher": MESHER_VERSION,
        "packages": {name: version(name) for name in _packages(geometry)},
    }
    return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()


def _packages(geometry: Geometry) -> tuple[str, ...]:
    """The distributions whose version can change the mesh."""
    if geometry.has_own_tetrahedra:
        return ("gmsh", "meshio")
    if geometry.shape == FILE or SHAPES[geometry.shape].of_sphere is not None:
        return ("gmsh", "pyacvd", "vtk")
    return ("gmsh",)


def file_digest(path: Path) -> str:
    """SHA-256 (hex) of a file. Raises MeshError where it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise MeshError(f"{path.name}: cannot be read ({error.strerror})") from error
