"""PLY surfaces, text and binary, polygons cut into triangles: numpy only.

A reader of our own: VTK's was seen to crash on damaged files, meshio's knows only some of the names in use.
Format: G. Turk, "The PLY Polygon File Format" (1994).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .mesh import Array, Index, MeshError
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
        if any(length for _, _, length in element.properties):
            triangles = np.concatenate([triangles, _faces(numbers, element)])
            continue
        columns = numbers.records([(name, kind, 1) for name, kind, _ in element.properties], element.count)
        if element.name == "vertex":
            if not {"x", "y", "z"} <= set(columns):
                raise MeshError("has vertices without x, y and z")
            points = np.concatenate([columns[name] for name in "xyz"], axis=1).astype(np.float64)
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
            case ["element", name, count] if count.isdecimal():
                elements.append(_Element(name, int(count)))
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


def _faces(numbers: Numbers, element: _Element) -> Index:
    """Triangles of an element with lists; none where no list holds corners of faces."""
    start = numbers.position
    fields: list[tuple[str, str, int]] = []
    for name, kind, length in element.properties:
        fields += [(f"length of {name}", length, 1), (name, kind, 3)] if length else [(name, kind, 1)]
    corners = next((name for name, _, length in element.properties if length and name in _CORNERS), None)
    try:
        columns = numbers.records(fields, element.count)
    except MeshError:  # not all triangles, or truncated: reading row by row tells
        columns = {}
    lengths = [values for name, values in columns.items() if name.startswith("length of ")]
    if corners in columns and all((values == 3).all() for values in lengths):
        return columns[corners].astype(np.int64)
    numbers.rewind(start)
    triangles = []
    for _ in range(element.count):
        for name, kind, length in element.properties:
            count = numbers.integer(length) if length else 1
            if name == corners:
                polygon = numbers.integers(kind, count).tolist()
                triangles += [[polygon[0], polygon[k], polygon[k + 1]] for k in range(1, count - 1)]
            else:
                numbers.reals(kind, count)
    return np.array(triangles, dtype=np.int64).reshape(-1, 3)
