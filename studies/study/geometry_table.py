"""[geometry] as a typed table: the keys that shapes declare, those of files and those of any shape."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, PlainValidator, create_model

from .geometry_spec import LEAST_SLIVERS, MOST_PERTURBATION
from .kinds import SI, Length, Vector3, number_check, positive
from .shapes import SHAPES, shape_names
from .table import Enters, Table, as_path


def _of_shapes(key: str) -> tuple[Any, Any]:
    """Type and help of a key of [geometry] that some shapes declare, and a file's size."""
    taken = {shape.name: shape.parameters[key] for shape in SHAPES.values() if key in shape.parameters}
    texts: dict[str, list[str]] = {}
    for name, text in [(name, about.help) for name, about in taken.items()] + _OF_FILE.get(key, []):
        texts.setdefault(text, []).append(name)
    told = "; ".join(f"{', '.join(names)}: {text}" for text, names in texts.items())
    first, counts = next(iter(taken.values())), {about.count for about in taken.values()}
    values = {(False,): float, (True,): Vector3, (False, True): float | Vector3}
    kind: Any = Annotated[
        values[tuple(sorted({count > 1 for count in counts}))],
        SI(first.unit, tuple(sorted(counts))),
        positive,
    ]
    if first.choices:
        kind = Literal[tuple(sorted(first.choices))]
    return Annotated[kind | None, Enters.MESH], Field(None, description=told)


_OF_FILE = {"size": [("file", "its largest extent")]}


class _Body(Table):
    if TYPE_CHECKING:
        shape: str
        size: float | Vector3 | None
    else:
        shape: Annotated[Literal[shape_names()], Enters.MESH] = Field(
            description="kind of body; `organ` is a procedural liver, `file` reads a mesh"
        )
    mesh_size: Annotated[Length | None, Enters.MESH] = Field(
        None, description="edge length of the mesh; only a file with tetrahedra does without"
    )


if TYPE_CHECKING:
    _ShapedBody = _Body
else:
    _ShapedBody = create_model(
        "_ShapedBody",
        __base__=_Body,
        **{key: _of_shapes(key) for shape in SHAPES.values() for key in shape.parameters},
    )


class Geometry(_ShapedBody):
    """[geometry]; all shapes but a file are centred on the origin"""

    path: Annotated[
        Annotated[Path, PlainValidator(as_path, json_schema_input_type=str)] | None, Enters.MESH
    ] = Field(
        None,
        description="file: a surface (STL, OBJ, PLY, VTP) or tetrahedra (MSH, VTU, VTK); it is scaled to metres "
        "and not moved",
    )
    coordinates: Literal["file", "centred"] | None = Field(
        None,
        description="file: what the coordinates of planes, balls, boxes and measured points start from: the origin "
        "of the file, or the middle of its bounding box; needed where a study has coordinates",
    )
    scale: Annotated[Annotated[float, SI("1"), positive] | None, Enters.MESH] = Field(
        None, description="file: metres per unit of the file, 1 where neither scale nor size is given"
    )
    slivers: Annotated[
        Annotated[
            float, SI("1"), number_check(lambda v: v >= LEAST_SLIVERS, f"must be at least {LEAST_SLIVERS:g}")
        ]
        | None,
        Enters.MESH,
    ] = Field(
        None,
        description="any shape: squeeze one facet in twenty-five until its longest edge is so many heights",
    )
    perturbation: Annotated[
        Annotated[
            float,
            SI("1"),
            positive,
            number_check(lambda v: v <= MOST_PERTURBATION, f"must be at most {MOST_PERTURBATION:g}"),
        ]
        | None,
        Enters.MESH,
    ] = Field(
        None, description="any shape: move each node at random by up to this share of its shortest edge"
    )
    seed: Annotated[int | None, Enters.MESH] = Field(
        None, description="of the slivers and the perturbation, 0 where left out", ge=0, lt=2**32
    )

    @classmethod
    def with_defaults(cls, data: dict[str, Any]) -> dict[str, Any]:
        shape = SHAPES.get(str(data.get("shape")))
        keys = shape.parameters.items() if shape is not None else ()
        return {name: about.choices[0] for name, about in keys if about.choices} | data
