"""Every mistake in a study file is told with its line, its key and a sentence that helps: see `mistakes.toml`."""

import tomllib
from pathlib import Path

import pytest

from vdmbench.study.config import StudyError, geometry_error
from vdmbench.study.errors import MeshError
from vdmbench.work.plan import make_plan

from .study_texts import CURVE, POINTS, SMALL, SWEPT, TIPS, load, problems

TABLE = tomllib.loads(Path(__file__).with_name("mistakes.toml").read_text())
BASES = {"small": SMALL, "swept": f"{SWEPT}[sweep]\n", "pressed": TIPS, "points": POINTS, "curve": CURVE}


@pytest.mark.parametrize(
    ("base", "old", "new", "told"),
    [(base, *row[:2], row[2:]) for base, rows in TABLE.items() for row in rows],
)
def test_a_mistake_is_told(tmp_path: Path, base: str, old: str, new: str, told: list[str]) -> None:
    sound = BASES[base]
    assert old in sound or old == "*"
    wrong = new if old == "*" else sound.replace(old, new, 1) if old else sound + new
    for name in ("a.geo", "a.step", "a.stl"):
        (tmp_path / name).touch()
    of_file = base in ("points", "curve")
    (tmp_path / "tips.csv").write_text(wrong if of_file else CURVE)
    found = problems(tmp_path, TIPS if of_file else wrong)
    assert [f"{line}: {key}: {message}" for line, key, message in found] == told


@pytest.mark.parametrize("table", [POINTS, CURVE])
def test_the_texts_are_sound(tmp_path: Path, table: str) -> None:
    (tmp_path / "tips.csv").write_text(table)
    for text in (SMALL, SWEPT, TIPS):
        load(tmp_path, text)


def test_what_only_the_mesher_finds_is_told_of_a_solid_at_its_shape(tmp_path: Path) -> None:
    """A solid has no path."""
    [problem] = geometry_error(load(tmp_path, SMALL), MeshError("gmsh cannot mesh this geometry")).problems
    assert (problem.line, problem.key) == (5, "geometry.shape")


def test_too_many_nodes_are_told_where_the_mesh_size_is_swept(tmp_path: Path) -> None:
    """By the key itself: `tests/robustness/test_command_line.py`."""
    study = load(tmp_path, f'{SWEPT}[sweep]\n"geometry.mesh_size" = [6e-3, 1e-4]\n')
    with pytest.raises(StudyError, match=r"would give about 2.3e\+06 nodes, more than the 2000000") as caught:
        make_plan(study, tmp_path / "run", tmp_path / "cache")
    (problem,) = caught.value.problems
    assert (problem.line, problem.key) == (27, 'sweep."geometry.mesh_size"')
