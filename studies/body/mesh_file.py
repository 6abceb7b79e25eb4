"""Surface and tetrahedral mesh files to arrays: the only module that imports meshio.

Its errors do not name the file; the caller does."""

from __future__ import annotations

import contextlib
import io
import re
import warnings
from collections.abc import Mapping
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from solver_common.arrays import Array, Index, Mask

from ..machine.files import require_end
from ..study.errors import MeshError
from .mesh import Mesh
from .obj_file import read_obj
from .ply_file import read_ply

if TYPE_CHECKING:
    import meshio

MOST_ARRAYS = 1000  # of a file, and properties of an element: readers take the square of their number in time
_DEFLATED = 1032  # bytes at most that one byte of deflated data stands for
_XML_COUNT = re.compile(rb"""\bNumberOf\w+\s*=\s*["']\s*(\d+)""")
# lines of a legacy VTK file: the dataset; a keyword and its counts; an array, its components and its tuples
_DATASET = re.compile(rb"^[ \t]*DATASET[ \t]+(\w{1,40})", re.MULTILINE | re.IGNORECASE)
_COUNTS = re.compile(
    rb"^[ \t]*(?:POINTS|CELLS|CELL_TYPES|POINT_DATA|CELL_DATA|FIELD|SCALARS|COLOR_SCALARS|VECTORS|NORMALS|TENSORS6?"
    rb"|TEXTURE_COORDINATES|LOOKUP_TABLE|METADATA)\b([^\n]{0,300})",
    re.MULTILINE | re.IGNORECASE,
)
_ARRAY = re.compile(rb"^[ \t]*\S{1,200}[ \t]+(\d+)[ \t]+(\d+)[ \t]+[a-zA-Z_]\w*[ \t\r]*$", re.MULTILINE)
_ANNOUNCES = "is truncated or damaged: it announces more than a file of its size can hold"
_MANY_ARRAYS = f"has more than {MOST_ARRAYS:,} arrays beside its mesh; write it without them"
_ONLY = {
    ".vtp": "only PolyData can be used as a surface",
    ".vtu": "only an UnstructuredGrid can be used",
    ".vtk": "only an UNSTRUCTURED_GRID of tetrahedra can be used; write a surface as STL, OBJ, PLY or VTP",
}
_STL_HEAD, _STL_FACET = 84, 50  # bytes of a binary STL: a title and the number of facets; each facet
# cells that are passed over beside tetrahedra, and their number of nodes
_FLAT_CELLS = {"vertex": 1, "line": 2, "triangle": 3, "quad": 4}


def read_surface(path: Path) -> tuple[Array, Index]:
    """Points (n, 3) and triangles (F, 3) of an STL, OBJ, PLY or VTP file; polygons are cut into triangles.

    Raises MeshError for a damaged or truncated file and one without facets.
    """
    suffix = path.suffix.lower()
    if suffix == ".ply":
        points, triangles = read_ply(path)
    elif suffix == ".obj":
        points, triangles = read_obj(path)
    elif suffix == ".vtp":
        from .remesh import read_vtp  # meshio does not know this format

        _check_xml(path, b"PolyData")
        points, triangles = read_vtp(path)
    else:
        _check_binary_stl(path)
        mesh = _read(path)
        points, triangles = _coordinates(mesh.points), _triangles(mesh)
    if len(triangles) == 0:
        raise MeshError("holds no facets; give the closed surface of a solid")
    return points, triangles


def read_tetrahedra(path: Path) -> tuple[Array, Index]:
    """Points (n, 3) and tetrahedra (m, 4) of a VTU or legacy VTK file, as they stand in it.

    Raises MeshError for a damaged or truncated file and for other cells than four-node
    tetrahedra (facets, lines and vertices beside them are passed over).
    """
    mesh = _read_grid(path)
    if path.suffix.lower() == ".vtk":
        _check_legacy_vtk(path, sum(len(block.data) for block in mesh.cells))
    nodes = {"tetra": 4, **_FLAT_CELLS}
    wrong = sorted({block.type for block in mesh.cells} - set(nodes))
    if wrong:
        raise MeshError(
            f"holds {', '.join(wrong)} cells; only four-node (first-order) tetrahedra can be used"
        )
    if any(np.shape(block.data)[1:] != (nodes[block.type],) for block in mesh.cells):
        raise MeshError("is damaged: it has cells whose number of nodes does not fit their kind")
    blocks = [np.asarray(block.data, dtype=np.int64) for block in mesh.cells if block.type == "tetra"]
    return _coordinates(mesh.points), np.concatenate([np.empty((0, 4), dtype=np.int64), *blocks])


