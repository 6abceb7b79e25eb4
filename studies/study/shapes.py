"""Shapes of bodies. One more is a `register(BodyShape(...))`, here or in a file `shape_NAME.py`.

Its keys of [geometry], their checks, the estimate of its mesh, its content key and its mesh follow from that.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import MeshError
from .modules import load_all

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

Extents = tuple[float, float, float]
VOLUME_SUFFIXES = (".msh", ".vtu", ".vtk")
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

load_all("vdmbench.study", "shape_")  # last: they use what is above
