"""`--set KEY=VALUE`: a study with some of its values changed on the command line."""

import shlex
from pathlib import Path
from typing import Any

import pytest

from tests.command import vdmbench, write_study
from vdmbench.store import cases as store
from vdmbench.study.errors import InputError
from vdmbench.study.files import changes_of, merged


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("a.b=3 kPa", {"a": {"b": "3 kPa"}}),
        ("a.b='3 kPa'", {"a": {"b": "3 kPa"}}),
        ("a = 0.45", {"a": 0.45}),
        ('sweep."a.b"=[1, 2]', {"sweep": {"a.b": [1, 2]}}),
        ('a=say "no"', {"a": 'say "no"'}),
    ],
)
def test_a_value_is_toml_or_a_text(text: str, found: object) -> None:
    assert changes_of(text) == found


@pytest.mark.parametrize("text", ["a", "a=", "=1", "a b=1"])
def test_what_is_no_change_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="write KEY=VALUE"):
        changes_of(text)


def test_quotes_that_a_colon_needs_are_told() -> None:
    with pytest.raises(InputError) as refused:
        changes_of("models.bem:nonlinear.parts=8")
    *_, remedy = shlex.split(str(refused.value))
    assert changes_of(remedy) == {"models": {"bem:nonlinear": {"parts": 8}}}
    assert changes_of("a.b=1:2") == {"a": {"b": "1:2"}}


def test_an_empty_table_makes_what_is_not_there() -> None:
    assert merged({"a": {"b": 1}}, {"a": {}, "c": {}}) == {"a": {"b": 1}, "c": {}}
    assert merged({"a": 1}, {"a": {}}) == {"a": {}}, "told as a mistake"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"a": {"x": 1}}, 'a is a value and has no key "x"'),
        ({"v": {"2": None}}, "v.2 is one of a list"),
        ({"v": {2: 0.0}}, "names its key by a text, not by a whole number"),
    ],
)
def test_a_change_that_leads_nowhere_is_refused(change: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError, match=told):
        merged({"a": 1, "v": [0, 0, 1]}, change)


def test_the_changed_study_runs_and_says_how_to_repeat_it(tmp_path: Path) -> None:
    write_study(tmp_path)
    changed = ("--set", "tissue.youngs_modulus=7 kPa", "--set", "tissue.poisson_ratio=0.45")
    result = vdmbench("run", "small.toml", *changed, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    run = store.read_run(tmp_path / "results/runs/small")
    for study in (run.study, *(case.study for case in run.cases)):
        assert (study.tissue.youngs_modulus, study.tissue.poisson_ratio) == (7000.0, 0.45)
    assert "7 kPa" in run.study_text
    assert run.plan["command"] == ["run", "small.toml", *changed]


def test_a_wrong_change_is_told_by_its_key(tmp_path: Path) -> None:
    write_study(tmp_path)
    for verb in ("check", "show", "run"):
        result = vdmbench(verb, "small.toml", "--set", "tissue.youngs_modulus=-3 kPa", cwd=tmp_path)
        assert result.returncode == 2
        assert "tissue.youngs_modulus" in result.stderr
        assert "small.toml:14: " in result.stderr, "the line of the file"


def test_a_change_of_a_swept_key_is_refused(tmp_path: Path) -> None:
    write_study(tmp_path, a=("[load]", '[sweep]\n"tissue.poisson_ratio" = [0.45, 0.49]\n[load]'))
    refused = vdmbench("check", "small.toml", "--set", "tissue.poisson_ratio=0.3", cwd=tmp_path)
    assert refused.returncode == 2
    assert 'change sweep."tissue.poisson_ratio" instead' in refused.stderr
    axis = 'sweep."tissue.poisson_ratio"=[0.3]'
    plan = vdmbench("plan", "small.toml", "--set", axis, cwd=tmp_path)
    assert "missing  poisson_ratio = 0.3\n" in plan.stdout