def read_point_fields(path: Path) -> tuple[Array, dict[str, Array]]:
    """Points (n, 3) of a VTU or legacy VTK file, and what it tells of each as a vector: name -> (n, 3).

    Raises MeshError for a missing, unreadable or damaged file; its cells do not matter.
    """
    check_readable(path)
    mesh = _read_grid(path)
    points = _coordinates(mesh.points)
    found = {name: np.asarray(values) for name, values in mesh.point_data.items()}
    vectors = {
        name: values.astype(np.float64)
        for name, values in found.items()
        if values.shape == points.shape and values.dtype.kind in "fiu"
    }
    return points, vectors


def write_surface_vtu(path: Path, points: Array, triangles: Index, fields: Mapping[str, Array]) -> None:
    """Write a surface with fields at its nodes, (N,) or (N, 3), as a VTU file. Raises OSError."""
    import meshio

    meshio.vtu.write(str(path), meshio.Mesh(points, [("triangle", triangles)], dict(fields)))
    require_end(path, b"</VTKFile>")


def write_body_vtu(path: Path, mesh: Mesh, fields: Mapping[str, Array], facet_pressure: Array) -> None:
    """Write tetrahedra and facets with fields (n,) or (n, 3) at the points, (F,) on the facets. Raises OSError."""
    import meshio

    inside = np.zeros(len(mesh.tetrahedra))
    cells = [("tetra", mesh.tetrahedra), ("triangle", mesh.surface_nodes[mesh.triangles])]
    data = {"pressure": [inside, facet_pressure]}
    meshio.vtu.write(str(path), meshio.Mesh(mesh.points, cells, dict(fields), data))
    require_end(path, b"</VTKFile>")


def write_body_msh(path: Path, mesh: Mesh, parts: Mapping[str, Mask]) -> None:
    """Write tetrahedra and facets as MSH 2.2 text, a facet in the first part (F,) that has it. Raises OSError."""
    import meshio

    names, number = ["surface", *parts], np.ones(len(mesh.triangles), dtype=np.int32)
    for k, mask in reversed(list(enumerate(parts.values(), 2))):
        number[mask] = k
    tags = [np.full(len(mesh.tetrahedra), 1, dtype=np.int32), number]
    about = {name: np.array([k, 2]) for k, name in enumerate(names, 1)} | {"body": np.array([1, 3])}
    cells = [("tetra", mesh.tetrahedra), ("triangle", mesh.surface_nodes[mesh.triangles])]
    made = meshio.Mesh(
        mesh.points, cells, cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags}, field_data=about
    )
    meshio.gmsh.write(str(path), made, fmt_version="2.2", binary=False)
    require_end(path, b"$EndElements")


def check_readable(path: Path) -> None:
    """Raise MeshError for a file that is missing, empty, a directory, or closed to this user."""
    if not path.exists():
        raise MeshError("no such file")
    if not path.is_file():
        raise MeshError("is not a file")
    try:
        with path.open("rb") as file:
            head = file.read(1)
    except OSError as error:
        raise MeshError(f"cannot be read ({error.strerror})") from error
    if not head:
        raise MeshError("is empty")


def _read_grid(path: Path) -> meshio.Mesh:
    if path.suffix.lower() == ".vtk":
        _check_legacy_header(path)
    else:
        _check_xml(path, b"UnstructuredGrid")
    return _read(path)


