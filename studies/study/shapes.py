"""Shapes of bodies: [geometry] as typed tables, one a shape. One more is a class here or in a file `shape_NAME.py`.

Its checks, the estimate of its mesh, its content key and its mesh follow from that.
"""

from __future__ import annotations

import hashlib
import json
import math
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import PlainValidator

from .errors import MeshError
from .kinds import (
    SI,
    Enters,
    Key,
    Length,
    Lengths,
    OneOf,
    Ratio,
    as_path,
    number_check,
    within,
)
from .registry import load_all

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


Extents = tuple[float, float, float]
VOLUME_SUFFIXES = (".msh", ".vtu", ".vtk")
CAVITIES = "what its cavities hold: nothing, or an incompressible fluid that keeps the volume of each"
Slivers = Annotated[float, SI("1"), number_check(lambda v: v >= 2, "must be at least 2")]


class Geometry(OneOf):
    """[geometry]; all shapes but a file are centred on the origin"""

    by = "shape"
    kinds: ClassVar[dict[str, Any]] = {}
    enters = Enters.MESH
    packages: ClassVar[tuple[str, ...]] = ("gmsh",)  # distributions whose version can change the mesh
    has_own_tetrahedra: ClassVar[bool] = False

    shape: str = Key("kind of body")
    mesh_size: Length | None = Key("edge length of the mesh; only a file with tetrahedra does without", None)
    slivers: Slivers | None = Key(
        "any shape: squeeze one facet in twenty-five until its longest edge is so many heights", None
    )
    perturbation: Annotated[Ratio, within(0, 0.5)] | None = Key(
        "any shape: move each node at random by up to this share of its shortest edge", None
    )
    seed: int | None = Key("of the slivers and the perturbation, 0 where left out", None, ge=0, lt=2**32)

    @property
    def parameters(self) -> dict[str, Any]:
        """The keys beside the shape and the mesh size."""
        apart = ("shape", "mesh_size")
        return {key: value for key, value in self.model_dump().items() if key not in apart}


class Shape(Geometry):
    """A shape that is no file."""

    if TYPE_CHECKING:
        mesh_size: float
    else:
        mesh_size: Length = Key(Geometry.model_fields["mesh_size"].description)

    def extents(self) -> Extents:
        """Extents along x, y and z [m]."""
        raise NotImplementedError(f"{self.shape}: a shape has extents")

    def area_and_volume(self) -> tuple[float, float]:
        """Area [m^2] and volume [m^3], within some percent: they give the size of a mesh."""
        raise NotImplementedError(f"{self.shape}: a shape has an area and a volume")

    def extent_key(self) -> str:
        """The key of the largest length."""
        own = {
            key: getattr(self, key) for key in type(self).model_fields.keys() - Geometry.model_fields.keys()
        }
        lengths = {key: value for key, value in own.items() if not isinstance(value, str)}
        return max(
            lengths, key=lambda key: max(lengths[key]) if isinstance(lengths[key], tuple) else lengths[key]
        )


class Solid(Shape):
    """A shape that OpenCASCADE makes."""

    def add(self, occ: Any, unit: float) -> None:
        """Add it to `gmsh.model.occ`, in lengths of `unit` [m]."""
        raise NotImplementedError(f"{self.shape}: a solid is added to a model")


class SphereImage(Shape):
    """A shape that is a smooth image of the unit sphere."""

    packages = ("gmsh", "pyacvd", "vtk")

    def of_sphere(self, sphere: Array) -> Array:
        """Points (n, 3) of its surface for points of the unit sphere, one to one, of any size and position."""
        raise NotImplementedError(f"{self.shape}: an image of the sphere has points")


# --- the solids ---


class _Ball(Solid):
    def area_and_volume(self) -> tuple[float, float]:
        """The area is Thomsen's formula (p = 1.6075), within 1.1 % of an ellipsoid's."""
        a, b, c = self.extents()
        p = 1.6075
        mean = ((a * b) ** p + (b * c) ** p + (c * a) ** p) / 3
        return math.pi * mean ** (1 / p), math.pi / 6 * a * b * c

    def add(self, occ: Any, unit: float) -> None:
        ball = occ.addSphere(0.0, 0.0, 0.0, 0.5)
        occ.dilate([(3, ball)], 0.0, 0.0, 0.0, *(extent / unit for extent in self.extents()))


class Sphere(_Ball):
    """a ball"""

    shape: Literal["sphere"]
    radius: Length = Key("radius")

    def extents(self) -> Extents:
        return (2 * self.radius,) * 3


class Ellipsoid(_Ball):
    """a ball, stretched along the axes"""

    shape: Literal["ellipsoid"]
    semi_axes: Lengths = Key("half of its extents along x, y, z")

    def extents(self) -> Extents:
        a, b, c = self.semi_axes
        return 2 * a, 2 * b, 2 * c


