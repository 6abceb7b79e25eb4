"""Whatever the study file holds, it is a Study or a StudyError with sentences: never another exception."""

import json
import os
import tomllib
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.study.study_texts import FULL
from vdmbench.study.config import Study, StudyError, expand, load_study, resolved
from vdmbench.study.files import shipped_studies

BASE = tomllib.loads(FULL)
# every table of a study, in what is shipped and needs no other file
BASES = [
    BASE,
    *(
        tomllib.loads(text)
        for path in shipped_studies().values()
        if "path = " not in (text := path.read_text())
    ),
]


def attempt(path: Path) -> StudyError | None:
    """Load and expand a study file; the error, after a look at its sentences, where there is one."""
    try:
        study = load_study(path)
        for case in expand(study):
            json.dumps(resolved(case.study), allow_nan=False)
        Study.model_validate(resolved(study))
    except StudyError as error:
        found = error
    else:
        return None
    lines = path.read_bytes().count(b"\n") + 1
    assert found.problems
    for problem in found.problems:
        assert 1 <= problem.line <= lines
        assert problem.message
        assert str(problem).replace(str(path), "").isprintable()
        assert len(str(problem)) < 2000
    return found


def fails(path: Path, content: bytes | str) -> str:
    """The one problem of a file with this content."""
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    error = attempt(path)
    [problem] = error.problems
    return f"{problem.line}: {problem.key}: {problem.message}"


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("study") / "study.toml"


def test_the_base_of_these_tests_is_sound(path: Path) -> None:
    path.write_text(tomli_w.dumps(BASE))
    assert attempt(path) is None


# --- files ---


def test_a_byte_order_mark_and_windows_line_ends_are_fine(path: Path) -> None:
    text = tomli_w.dumps(BASE)
    path.write_text(text)
    plain = resolved(load_study(path))
    path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    assert resolved(load_study(path)) == plain


def test_a_file_that_cannot_be_read_is_told(tmp_path: Path) -> None:
    for name, message in (
        ("none.toml", "does not exist"),
        (".", "is not a file"),
        ("x" * 300, "cannot be read: File name too long"),
        ("a\0b", "is not a usable path"),
        ("none.toml/x", "does not exist"),
    ):
        with pytest.raises(StudyError) as caught:
            load_study(tmp_path / name)
        assert caught.value.problems[0].message == message
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    with pytest.raises(StudyError, match="is not a file"):
        load_study(fifo)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"a = 1\nb = '\xff'\n", "2: : is not UTF-8 text; save the file in UTF-8"),
        ("a = 1".encode("utf-16"), "1: : is not UTF-8 text"),
        ("\n\na = = 1", "3: : TOML syntax: invalid value"),
        ("a = 1\n\n[b", "3: : TOML syntax: expected"),
        ("a = 1\na = 2", "2: : TOML syntax: cannot overwrite a value"),
        ("a = 2020-13-40", "1: : TOML syntax: "),
        ("a = 1\nb = \x00", "2: : TOML syntax: "),
        ("#" * 1_000_001, "1: : is larger than 1 MB"),
        ("a = 1\nb = " + "[" * 5000 + "]" * 5000, "2: : nested more than 64 levels deep"),
        ("a = 1\nb = " + "[" * 300 + "]" * 300, "2: : nested more than 64 levels deep"),
        ("b = " + "{a=" * 5000 + "1" + "}" * 5000, "1: : nested more than 64 levels deep"),
        ("\n" + "a." * 5000 + "a = 1", "2: : nested more than 64 levels deep"),
        ("[" + "a." * 5000 + "a]", "1: : nested more than 64 levels deep"),
        ("[" * 5000, "1: : nested more than 64 levels deep"),
        ("\nb = " + "1" * 5000, "2: : a number is too long"),
        ("\nb = -" + "1_1" * 2500, "2: : a number is too long"),
    ],
    ids=lambda value: repr(value[:20]),
)
def test_a_file_that_cannot_be_parsed_is_told(path: Path, content: bytes | str, message: str) -> None:
    assert fails(path, content).startswith(message)


def test_a_table_that_says_no_kind_is_told_the_kinds(path: Path) -> None:
    unkind = {**BASE, "geometry": {key: v for key, v in BASE["geometry"].items() if key != "shape"}}
    told = fails(path, tomli_w.dumps(unkind))
    assert "geometry.shape: is missing: kind of body, one of sphere, ellipsoid, " in told


# --- anything at all ---

