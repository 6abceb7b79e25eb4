"""Shapes of bodies. One more is a `register(BodyShape(...))`, here or in a file `shape_NAME.py`.

Its keys of [geometry], their checks, the estimate of its mesh, its content key and its mesh follow from that.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import MeshError
from .registry import load_all

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


Extents = tuple[float, float, float]
VOLUME_SUFFIXES = (".msh", ".vtu", ".vtk")
CAVITIES = "what its cavities hold: nothing, or an incompressible fluid that keeps the volume of each"
FILE = "file"  # the shape that is read, and has no declaration


@dataclass(frozen=True)
class Geometry:
    """A shape with resolved parameters, in SI units; all but files are centred on the origin.

    Attributes
    ----------
    shape : a name in `SHAPES`, or "file"
    mesh_size : edge length wanted [m]; a file with tetrahedra keeps its own
    parameters : those that the shape declares, lengths in m. file: path, and at most one of size (largest extent
        after scaling) and scale (factor from the file's unit to m, 1 by default). any: slivers, perturbation, seed
        of `vdmbench.body.distort`.
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

    def choice(self, name: str) -> str:
        """A parameter that is one of several words, its default where it is left out."""
        return str(self.parameters.get(name, SHAPES[self.shape].parameters[name].choices[0]))

    def scaled(self, factor: float, *names: str) -> Geometry:
        """With these lengths times a factor, all of its shape's where none is named."""
        lengths = names or [name for name, about in SHAPES[self.shape].parameters.items() if about.is_length]
        parameters = {name: tuple(factor * number for number in self.numbers(name)) for name in lengths}
        return replace(self, parameters={**self.parameters, **parameters})

    @property
    def path(self) -> Path:
        """The file of shape `file`."""
        return Path(str(self.parameters["path"]))

    @property
    def has_own_tetrahedra(self) -> bool:
        """Whether the shape is a file with tetrahedra, which `mesh_size` does not touch."""
        return self.shape == FILE and self.path.suffix.lower() in VOLUME_SUFFIXES


@dataclass(frozen=True)
class ShapeKey:
    """A key of [geometry] that a shape takes: 1 or 3 positive lengths or numbers, or one of several words.

    Attributes
    ----------
    help : what it is
    count : how many numbers
    unit : "m", or "1" of a plain number
    choices : the words, the default first; without it the key is needed
    """

    help: str
    count: int = 1
    unit: str = "m"
    choices: tuple[str, ...] = ()

    @property
    def is_length(self) -> bool:
        """Whether it scales with the body."""
        return self.unit == "m" and not self.choices


@dataclass(frozen=True, kw_only=True)
class BodyShape:
    """A shape of the registry, centred on the origin.

    Attributes
    ----------
    name : what a study writes
    version : raised whenever its meshes change; part of their keys
    parameters : its keys of [geometry] besides mesh_size
    extents : along x, y and z [m]
    area_and_volume : [m^2], [m^3], within some percent: the size of a mesh is told from them
    add : adds it to `gmsh.model.occ`, with lengths in units of the mesher's
    of_sphere : points (n, 3) of its surface for points of the unit sphere, one to one, of any size and place
    """

    name: str
    version: str
    parameters: Mapping[str, ShapeKey]
    extents: Callable[[Geometry], Extents]
    area_and_volume: Callable[[Geometry], tuple[float, float]]
    add: Callable[[Any, Geometry], None] | None = None
    of_sphere: Callable[[Array], Array] | None = None

    @property
    def needed(self) -> set[str]:
        """The keys that it cannot do without, mesh_size apart."""
        return {name for name, about in self.parameters.items() if not about.choices}


SHAPES: dict[str, BodyShape] = {}


def register(shape: BodyShape) -> None:
    """Add a shape.

    Raises
    ------
    ValueError
        a name that is taken, a key that another shape declares otherwise, or not one way to make it.
    """
    if shape.name in (FILE, *SHAPES):
        raise ValueError(f"a shape {shape.name!r} is registered already")
    if not shape.version or (shape.add is None) == (shape.of_sphere is None):
        raise ValueError(f"{shape.name}: a shape declares its version and either add or of_sphere")
    for name, about in shape.parameters.items():
        others = [known.parameters[name] for known in SHAPES.values() if name in known.parameters]
        if any((about.unit, about.choices) != (other.unit, other.choices) for other in others):
            raise ValueError(f"{shape.name}: {name} is declared already, as something else")
    SHAPES[shape.name] = shape


def shape_names() -> tuple[str, ...]:
    """Every name that a study can write."""
    return (*SHAPES, FILE)


# --- the solids ---


def _solid(name: str, parameters: Mapping[str, ShapeKey], **functions: Any) -> None:
    register(BodyShape(name=name, version="1", parameters=parameters, **functions))


def _add_ball(occ: Any, body: Geometry) -> None:
    ball = occ.addSphere(0.0, 0.0, 0.0, 0.5)
    occ.dilate([(3, ball)], 0.0, 0.0, 0.0, *SHAPES[body.shape].extents(body))


def _ellipsoid_extents(body: Geometry) -> Extents:
    a, b, c = (2 * semi_axis for semi_axis in body.numbers("semi_axes"))
    return a, b, c


def _ball_area_and_volume(body: Geometry) -> tuple[float, float]:
    """The area is Thomsen's formula (p = 1.6075), within 1.1 % of an ellipsoid's."""
    a, b, c = SHAPES[body.shape].extents(body)
    p = 1.6075
    mean = ((a * b) ** p + (b * c) ** p + (c * a) ** p) / 3
    return math.pi * mean ** (1 / p), math.pi / 6 * a * b * c


_solid(
    "sphere",
    {"radius": ShapeKey("radius")},
    extents=lambda body: (2 * body.number("radius"),) * 3,
    area_and_volume=_ball_area_and_volume,
    add=_add_ball,
)
_solid(
    "ellipsoid",
    {"semi_axes": ShapeKey("half of its extents along x, y, z", count=3)},
    extents=_ellipsoid_extents,
    area_and_volume=_ball_area_and_volume,
    add=_add_ball,
)


def _hollow_extents(body: Geometry) -> Extents:
    radius, cavity = body.number("radius"), body.number("cavity_radius")
    if not cavity < radius:
        raise MeshError(
            f"the cavity must be smaller than the ball: {cavity:g} m in {radius:g} m", "cavity_radius"
        )
    return (2 * radius,) * 3


def _hollow_area_and_volume(body: Geometry) -> tuple[float, float]:
    radius, cavity = body.number("radius"), body.number("cavity_radius")
    return 4 * math.pi * (radius**2 + cavity**2), 4 / 3 * math.pi * (radius**3 - cavity**3)


def _add_hollow_ball(occ: Any, body: Geometry) -> None:
    whole, cavity = (occ.addSphere(0.0, 0.0, 0.0, body.number(name)) for name in ("radius", "cavity_radius"))
    occ.cut([(3, whole)], [(3, cavity)])


_solid(
    "hollow-sphere",
    {
        "radius": ShapeKey("radius"),
        "cavity_radius": ShapeKey("radius of the ball in its middle that is left out"),
        "cavities": ShapeKey(CAVITIES, choices=("empty", "fluid")),
    },
    extents=_hollow_extents,
    area_and_volume=_hollow_area_and_volume,
    add=_add_hollow_ball,
)


def _box_extents(body: Geometry) -> Extents:
    a, b, c = body.numbers("size")
    return a, b, c


def _box_area_and_volume(body: Geometry) -> tuple[float, float]:
    a, b, c = _box_extents(body)
    return 2 * (a * b + b * c + c * a), a * b * c


def _add_box(occ: Any, body: Geometry) -> None:
    size = _box_extents(body)
    occ.addBox(*(-0.5 * length for length in size), *size)


_solid(
    "box",
    {"size": ShapeKey("its extents along x, y, z", count=3)},
    extents=_box_extents,
    area_and_volume=_box_area_and_volume,
    add=_add_box,
)


def _along(body: Geometry, length: float, across: float) -> Extents:
    """The length along a cylinder's axis, and something else along the two others."""
    a, b, c = (length if name == body.choice("axis") else across for name in "xyz")
    return a, b, c


def _cylinder_area_and_volume(body: Geometry) -> tuple[float, float]:
    radius, length = body.number("radius"), body.number("length")
    return 2 * math.pi * radius * (radius + length), math.pi * radius**2 * length


def _add_cylinder(occ: Any, body: Geometry) -> None:
    length = _along(body, body.number("length"), 0.0)
    occ.addCylinder(*(-0.5 * part for part in length), *length, body.number("radius"))


_solid(
    "cylinder",
    {
        "radius": ShapeKey("radius"),
        "length": ShapeKey("length"),
        "axis": ShapeKey("its axis, z where left out", choices=("z", "x", "y")),
    },
    extents=lambda body: _along(body, body.number("length"), 2 * body.number("radius")),
    area_and_volume=_cylinder_area_and_volume,
    add=_add_cylinder,
)


# --- What is to be meshed, as plain values: checks, size estimate and content key. Imports no mesher ---


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


# --- A liver-like body as a smooth image of the unit sphere: thick right lobe, thin left lobe, hollow underside ---


_FULLNESS = 2.3
# extents, area and volume for size 1, measured on its finest surface
_EXTENTS = (1.0, 0.606, 0.586)
_AREA, _VOLUME = 1.5155, 0.14533


def liver_points(sphere: Array) -> Array:
    """Points (n, 3) of the organ for points of the unit sphere; half its width is about 1.

    x runs from the right lobe (negative) to the left, y from front to back, z upward. The numbers are chosen
    by eye, so that for each x the depth, and for each x and y the height, grows with the sphere's own: the
    map is one to one and the body cannot meet itself.
    """
    import numpy as np  # slow to load: not where a study is only checked

    # Fuller than a sphere: with the exponent 2 the lobes would be pointed.
    x, v, w = (sphere / (np.abs(sphere) ** _FULLNESS).sum(axis=1, keepdims=True) ** (1.0 / _FULLNESS)).T
    left = _smooth_step(x, -0.35, 0.95)  # 0 in the right lobe, 1 at the tip of the left
    # Depth: the right lobe is deep, the left one lies towards the front.
    y = (0.62 - 0.24 * left) * v - 0.12 * left
    # Thickness: from lobe to lobe, and a wedge from the blunt back to the thinner front edge.
    wedge = 1.0 + 0.30 * np.tanh(1.5 * y)
    half_height = (0.60 - 0.36 * left) * wedge
    # The top is a dome nearly level from lobe to lobe, so the lower edge rises to the left.
    middle = 0.30 * left - 0.10 * (x + 0.3) ** 2 - 0.12 * y**2
    # Underside: a broad hollow towards the left, and a furrow between the lobes; they fade towards the top.
    below = 0.5 * (1.0 - w)
    hollow = 0.34 * np.exp(-(((x - 0.15) / 0.42) ** 2) - ((y - 0.05) / 0.36) ** 2)
    furrow = 0.12 * np.exp(-(((x - 0.22) / 0.12) ** 2) - ((y + 0.35) / 0.30) ** 2)
    z = middle + half_height * w + (hollow + furrow) * below
    return np.stack([x, y, z], axis=1)


def _smooth_step(x: Array, start: float, end: float) -> Array:
    """From 0 at `start` to 1 at `end`, with level ends (a cubic)."""
    import numpy as np

    t = np.clip((x - start) / (end - start), 0.0, 1.0)
    step: Array = t * t * (3.0 - 2.0 * t)
    return step


def _extents(body: Geometry) -> tuple[float, float, float]:
    a, b, c = (share * body.number("size") for share in _EXTENTS)
    return a, b, c


register(
    BodyShape(
        name="organ",
        version="1",
        parameters={"size": ShapeKey("its largest extent")},
        extents=_extents,
        area_and_volume=lambda body: (_AREA * body.number("size") ** 2, _VOLUME * body.number("size") ** 3),
        of_sphere=liver_points,
    )
)

load_all("vdmbench.study", "shape_")  # last: they use what is above