class HollowSphere(Solid):
    """a ball with a cavity in its middle"""

    shape: Literal["hollow-sphere"]
    radius: Length = Key("radius")
    cavity_radius: Length = Key("radius of the ball in its middle that is left out")
    cavities: Annotated[Literal["empty", "fluid"], Enters.ANSWERS] = Key(CAVITIES, "empty")

    def extents(self) -> Extents:
        if not self.cavity_radius < self.radius:
            told = f"the cavity must be smaller than the ball: {self.cavity_radius:g} m in {self.radius:g} m"
            raise MeshError(told, "cavity_radius")
        return (2 * self.radius,) * 3

    def area_and_volume(self) -> tuple[float, float]:
        outer, inner = self.radius, self.cavity_radius
        return 4 * math.pi * (outer**2 + inner**2), 4 / 3 * math.pi * (outer**3 - inner**3)

    def add(self, occ: Any, unit: float) -> None:
        whole, cavity = (
            occ.addSphere(0.0, 0.0, 0.0, radius / unit) for radius in (self.radius, self.cavity_radius)
        )
        occ.cut([(3, whole)], [(3, cavity)])


class Box(Solid):
    """a cuboid"""

    shape: Literal["box"]
    size: Lengths = Key("its extents along x, y, z")

    def extents(self) -> Extents:
        return self.size

    def area_and_volume(self) -> tuple[float, float]:
        a, b, c = self.size
        return 2 * (a * b + b * c + c * a), a * b * c

    def add(self, occ: Any, unit: float) -> None:
        size = [length / unit for length in self.size]
        occ.addBox(*(-0.5 * length for length in size), *size)


class Cylinder(Solid):
    """a round cylinder"""

    shape: Literal["cylinder"]
    radius: Length = Key("radius")
    length: Length = Key("length")
    axis: Literal["x", "y", "z"] = Key("its axis", "z")

    def _along(self, length: float, across: float) -> Extents:
        a, b, c = (length if name == self.axis else across for name in "xyz")
        return a, b, c

    def extents(self) -> Extents:
        return self._along(self.length, 2 * self.radius)

    def area_and_volume(self) -> tuple[float, float]:
        return 2 * math.pi * self.radius * (self.radius + self.length), math.pi * self.radius**2 * self.length

    def add(self, occ: Any, unit: float) -> None:
        length = self._along(self.length / unit, 0.0)
        occ.addCylinder(*(-0.5 * part for part in length), *length, self.radius / unit)


class FileBody(Geometry):
    """a mesh from a file: a surface, or tetrahedra"""

    shape: Literal["file"]
    path: Annotated[Path, PlainValidator(as_path, json_schema_input_type=str)] = Key(
        "a surface (STL, OBJ, PLY, VTP) or tetrahedra (MSH, VTU, VTK); it is scaled to metres and not moved"
    )
    size: Length | None = Key("its largest extent", None)
    scale: Ratio | None = Key("metres per unit of the file, 1 where neither scale nor size is given", None)
    cavities: Annotated[Literal["empty", "fluid"] | None, Enters.ANSWERS] = Key(
        f"{CAVITIES}; needed where closed pieces of its surface lie inside the outer one", None
    )
    repair: Literal["fill-holes", "largest-piece", "both"] | None = Key(
        "close holes of a surface by facets between the nodes of their rims, keep of several pieces "
        "the one with the most area, or both; left out, either is refused",
        None,
    )

    @property
    def suffix(self) -> str:
        """File suffix in small letters."""
        return self.path.suffix.lower()

    @property
    def has_own_tetrahedra(self) -> bool:  # type: ignore[override]
        """Whether the file has tetrahedra; `mesh_size` then has no effect."""
        return self.suffix in VOLUME_SUFFIXES


# --- before meshing: checks, size estimate and content key; imports no mesher ---


MESHER_VERSION = "2"  # raise it with every change that alters a mesh

SURFACE_SUFFIXES = (".stl", ".obj", ".ply", ".vtp")

SMALLEST_EXTENT = 1e-3  # m; beyond this and the largest, a wrong unit is more likely than such an organ
MAX_NODES = 2_000_000  # of a mesh
LARGEST_EXTENT = 10.0  # m


def check_extent(extent: float, remedy: str, *key: str) -> None:
    """Raise MeshError about a key, ending with `remedy`, for a largest extent [m] that is implausible."""
    if not SMALLEST_EXTENT * (1 - 1e-9) <= extent <= LARGEST_EXTENT * (1 + 1e-9):
        raise MeshError(
            f"the largest extent is {extent:.6g} m, which looks like a mixed-up unit; {remedy}", *key
        )


def check_mesh_size(mesh_size: float, smallest_extent: float, doubt: str = "") -> None:
    """Raise MeshError, with `doubt` before its remedy, where an edge is longer than half of the smallest extent."""
    if mesh_size > 0.5 * smallest_extent * (1 + 1e-9):
        raise MeshError(
            f"mesh_size {mesh_size:g} m is too large for a body whose smallest extent is {smallest_extent:g} m; "
            f"{doubt}use at most {0.5 * smallest_extent:g} m",
            "mesh_size",
        )


