"""What goes with a release says what the program says: verbs, versions, libraries, the commands of the workflow."""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path

import pytest
import yaml

from vdmbench.cli.arguments import parse, verbs
from vdmbench.study.errors import LIBRARIES

ROOT = Path(__file__).parents[2]


def test_every_verb_is_in_the_manual() -> None:
    text = (ROOT / "docs/reference/commands.md").read_text()
    told = set(re.findall(r"`([a-z]+)(?: [^`]*)?`", text.split("## Exit codes")[0]))
    assert verbs().keys() - told == set()


def test_the_citation_has_the_version_and_the_licence_of_the_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == project["version"]
    assert citation["license"] == project["license"]
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()
    assert (ROOT / "CHANGELOG.md").read_text().count(f"## {project['version']}") == 1


@pytest.mark.parametrize("name", ["Containerfile", "docs/howto/gate-workflow.yml"])
def test_the_libraries_are_those_that_an_error_names(name: str) -> None:
    text = (ROOT / name).read_text()
    assert set(re.findall(r"\blib[a-z0-9-]+\b", text)) - {"libraries"} == set(LIBRARIES)


def test_the_commands_of_the_workflow_are_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    workflow = yaml.safe_load((ROOT / "docs/howto/gate-workflow.yml").read_text())
    steps = [step.get("run", "") for step in workflow["jobs"]["gate"]["steps"]]
    commands = [step for step in steps if step.startswith("vdmbench ")]
    assert [shlex.split(command)[1] for command in commands] == ["check", "run", "gate"]
    monkeypatch.chdir(tmp_path)
    Path("results/runs/mine/cases").mkdir(parents=True)
    for command in commands:
        parse(shlex.split(command)[1:])


def test_a_container_has_only_what_is_there() -> None:
    text = (ROOT / "Containerfile").read_text()
    assert (ROOT / "constraints.txt").exists()
    assert "/src/constraints.txt" in text
    assert 'ENTRYPOINT ["vdmbench"]' in text
    shipped = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["data-files"]
    left_out = (ROOT / ".containerignore").read_text().split()
    for path in ("constraints.txt", *(name for names in shipped.values() for name in names)):
        assert not [name for name in left_out if f"{path}/".startswith(f"{name}/")], f"the image needs {path}"
