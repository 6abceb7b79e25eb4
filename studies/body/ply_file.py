"""PLY surfaces, text and binary, polygons cut into triangles: numpy only.

A reader of our own: VTK's has coordinates in single precision and crashes where a file is cut; meshio's refuses
lists of vertices and any element but vertices and faces.
Format: G. Turk, "The PLY Polygon File Format" (1994).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from solver_common.arrays import Array, Index

from ..study.errors import MeshError
from .numbers_in_file import Numbers

_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MOST_PROPERTIES = 1000
_CORNERS = ("vertex_indices", "vertex_index")


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[tuple[str, str, str]] = field(
        default_factory=list
    )  # name, type, type of a list's length or ""


def read_ply(path: Path) -> tuple[Array, Index]:
    """Points (n, 3) and triangles (F, 3); a polygon becomes a fan about its first corner.

    Raises MeshError for a file that is damaged, truncated, or has no vertices and faces.
    """
    data = path.read_bytes()
    order, elements, body = _header(data)
    numbers = Numbers(body, binary=bool(order), order=order or "<")
    points: Array = np.empty((0, 3))
    triangles: Index = np.empty((0, 3), dtype=np.int64)
    for element in elements:
        single = {name for name, _, length in element.properties if not length}
        if element.name == "vertex" and not {"x", "y", "z"} <= single:
            raise MeshError("has vertices without x, y and z")
        columns = _columns(numbers, element)
        if element.name == "vertex":
            points = np.stack([np.asarray(columns[name], dtype=np.float64) for name in "xyz"], axis=1)
        else:
            lists = [columns[name] for name in _CORNERS if name in columns and name not in single]
            triangles = np.concatenate([triangles, *map(_fans, lists[:1])])
    return points, triangles


def _header(data: bytes) -> tuple[str, list[_Element], bytes]:
    """Byte order ("" for text), the elements in order, and the bytes after the header."""
    head, mark, body = data.partition(b"end_header")
    body = body.partition(b"\n")[2]
    lines = [line.split() for line in head.decode("ascii", "replace").splitlines()]
    if not mark or not lines or lines[0] != ["ply"]:
        raise MeshError("is not a PLY file, or its header is cut")
    order = None
    elements: list[_Element] = []
    for words in lines[1:]:
        match words:
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", name, "1.0"] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", *_] if len(elements) >= _MOST_PROPERTIES:
                raise MeshError(f"has more than {_MOST_PROPERTIES:,} elements")
            case ["element", name, count] if count.isdecimal() and len(count) <= 18:
                elements.append(_Element(name, int(count)))
            case ["property", *_] if elements and len(elements[-1].properties) >= _MOST_PROPERTIES:
                raise MeshError(f"has more than {_MOST_PROPERTIES:,} properties in one element; write fewer")
            case ["property", *_, name] if elements and name in {p[0] for p in elements[-1].properties}:
                raise MeshError(f"has the property {name[:40]!r} twice in one element")
            case ["property", "list", length, kind, name] if elements and {length, kind} <= set(_TYPES):
                elements[-1].properties.append((name, _TYPES[kind], _TYPES[length]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append((name, _TYPES[kind], ""))
            case _:
                raise MeshError(f"has a PLY header line that cannot be read: {' '.join(words)[:60]!r}")
    if order is None:
        raise MeshError("has a PLY header without a known format")
    return order, elements, body


def _columns(numbers: Numbers, element: _Element) -> dict[str, Any]:
    """The values of each property; of a list, a row each: an (n, 3) array where all have three numbers."""
    start = numbers.position
    table: list[tuple[str, str, int]] = []
    for name, kind, length in element.properties:
        table += [(f"length of {name}", length, 1), (name, kind, 3)] if length else [(name, kind, 1)]
    try:
        found = numbers.records(table, element.count)
    except MeshError:  # not all lists of three, or truncated: reading row by row tells
        found = {}
    if found and all((values == 3).all() for name, values in found.items() if name.startswith("length of ")):
        return {
            name: values if length else values[:, 0]
            for name, _, length in element.properties
            for values in (found[name],)
        }
    numbers.rewind(start)
    rows: dict[str, list[Any]] = {name: [] for name, _, _ in element.properties}
    for _ in range(element.count):
        for name, kind, length in element.properties:
            take = numbers.integers if name in _CORNERS else numbers.reals
            if length:
                rows[name].append(take(kind, numbers.integer(length)))
            else:
                rows[name].append(float(numbers.reals(kind, 1)[0]))
    return rows


def _fans(polygons: Sequence[Any]) -> Index:
    """Triangles (F, 3) of polygons, each a fan about its first corner."""
    if isinstance(polygons, np.ndarray):
        return polygons.astype(np.int64)
    fans = [
        np.stack([np.full(len(polygon) - 2, polygon[0]), polygon[1:-1], polygon[2:]], axis=1)
        for polygon in polygons
        if len(polygon) > 2
    ]
    return np.concatenate([np.empty((0, 3), dtype=np.int64), *fans])
