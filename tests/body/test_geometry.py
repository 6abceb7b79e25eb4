"""Shapes to meshes: exactness, order, determinism, the surface alone, the organ, files and the cache."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.bodies import shaped
from vdmbench.body.geometry import build_mesh
from vdmbench.body.imported import imported_surface
from vdmbench.body.intersections import intersecting_facets
from vdmbench.body.mesh import Mesh
from vdmbench.body.mesh_cache import mesh_from_cache, read_mesh, write_mesh
from vdmbench.body.read_apart import read_clean
from vdmbench.body.remesh import unit_sphere
from vdmbench.body.repair import Clean
from vdmbench.body.surface_measures import enclosed_volume, facet_area_vectors
from vdmbench.body.topology import tetrahedron_sicn, tetrahedron_volumes
from vdmbench.study import shapes
from vdmbench.study.errors import MeshError
from vdmbench.study.shapes import Box, Cylinder, Shape, geometry_key, liver_points

from .test_mesh_files import write_surface

pytestmark = pytest.mark.usefixtures("read_here")
SPHERE = shaped("sphere", 0.012, {"radius": 0.05})
ELLIPSOID = shaped("ellipsoid", 0.010, {"semi_axes": (0.06, 0.04, 0.03)})
BOX = shaped("box", 0.010, {"size": (0.1, 0.05, 0.04)})
CYLINDER = shaped("cylinder", 0.010, {"radius": 0.03, "length": 0.1, "axis": "y"})
ORGAN = shaped("organ", 0.011, {"size": 0.19})
SHAPES = [SPHERE, ELLIPSOID, BOX, CYLINDER, ORGAN]
NAMES = [geometry.shape for geometry in SHAPES]


def resized(geometry: Shape, mesh_size: float) -> Shape:
    return geometry.model_copy(update={"mesh_size": mesh_size})


def squared_level(geometry: Shape, points: np.ndarray) -> np.ndarray:
    """1 on the shape's curved surface, less inside."""
    if isinstance(geometry, Box):
        return np.max(np.abs(points) / (0.5 * np.array(geometry.size)), axis=1)
    if isinstance(geometry, Cylinder):
        across = np.hypot(points[:, 0], points[:, 2]) / geometry.radius
        return np.maximum(across, np.abs(points[:, 1]) / (0.5 * geometry.length))
    return ((points / (0.5 * np.array(geometry.extents()))) ** 2).sum(axis=1)


@pytest.mark.parametrize("geometry", SHAPES, ids=NAMES)
def test_every_shape_is_a_sound_mesh(geometry: Shape) -> None:
    mesh = build_mesh(geometry)
    assert (tetrahedron_volumes(mesh.points, mesh.tetrahedra) > 0).all()
    assert_array_equal(np.unique(mesh.tetrahedra), np.arange(len(mesh.points)))
    assert (np.diff(mesh.surface_nodes) > 0).all()
    assert_array_equal(np.unique(mesh.triangles), np.arange(len(mesh.surface_nodes)))
    # outward and closed: the surface holds the volume of the tetrahedra, its area vectors cancel, Euler's 2
    volume = tetrahedron_volumes(mesh.points, mesh.tetrahedra).sum()
    assert_allclose(enclosed_volume(mesh.surface_points, mesh.triangles), volume, rtol=1e-12, atol=0)
    area = facet_area_vectors(mesh.surface_points, mesh.triangles)
    assert_allclose(area.sum(axis=0), 0, rtol=0, atol=1e-12 * np.abs(area).sum())
    assert len(mesh.surface_nodes) - len(mesh.triangles) // 2 == 2
    edges = mesh.surface_points[mesh.triangles] - mesh.surface_points[np.roll(mesh.triangles, 1, axis=1)]
    lengths = np.linalg.norm(edges, axis=2)
    assert_allclose(lengths.mean(), geometry.mesh_size, rtol=0.15, atol=0)
    assert lengths.max() < 2.2 * geometry.mesh_size
    assert mesh.quality["worst_sicn"] == tetrahedron_sicn(mesh.points, mesh.tetrahedra).min() >= 0.25
    assert mesh.quality["surface_nodes"] == len(mesh.surface_nodes)
    assert mesh.quality["volume"] == pytest.approx(volume, rel=1e-12)
    if geometry is not ORGAN:
        assert_allclose(squared_level(geometry, mesh.surface_points), 1, rtol=1e-9, atol=0)
        inner = np.setdiff1d(np.arange(len(mesh.points)), mesh.surface_nodes)
        assert (squared_level(geometry, mesh.points[inner]) < 1).all()
    of_shape, inside = geometry.area_and_volume()
    for nodes, within in ((len(mesh.points), inside), (len(mesh.surface_nodes), 0.0)):
        assert 0.8 < nodes / sum(shapes.estimated_nodes(of_shape, within, geometry.mesh_size)) < 1.25
    surface = build_mesh(geometry, volume=False)
    assert_array_equal(surface.surface_points, mesh.surface_points)
    assert_array_equal(surface.triangles, mesh.triangles)
    assert len(surface.tetrahedra) == 0
    assert len(surface.points) == len(mesh.surface_nodes)


