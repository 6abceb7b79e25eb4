"""Mesh files that end their reader, or ask for more than there is: one line that names the file, and no harm."""

from __future__ import annotations

import os
import resource
from pathlib import Path

import numpy as np
import pytest
import pyvista as pv

from tests.command import write_study
from vdmbench.body import read_apart
from vdmbench.body.read_apart import clean_of, read_clean
from vdmbench.cli.main import main
from vdmbench.study.errors import MeshError

from .test_mutated_meshes import read_apart as read_in_a_fork

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


@pytest.mark.parametrize("verb", ["check", "run"])
def test_the_command_tells_a_file_that_ends_its_reader(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], verb: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "liver.vtp").write_bytes(CRASH)
    shape = ('shape = "sphere"\nradius = "50 mm"', 'shape = "file"\npath = "liver.vtp"')
    write_study(tmp_path, shape=shape)
    with pytest.raises(SystemExit) as ended:
        main([verb, "small.toml"])
    told = capsys.readouterr().err
    assert ended.value.code == 2, told
    assert "liver.vtp: ends its reader with signal" in told
    if verb != "run":
        assert told.startswith("vdmbench: small.toml:10: geometry.path: liver.vtp: ")
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
    """A million points take 24 MB and more; what this process may take stays as it was."""
    path = tmp_path / "large.ply"
    header = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 1000000\nproperty double x\nproperty double y\n"
    )
    path.write_bytes(f"{header}property double z\nend_header\n".encode() + os.urandom(24_000_000))
    before = resource.getrlimit(resource.RLIMIT_DATA)
    monkeypatch.setattr(read_apart, "MEMORY", 20_000_000)
    monkeypatch.setattr(read_apart, "MEMORY_PER_BYTE", 0)
    with pytest.raises(MeshError, match=r"takes more than 0\.0 GB of memory to read"):
        clean_of(path)
    assert resource.getrlimit(resource.RLIMIT_DATA) == before
    monkeypatch.setattr(read_apart, "MEMORY", 1_000_000_000)
    with pytest.raises(MeshError, match="holds no facets"):
        clean_of(path)
