"""No stored file says in which folder a surface lies: that may name a patient. Its name and its hash are enough."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import meshio
import pytest

from tests.command import vdmbench, write_study
from tests.unit.report_runs import icosphere
from vdmbench.store import cases as store
from vdmbench.study.folders import text_without_folders

MODELS = ('["vdm-paper", "fem-linear"]', '["vdm-paper"]')
REFERENCE = ('reference = "fem-linear"\n', "")


def _surface(folder: Path) -> Path:
    folder.mkdir(parents=True)
    points, triangles = icosphere(2)
    meshio.Mesh(0.05 * points, [("triangle", triangles)]).write(folder / "ball.obj")
    return folder / "ball.obj"


@pytest.mark.parametrize("how", ["option", "study", "sweep"])
def test_no_stored_file_names_the_folder_of_a_surface(tmp_path: Path, how: str) -> None:
    surface = _surface(tmp_path / "Jane-Doe" / "scans")
    work = tmp_path / "work"
    work.mkdir()
    sphere = ('shape = "sphere"\nradius = "50 mm"', f"shape = 'file'\npath = '{surface}'")
    own = {} if how == "option" else {"c": sphere}
    if how == "sweep":
        own["d"] = (
            "[load]",
            f"[sweep]\n\"geometry.path\" = ['{surface}', '{surface.with_name('other.obj')}']\n[load]",
        )
        surface.with_name("other.obj").write_bytes(surface.read_bytes() + b"\n")
    write_study(work, a=MODELS, b=REFERENCE, **own)
    extra = ["--surface", surface] if how == "option" else ["--allow-outside"]
    result = vdmbench("run", "small.toml", *extra, cwd=work)
    assert result.returncode == 0, result.stderr
    results = work / "results"
    for path in (path for path in results.rglob("*") if path.is_file()):
        assert b"Jane-Doe" not in path.read_bytes(), path
    (directory,) = (results / "runs").iterdir()
    run = store.read_run(directory)
    case = run.cases[0]
    assert case.resolved["geometry"]["path"] == "ball.obj"
    assert case.provenance["geometry_file_hash"] == hashlib.sha256(surface.read_bytes()).hexdigest()
    assert vdmbench("report", directory, cwd=work).returncode == 0


def test_no_stored_file_names_a_folder_of_the_command(tmp_path: Path) -> None:
    surface = _surface(tmp_path / "Jane-Doe" / "scans")
    write_study(surface.parent, a=MODELS, b=REFERENCE)
    words = ["Jane-Doe/scans/small.toml", "--surface", "Jane-Doe/scans/ball.obj", "--out", "Jane-Doe/out"]
    result = vdmbench("run", *words, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    out = tmp_path / "Jane-Doe" / "out"
    for path in (
        path for folder in (out, tmp_path / "results") for path in folder.rglob("*") if path.is_file()
    ):
        assert b"Jane-Doe" not in path.read_bytes(), path
    plan = json.loads((out / "plan.json").read_text())
    assert plan["command"] == ["run", "small.toml", "--surface", "ball.obj", "--out", "out"]
    assert plan["directory"] == "out"
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
