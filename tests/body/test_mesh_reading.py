"""Mesh files that end their reader, ask for too much or were changed at random: read, or refused in one line.

The changes come from a seeded generator, so that a failure is found again by its number.
"""

import faulthandler
import os
import resource
from pathlib import Path

import numpy as np
import pytest
import pyvista as pv

from tests.bodies import shaped
from tests.command import write_study
from vdmbench.body import read_apart
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh import Mesh
from vdmbench.body.read_apart import clean_of, read_clean
from vdmbench.body.topology import mesh_from_tetrahedra, mesh_from_triangles
from vdmbench.cli.main import main
from vdmbench.study.errors import MeshError

from .test_mesh_files import SUFFIXES, VOLUMES, write_named

VTP = (
    '<?xml version="1.0"?><VTKFile type="{kind}" version="0.1" byte_order="LittleEndian"><PolyData>'
    '<Piece NumberOfPoints="{points}" NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0" NumberOfPolys="1">'
    '{arrays}<Points><DataArray type="Float64" NumberOfComponents="3" format="ascii">0 0 0 1 0 0 0 1 0</DataArray>'
    '</Points><Polys><DataArray type="Int64" Name="connectivity" format="ascii">{corners}</DataArray>'
    '<DataArray type="Int64" Name="offsets" format="ascii">{offsets}</DataArray></Polys></Piece></PolyData>'
    "</VTKFile>"
)
LEGACY = (
    "# vtk DataFile Version 4.2\nx\nASCII\nDATASET UNSTRUCTURED_GRID\n{body}"
    "POINTS 4 double\n0 0 0 .1 0 0 0 .1 0 0 0 .1\nCELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n10\n"
)


def vtp(
    kind: str = "PolyData",
    points: object = 3,
    corners: str = "0 1 2",
    offsets: object = 3,
    arrays: str = "",
) -> bytes:
    return VTP.format(kind=kind, points=points, corners=corners, offsets=offsets, arrays=arrays).encode()


def legacy(old: str = "", new: str = "") -> bytes:
    text = LEGACY.format(body="")
    assert old in text
    return text.replace(old, new, 1).encode()


def many_properties(count: int) -> bytes:
    lines = [f"property float p{n}" for n in range(count)]
    return "\n".join(
        ["ply", "format ascii 1.0", "element vertex 1", *lines, "end_header", "0 " * count, ""]
    ).encode()


