"""Mesh files that are broken, cut, mixed up or malicious: one clear line each, no output, no wrong mesh."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gmsh
import meshio
import numpy as np
import pytest
import pyvista as pv
from numpy.testing import assert_allclose, assert_array_equal

from solver_common.arrays import Array, Index
from tests.bodies import shaped
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh import Mesh
from vdmbench.body.topology import tetrahedron_volumes
from vdmbench.study.errors import MeshError
from vdmbench.work.plan import PlannedMesh

SUFFIXES = ["a.stl", "b.stl", "a.obj", "a.ply", "b.ply", "a.vtp", "b.vtp"]
VOLUMES = [
    "2.2-text.msh",
    "2.2-binary.msh",
    "4.1-text.msh",
    "4.1-binary.msh",
    "a.vtu",
    "b.vtu",
    "a.vtk",
    "b.vtk",
    "c.vtk",
]


pytestmark = pytest.mark.usefixtures("read_here")


@pytest.fixture(scope="module")
def ball() -> Mesh:
    return build_mesh(shaped("sphere", 0.02, {"radius": 0.05}))


def from_file(path: Path, **parameters: float) -> Mesh:
    return build_mesh(shaped("file", 0.025, {"path": str(path), **parameters}), volume=False)


def refused(path: Path, words: str, **parameters: float) -> None:
    """The file gives a MeshError of one line that names the file and matches `words`."""
    with pytest.raises(MeshError, match=words) as caught:
        from_file(path, **parameters)
    assert "\n" not in str(caught.value)
    assert path.name in str(caught.value)
    assert len(str(caught.value)) < 300


def write_surface(path: Path, points: Array, triangles: Index, *, binary: bool = True) -> Path:
    if path.suffix == ".obj":
        meshio.Mesh(points, [("triangle", triangles)]).write(path)
    else:
        pv.PolyData(points, faces=np.insert(triangles, 0, 3, axis=1).ravel()).save(path, binary=binary)
    return path


def write_named(path: Path, ball: Mesh) -> Path:
    """One of `SUFFIXES` (a binary, b text) or `VOLUMES`."""
    stem, suffix = path.stem, path.suffix
    if suffix in (".stl", ".obj", ".ply", ".vtp"):
        return write_surface(path, ball.surface_points, ball.triangles, binary=stem == "a")
    if suffix == ".msh":
        version, _, kind = stem.partition("-")
        return write_msh(
            path, ball.points, {4: ball.tetrahedra}, version=float(version), binary=kind == "binary"
        )
    if stem == "c":
        pv.UnstructuredGrid({10: ball.tetrahedra}, ball.points).save(path)
        return path
    mesh = meshio.Mesh(ball.points, [("tetra", ball.tetrahedra)])
    if suffix == ".vtu":
        meshio.vtu.write(path, mesh, binary=stem == "a")
    else:
        meshio.vtk.write(path, mesh, "4.2" if stem == "a" else "5.1", binary=stem == "a")
    return path


@contextlib.contextmanager
def gmsh_model(path: Path, **mesh_options: float) -> Iterator[Any]:
    """gmsh's model, to be filled; it is written at the end."""
    gmsh.initialize([], readConfigFiles=False, run=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        for name, value in mesh_options.items():
            gmsh.option.setNumber(f"Mesh.{name}", value)
        yield gmsh.model
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


def write_msh(
    path: Path, points: Array, cells: dict[int, Index], *, version: float = 4.1, binary: bool = False
) -> Path:
    """Elements by gmsh's type number, written by gmsh."""
    with gmsh_model(path, MshFileVersion=version, Binary=binary) as model:
        entity = model.addDiscreteEntity(3)
        model.mesh.addNodes(3, entity, np.arange(1, len(points) + 1), points.ravel())
        for kind, elements in cells.items():
            model.mesh.addElementsByType(entity, kind, [], (elements + 1).ravel())
    return path


# --- files that are not there, not readable, or not what their name says ------------------------------


@pytest.mark.parametrize("suffix", [".stl", ".msh"])
def test_the_size_of_a_mesh_is_known_before_it_is_made(tmp_path: Path, ball: Mesh, suffix: str) -> None:
    write_surface(tmp_path / "ball.stl", ball.surface_points, ball.triangles)
    write_msh(tmp_path / "ball.msh", ball.points, {4: ball.tetrahedra})
    for volume in (True, False):
        geometry = shaped("file", 0.012, {"path": str(tmp_path / f"ball{suffix}")})
        mesh = build_mesh(geometry, volume=volume)
        counted = [len(mesh.surface_nodes), len(mesh.tetrahedra)]
        size = PlannedMesh("", geometry, volume, tmp_path / "none.npz").size
        slack = 0.0 if suffix == ".msh" else 0.25
        assert_allclose([size.nodes, size.tetrahedra], counted, rtol=slack, atol=0.0)


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply", ".vtp", ".msh", ".vtu", ".vtk"])
def test_missing_empty_and_foreign_files(tmp_path: Path, suffix: str) -> None:
    refused(tmp_path / f"missing{suffix}", "No such file")
    directory = tmp_path / f"directory{suffix}"
    directory.mkdir()
    refused(directory, "Is a directory")
    for content in (b"", b"\x00\xff" * 300, b"<html>no</html>\n", b"1 2 3\n" * 50):
        foreign = tmp_path / f"foreign{suffix}"
        foreign.write_bytes(content)
        refused(foreign, "cannot be read|is not a|has no|holds no|header|three coordinates|cannot be read")


def test_scripts_are_not_run_whatever_they_are_called(tmp_path: Path, ball: Mesh) -> None:
    """gmsh takes a .msh that is none for a script, and obeys an option file beside a mesh."""
    trace = tmp_path / "trace"
    script = f'SystemCall "touch {trace}";\n'
    (tmp_path / "a.msh").write_text(script)
    refused(tmp_path / "a.msh", "is not a mesh file of gmsh")
    path = write_named(tmp_path / "4.1-text.msh", ball)
    (tmp_path / "4.1-text.msh.opt").write_text(script)
    from_file(path)
    assert not trace.exists()


# --- damage: cut and flipped --------------------------------------------------------------------------


@pytest.mark.parametrize("name", SUFFIXES + VOLUMES)
def test_sound_files_are_read_and_cut_ones_refused(
    tmp_path: Path, ball: Mesh, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """A cut file is refused, or gives the very same mesh (only its last blank was lost)."""
    path = write_named(tmp_path / name, ball)
    capfd.readouterr()
    whole = from_file(path)
    if path.name in VOLUMES:
        assert len(whole.surface_nodes) == len(ball.surface_nodes)
        assert_array_equal(whole.triangles, ball.triangles)
        assert_allclose(whole.surface_points, ball.surface_points, rtol=0, atol=1e-9)
    else:
        assert whole.quality["imported_points"] == len(ball.surface_nodes)
    data = path.read_bytes()
    cuts = {*range(0, len(data), max(len(data) // 40, 1)), *range(len(data) - 24, len(data))}
    survived = 0
    messages: list[str] = []
    for cut in sorted(cuts):
        path.write_bytes(data[:cut])
        try:
            assert from_file(path).content_hash == whole.content_hash, f"cut at {cut} of {len(data)}"
            survived += 1
        except MeshError as error:
            messages.append(str(error))
    assert survived < len(cuts) / 2
    assert not any("\n" in message for message in messages)
    assert capfd.readouterr() == ("", "")


# --- surfaces that bound no solid, or not well --------------------------------------------------------


def test_surfaces_that_cannot_be_meshed(tmp_path: Path, ball: Mesh) -> None:
    points, triangles = ball.surface_points, ball.triangles
    far = int(np.argmax(np.linalg.norm(points - points[triangles[0, 0]], axis=1)))
    inner_wall = np.concatenate([triangles, [[*triangles[0, :2], far]]])
    hole_in_numbers = np.where(np.arange(len(points))[:, None] == 3, np.nan, points)
    for number, (moved, facets, words) in enumerate(
        (
            (points, inner_wall, r"open, in 1 place \(2 edges"),
            (hole_in_numbers, triangles, "points have coordinates that are not finite"),
            (points * 1e300, triangles, r"coordinates that are not finite numbers below 1e\+100"),
            (points * 1000, triangles, "mixed-up unit; give geometry.size"),
            (points / 1000, triangles, "mixed-up unit; give geometry.size"),
        )
    ):
        refused(write_surface(tmp_path / f"{number}.ply", moved, facets), words)


def test_holes_and_pieces_are_told_with_place_and_size_and_repaired_on_request(
    tmp_path: Path, ball: Mesh
) -> None:
    points, triangles = ball.surface_points, ball.triangles
    top = np.argmax(points[:, 2])
    speck = 0.02 * points + [3.0 * points[:, 0].max(), 0.0, 0.0]
    holed = triangles[(triangles != top).all(axis=1)]
    both = np.concatenate([holed, triangles + len(points)])
    holes = write_surface(tmp_path / "holes.stl", points, holed)
    pieces = write_surface(tmp_path / "pieces.stl", np.concatenate([points, speck]), both)
    whole = from_file(write_surface(tmp_path / "ball.stl", points, triangles))
    refused(holes, r"is open, in 1 place \([0-9]+ edges about \(.*\), .* across\); .*fill-holes")
    extent = np.ptp(points)
    far = write_surface(tmp_path / "far.stl", 100.0 / extent * points + [1234.0, 0.0, 0.0], holed)
    refused(far, r"edges about \(12[0-9.]+, ")
    for path, repair, added, other in (
        (holes, "fill-holes", len(triangles) - len(holed) - 2, 0),
        (pieces, "both", len(triangles) - len(holed) - 2, len(triangles)),
    ):
        mesh = from_file(path, repair=repair)
        assert mesh.quality["facets_added"] == added
        assert mesh.quality["facets_of_other_pieces"] == other
        assert mesh.quality["volume"] == pytest.approx(whole.quality["volume"], rel=0.05)
    with pytest.raises(MeshError, match="is open"):
        from_file(pieces, repair="largest-piece")
    torn = write_surface(tmp_path / "torn.stl", points, triangles[np.arange(len(triangles)) % 4 > 0])
    refused(torn, 'is open, .*; repair = "fill-holes" does not close it: ', repair="fill-holes")


@pytest.mark.parametrize("name", ["a.stl", "a.vtp"])
def test_mesh_size_beyond_the_body_and_over_the_budget(tmp_path: Path, ball: Mesh, name: str) -> None:
    parameters = {"path": str(write_named(tmp_path / name, ball))}
    unit = f"the body is {np.ptp(ball.surface_points, axis=0).max():.3g} m across: "
    asked = f"{unit}if the file is not in metres give scale or size, else use"
    extent = "too large for a body whose smallest extent is .* m; "
    with pytest.raises(MeshError, match=f"{extent}{asked} at most") as large:
        build_mesh(shaped("file", 0.06, parameters))
    budget = "would give about .* nodes, more than the 2000000 allowed; "
    with pytest.raises(MeshError, match=f"{budget}{asked} a larger mesh_size$") as small:
        build_mesh(shaped("file", 1e-5, parameters))
    with pytest.raises(
        MeshError, match=f"{budget}{unit}if that is wrong correct scale, else use a larger mesh_size$"
    ):
        build_mesh(shaped("file", 1e-5, {**parameters, "scale": 1.0}))
    assert large.value.place == small.value.place == ("mesh_size",), "the file is sound"


def test_no_facets_or_other_cells(tmp_path: Path, ball: Mesh) -> None:
    points = ball.surface_points
    meshio.Mesh(points, [("line", ball.triangles[:, :2])]).write(tmp_path / "lines.vtk")
    refused(
        tmp_path / "lines.vtk", "holds no tetrahedra, or is damaged; give a volume mesh, or a surface as STL"
    )
    pv.PolyData(points).save(tmp_path / "points.vtp")
    refused(tmp_path / "points.vtp", "holds no facets")
    (tmp_path / "points.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    refused(tmp_path / "points.obj", "holds no facets")
    (tmp_path / "index.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 7\n")
    refused(tmp_path / "index.obj", "cannot be read as .obj")


def test_polygons_are_cut_into_triangles(tmp_path: Path) -> None:
    box = pv.Box((-0.05, 0.05, -0.05, 0.05, -0.05, 0.05)).clean()
    quads = box.faces.reshape(-1, 5)[:, 1:]
    lines = [f"v {x} {y} {z}" for x, y, z in box.points] + [
        "f " + " ".join(f"{corner + 1}/1/1" for corner in quad) for quad in quads
    ]
    (tmp_path / "a.obj").write_text("\n".join(["vt 0 0", "vn 0 0 1", *lines, ""]))
    header = ["ply", "format ascii 1.0", "comment a box", "element vertex 8", "property double x"]
    header += ["property double y", "property double z", "element face 6"]
    header += ["property list uchar int vertex_index", "property uchar red", "end_header"]
    rows = [" ".join(map(str, p)) for p in box.points] + [
        f"4 {' '.join(map(str, quad))} 255" for quad in quads
    ]
    (tmp_path / "a.ply").write_text("\n".join([*header, *rows, ""]))
    box.save(tmp_path / "a.vtp")
    for name in ("a.obj", "a.ply", "a.vtp"):
        mesh = from_file(tmp_path / name)
        assert mesh.quality["imported_points"] == 8
        assert mesh.quality["volume"] / (1 + mesh.quality["volume_change"]) == pytest.approx(1e-3, rel=1e-6)


# --- files with tetrahedra ----------------------------------------------------------------------------


def two_boxes(path: Path, version: float, binary: bool, save_all: bool) -> int:
    """Two unit boxes side by side with named, unnamed and overlapping groups; the number of tetrahedra."""
    options = {"MshFileVersion": version, "Binary": binary, "SaveAll": save_all, "MeshSizeMax": 0.5}
    with gmsh_model(path, **options) as model:
        occ = model.occ
        occ.fragment([(3, occ.addBox(0, 0, 0, 1, 1, 1))], [(3, occ.addBox(1, 0, 0, 1, 1, 1))])
        occ.synchronize()

        def inside(x0: float, x1: float, y1: float) -> list[int]:
            corners = (x0 - 0.01, -0.01, -0.01, x1 + 0.01, y1 + 0.01, 1.01)
            return [tag for _, tag in model.getEntitiesInBoundingBox(*corners, 2)]

        left, front = inside(0, 0, 1), inside(0, 2, 0)
        for dim, members, name in (
            (2, left, "left side"),
            (2, left + front, "left and front"),
            (3, [1], "first"),
            (3, [2], ""),
            (3, [1, 2], "all"),
            (0, [1], "corner"),
        ):
            model.setPhysicalName(dim, model.addPhysicalGroup(dim, members), name)
        model.mesh.generate(3)
        return len(model.mesh.getElementsByType(4)[0])


@pytest.mark.parametrize(
    ("version", "binary", "save_all"),
    [(2.2, True, False), (4.1, False, False), (4.1, True, True)],
)
def test_physical_groups_become_masks_of_surface_nodes(
    tmp_path: Path, version: float, binary: bool, save_all: bool
) -> None:
    path = tmp_path / "boxes.msh"
    tetrahedra = two_boxes(path, version, binary, save_all)
    mesh = build_mesh(shaped("file", 0.01, {"path": str(path), "scale": 0.1}))
    assert len(mesh.tetrahedra) == tetrahedra
    assert_allclose(tetrahedron_volumes(mesh.points, mesh.tetrahedra).sum(), 2e-3, rtol=1e-12, atol=0)
    x, y, z = 10 * mesh.surface_points.T
    near = 1e-9
    expected = {
        "left side": x < near,
        "left and front": (x < near) | (y < near),
        "first": x < 1 + near,
        "volume-4": x > 1 - near,
        "all": np.ones(len(x), dtype=bool),
        "corner": (x < near) & (y < near) & (z > 1 - near),
    }
    assert set(mesh.groups) == set(expected)
    for name, mask in expected.items():
        assert_array_equal(mesh.groups[name], mask, err_msg=name)
    surface = build_mesh(shaped("file", 0.01, {"path": str(path), "scale": 0.1}), volume=False)
    assert_array_equal(surface.surface_points, mesh.surface_points)
    assert_array_equal(surface.groups["left side"], mesh.groups["left side"])


def test_groups_keep_their_nodes_where_others_are_dropped(tmp_path: Path, ball: Mesh) -> None:
    """A node of no tetrahedron stands before all others in the file."""
    upper = np.flatnonzero(ball.points[:, 2] > 0.02)
    points, tetrahedra = np.concatenate([[[0.0, 0.0, 1.0]], ball.points]), ball.tetrahedra + 1
    path = tmp_path / "groups.msh"
    with gmsh_model(path, SaveAll=1) as model:
        body, part = model.addDiscreteEntity(3), model.addDiscreteEntity(0)
        model.mesh.addNodes(3, body, np.arange(1, len(points) + 1), points.ravel())
        model.mesh.addElementsByType(body, 4, [], (tetrahedra + 1).ravel())
        model.mesh.addElementsByType(part, 15, [], upper + 2)
        model.setPhysicalName(0, model.addPhysicalGroup(0, [part]), "upper")
    mesh = from_file(path)
    assert mesh.quality["points_dropped"] == 1
    assert_array_equal(mesh.groups["upper"], mesh.surface_points[:, 2] > 0.02)
    assert_allclose(mesh.points.min(axis=0), ball.points.min(axis=0), rtol=0, atol=1e-15)


def test_tetrahedra_are_turned_and_scaled_or_refused(tmp_path: Path, ball: Mesh) -> None:
    """What is wrong with arrays is in `test_mesh`."""

    def written(name: str, points: Array, tetrahedra: Index) -> Path:
        pv.UnstructuredGrid({10: tetrahedra}, points).save(tmp_path / f"{name}.vtu")
        return tmp_path / f"{name}.vtu"

    points, tetrahedra = ball.points, ball.tetrahedra
    mirrored = tetrahedra[:, [1, 0, 2, 3]]
    some = np.concatenate([mirrored[:7], tetrahedra[7:]])
    refused(written("some", points, some), f"7 of {len(tetrahedra)} tetrahedra are inverted")
    orphans = np.concatenate([points, [[0.0, 0, 1], [0, 0, 2]]])
    turned = from_file(written("all", orphans, mirrored))
    assert turned.quality["tetrahedra_turned"] == len(tetrahedra)
    assert turned.quality["points_dropped"] == 2
    assert turned.quality["volume"] == pytest.approx(ball.quality["volume"], rel=1e-9)
    half = tetrahedra[points[tetrahedra].mean(axis=1)[:, 2] > 0.01]
    two = np.concatenate([points, points + np.array([0, 0, 0.2])]), np.concatenate([half, half + len(points)])
    refused(written("apart", *two), "separate pieces, in 2 places|not manifold")
    refused(written("metres", points * 1000, tetrahedra), "mixed-up unit; give geometry.size")
    scaled = from_file(tmp_path / "metres.vtu", size=0.1)
    assert_allclose(np.ptp(scaled.points, axis=0).max(), 0.1, rtol=1e-12, atol=0)


def test_other_cells_are_named(tmp_path: Path) -> None:
    cube = np.array([[x, y, z] for z in (0.0, 0.1) for x, y in ((0, 0), (0.1, 0), (0.1, 0.1), (0, 0.1))])
    hexahedron = np.arange(8)[None]
    write_msh(tmp_path / "hexahedron.msh", cube, {5: hexahedron})
    refused(tmp_path / "hexahedron.msh", "holds hexahedron 8 cells; only four-node")
    quadratic = np.concatenate([np.eye(4)[:, 1:], np.random.default_rng(0).random((6, 3))]) * 0.1
    write_msh(tmp_path / "quadratic.msh", quadratic, {11: np.arange(10)[None]})
    refused(tmp_path / "quadratic.msh", "holds tetrahedron 10 cells")
    for suffix in (".vtu", ".vtk"):
        grid = pv.UnstructuredGrid({12: hexahedron, 10: np.array([[0, 1, 2, 4]])}, cube)
        grid.save(tmp_path / f"mixed{suffix}")
        refused(tmp_path / f"mixed{suffix}", "holds vtkhexahedron cells; only four-node")
        pv.UnstructuredGrid({24: np.arange(10)[None]}, quadratic).save(tmp_path / f"quadratic{suffix}")
        refused(tmp_path / f"quadratic{suffix}", "holds vtkquadratictetra cells")


def test_too_many_nodes_in_a_file(tmp_path: Path, ball: Mesh, monkeypatch: pytest.MonkeyPatch) -> None:
    geometry = shaped("file", 0.01, {"path": str(write_named(tmp_path / "a.vtu", ball))})
    other = geometry.model_copy(update={"mesh_size": 5.0})
    assert build_mesh(other).content_hash == build_mesh(geometry).content_hash
    monkeypatch.setattr("vdmbench.body.imported.MAX_NODES", 50)
    with pytest.raises(MeshError, match=f"has {len(ball.points)} nodes, more than the 50 allowed"):
        build_mesh(geometry)
