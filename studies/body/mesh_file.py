"""Surface and tetrahedral mesh files to arrays and back, by trimesh, VTK, gmsh and meshio.

With these readers and the checks of `repair` and `topology` no trial file is silently misread
(tests/body/test_mesh_files.py: 16 sound files, each cut at 64 places). Other readers misread some: VTK's of OBJ
and PLY have single precision, meshio loses overlapping groups of MSH. Readers may crash or use unlimited memory:
`read_apart` calls them. Errors do not name the file; the caller does.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solver_common.arrays import Array, Index, Mask

from ..machine import require_end
from ..study.errors import MeshError
from .mesh import Mesh

# VTK's numbers of cells
_TETRAHEDRON, _FLAT_CELLS = 10, {1: "vertex", 3: "line", 5: "triangle", 9: "quad"}
_DIMENSIONS = ("point", "curve", "surface", "volume")
_HOLDS = {
    ".ply": "vertices of x, y and z without lists, and faces",
    ".vtp": "PolyData",
    ".vtu": "an UnstructuredGrid",
    ".vtk": "an UNSTRUCTURED_GRID (write a surface as STL, OBJ, PLY or VTP)",
}
# gmsh types of the first-order elements allowed in a file; only tetrahedra are used
_GMSH_TETRAHEDRON, _GMSH_CELLS = 4, {15, 1, 2, 3, 4}


def read_surface(path: Path) -> tuple[Array, Index]:
    """Points (n, 3) and triangles (F, 3) of an STL, OBJ, PLY or VTP file; polygons are cut into triangles.

    Raises MeshError for a damaged or truncated file and one without facets.
    """
    points, triangles = _vtk_surface(path) if path.suffix.lower() == ".vtp" else _trimesh_surface(path)
    if len(triangles) == 0:
        raise MeshError("holds no facets, or is damaged; give the closed surface of a solid")
    return points, triangles


def _trimesh_surface(path: Path) -> tuple[Array, Index]:
    import trimesh  # slow to load

    kind = path.suffix.lower().removeprefix(".")
    with path.open("rb") as file:
        try:
            found: Any = trimesh.load_mesh(
                file, file_type=kind, process=False, skip_materials=True, maintain_order=True
            )
            points, triangles = np.asarray(found.vertices, dtype=np.float64), np.asarray(found.faces)
        except MemoryError:
            raise
        except Exception as error:  # any error of parsing a damaged file
            raise _unreadable(path) from error
    return points.reshape(-1, 3), triangles.reshape(-1, 3).astype(np.int64)


def _vtk_surface(path: Path) -> tuple[Array, Index]:
    from vtkmodules.vtkFiltersCore import vtkTriangleFilter

    found = _vtk(path)
    corners = _numpy(found.GetPolys().GetConnectivityArray())
    if corners.size and (corners.min() < 0 or corners.max() >= found.GetNumberOfPoints()):
        raise MeshError("facets name points that do not exist; the file is damaged")
    cut: Any = vtkTriangleFilter()
    cut.PassLinesOff()
    cut.PassVertsOff()
    cut.SetInputData(found)
    cut.Update()
    surface = cut.GetOutput()
    triangles = _numpy(surface.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    return _vtk_points(surface), triangles.astype(np.int64)


def read_tetrahedra(path: Path) -> tuple[Array, Index, dict[str, Mask]]:
    """Points (n, 3), tetrahedra (m, 4) and physical groups as masks (n,) of a VTU, legacy VTK or MSH file.

    Only an MSH file has groups. One without a name is named by its dimension and number, as `surface-3`; of two
    with the same name the lower dimension counts. Raises MeshError for a damaged or truncated file, and for cells
    other than four-node tetrahedra; facets, lines and vertices beside them are skipped.
    """
    if path.suffix.lower() == ".msh":
        return _gmsh_tetrahedra(path)
    grid = _vtk(path)
    cells = grid.GetCells()
    kinds = _numpy(grid.GetCellTypes()) if grid.GetNumberOfCells() else np.empty(0, dtype=int)
    wrong = sorted(set(np.unique(kinds).tolist()) - {_TETRAHEDRON, *_FLAT_CELLS})
    if wrong:
        names = ", ".join(
            grid.GetCell(int(np.argmax(kinds == kind))).GetClassName().lower() for kind in wrong
        )
        raise MeshError(f"holds {names} cells; only four-node (first-order) tetrahedra can be used")
    starts = _numpy(cells.GetOffsetsArray())[:-1][kinds == _TETRAHEDRON]
    corners = _numpy(cells.GetConnectivityArray()) if len(starts) else np.empty(0, dtype=int)
    if len(starts) and (starts.min() < 0 or starts.max() + 4 > len(corners)):
        raise _unreadable(path)
    return _vtk_points(grid), corners[starts[:, None] + np.arange(4)].astype(np.int64), {}


def read_point_fields(path: Path) -> tuple[Array, dict[str, Array]]:
    """Points (n, 3) of a VTU or legacy VTK file, and its vector fields at them: name -> (n, 3).

    Raises MeshError for an unreadable or damaged file; its cells are not used.
    """
    grid = _vtk(path)
    points, data = _vtk_points(grid), grid.GetPointData()
    arrays = [data.GetArray(k) for k in range(data.GetNumberOfArrays())]
    found = {array.GetName(): _numpy(array) for array in arrays if array is not None}
    return points, {
        name: values.astype(np.float64) for name, values in found.items() if values.shape == points.shape
    }


def _vtk(path: Path) -> Any:
    """The data of a VTK file. Raises MeshError if VTK reports any problem."""
    from vtkmodules.vtkCommonCore import vtkLogger, vtkOutputWindow, vtkStringOutputWindow
    from vtkmodules.vtkIOLegacy import vtkUnstructuredGridReader
    from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLUnstructuredGridReader

    suffix = path.suffix.lower()
    kinds = {
        ".vtp": vtkXMLPolyDataReader,
        ".vtu": vtkXMLUnstructuredGridReader,
        ".vtk": vtkUnstructuredGridReader,
    }
    reader: Any = kinds[suffix]()
    complaints = vtkStringOutputWindow()
    if suffix == ".vtk":
        reader.ReadAllVectorsOn()
        data = path.read_bytes()
        if b"\nASCII" in data[:600] and not data.endswith(b"\n"):  # VTK misses a truncated last number
            raise MeshError("is truncated: its last line has no end; write it again")
    reader.SetFileName(str(path))
    window, verbosity = vtkOutputWindow.GetInstance(), vtkLogger.GetCurrentVerbosityCutoff()
    vtkOutputWindow.SetInstance(complaints)
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        reader.Update()
    finally:
        vtkLogger.SetStderrVerbosity(verbosity)
        vtkOutputWindow.SetInstance(window)
    if complaints.GetOutput():
        raise _unreadable(path)
    return reader.GetOutput()


def _numpy(array: Any) -> NDArray[Any]:
    from vtkmodules.util import numpy_support  # slow to load

    as_numpy: Any = numpy_support.vtk_to_numpy  # untyped
    return np.asarray(as_numpy(array))


def _vtk_points(found: Any) -> Array:
    if not found.GetNumberOfPoints():
        return np.empty((0, 3))
    return np.asarray(_numpy(found.GetPoints().GetData()), dtype=np.float64)


def _unreadable(path: Path) -> MeshError:
    suffix = path.suffix.lower()
    holds = f", or does not hold {_HOLDS[suffix]}" if suffix in _HOLDS else ", or of another kind"
    return MeshError(f"cannot be read as {suffix}; it is damaged, truncated{holds}")


def _gmsh_tetrahedra(path: Path) -> tuple[Array, Index, dict[str, Mask]]:
    import gmsh

    data = path.read_bytes()
    if not data.startswith((b"$MeshFormat", b"$Comments")):  # gmsh executes other files as scripts
        raise MeshError("is not a mesh file of gmsh")
    if b"$EndElements" not in data:  # gmsh does not notice a truncated last number
        raise MeshError("is truncated or has no complete Elements section; write it again")
    gmsh.initialize([], readConfigFiles=False, run=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        with TemporaryDirectory() as alone:  # gmsh obeys an option file beside a mesh
            copy = Path(alone, "copy.msh")
            copy.write_bytes(data)
            gmsh.merge(str(copy))
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        kinds, _, _ = gmsh.model.mesh.getElements()
        wrong = sorted({*kinds.tolist()} - _GMSH_CELLS)
        if wrong:
            names = ", ".join(gmsh.model.mesh.getElementProperties(kind)[0].lower() for kind in wrong)
            raise MeshError(f"holds {names} cells; only four-node (first-order) tetrahedra can be used")
        _, corners = gmsh.model.mesh.getElementsByType(_GMSH_TETRAHEDRON)
        members = {
            gmsh.model.getPhysicalName(dim, group)
            or f"{_DIMENSIONS[dim]}-{group}": gmsh.model.mesh.getNodesForPhysicalGroup(dim, group)[0]
            for dim, group in reversed(gmsh.model.getPhysicalGroups())  # volumes first, points last
        }
    except Exception as error:
        if type(error) is not Exception:  # gmsh raises nothing more specific than Exception itself
            raise
        raise MeshError("is damaged or truncated, gmsh cannot read it; write it again") from error
    finally:
        gmsh.finalize()
    order = np.argsort(tags)
    tetrahedra = np.searchsorted(tags[order], np.asarray(corners)).reshape(-1, 4)
    groups = {name: np.isin(tags[order], nodes) for name, nodes in reversed(members.items())}
    return coordinates.reshape(-1, 3)[order], tetrahedra.astype(np.int64), groups


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
