"""What a run replaces is its own: directories of others, links and special files are refused before it begins."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.command import vdmbench, write_study


def _content(directory: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in directory.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("verb", "name"),
    [
        *(("run", name) for name in ("report.html", "plan.json", "cases/notes")),
        *((verb, "study.toml") for verb in ("plan", "calibrate")),
    ],
)
def test_a_directory_of_others_is_left_as_it_is(tmp_path: Path, verb: str, name: str) -> None:
    write_study(tmp_path)
    (tmp_path / "mine" / name).parent.mkdir(parents=True)
    (tmp_path / "mine" / name).write_text('{"resource": 1}')
    (tmp_path / "mine" / "thesis.tex").write_text("x")
    before = _content(tmp_path)
    result = vdmbench(verb, "small.toml", "--out", "mine", cwd=tmp_path)
    assert result.returncode == 2
    assert "mine: is not empty and not a" in result.stderr
    assert _content(tmp_path) == before


@pytest.mark.parametrize("verb", ["plan", "run", "calibrate", "bench"])
def test_no_directory_is_not_the_working_directory(tmp_path: Path, verb: str) -> None:
    write_study(tmp_path)
    result = vdmbench(verb, "small.toml", "--out", "", cwd=tmp_path)
    assert result.returncode == 2
    assert "--out: name a place" in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["small.toml"]