@pytest.mark.parametrize("geometry", [SPHERE, ELLIPSOID, CYLINDER], ids=["sphere", "ellipsoid", "cylinder"])
def test_volume_converges_with_the_square_of_the_mesh_size(geometry: Shape) -> None:
    _, exact = geometry.area_and_volume()
    sizes = geometry.mesh_size * np.array([1.0, 0.7, 0.5])
    errors = [1 - build_mesh(resized(geometry, h), volume=False).quality["volume"] / exact for h in sizes]
    order = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert 1.7 < order < 2.3, errors
    assert 0 < errors[-1] < 0.01


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_cylinder_lies_along_its_axis(axis: str) -> None:
    """Its mesh has these extents, as that of every shape."""
    extents = shaped("cylinder", 0.02, {"radius": 0.03, "length": 0.1, "axis": axis}).extents()
    assert dict(zip("xyz", extents, strict=True)) == {"x": 0.06, "y": 0.06, "z": 0.06, axis: 0.1}


def test_another_process_makes_the_same_bytes() -> None:
    geometry = resized(ORGAN, 0.02)
    script = (
        "from vdmbench.body.geometry import build_mesh; from vdmbench.study.shapes import Geometry;"
        f"print(build_mesh(Geometry.model_validate({geometry.model_dump()!r})).content_hash)"
    )
    environment = {**os.environ, "PYTHONHASHSEED": "7", "OMP_NUM_THREADS": "2"}
    run = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, env=environment
    )
    assert run.stdout.strip() == build_mesh(geometry).content_hash


# --- the organ ----------------------------------------------------------------------------------------


def test_the_organ_s_stated_measures_are_those_of_its_surface() -> None:
    sphere, triangles = unit_sphere(6)
    points = liver_points(sphere)
    width = np.ptp(points, axis=0)[0]
    geometry = shaped("organ", 0.1, {"size": 1.0})
    assert_allclose(np.ptp(points, axis=0) / width, geometry.extents(), rtol=0, atol=6e-4)
    area = np.linalg.norm(facet_area_vectors(points, triangles), axis=1).sum()
    coarse, facets = unit_sphere(4)
    assert len(intersecting_facets(liver_points(coarse), facets)) == 0
    measured = area / width**2, enclosed_volume(points, triangles) / width**3
    assert_allclose(measured, geometry.area_and_volume(), rtol=1e-3, atol=0)


@pytest.mark.parametrize("nodes", [500, pytest.param(5000, marks=pytest.mark.slow)])
def test_the_organ_meshes_well_at_every_size(nodes: int) -> None:
    area, _ = ORGAN.area_and_volume()
    mesh = build_mesh(resized(ORGAN, float(np.sqrt(2 / np.sqrt(3) * area / nodes))))
    assert abs(len(mesh.surface_nodes) / nodes - 1) < 0.01
    assert mesh.quality["worst_sicn"] >= 0.1
    assert mesh.quality["self_intersections_fixed"] == 0
    # chords of edge h over a curvature c are apart by c h^2 / 8: of second order, hence 1 / nodes
    assert mesh.quality["surface_distance_mean"] < mesh.quality["area"] ** 0.5 / nodes
    assert abs(mesh.quality["volume_change"]) < 10 / nodes


# --- imported surfaces --------------------------------------------------------------------------------


def surface_file(path: Path, mesh: Mesh, shift: float = 0.0) -> Path:
    """In millimetres."""
    return write_surface(path, mesh.surface_points * 1e3 + shift, mesh.triangles)