CRASH = vtp(offsets=300_000_000)  # VTK asks for the memory and ends the process
HOSTILE = {
    "corner.vtp": vtp(corners="0 1 999999999"),
    "points.vtp": vtp(points=10**9),
    "digits.vtp": vtp(points="9" * 5000),
    "arrays.vtp": vtp(arrays="<DataArray/>" * 1001),
    "polygon.vtp": vtp(corners="0 1 2 " * 4000, offsets=12000),
    "points.vtk": legacy("POINTS 4", f"POINTS {10**9}"),
    "cells.vtk": legacy("CELLS 1 5", f"CELLS 1 {10**9}"),
    "types.vtk": legacy("CELL_TYPES 1", f"cell_types {10**9}"),
    "field.vtk": legacy() + f"POINT_DATA 4\nFIELD f 1\nx {10**5} {10**5} double\n1\n".encode(),
    "other.vtk": b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET STRUCTURED_POINTS\nDIMENSIONS 9999 9999 9999\n",
    "surface.vtk": b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 3 double\n0 0 0 1 0 0 0 1 0\n",
    "many.ply": many_properties(100_000),
    "elements.ply": b"ply\nformat ascii 1.0\n" + b"element x 0\n" * 1001 + b"end_header\n",
}


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork")
def test_what_would_break_a_reader_is_refused(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(HOSTILE[name])
    told = read_in_a_fork(path)
    assert told != "sound"
    assert told.isprintable()


def test_the_command_tells_a_file_that_ends_its_reader(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "liver.vtp").write_bytes(CRASH)
    shape = ('shape = "sphere"\nradius = "50 mm"', 'shape = "file"\npath = "liver.vtp"')
    write_study(tmp_path, shape=shape)
    with pytest.raises(SystemExit) as ended:
        main(["check", "small.toml"])
    told = capsys.readouterr().err
    assert ended.value.code == 2, told
    assert told.startswith("vdmbench: small.toml:10: geometry.path: liver.vtp: ends its reader with signal")
    assert told.count("\n") == 1


@pytest.fixture
def ball(tmp_path: Path) -> Path:
    path = tmp_path / "ball.ply"
    pv.Icosphere(radius=0.05, nsub=3).save(path)
    return path


def test_a_sound_file_is_read_apart_as_it_is_here(ball: Path) -> None:
    apart, here = clean_of(ball), read_clean(ball)
    assert vars(apart).keys() == vars(here).keys()
    for name, value in vars(here).items():
        np.testing.assert_array_equal(getattr(apart, name), value, err_msg=name, strict=True)


def test_reading_has_an_end(ball: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(read_apart, "SECONDS", 0.01)
    with pytest.raises(MeshError, match="takes more than 0 s to read; it is damaged or of another kind"):
        clean_of(ball)


def test_reading_has_a_limit_of_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Points of 4.8 MB take that and more; what this process may take stays as it was."""
    path = tmp_path / "large.ply"
    header = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 200000\nproperty double x\nproperty double y\n"
    )
    path.write_bytes(f"{header}property double z\nend_header\n".encode() + os.urandom(4_800_000))
    before = resource.getrlimit(resource.RLIMIT_DATA)
    monkeypatch.setattr(read_apart, "MEMORY", 4_000_000)
    monkeypatch.setattr(read_apart, "MEMORY_PER_BYTE", 0)
    with pytest.raises(MeshError, match=r"takes more than 0\.0 GB of memory to read"):
        clean_of(path)
    assert resource.getrlimit(resource.RLIMIT_DATA) == before
    monkeypatch.setattr(read_apart, "MEMORY", 1_000_000_000)
    with pytest.raises(MeshError, match="holds no facets"):
        clean_of(path)


WORDS = (b"-1", b"0", b"9999999999", b"nan", b"1e999", b"4294967296", b"-9223372036854775808", b"\xff" * 8)


@pytest.fixture(scope="module")
def small_ball() -> Mesh:
    return build_mesh(shaped("sphere", 0.025, {"radius": 0.05}))


def changed(data: bytes, rng: np.random.Generator) -> bytes:
    """One to four changes, half of them in the first 400 bytes, where the counts and kinds stand."""
    for _ in range(rng.integers(1, 5)):
        end = len(data) if rng.random() < 0.5 else min(400, len(data))
        at, length = int(rng.integers(0, end)), int(rng.choice([1, 4, 8, 100]))
        words = [at for at in range(min(end, 2000)) if data[at : at + 1].isdigit()]
        match rng.choice(["flip", "cut", "double", "word", "number"]):
            case "flip":
                data = data[:at] + rng.bytes(1) + data[at + 1 :]
            case "cut":
                data = data[:at] + data[at + length :]
            case "double":
                data = data[:at] + data[at : at + length] * int(rng.choice([2, 1000])) + data[at + length :]
            case "number" if words:
                at = int(rng.choice(words))
                data = data[:at] + rng.choice(np.array(WORDS, dtype=object)) + data[at + 1 :]
            case _:
                data = data[:at] + rng.choice(np.array(WORDS, dtype=object)) + data[at + length :]
    return data


def read(path: Path) -> str:
    """ "sound" where the file is read, and then checked, else the sentence that refuses it."""
    try:
        body = read_clean(path)
        if body.cells.shape[1] == 4:
            mesh = mesh_from_tetrahedra(body.points, body.cells, groups=body.groups)
        else:
            mesh = mesh_from_triangles(body.points, body.cells)
    except MeshError as error:
        return str(error)
    except MemoryError:
        return "takes more memory than it may"
    sound = np.isfinite(mesh.points).all() and mesh.quality["volume"] > 0
    return "sound" if sound else "neither read nor refused\n"


def read_in_a_fork(path: Path) -> str:
    """The same in a process of its own, which a reader may end."""
    answer, told = os.pipe()
    child = os.fork()
    if not child:
        faulthandler.disable()
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        # beside what the tests before have taken
        pages = [int(word) for word in Path("/proc/self/statm").read_text().split()]
        resource.setrlimit(resource.RLIMIT_AS, (resource.getpagesize() * pages[0] + 6_000_000_000,) * 2)
        resource.setrlimit(resource.RLIMIT_DATA, (resource.getpagesize() * pages[5] + 2_500_000_000,) * 2)
        resource.setrlimit(resource.RLIMIT_CPU, (20, 20))
        try:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            os.write(told, read(path).encode())
        except BaseException as error:  # noqa: BLE001
            os.write(told, f"neither read nor refused\n{error!r}".encode())
        os._exit(0)
    os.close(told)
    with os.fdopen(answer, "rb") as file:
        data = file.read()
    _, status = os.waitpid(child, 0)
    return f"ends its reader with signal {os.WTERMSIG(status)}" if os.WIFSIGNALED(status) else data.decode()


@pytest.mark.parametrize("name", SUFFIXES + VOLUMES)
@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork")
def test_a_changed_mesh_file_is_read_or_refused(tmp_path: Path, small_ball: Mesh, name: str) -> None:
    whole = write_named(tmp_path / name, small_ball)
    data = whole.read_bytes()
    assert read(whole) == read_in_a_fork(whole) == "sound"  # here too, so that its readers are loaded once
    answers = []
    for number in range(8):
        path = tmp_path / f"changed-{name}"
        path.write_bytes(changed(data, np.random.default_rng(number)))
        answer = read_in_a_fork(path)
        assert answer.isprintable(), (number, answer)
        assert 0 < len(answer) < 300, number
        answers.append(answer)
    assert any(answer != "sound" for answer in answers)
    assert sum("signal" in answer for answer in answers) < 5, answers