def _read(path: Path) -> meshio.Mesh:
    """Read by the format's own reader: `meshio.read` prints and ends the process where it fails."""
    import meshio  # with all its formats slow to load: only where a file is read

    suffix = path.suffix.lower()
    readers = {".stl": meshio.stl.read, ".vtu": meshio.vtu.read, ".vtk": meshio.vtk.read}
    silent = io.StringIO()
    try:
        with (
            warnings.catch_warnings(),
            contextlib.redirect_stdout(silent),
            contextlib.redirect_stderr(silent),
        ):
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", message="string or file could not be read to its end")
            return readers[suffix](str(path))
    except MemoryError:
        raise
    except Exception as error:  # meshio fails on damaged files with whatever its parsing runs into
        raise MeshError(f"cannot be read as {suffix}; it is damaged, truncated or of another kind") from error


def _check_binary_stl(path: Path) -> None:
    """meshio takes a binary STL of another length than it announces for text."""
    with path.open("rb") as file:
        head = file.read(_STL_HEAD)
    if b"\0" not in head:
        return  # text
    announced = int.from_bytes(head[-4:], "little") if len(head) == _STL_HEAD else 0
    room = (path.stat().st_size - _STL_HEAD) / _STL_FACET
    if room < announced:
        raise MeshError(
            f"is truncated or is not an STL: it announces {announced:,} facets and ends after {max(int(room), 0):,}"
        )
    if room > announced:
        raise MeshError(
            f"is damaged or is not an STL: it announces {announced:,} facets and goes on after the last"
        )


def _check_xml(path: Path, dataset: bytes) -> None:
    """The kind of dataset and the counts of an XML file of VTK, before anything is made of them."""
    data = path.read_bytes()
    kind = re.search(rb"""<VTKFile\b[^>]*\btype\s*=\s*["'](\w*)""", data)
    if kind is not None and kind[1] != dataset:
        raise MeshError(f"holds a dataset {kind[1][:40].decode()!r} of VTK; {_ONLY[path.suffix.lower()]}")
    room = len(data) * (_DEFLATED if re.search(rb"<VTKFile\b[^>]*\bcompressor", data) else 1)
    if any(_number(count) > room for count in _XML_COUNT.findall(data)):
        raise MeshError(_ANNOUNCES)
    if data.count(b"<DataArray") > MOST_ARRAYS:
        raise MeshError(_MANY_ARRAYS)


def _check_legacy_header(path: Path) -> None:
    """The kind of dataset and the counts of a legacy VTK file, before anything is made of them."""
    data = path.read_bytes()
    kinds = _DATASET.findall(data)
    other = next((kind for kind in kinds if kind.upper() != b"UNSTRUCTURED_GRID"), None)
    if other is not None:
        raise MeshError(f"holds a dataset {other.decode()!r} of VTK; {_ONLY['.vtk']}")
    lines = [[_number(word) for word in line.split() if word.isdigit()] for line in _COUNTS.findall(data)]
    arrays = [_number(components) * _number(tuples) for components, tuples in _ARRAY.findall(data)]
    if any(count > len(data) for count in [*chain(*lines), *arrays]):
        raise MeshError(_ANNOUNCES)
    if len(lines) + len(arrays) > MOST_ARRAYS:
        raise MeshError(_MANY_ARRAYS)


def _number(digits: bytes) -> int:
    """A count; one of more than 18 digits, which Python may refuse to convert, is as large as one of 18."""
    return int(digits[:18])


def _check_legacy_vtk(path: Path, cells: int) -> None:
    """meshio does not miss the last cells of a legacy VTK file that is cut, nor the end of its last number."""
    data = path.read_bytes()
    announced = re.search(rb"^CELL_TYPES[ \t]+(\d+)", data, re.MULTILINE)
    if announced is None or int(announced[1]) != cells:
        raise MeshError("is truncated: it announces more cells than it holds")
    if re.search(rb"^ASCII\b", data[:600], re.MULTILINE) and not data.endswith(b"\n"):
        raise MeshError("is truncated: its last line has no end; write it again")


def _coordinates(points: object) -> Array:
    coordinates = np.asarray(points, dtype=np.float64)
    if coordinates.ndim != 2 or coordinates.shape[1] != 3:
        raise MeshError("points must have three coordinates each")
    return coordinates


def _triangles(mesh: meshio.Mesh) -> Index:
    blocks = [np.asarray(block.data, dtype=np.int64) for block in mesh.cells if block.type == "triangle"]
    return np.concatenate([np.empty((0, 3), dtype=np.int64), *blocks])
