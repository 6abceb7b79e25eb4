"""Before anything is solved: `new`, `check`, `show`, how a study is found, whose directory a run may take."""

import json
import tomllib
from pathlib import Path

import pytest
from matplotlib.image import imread

from tests.command import do, vdmbench, write_study
from vdmbench.cli.arguments import parse
from vdmbench.cli.studies import make_plan
from vdmbench.study.config import expand, load_study
from vdmbench.study.errors import InputError, Problem
from vdmbench.study.files import shipped_studies, study_path

BASE, FINGER = 'below = { axis = "z", fraction = 0.2 }', 'cap = { direction = [0, 0, 1], angle = "30 deg" }'
THIN = 'shape = "box"\nsize = ["100 mm", "100 mm", "20 mm"]'
BALL = ('shape = "sphere"\nradius = "50 mm"', THIN)
CASES: dict[str, tuple[list[tuple[str, str]], int, str]] = {
    "a region off the body": (
        [(FINGER, 'ball = { center = [0, 0, 1], radius = "20 mm" }')],
        2,
        "small.toml:19: regions.finger: region 'finger' selects no node of the mesh; enlarge it",
    ),
    "a support that the body does not reach": (
        [(BASE, 'below = { axis = "z", value = "-60 mm" }')],
        2,
        "small.toml:17: regions.base: region 'base' selects no node of the mesh; enlarge it",
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
    "a scene without a load": (
        [('"0.1 N"', '"0 N"')],
        0,
        "small.toml:22: constraints: nothing loads the body: every answer is zero",
    ),
    "the weight of a scan alone": (
        [
            (
                '["vdm-paper", "fem-linear"]\nreference = "fem-linear"',
                '["bem:nonlinear", "fem"]\nreference = "fem"',
            ),
            ('"0.1 N"', '"0 N"'),
            ("[load]", "[gravity]\nacceleration = [0, 0, -9.81]\nscanned = true\n[load]"),
        ],
        0,
        "small.toml:22: constraints: nothing but the weight of its scan loads the body: every answer is zero",
    ),
    "steps of a weight alone": (
        [('"0.1 N"', '"0 N"'), ("[load]", "[gravity]\nacceleration = [0, 0, -9.81]\n[load]")],
        0,
        "small.toml:34: load: every step is the same, as no factor acts on the weight",
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
    assert [path.name for path in Path("results/cache").iterdir()] == ["meshes"], "nothing is solved"
    (mesh,) = make_plan(load_study(Path("small.toml")), parse(["plan", "small.toml"])).meshes.values()
    assert mesh.path.exists(), "kept for the run"
    with pytest.raises(ValueError, match="--case 2: the study has 1 cases"):
        do(parse(["show", "small.toml", "--case", "2"]))
    with pytest.raises(InputError, match=r"ends in \.png"):
        do(parse(["show", "small.toml", "--save", "scene.xyz"]))
    assert not Path("scene.xyz").exists()


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


def test_a_name_that_is_nearly_right_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_study(tmp_path)
    assert study_path("quickstart") == shipped_studies()["quickstart"]
    assert study_path("small.toml") == Path("small.toml")
    for wrong, told in [
        ("quikstart", 'did you mean "quickstart"'),
        ("smal.toml", 'did you mean "small.toml"'),
        ("small", 'did you mean "small.toml"'),
        ("zzz", "known: small.toml, accuracy-box, "),
        ("../cases/quickstart", 'did you mean "quickstart"'),
    ]:
        with pytest.raises(InputError, match=told):
            study_path(wrong)


def test_the_cache_is_where_it_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = str(write_study(tmp_path))
    study = load_study(Path(path))
    monkeypatch.delenv("VDMBENCH_RESULTS", raising=False)
    monkeypatch.delenv("VDMBENCH_CACHE", raising=False)
    assert make_plan(study, parse(["plan", path])).cache == Path("results/cache")
    monkeypatch.setenv("VDMBENCH_RESULTS", "elsewhere")
    assert make_plan(study, parse(["plan", path])).cache == Path("elsewhere/cache")
    monkeypatch.setenv("VDMBENCH_CACHE", "shared")
    assert make_plan(study, parse(["plan", path])).cache == Path("shared")
    assert make_plan(study, parse(["plan", path, "--cache", "mine"])).cache == Path("mine")


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
