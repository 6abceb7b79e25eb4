"""What has no room in memory is doubted, or refused before it runs."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.command import SMALL_STUDY
from vdmbench import models
from vdmbench.cli.main import main
from vdmbench.study.registry import MODELS
from vdmbench.work import explain


@pytest.fixture
def ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[[str, Any], tuple[int, str]]:
    """What a verb says of a study with a model that declares so much memory, and its exit code."""
    path = tmp_path / "small.toml"
    path.write_text(SMALL_STUDY.replace('"vdm-paper"', '"vdm-paper", "theirs"'))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(explain, "machine_memory", lambda: 25e9)

    def end(verb: str, memory: Any) -> tuple[int, str]:
        model = dataclasses.replace(models.find("vdm-vector")[0], name="theirs", memory=memory)
        monkeypatch.setitem(MODELS, "theirs", model)
        with pytest.raises(SystemExit) as ended:
            main([verb, str(path)])
        return int(ended.value.code or 0), " ".join("".join(capsys.readouterr()).split())

    return end


@pytest.mark.parametrize(("times", "ends_with"), [(0.5, 0), (1.5, 0), (4.9, 2)])
def test_more_memory_than_there_is_is_doubted_and_five_times_as_much_refused(
    ends: Callable[[str, Any], tuple[int, str]], times: float, ends_with: int
) -> None:
    told = (
        f"theirs on a mesh of sphere at 16 mm would take about {times * 25:,.0f} GB, and this machine has 25"
    )
    code, said = ends("check", lambda *_: times * 25e9)
    assert (code, told in said) == (ends_with, times > 1), said
    if ends_with:
        code, said = ends("run", lambda *_: times * 25e9)
        assert (code, told in said) == (ends_with, True), said


@pytest.mark.parametrize(
    ("formula", "why"),
    [
        (lambda *_: 1.0 / 0.0, "ZeroDivisionError"),
        (lambda *_: exit(0), "SystemExit(0)"),
        (lambda *_: float("nan"), "it says nan B"),
    ],
)
def test_a_formula_that_fails_is_told_by_the_name_of_its_model(
    ends: Callable[[str, Any], tuple[int, str]], formula: Any, why: str
) -> None:
    for verb in ("check", "plan", "run"):
        code, said = ends(verb, formula)
        assert code == 2, said
        assert "theirs: memory(size, solver) fails: " in said
        assert why in said
