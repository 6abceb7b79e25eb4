"""The documents are true: their commands run, their tables are what is printed, their links lead somewhere."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import pyvista

from tests.command import vdmbench
from tools import documents, site
from vdmbench.body.geometry import build_mesh
from vdmbench.study.config import expand, load_study

pytestmark = pytest.mark.usefixtures("read_here")

TEXT = documents.README.read_text()
DOCS = documents.ROOT / "docs"
DOCUMENTS = sorted({*(documents.ROOT / home for home in site.ELSEWHERE), *DOCS.rglob("*.md")})


def blocks(language: str, document: Path = documents.README) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", document.read_text(), flags=re.MULTILINE | re.DOTALL)


def test_the_result_table_is_what_the_command_prints_and_a_notebook_reads_it(
    quickstart: Path, tmp_path: Path
) -> None:
    shutil.copytree(quickstart, tmp_path, dirs_exist_ok=True)
    table = documents.headline_table(tmp_path)
    assert table == documents.shown(documents.README, "quickstart"), "run `make docs` and look at it"
    assert documents.NOTEBOOK.read_text() == documents.notebook(), "run `make docs`"
    cells = json.loads(documents.NOTEBOOK.read_text())["cells"]
    notebook = "\n".join(cell["source"] for cell in cells if cell["cell_type"] == "code")
    reading, without_us = re.findall(
        r"```python\n(.*?)```", (documents.ROOT / "results/FORMAT.md").read_text(), re.DOTALL
    )
    code = (
        f"import pyvista\npyvista.OFF_SCREEN = True\n{notebook}\nprint(*error, *ratio, case.n_points)\n"
        f"{reading}\nprint(*error, *u.shape)\nread = error, u\n"
        f"{without_us}\nassert (error == read[0]).all()\nassert (u == read[1].reshape(-1, 3)).all()"
    )
    told = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, check=True, capture_output=True, text=True
    )
    by_notebook, by_format = told.stdout.splitlines()
    *numbers, nodes = (float(word) for word in by_notebook.split())
    assert sorted(numbers[6:]) == [0.45, 0.45, 0.49, 0.49, 0.4999, 0.4999]
    worst = next(row for row in documents.cells(table) if row[0] == "vdm-vector")[1].split("worst ")[1]
    assert f"{100 * max(numbers[:6]):.1f} %" == worst.replace("\u00a0", " ")
    assert nodes == 487
    *errors, steps, points, components = by_format.split()
    assert 0.7 < float(errors[-1]) < 0.8, "of vdm-paper, as in the table"
    assert [int(steps), points, components] == [len(errors), "487", "3"]


def test_the_first_study_and_its_commands(tmp_path: Path) -> None:
    (study,) = blocks("toml")
    assert len(study.splitlines()) <= 10, "ten lines were promised"
    assert study.count('"9 mm"') == 1
    (tmp_path / "mine.toml").write_text(study.replace('"9 mm"', '"14 mm"'))
    (commands,) = (block for block in blocks("sh") if "check mine.toml" in block)
    for line in commands.splitlines():
        words = shlex.split(line, comments=True)
        assert words[0] == "vdmbench"
        result = vdmbench(*words[1:], cwd=tmp_path)
        assert result.returncode == 0, f"{line}\n{result.stderr}"
    assert (tmp_path / "results/runs/mine/report.html").exists()
    found = json.loads(vdmbench("report", "results/runs/mine", "--json", cwd=tmp_path).stdout)
    assert list(found["metrics"]) == [
        "vdm-paper",
        "vdm-vector",
        "bem",
        "fem-linear",
        "fem-linear refined",
    ]
    error = found["metrics"]["bem"]["relative_l2_displacement_error"]
    assert 0 < error["bar"] < error["value"] < 0.15, "a usable model, and an error bar that tells so"


def test_a_surface_of_ones_own(tmp_path: Path, liver: Path) -> None:
    (command,) = (block for block in blocks("sh") if "--surface" in block)
    words = shlex.split(command, comments=True)
    (tmp_path / "liver.obj").write_bytes(liver.read_bytes())
    assert vdmbench("check", *words[2:], cwd=tmp_path).returncode == 0
    plan = json.loads(vdmbench("plan", *words[2:], "--json", cwd=tmp_path).stdout)
    assert plan["cases_to_run"] == 1


def test_the_front_page_is_short() -> None:
    assert len(TEXT.split()) <= 700


def test_the_tutorial(tmp_path: Path) -> None:
    """On the procedural organ, written as a surface."""
    study = load_study(documents.ROOT / "studies" / "cases" / "liver-palpation.toml")
    mesh = build_mesh(expand(study)[0].study.geometry)
    faces = np.column_stack([np.full(len(mesh.triangles), 3), mesh.triangles])
    pyvista.PolyData(mesh.surface_points, faces).save(tmp_path / "liver.stl")
    tutorial = DOCS / "tutorial.md"
    lines = [line for block in blocks("sh", tutorial) for line in block.splitlines()]
    (accepted,) = blocks("toml", tutorial)
    for line in lines:
        words = shlex.split(line.replace("liver.obj", "liver.stl"), comments=True)
        result = vdmbench(*words[1:], cwd=tmp_path)
        assert result.returncode == 0, f"{line}\n{result.stderr}"
        if words[1] == "new":
            text = (tmp_path / "mine.toml").read_text()
            coarse, count = re.subn(r'mesh_size = "\d+ mm"', 'mesh_size = "20 mm"', text)
            assert count == 1
            (tmp_path / "mine.toml").write_text(f"{coarse}\n{accepted}")
    assert "VDM as printed: " in result.stdout
    assert (tmp_path / "scene.png").is_file()
    assert (tmp_path / "results/runs/mine-liver/report.html").is_file()


def test_links_lead_somewhere() -> None:
    for path in DOCUMENTS:
        for target in re.findall(r"\]\(([^)#]+)\)", path.read_text()):
            assert target.startswith("http") or (path.parent / target).exists(), (path, target)


def test_the_site_is_built(tmp_path: Path) -> None:
    """Strictly: a link or a page that is missing is an error."""
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", str(tmp_path / "site")]
    told = subprocess.run(command, cwd=documents.ROOT, capture_output=True, text=True)
    assert told.returncode == 0, told.stderr
    front = (tmp_path / "site" / "index.html").read_text()
    assert 'href="reference/study-keys/"' in front
    assert "studies/STUDY.md" not in front


def test_the_key_reference_is_the_schema() -> None:
    assert documents.STUDY_KEYS.read_text() == documents.study_keys(), "run `make docs`"


def test_exit_codes_are_those_of_the_program() -> None:
    from vdmbench.cli import output as cli

    text = (DOCS / "reference" / "commands.md").read_text()
    documented = {int(code) for code in re.findall(r"^\| (\d+) \|", text, flags=re.MULTILINE)}
    own = {cli.OK, cli.REGRESSED, cli.USAGE, cli.FAILED, cli.MACHINE, cli.DAMAGED, cli.NOTHING_COMPARED}
    assert documented == own | {cli.BUG, cli.INTERRUPTED}


def test_every_shipped_study_is_listed_with_its_title(tmp_path: Path) -> None:
    listed = vdmbench("list", cwd=tmp_path).stdout
    for path in (documents.ROOT / "studies" / "cases").glob("*.toml"):
        assert path.stem in listed


def test_every_model_is_in_the_table() -> None:
    from vdmbench.models import all_models
    from vdmbench.study.registry import Family

    text = (DOCS / "reference" / "models.md").read_text()
    assert set(re.findall(r"^\| `((?:vdm|bem|fem|mass)[a-z0-9-]*)` \|", text, flags=re.MULTILINE)) == {
        name for name, model in all_models().items() if model.family is not Family.ENGINES
    }
