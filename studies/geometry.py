"""Geometry to mesh: the only module that imports gmsh."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import gmsh
import numpy as np

from studies.geometry_spec import Geometry, area_and_volume, check_geometry, check_node_budget, extents
from studies.mesh import Index, Mesh, MeshError
from studies.topology import mesh_from_tetrahedra, mesh_from_triangles

_TRIANGLE, _TETRAHEDRON = 2, 4  # gmsh's element types

_OPTIONS = {
    "General.Terminal": 0,
    # one thread and a fixed seed: the same mesh, bit by bit, every time
    "General.NumThreads": 1,
    "Mesh.MaxNumThreads1D": 1,
    "Mesh.MaxNumThreads2D": 1,
    "Mesh.MaxNumThreads3D": 1,
    "Mesh.RandomSeed": 1,
    "Mesh.Algorithm": 6,  # frontal Delaunay: the most regular triangles
    "Mesh.Algorithm3D": 10,  # HXT: leaves the surface mesh as it is and optimises on the way
    "Mesh.Optimize": 1,
    "Mesh.ElementOrder": 1,
    # the one size asked for, everywhere
    "Mesh.MeshSizeFromPoints": 0,
    "Mesh.MeshSizeFromCurvature": 0,
    "Mesh.MeshSizeExtendFromBoundary": 0,
}


def build_mesh(geometry: Geometry, *, volume: bool = True, max_nodes: int = 2_000_000) -> Mesh:
    """Mesh a geometry: tetrahedra and their boundary, or with `volume=False` the same surface alone.

    Deterministic: equal inputs and package versions give equal bytes. `Mesh.quality` holds counts, volume
    [m^3], area [m^2], `worst_sicn`, `seconds` and, for an imported surface, what was repaired.

    Raises MeshError, in one sentence, for a geometry, a file or a mesh size that cannot be used; the number
    of nodes is estimated against `max_nodes` before anything is meshed.
    """
    check_geometry(geometry)
    started = time.perf_counter()
    area, inside = area_and_volume(geometry)
    check_node_budget(area, inside if volume else 0.0, geometry.mesh_size, max_nodes)
    unit = max(extents(geometry))
    mesh = _mesh_with_gmsh(lambda: _add_solid(geometry, unit), geometry.mesh_size, unit, volume=volume)
    return replace(mesh, quality={**mesh.quality, "seconds": time.perf_counter() - started})


@contextmanager
def _gmsh_session(mesh_size: float) -> Iterator[None]:
    """A silent gmsh with fixed options that leaves signals alone; its errors become MeshError."""
    gmsh.initialize([], readConfigFiles=False, run=False, interruptible=False)
    try:
        for name, value in _OPTIONS.items():
            gmsh.option.setNumber(name, value)
        gmsh.option.setNumber("Mesh.MeshSizeMin", mesh_size)
        gmsh.option.setNumber("Mesh.MeshSizeMax", mesh_size)
        yield
    except MeshError:
        raise
    except Exception as error:  # gmsh raises nothing more specific
        raise MeshError(f"gmsh could not mesh this geometry ({error}); try another mesh_size") from error
    finally:
        gmsh.finalize()


def _mesh_with_gmsh(add_model: Callable[[], None], mesh_size: float, unit: float, *, volume: bool) -> Mesh:
    """Mesh the model that `add_model` makes in lengths of `unit` [m], so that no tolerance depends on its size."""
    with _gmsh_session(mesh_size / unit):
        add_model()
        gmsh.model.mesh.generate(3 if volume else 2)
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        triangles = _elements(_TRIANGLE, 3)
        tetrahedra = _elements(_TETRAHEDRON, 4)
    # Surface nodes have the lower tags: in tag order they come first, with or without the inside.
    elements = tetrahedra if volume else triangles
    used = np.unique(elements)
    order = np.argsort(tags)
    points = unit * coordinates.reshape(-1, 3)[order][np.searchsorted(tags[order], used)]
    local = np.searchsorted(used, elements)
    return mesh_from_tetrahedra(points, local) if volume else mesh_from_triangles(points, local)


def _elements(kind: int, width: int) -> Index:
    _, nodes = gmsh.model.mesh.getElementsByType(kind)
    return np.asarray(nodes, dtype=np.int64).reshape(-1, width)


def _add_solid(geometry: Geometry, unit: float) -> None:
    """Add a shape with exact surfaces (OpenCASCADE), centred on the origin, in lengths of `unit` [m]."""
    occ = gmsh.model.occ
    size = np.array(extents(geometry)) / unit
    if geometry.shape == "box":
        occ.addBox(*(-0.5 * size), *size)
    elif geometry.shape == "cylinder":
        axis = np.eye(3)["xyz".index(str(geometry.parameters.get("axis", "z")))]
        length = geometry.number("length") / unit * axis
        occ.addCylinder(*(-0.5 * length), *length, geometry.number("radius") / unit)
    else:
        ball = occ.addSphere(0.0, 0.0, 0.0, 0.5)
        occ.dilate([(3, ball)], 0.0, 0.0, 0.0, *size)
    occ.synchronize()
