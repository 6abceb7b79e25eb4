"""What `vdmbench check` tells of a scene before anything is solved, and the picture that `show` makes of it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from matplotlib.image import imread

from tests.command import do, write_study
from vdmbench.cli.arguments import parse
from vdmbench.study.errors import Problem

BASE, FINGER = 'below = { axis = "z", fraction = 0.2 }', 'cap = { direction = [0, 0, 1], angle = "30 deg" }'
THIN = 'shape = "box"\nsize = ["100 mm", "100 mm", "20 mm"]'
BALL = ('shape = "sphere"\nradius = "50 mm"', THIN)
CASES: dict[str, tuple[list[tuple[str, str]], int, str]] = {
    "a region off the body": (
        [(FINGER, 'ball = { center = [0, 0, 1], radius = "20 mm" }')],
        2,
        "small.toml:19: regions.finger: region 'finger' lies off the body",
    ),
    "a support that the body does not reach": (
        [(BASE, 'below = { axis = "z", value = "-60 mm" }')],
        2,
        "small.toml:17: regions.base: region 'base' selects no node of the mesh: the body has",
    ),
    "a contact on the support": (
        [(BASE, 'below = { axis = "z", fraction = 0.99 }')],
        2,
        "small.toml:25: constraints.finger: contact 'finger' covers",
    ),
    "a load that the run refuses to judge": (
        [('"0.1 N"', '"5 N"')],
        0,
        "small.toml:25: constraints.finger: presses with 5 N, which by linear theory moves the surface by 0.",
    ),
    "a modulus of bone": (
        [('"5 kPa"', '"5 GPa"')],
        0,
        "small.toml:14: tissue.youngs_modulus: 5 GPa is stiffer than tendon",
    ),
    "a sound scene": ([], 0, ""),
    "a ball on both faces of a plate": (
        [
            BALL,
            ('"16 mm"', '"8 mm"'),
            (FINGER, 'ball = { center = ["45 mm", 0, 0], radius = "30 mm" }'),
            (BASE, 'below = { axis = "x", fraction = 0.05 }'),
        ],
        0,
        "small.toml:28: constraints.finger.region: presses opposite sides of the body",
    ),
}


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", CASES)
def test_a_scene_is_told_with_file_and_line(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    changes, code, told = CASES[name]
    write_study(Path(), **{f"change{k}": change for k, change in enumerate(changes)})
    assert do(parse(["check", "small.toml", "--json"])) == code
    found = json.loads(capsys.readouterr().out)["problems" if code else "warnings"]
    assert [str(Problem(**each)).startswith(told) for each in found] == ([True] if told else [])


def test_a_doubt_is_told_in_words_too(capsys: pytest.CaptureFixture[str]) -> None:
    write_study(Path(), stiff=CASES["a modulus of bone"][0][0])
    assert do(parse(["check", "small.toml"])) == 0
    assert f"warning: {CASES['a modulus of bone'][2]}" in capsys.readouterr().out


def test_a_scene_is_drawn_before_anything_is_solved(capsys: pytest.CaptureFixture[str]) -> None:
    write_study(Path())
    assert do(parse(["show", "small.toml"])) == 0
    told = capsys.readouterr().out
    assert "Contact: finger, 0.1 N, hertz pressure" in told
    assert "picture: small-scene.png" in told
    picture = imread("small-scene.png")
    # colours of support and contact are there: told apart by blue and by red
    red, green, blue = (picture[..., k] for k in range(3))
    assert ((blue - red > 0.2) & (blue > green)).sum() > 500
    assert ((red - blue > 0.2) & (red > green)).sum() > 500
    assert not Path("results").exists(), "nothing is solved, nothing is kept"
    with pytest.raises(ValueError, match="--case 2: the study has 1 cases"):
        do(parse(["show", "small.toml", "--case", "2"]))
