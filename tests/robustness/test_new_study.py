"""`vdmbench new`: the study runs as it is, and nothing is overwritten."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from tests.command import do
from vdmbench.cli.arguments import parse
from vdmbench.study.config import expand, load_study
from vdmbench.study.files import shipped_studies


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_what_it_writes_is_sound_and_told_line_by_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert do(parse(["new", "palpation"])) == 0
    study = load_study(Path("palpation.toml"))
    assert study.study.name == "palpation"
    assert len(expand(study)) == 2
    assert do(parse(["check", "palpation.toml"])) == 0
    assert capsys.readouterr().out.endswith("palpation.toml: ok, 2 cases\n"), "without a doubt"
    text = Path("palpation.toml").read_text()
    assert "vdmbench run palpation.toml" in text
    assert text.count("#") > 15
    # the commented lines for a scan are sound too
    Path("liver.stl").write_text("")
    scan = text.replace('shape = "sphere"', "").replace('radius = "50 mm"', "")
    for key in ("shape", "path", "scale"):
        assert f"# {key} = " in scan
        scan = scan.replace(f"# {key} = ", f"{key} = ")
    Path("scan.toml").write_text(scan)
    assert load_study(Path("scan.toml")).geometry.scale == 0.001


@pytest.mark.parametrize("name", shipped_studies())
def test_every_shipped_study_can_be_copied(name: str) -> None:
    assert do(parse(["new", "folder/mine.toml", "--from", name])) == 0
    source, mine = (
        tomllib.loads(path.read_text()) for path in (shipped_studies()[name], Path("folder/mine.toml"))
    )
    assert mine["study"].pop("name") == "mine"
    assert source["study"].pop("name") == name
    assert mine == source


def test_files_that_a_study_names_come_along() -> None:
    Path("from").mkdir()
    Path("from/liver.stl").write_text("solid")
    text = '[study]\nmodels = ["vdm-paper"]\nname = \'old\'\n[geometry]\nshape = "file"\npath = "liver.stl"\n'
    Path("from/old.toml").write_text(text)
    assert do(parse(["new", "to/new", "--from", "from/old.toml"])) == 0
    assert Path("to/new.toml").read_text() == text.replace("'old'", '"new"')
    assert Path("to/liver.stl").read_text() == "solid"
    Path("from/old.toml").write_text(text.replace("liver.stl", "../secret"))
    with pytest.raises(ValueError, match=r"names '\.\./secret', which is no file beside it"):
        do(parse(["new", "other", "--from", "from/old.toml"]))


def test_nothing_is_overwritten() -> None:
    Path("mine.toml").write_text("precious")
    with pytest.raises(ValueError, match=r"mine.toml: is there already, and is not overwritten"):
        do(parse(["new", "mine"]))
    assert Path("mine.toml").read_text() == "precious"
    with pytest.raises(ValueError, match="letters, digits"):
        do(parse(["new", "my study"]))
