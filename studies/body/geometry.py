"""Geometry to mesh, by gmsh."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import gmsh
import numpy as np

from solver_common.arrays import Array, Index

from ..study.errors import MeshError
from ..study.shapes import (
    FileBody,
    Geometry,
    Shape,
    Solid,
    SphereImage,
    check_mesh_size,
    check_node_budget,
)
from .imported import centred, imported_surface, imported_tetrahedra, named
from .mesh import Mesh
from .surface_measures import enclosed_volume, shells
from .topology import mesh_from_tetrahedra, mesh_from_triangles, surface_only

_TRIANGLE, _TETRAHEDRON = 2, 4  # gmsh's element types
_SUBDIVISIONS = 6  # of a sphere: 40,962 points, far finer than any mesh of a shape made from it

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


def build_mesh(geometry: Geometry, *, volume: bool = True) -> Mesh:
    """Mesh a geometry: tetrahedra and their boundary, or with `volume=False` the same surface alone.

    Slivers and perturbed nodes are limited by the tetrahedra, where there are any.

    Deterministic: equal inputs and package versions give equal bytes. `Mesh.quality` holds counts, volume [m^3],
    area [m^2], `worst_sicn`, `seconds` and, for an imported mesh, the repairs and the distance of the new surface
    from the imported one [m].

    Raises MeshError, in one sentence, for an unusable file, mesh size or mesh.
    """
    started = time.perf_counter()
    if isinstance(geometry, FileBody):
        with named(geometry):
            mesh = _of_file(geometry, volume)
    else:
        assert isinstance(geometry, Shape)
        check_mesh_size(geometry.mesh_size, min(geometry.extents()))
        area, inside = geometry.area_and_volume()
        check_node_budget(area, inside if volume else 0.0, geometry.mesh_size)
        mesh = _of_sphere(geometry, volume) if isinstance(geometry, SphereImage) else _solid(geometry, volume)
    if geometry.slivers is not None or geometry.perturbation is not None:
        from .distort import distorted  # SciPy is slow to load

        mesh = distorted(
            mesh,
            slivers=geometry.slivers,
            perturbation=geometry.perturbation,
            seed=geometry.seed or 0,
        )
    return replace(mesh, quality={**mesh.quality, "seconds": time.perf_counter() - started})


def _solid(geometry: Shape, volume: bool) -> Mesh:
    assert isinstance(geometry, Solid)
    unit = _unit(max(geometry.extents()))

    def add() -> None:
        """With exact surfaces (OpenCASCADE), centred on the origin."""
        geometry.add(gmsh.model.occ, unit)
        gmsh.model.occ.synchronize()

    return _mesh_with_gmsh(add, geometry.mesh_size, unit, volume=volume)


def _of_sphere(geometry: SphereImage, volume: bool) -> Mesh:
    from .remesh import unit_sphere  # VTK is slow to load: only to make a new surface

    sphere, triangles = unit_sphere(_SUBDIVISIONS)
    points = centred(geometry.of_sphere(sphere), max(geometry.extents()))
    return replace(fill_surface(points, triangles, geometry.mesh_size, volume), moved=None)


def _of_file(geometry: FileBody, volume: bool) -> Mesh:
    if geometry.has_own_tetrahedra:
        mesh = imported_tetrahedra(geometry)
        return mesh if volume else surface_only(mesh)
    given, centre = imported_surface(geometry, volume=volume)
    mesh = fill_surface(given.points, given.cells, geometry.mesh_size or 0.0, volume)
    quality = {**mesh.quality, **given.repairs}
    return replace(mesh, points=mesh.points + centre, quality=quality)  # at the file's place


def fill_surface(points: Array, triangles: Index, mesh_size: float, volume: bool = True) -> Mesh:
    """Remesh a closed surface [m] uniformly, free it of intersections and fill it with tetrahedra."""
    from .intersections import without_intersections
    from .remesh import surface_distance, uniform_surface

    shell = shells(points, triangles)
    made, count = [], 0
    for k in range(int(shell.max()) + 1):
        used, local = np.unique(triangles[shell == k], return_inverse=True)
        nodes, facets = uniform_surface(points[used], local.reshape(-1, 3), mesh_size)
        made.append((nodes, (facets[:, ::-1] if k else facets) + count))  # facets of a cavity come outward
        count += len(nodes)
    nodes, facets = (np.concatenate(parts) for parts in zip(*made, strict=True))
    nodes, fixed = without_intersections(nodes, facets)
    mean_distance, moved = surface_distance(points, triangles, nodes, facets)
    quality = {
        "surface_distance_mean": mean_distance,
        "surface_distance_max": float(moved.max()),
        "volume_change": enclosed_volume(nodes, facets) / enclosed_volume(points, triangles) - 1.0,
        "self_intersections_fixed": float(fixed),
    }
    surface = replace(mesh_from_triangles(nodes, facets, quality=quality), moved=moved)
    if not volume:
        return surface
    unit = _unit(float(np.ptp(nodes, axis=0).max()))
    mesh = _mesh_with_gmsh(lambda: _add_surface(nodes / unit, facets), mesh_size, unit, volume=True)
    if surface_only(mesh).content_hash != surface.content_hash:
        raise MeshError("gmsh changed the surface while it filled it; use another mesh_size")
    return replace(mesh, quality={**mesh.quality, **quality}, moved=moved)


def _unit(extent: float) -> float:
    """The power of two nearest to a body's extent [m], as gmsh's unit of length: its tolerances are absolute.

    Scaling by a power of two is exact: nodes come back unchanged.
    """
    return 2.0 ** round(np.log2(extent))


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
    except Exception as error:
        if type(error) is not Exception:  # gmsh raises nothing more specific than Exception itself
            raise
        raise MeshError(f"gmsh cannot mesh this geometry ({error}); try another mesh_size") from error
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
    # surface nodes have lower tags: in tag order they come first, with or without the inside
    elements = tetrahedra if volume else triangles
    used = np.unique(elements)
    order = np.argsort(tags)
    points = unit * coordinates.reshape(-1, 3)[order][np.searchsorted(tags[order], used)]
    local = np.searchsorted(used, elements)
    return mesh_from_tetrahedra(points, local) if volume else mesh_from_triangles(points, local)


def _elements(kind: int, width: int) -> Index:
    _, nodes = gmsh.model.mesh.getElementsByType(kind)
    return np.asarray(nodes, dtype=np.int64).reshape(-1, width)


def _add_surface(points: Array, triangles: Index) -> None:
    """Add the inside of a closed triangle surface; the triangles are kept."""
    shell, loops = shells(points, triangles), []
    for k in range(int(shell.max()) + 1):
        surface = gmsh.model.addDiscreteEntity(2)
        nodes = np.unique(triangles[shell == k])
        gmsh.model.mesh.addNodes(2, surface, nodes + 1, points[nodes].ravel())
        gmsh.model.mesh.addElementsByType(surface, _TRIANGLE, [], (triangles[shell == k] + 1).ravel())
        loops.append(gmsh.model.geo.addSurfaceLoop([surface]))
    gmsh.model.geo.addVolume(loops)
    gmsh.model.geo.synchronize()