def estimated_nodes(area: float, volume: float, mesh_size: float) -> tuple[float, float]:
    """Nodes of a uniform mesh on `area` and inside `volume` (0 where only the surface is meshed).

    Equilateral triangles of edge h give area / (h^2 sqrt(3)/2) surface nodes. The number inside is a fit to
    meshes of this module with 400 to 90,000 nodes: gmsh makes the inside somewhat coarser than the surface.
    """
    inside = max(0.0, 0.6 * volume / mesh_size**3 - 0.37 * area / mesh_size**2)
    return 2 / math.sqrt(3) * area / mesh_size**2, inside


def expected_size(area: float, volume: float, mesh_size: float) -> tuple[float, float]:
    """Surface nodes and tetrahedra of a uniform mesh; no tetrahedra if `volume` is 0.

    A tetrahedral mesh with many nodes has about six cells per node, and two per surface node.
    """
    on_surface, inside = estimated_nodes(area, volume, mesh_size)
    return on_surface, 2.6 * on_surface + 6.5 * inside if volume else 0.0


def check_node_budget(
    area: float, volume: float, mesh_size: float, remedy: str = "use a larger mesh_size"
) -> None:
    """Raise MeshError where the estimated number of nodes exceeds `MAX_NODES`."""
    nodes = sum(estimated_nodes(area, volume, mesh_size))
    if nodes > MAX_NODES:
        raise MeshError(
            f"mesh_size {mesh_size:g} m would give about {nodes:.2g} nodes, more than the {MAX_NODES} allowed; "
            f"{remedy}",
            "mesh_size",
        )


def doubted_extent(geometry: Geometry, extent: float) -> str:
    """What to do about a body of this extent [m], whose unit may be wrong, before what else helps."""
    given = [key for key in ("size", "scale") if key in geometry.parameters]
    told = "if that is wrong correct " + (given[0] if given else "its lengths")
    if isinstance(geometry, FileBody) and not given:
        told = "if the file is not in metres give scale or size"
    return f"the body is {extent:.3g} m across: {told}, else "


def geometry_key(geometry: Geometry, *, volume: bool) -> str:
    """SHA-256 (hex) of all that decides the mesh: resolved inputs, the file's bytes and the mesher's versions.

    A file counts by its content and kind, not by its path. Raises MeshError for an unreadable file.
    """
    inputs: dict[str, object] = {}
    for name, value in geometry.parameters.items():
        if name == "path":
            continue
        numbers = value if isinstance(value, tuple) else (value,)
        inputs[name] = value if isinstance(value, str) else [float(v).hex() for v in numbers]
    packages = geometry.packages
    if isinstance(geometry, FileBody):
        inputs["file"] = file_digest(geometry.path)
        inputs["kind"] = geometry.suffix
        inputs["origin"] = "file"  # up to version 0.2 a body was moved to the origin
        if "size" not in inputs:
            inputs.setdefault("scale", [(1.0).hex()])
        packages = ("gmsh", "meshio") if geometry.has_own_tetrahedra else ("gmsh", "pyacvd", "vtk")
    if not geometry.has_own_tetrahedra:
        inputs["mesh_size"] = float(geometry.mesh_size or 0.0).hex()
    described = {
        "shape": geometry.shape,
        "inputs": inputs,
        "volume": volume,
        "mesher": MESHER_VERSION,
        "packages": {name: version(name) for name in packages},
    }
    return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()


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

    x runs from the right lobe (negative) to the left, y from front to back, z upward. The numbers are chosen by
    eye. For each x the depth, and for each x and y the height, grows with the sphere's own: the map is one to
    one, and the body does not intersect itself.
    """
    import numpy as np  # slow to load: not where a study is only checked

    # Fuller than a sphere: with exponent 2 the lobes would be pointed.
    x, v, w = (sphere / (np.abs(sphere) ** _FULLNESS).sum(axis=1, keepdims=True) ** (1.0 / _FULLNESS)).T
    left = _smooth_step(x, -0.35, 0.95)  # 0 in the right lobe, 1 at the tip of the left
    # Depth: the right lobe is deep, the left one lies towards the front.
    y = (0.62 - 0.24 * left) * v - 0.12 * left
    # Thickness: from lobe to lobe, and a wedge from the blunt back to the thinner front edge.
    wedge = 1.0 + 0.30 * np.tanh(1.5 * y)
    half_height = (0.60 - 0.36 * left) * wedge
    # The top is a dome nearly level from lobe to lobe, so the lower edge rises to the left.
    middle = 0.30 * left - 0.10 * (x + 0.3) ** 2 - 0.12 * y**2
    # Underside: a broad hollow on the left, and a furrow between the lobes; both fade towards the top.
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


class Organ(SphereImage):
    """a procedural liver"""

    shape: Literal["organ"]
    size: Length = Key("its largest extent")

    def extents(self) -> Extents:
        a, b, c = (share * self.size for share in _EXTENTS)
        return a, b, c

    def area_and_volume(self) -> tuple[float, float]:
        return _AREA * self.size**2, _VOLUME * self.size**3

    def of_sphere(self, sphere: Array) -> Array:
        return liver_points(sphere)


load_all("vdmbench.study", "shape_")  # last: they use what is above