@pytest.mark.parametrize("suffix", [".stl", ".vtp"])
def test_a_surface_file_is_scaled_remeshed_and_filled_where_it_lies(tmp_path: Path, suffix: str) -> None:
    original = build_mesh(resized(ELLIPSOID, 0.005))
    path = surface_file(tmp_path / f"a{suffix}", original, shift=300.0)
    mesh = build_mesh(shaped("file", 0.01, {"path": str(path), "scale": 1e-3}))
    _, exact = ELLIPSOID.area_and_volume()
    assert_allclose(mesh.quality["volume"], exact, rtol=0.04, atol=0)
    assert_allclose((mesh.points.max(axis=0) + mesh.points.min(axis=0)) / 2, 0.3, rtol=0, atol=1e-3)
    assert mesh.quality["worst_sicn"] > 0.2
    assert mesh.quality["imported_points"] == len(original.surface_nodes)
    assert mesh.quality["scale"] == pytest.approx(1e-3, rel=1e-12)
    assert mesh.quality["volume_change"] == pytest.approx(
        mesh.quality["volume"] / original.quality["volume"] - 1, abs=1e-5
    )
    assert 0 < mesh.quality["surface_distance_mean"] < mesh.quality["surface_distance_max"] < 2e-3
    assert original.moved is None
    assert mesh.moved.shape == (len(mesh.surface_nodes),)
    assert mesh.moved.max() == mesh.quality["surface_distance_max"]
    write_mesh(tmp_path / "mesh.npz", mesh)
    stored = read_mesh(tmp_path / "mesh.npz")
    assert_array_equal(stored.moved, mesh.moved)
    alone = build_mesh(shaped("file", 0.01, {"path": str(path), "scale": 1e-3}), volume=False)
    assert_array_equal(alone.moved, mesh.moved)
    assert_array_equal(alone.surface_points, mesh.surface_points)
    assert_array_equal(alone.triangles, mesh.triangles)


def test_size_and_scale_say_the_same(tmp_path: Path) -> None:
    path = surface_file(tmp_path / "a.vtp", build_mesh(BOX))
    by_scale = build_mesh(shaped("file", 0.01, {"path": str(path), "scale": 2e-3}), volume=False)
    by_size = build_mesh(shaped("file", 0.01, {"path": str(path), "size": 0.2}), volume=False)
    assert by_size.quality["scale"] == pytest.approx(2e-3, rel=1e-12)
    assert_allclose(by_size.points, by_scale.points, rtol=0, atol=1e-12)
    assert_allclose(np.ptp(by_size.points, axis=0), [0.2, 0.1, 0.08], rtol=0.05, atol=0)


# --- the specification and the cache -----------------------------------------------------------------


def test_the_key_covers_the_inside_and_the_mesher(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each key of [geometry] enters it too: tests/work/test_keys.py."""
    keys = {geometry_key(CYLINDER, volume=volume) for volume in (False, True)}
    monkeypatch.setattr(shapes, "MESHER_VERSION", "another")
    keys.add(geometry_key(CYLINDER, volume=True))
    assert len(keys) == 3


def test_a_file_counts_by_its_content_not_its_path(tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_bytes(b"one")
    (tmp_path / "b.stl").write_bytes(b"one")
    (tmp_path / "c.stl").write_bytes(b"two")
    keys = [
        geometry_key(shaped("file", 0.01, {"path": str(tmp_path / f"{n}.stl")}), volume=True) for n in "abc"
    ]
    assert keys[0] == keys[1] != keys[2]
    with pytest.raises(MeshError, match=r"missing\.stl: cannot be read"):
        geometry_key(shaped("file", 0.01, {"path": str(tmp_path / "missing.stl")}), volume=True)


def test_a_file_is_read_once_for_several_mesh_sizes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As long as its bytes are the same, whatever its path says."""
    reads: list[Path] = []

    def reading(path: Path, repair: str) -> Clean:
        reads.append(path)
        return read_clean(path, repair)

    monkeypatch.setattr("vdmbench.body.imported.clean_of", reading)
    path = surface_file(tmp_path / "body.stl", build_mesh(SPHERE, volume=False))

    def areas() -> list[float]:
        sizes = (0.01, 0.012)
        found = [shaped("file", size, {"path": str(path), "scale": 1e-3}) for size in sizes]
        return [imported_surface(geometry, volume=True)[0].area for geometry in found]

    first = areas()
    assert len(reads) == 1
    surface_file(path, build_mesh(BOX, volume=False))
    assert areas() != first
    assert len(reads) == 2


def test_mesh_size_does_not_count_where_the_file_brings_its_tetrahedra(tmp_path: Path) -> None:
    (tmp_path / "a.msh").write_bytes(b"one")
    parameters = {"path": str(tmp_path / "a.msh")}
    assert geometry_key(shaped("file", 0.01, parameters), volume=True) == geometry_key(
        shaped("file", 0.02, parameters), volume=True
    )


def test_a_cached_mesh_comes_back_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    built = mesh_from_cache(BOX, tmp_path)
    monkeypatch.setattr("vdmbench.body.geometry.build_mesh", None)  # a second build would fail
    again = mesh_from_cache(BOX, tmp_path)
    assert again.content_hash == built.content_hash
    assert again.quality == built.quality
    names = [path.name for path in (tmp_path / "meshes").iterdir()]
    assert names == [f"{geometry_key(BOX, volume=True)}.npz"]
    with np.load(tmp_path / "meshes" / names[0]) as stored:  # numpy's own reader opens it
        assert_array_equal(stored["tetrahedra"], built.tetrahedra)
