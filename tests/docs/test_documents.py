"""The documents are true: commands run, tables are what is printed, links lead somewhere; so does a release."""

import json
import pkgutil
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import pyvista
import yaml

from tests.command import vdmbench
from tools import documents, site
from vdmbench.body.geometry import build_mesh
from vdmbench.cli.arguments import parse, verbs
from vdmbench.study.config import expand, load_study
from vdmbench.study.errors import LIBRARIES

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


def test_every_verb_is_in_the_manual() -> None:
    text = (documents.ROOT / "docs/reference/commands.md").read_text()
    told = set(re.findall(r"`([a-z]+)(?: [^`]*)?`", text.split("## Exit codes")[0]))
    assert verbs().keys() - told == set()


def test_the_citation_has_the_version_and_the_licence_of_the_package() -> None:
    project = tomllib.loads((documents.ROOT / "pyproject.toml").read_text())["project"]
    citation = yaml.safe_load((documents.ROOT / "CITATION.cff").read_text())
    assert citation["version"] == project["version"]
    assert citation["license"] == project["license"]
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()
    assert (documents.ROOT / "CHANGELOG.md").read_text().count(f"## {project['version']}") == 1


@pytest.mark.parametrize("name", ["Containerfile", "docs/howto/gate-workflow.yml"])
def test_the_libraries_are_those_that_an_error_names(name: str) -> None:
    text = (documents.ROOT / name).read_text()
    assert set(re.findall(r"\blib[a-z0-9-]+\b", text)) - {"libraries"} == set(LIBRARIES)


def test_the_commands_of_the_workflow_are_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    workflow = yaml.safe_load((documents.ROOT / "docs/howto/gate-workflow.yml").read_text())
    steps = [step.get("run", "") for step in workflow["jobs"]["gate"]["steps"]]
    commands = [step for step in steps if step.startswith("vdmbench ")]
    assert [shlex.split(command)[1] for command in commands] == ["check", "run", "gate"]
    monkeypatch.chdir(tmp_path)
    Path("results/runs/mine/cases").mkdir(parents=True)
    for command in commands:
        parse(shlex.split(command)[1:])


def test_a_container_has_only_what_is_there() -> None:
    text = (documents.ROOT / "Containerfile").read_text()
    assert (documents.ROOT / "constraints.txt").exists()
    assert "/src/constraints.txt" in text
    assert 'ENTRYPOINT ["vdmbench"]' in text
    shipped = tomllib.loads((documents.ROOT / "pyproject.toml").read_text())["tool"]["setuptools"][
        "data-files"
    ]
    left_out = (documents.ROOT / ".containerignore").read_text().split()
    for path in ("constraints.txt", *(name for names in shipped.values() for name in names)):
        assert not [name for name in left_out if f"{path}/".startswith(f"{name}/")], f"the image needs {path}"


# --- the two libraries ---


@pytest.mark.parametrize(("package", "count"), [("vdm", 1), ("fem_reference", 2)])
def test_examples_of_the_libraries_run(package: str, count: int) -> None:
    """One after the other: the second goes on from the first."""
    examples = blocks("python", documents.ROOT / package / "README.md")
    assert len(examples) == count
    exec(compile("".join(examples), "README.md", "exec"), {})


def test_every_equation_of_the_paper_has_code_with_a_docstring_and_a_test() -> None:
    text = (documents.ROOT / "vdm" / "README.md").read_text()
    tests = "\n".join(path.read_text() for path in (documents.ROOT / "tests").glob("*/test_vdm_*.py"))
    numbers: set[int] = set()
    for told, path, test in re.findall(
        r"^\| ([^|]+) \| `(vdm\.[\w.]+)` \| `(test_\w+)` \|$", text, re.MULTILINE
    ):
        assert pkgutil.resolve_name(path).__doc__, path
        assert f"def {test}(" in tests
        for first, last in re.findall(r"(\d+)(?:-(\d+))?", told):
            numbers |= set(range(int(first), int(last or first) + 1))
    assert numbers == set(range(1, 39))
