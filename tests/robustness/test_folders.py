"""No stored file says in which folder a surface lies: that may name a patient. Its name and its hash are enough."""

import hashlib
import json
from pathlib import Path

import meshio
import pytest

from tests.command import vdmbench, write_study
from tests.report.runs import icosphere
from vdmbench.store import cases as store
from vdmbench.study.files import text_without_folders

MODELS = ('["vdm-paper", "fem-linear"]', '["vdm-paper"]')
REFERENCE = ('reference = "fem-linear"\n', "")


def _surface(folder: Path) -> Path:
    folder.mkdir(parents=True)
    points, triangles = icosphere(2)
    meshio.Mesh(0.05 * points, [("triangle", triangles)]).write(folder / "ball.obj")
    return folder / "ball.obj"


@pytest.mark.usefixtures("read_here")
def test_no_stored_file_names_the_folder_of_a_surface_of_the_study(tmp_path: Path) -> None:
    surface = _surface(tmp_path / "Jane-Doe" / "scans")
    other = surface.with_name("other.obj")
    other.write_bytes(surface.read_bytes() + b"\n")
    work = tmp_path / "work"
    work.mkdir()
    sphere = ('shape = "sphere"\nradius = "50 mm"', f"shape = 'file'\npath = '{surface}'")
    sweep = ("[load]", f"[sweep]\n\"geometry.path\" = ['{surface}', '{other}']\n[load]")
    write_study(work, a=MODELS, b=REFERENCE, c=sphere, d=sweep)
    result = vdmbench("run", "small.toml", cwd=work)
    assert result.returncode == 0, result.stderr
    _assert_nobody_is_named(work / "results")
    (directory,) = (work / "results/runs").iterdir()
    case = store.read_run(directory).cases[0]
    assert str(case.study.geometry.path) == "ball.obj"
    assert case.provenance["geometry_file_hash"] == hashlib.sha256(surface.read_bytes()).hexdigest()
    assert vdmbench("report", directory, cwd=work).returncode == 0


def _assert_nobody_is_named(*folders: Path) -> None:
    for path in (path for folder in folders for path in folder.rglob("*") if path.is_file()):
        assert b"Jane-Doe" not in path.read_bytes(), path


@pytest.mark.usefixtures("read_here")
def test_no_stored_file_names_a_folder_of_the_command(tmp_path: Path) -> None:
    surface = _surface(tmp_path / "Jane-Doe" / "scans")
    write_study(surface.parent, a=MODELS, b=REFERENCE)
    words = ["Jane-Doe/scans/small.toml", "--surface", "Jane-Doe/scans/ball.obj", "--out", "Jane-Doe/out"]
    result = vdmbench("run", *words, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    out = tmp_path / "Jane-Doe" / "out"
    _assert_nobody_is_named(out, tmp_path / "results")
    plan = json.loads((out / "plan.json").read_text())
    assert plan["command"] == ["run", "small.toml", "--surface", "ball.obj", "--out", "out"]
    assert plan["surfaces"] == {hashlib.sha256(surface.read_bytes()).hexdigest(): "ball.obj"}
    again = json.loads(vdmbench("plan", *words, "--json", cwd=tmp_path).stdout)
    assert again["cases_to_run"] == 0
    assert again["directory"] == "Jane-Doe/out", "the terminal names it whole"


def test_only_absolute_paths_of_meshes_are_shortened() -> None:
    text = (
        """path = "/home/x/liver.stl"  # '~/y/a b.OBJ', "C:\\\\z\\\\q.ply"\nb = "a/b.stl"\nc = "/x/y.txt" """
    )
    short = """path = "liver.stl"  # 'a b.OBJ', "q.ply"\nb = "a/b.stl"\nc = "/x/y.txt" """
    assert text_without_folders(text) == short
