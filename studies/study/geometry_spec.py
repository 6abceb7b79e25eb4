"""What is to be meshed, as plain values: checks, size estimate and content key. Imports no mesher."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from ..machine.errors import MeshError

MESHER_VERSION = "2"  # raise it with every change that alters a mesh

SHAPES = ("sphere", "ellipsoid", "box", "cylinder", "organ", "file")
SURFACE_SUFFIXES = (".stl", ".obj", ".ply", ".vtp")
VOLUME_SUFFIXES = (".msh", ".vtu", ".vtk")

SMALLEST_EXTENT = 1e-3  # m; outside these two a length in the wrong unit is far likelier than such an organ
MAX_NODES = 2_000_000  # of a mesh
LARGEST_EXTENT = 10.0  # m

# The organ's extents, area and volume for size 1, measured on its finest surface.
_ORGAN_EXTENTS = (1.0, 0.606, 0.586)
_ORGAN_AREA = 1.5155
_ORGAN_VOLUME = 0.14533

_REQUIRED: dict[str, dict[str, int]] = {  # shape -> parameter -> how many numbers
    "sphere": {"radius": 1},
    "ellipsoid": {"semi_axes": 3},
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "organ": {"size": 1},
    "file": {},
}
DISTORTIONS = ("slivers", "perturbation", "seed")  # what any shape may have, see `vdmbench.body.distort`
LEAST_SLIVERS, MOST_PERTURBATION = 2.0, 0.5
_OPTIONAL: dict[str, tuple[str, ...]] = {"cylinder": ("axis",), "file": ("path", "size", "scale")}


@dataclass(frozen=True)
class Geometry:
    """A shape with resolved parameters, in SI units; all but files are centred on the origin.

    Attributes
    ----------
    shape : one of `SHAPES`
    mesh_size : edge length wanted [m]; a file with tetrahedra keeps its own
    parameters : by shape, lengths in m.
        sphere: radius. ellipsoid: semi_axes (3). box: size (3). cylinder: radius, length,
        axis "x", "y" or "z" (the default). organ: size, the largest extent. file: path, and at most one
        of size (largest extent after scaling) and scale (factor from the file's unit to m, 1 by default).
        any: slivers, perturbation and seed of `vdmbench.body.distort`.
    """

    shape: str
    mesh_size: float
    parameters: Mapping[str, float | tuple[float, ...] | str]

    def number(self, name: str) -> float:
        """A parameter that is one number."""
        return self.numbers(name)[0]

    def numbers(self, name: str) -> tuple[float, ...]:
        """A parameter as a tuple of numbers."""
        value = self.parameters[name]
        if isinstance(value, str):
            raise MeshError(f"{self.shape}: {name} must be a number, not {value!r}", name)
        values = value if isinstance(value, tuple | list) else (value,)
        return tuple(float(v) for v in values)

    @property
    def path(self) -> Path:
        """The file of shape `file`."""
        return Path(str(self.parameters["path"]))

    @property
    def has_own_tetrahedra(self) -> bool:
        """Whether the shape is a file with tetrahedra, which `mesh_size` does not touch."""
        return self.shape == "file" and self.path.suffix.lower() in VOLUME_SUFFIXES


def check_geometry(geometry: Geometry) -> None:
    """Raise MeshError for an unknown shape or parameter, a missing one, or a value out of range."""
    shape = geometry.shape
    if shape not in SHAPES:
        raise MeshError(f"unknown shape {shape!r}; choose one of {', '.join(SHAPES)}")
    required = _REQUIRED[shape]
    allowed = {*required, *_OPTIONAL.get(shape, ()), *DISTORTIONS}
    missing = sorted(set(required) - set(geometry.parameters))
    if shape == "file" and "path" not in geometry.parameters:
        missing = ["path"]
    if missing:
        raise MeshError(f"{shape}: {missing[0]} is missing", missing[0])
    unknown = sorted(set(geometry.parameters) - allowed)
    if unknown:
        told = f"{shape}: unknown parameter {unknown[0]!r}; it takes {', '.join(sorted(allowed))}"
        raise MeshError(told, unknown[0])
    for name in sorted(set(geometry.parameters) - {"path", "axis"}):
        wanted = required.get(name, 1)
        values = geometry.numbers(name)
        if len(values) != wanted:
            raise MeshError(f"{shape}: {name} must have {wanted} numbers, not {len(values)}", name)
        if name != "seed" and not all(math.isfinite(v) and v > 0 for v in values):
            raise MeshError(f"{shape}: {name} must be positive and finite", name)
    if geometry.parameters.get("axis", "z") not in ("x", "y", "z"):
        raise MeshError(f"cylinder: axis must be x, y or z, not {geometry.parameters['axis']!r}", "axis")
    if shape == "file":
        _check_file_parameters(geometry)
    else:
        extent = max(extents(geometry))
        remedy = f'lengths are in metres, so write "{extent:g} mm" if millimetres are meant'
        check_extent(extent, remedy, extent_key(geometry))
    if not geometry.has_own_tetrahedra:
        if not (math.isfinite(geometry.mesh_size) and geometry.mesh_size > 0):
            raise MeshError("mesh_size must be positive and finite", "mesh_size")
        if shape != "file":
            check_mesh_size(geometry.mesh_size, min(extents(geometry)))


def _check_file_parameters(geometry: Geometry) -> None:
    suffix = geometry.path.suffix.lower()
    if suffix == ".geo":
        raise MeshError(
            f"{geometry.path.name}: .geo files are scripts and are not run; mesh it and give the .msh"
        )
    if suffix not in SURFACE_SUFFIXES + VOLUME_SUFFIXES:
        raise MeshError(
            f"{geometry.path.name}: unknown kind of file; give a surface ({', '.join(SURFACE_SUFFIXES)}) "
            f"or tetrahedra ({', '.join(VOLUME_SUFFIXES)})"
        )
    if "size" in geometry.parameters and "scale" in geometry.parameters:
        raise MeshError("file: give size or scale, not both", "scale")


def extents(geometry: Geometry) -> tuple[float, float, float]:
    """Extents along x, y and z [m] of a shape that is not a file."""
    if geometry.shape == "box":
        a, b, c = geometry.numbers("size")
    elif geometry.shape == "ellipsoid":
        a, b, c = (2 * semi_axis for semi_axis in geometry.numbers("semi_axes"))
    elif geometry.shape == "cylinder":
        along = "xyz".index(str(geometry.parameters.get("axis", "z")))
        diameter, length = 2 * geometry.number("radius"), geometry.number("length")
        a, b, c = (length if k == along else diameter for k in range(3))
    elif geometry.shape == "organ":
        a, b, c = (share * geometry.number("size") for share in _ORGAN_EXTENTS)
    else:
        a = b = c = 2 * geometry.number("radius")
    return a, b, c


def extent_key(geometry: Geometry) -> str:
    """The key that decides the largest extent of a shape that is not a file."""
    if geometry.shape == "cylinder" and geometry.number("length") > 2 * geometry.number("radius"):
        return "length"
    return next(iter(_REQUIRED[geometry.shape]))


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
    """Surface area [m^2] and volume [m^3] of a shape that is not a file.

    The ellipsoid's area is Thomsen's formula (p = 1.6075), within 1.1 %.
    """
    a, b, c = extents(geometry)
    if geometry.shape == "organ":
        return _ORGAN_AREA * a**2, _ORGAN_VOLUME * a**3
    if geometry.shape == "box":
        return 2 * (a * b + b * c + c * a), a * b * c
    if geometry.shape == "cylinder":
        radius, length = geometry.number("radius"), geometry.number("length")
        return 2 * math.pi * radius * (radius + length), math.pi * radius**2 * length
    p = 1.6075
    mean = ((a * b) ** p + (b * c) ** p + (c * a) ** p) / 3
    return math.pi * mean ** (1 / p), math.pi / 6 * a * b * c


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
    area: float, volume: float, mesh_size: float, max_nodes: int, remedy: str = "use a larger mesh_size"
) -> None:
    """Raise MeshError where the estimated number of nodes exceeds `max_nodes`."""
    nodes = estimated_nodes(area, volume, mesh_size)
    if nodes > max_nodes:
        raise MeshError(
            f"mesh_size {mesh_size:g} m would give about {nodes:.2g} nodes, more than the {max_nodes} allowed; "
            f"{remedy}",
            "mesh_size",
        )


def fewer_nodes(geometry: Geometry, extent: float) -> str:
    """What to do about a mesh with too many nodes of a body this long [m], whose unit may be mixed up."""
    given = [key for key in ("size", "scale") if key in geometry.parameters]
    told = "if that is wrong correct " + (given[0] if given else "its lengths")
    if geometry.shape == "file" and not given:
        told = "if the file is not in metres give scale or size"
    last = "coarsen it" if geometry.has_own_tetrahedra else "use a larger mesh_size"
    return f"the body is {extent:.3g} m across: {told}, else {last}"


def geometry_key(geometry: Geometry, *, volume: bool) -> str:
    """SHA-256 (hex) of all that decides the mesh: resolved inputs, the file's bytes and the mesher's versions.

    A file counts by its content and kind, not by its path. Raises MeshError where the file cannot be read.
    """
    check_geometry(geometry)
    inputs: dict[str, object] = {
        name: value if isinstance(value, str) else [v.hex() for v in geometry.numbers(name)]
        for name, value in geometry.parameters.items()
        if name != "path"
    }
    if geometry.shape == "cylinder":
        inputs.setdefault("axis", "z")
    if geometry.shape == "file":
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
    if geometry.shape in ("file", "organ"):
        return ("gmsh", "pyacvd", "vtk")
    return ("gmsh",)


def file_digest(path: Path) -> str:
    """SHA-256 (hex) of a file. Raises MeshError where it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise MeshError(f"{path.name}: cannot be read ({error.strerror})") from error