AWKWARD = [
    0,
    1,
    -1,
    0.5,
    1e-300,
    1e300,
    "",
    "5 kPa",
    "50 mm",
    "-3 mm",
    "25 deg",
    "1e999 m",
    "9 **",
    "nan",
    "\0",
]
WORDS = (
    "base finger sphere box file organ contact fixed z zip latin-hypercube ../.. . study.toml /dev/null <b>"
)
PLACES = (
    "constraints.tip.pressure tissue.poisson_ratio geometry.radius geometry.shape load.factors.0 vdm.rotation"
)
NAMES = "start stop num scale mode samples seed above below cap tip base name region tissue force size path"
VALUES = st.one_of(
    st.booleans(),
    st.integers(-(10**20), 10**20),
    st.floats(),
    st.sampled_from([*AWKWARD, *WORDS.split(), *PLACES.split(), "a" * 5000, "\u2028"]),
    st.text(max_size=8),
    st.dates(),
)
KEYS = st.sampled_from([*NAMES.split(), *PLACES.split()]) | st.text(max_size=6)
TREES = st.recursive(
    VALUES, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=4), max_leaves=8
)


def places(tree: Any, at: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    pairs = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    return [at, *(place for key, value in pairs for place in places(value, (*at, key)))]


def changed(tree: Any, at: tuple[str | int, ...], change: str, key: str, value: Any) -> Any:
    """A copy of `tree` with one place set, removed, or given one more item."""
    if not at:
        if change == "add" and isinstance(tree, dict):
            return {**tree, key: value}
        return [*tree, value] if change == "add" and isinstance(tree, list) else value
    first, rest = at[0], at[1:]
    if isinstance(tree, dict):
        if change == "remove" and not rest:
            return {k: v for k, v in tree.items() if k != first}
        return {k: changed(v, rest, change, key, value) if k == first else v for k, v in tree.items()}
    if change == "remove" and not rest:
        return [v for k, v in enumerate(tree) if k != first]
    return [changed(v, rest, change, key, value) if k == first else v for k, v in enumerate(tree)]


@st.composite
def mutated(draw: st.DrawFn) -> dict[str, Any]:
    tree: Any = draw(st.sampled_from(BASES))
    for _ in range(draw(st.integers(1, 4))):
        tables = ("limits", "calibration", "anisotropy", "uncertainty", "models", "sweep")
        somewhere = places(tree)[1:] or [("study",)]
        newer = [place for place in somewhere if place[0] in tables] or somewhere
        at = draw(st.sampled_from(newer) | st.sampled_from(somewhere))
        change = draw(st.sampled_from(["set", "set", "add", "remove"]))
        value = draw(
            TREES | st.sampled_from([BASE[k] for k in ("regions", "limits", "constraints", "study")])
        )
        tree = changed(tree, at, change, draw(KEYS), value)
    assert isinstance(tree, dict)
    return tree


def never_breaks(path: Path, contents: st.SearchStrategy[bytes], count: int) -> None:
    """So many files with such contents are studies, or told to be none."""

    @settings(max_examples=count)
    @given(contents)
    def read(content: bytes) -> None:
        path.write_bytes(content)
        attempt(path)

    read()


@pytest.mark.parametrize(
    "data",
    [
        {**BASE, "regions": {"": {}}},
        {**BASE, "geometry": 5, "sweep": {"geometry.mesh_size": [1]}},
        {**BASE, "constraints": {"tip": {}}},
        {**BASE, "constraints": [{**BASE["constraints"][1], "pressure": [200]}]},
        {**BASE, "sweep": {"study": {"start": 1}}},
    ],
)
def test_a_study_that_once_broke_the_reader_is_told(path: Path, data: dict[str, Any]) -> None:
    path.write_text(tomli_w.dumps(data), encoding="utf-8")
    assert attempt(path) is not None


@pytest.mark.parametrize("count", [75, pytest.param(5000, marks=pytest.mark.slow)])
def test_a_mutated_study_never_breaks_the_reader(path: Path, count: int) -> None:
    never_breaks(path, mutated().map(tomli_w.dumps).map(str.encode), count)


@st.composite
def damaged_texts(draw: st.DrawFn) -> str:
    """A study's text with pieces cut out, put in, or repeated many times over."""
    text = tomli_w.dumps(BASE)
    for _ in range(draw(st.integers(1, 3))):
        start = draw(st.integers(0, len(text)))
        length = draw(st.sampled_from([0, 1, 1, 2, 10, 1000]))
        patch = draw(st.text("[]{}=.,'\"#\\ab1 \n\r\t\0é_-", max_size=4))
        times = draw(st.sampled_from([1, 1, 1, 100, 10_000]))
        text = text[:start] + patch * times + text[start + length :]
    return text


@pytest.mark.parametrize("count", [200, pytest.param(5000, marks=pytest.mark.slow)])
def test_a_damaged_text_never_breaks_the_reader(path: Path, count: int) -> None:
    never_breaks(path, damaged_texts().map(str.encode), count)


@settings(max_examples=100)
@given(st.binary(max_size=60))
def test_any_bytes_never_break_the_reader(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    assert attempt(path) is not None  # no 60 bytes are a study
