"""Results have room in a case file, in memory and on the disk; what has none is refused before it runs."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest

from tests.command import SMALL_STUDY, write_study
from vdmbench import models
from vdmbench.cli.main import main
from vdmbench.report.rebuild import rebuild
from vdmbench.study.errors import StudyError
from vdmbench.study.registry import MODELS, Size
from vdmbench.work import room
from vdmbench.work.explain import summary
from vdmbench.work.plan import Plan
from vdmbench.work.room import case_bytes, stored_bytes
from vdmbench.work.run import Event, Options, RunError, run_plan

from . import shared_work
from .shared_work import plan_of, run

cache, meshes = shared_work.cache, shared_work.meshes  # the fixtures
LONG = {"factors": [k / 10_000 for k in range(1, 10_001)]}


def _plan(directory: Path, **tables: object) -> Plan:
    return plan_of(directory / "run", directory / "cache", sweep={}, **tables)


def test_the_bytes_of_a_case_are_those_of_its_fields(tmp_path: Path) -> None:
    (case,) = _plan(tmp_path, load=LONG).cases
    results = len(case.study.study.models) + (case.study.uncertainty is not None)
    assert case_bytes(case, Size(100.0, 0.0)) == 2 * 3 * 8 * 100 * 10_000 * results


def test_what_a_plan_stores_is_what_a_run_stores(tmp_path: Path) -> None:
    plan = plan_of(tmp_path / "run", tmp_path / "cache")
    expected = stored_bytes(plan, plan.cases)
    run(plan)
    files = [path for part in ("run", "cache") for path in (tmp_path / part).rglob("*") if path.is_file()]
    assert 1 / 3 < expected / sum(path.stat().st_size for path in files) < 3


def _refused(plan: Plan, words: str) -> None:
    assert any(words in line for line in summary(plan)["refused"]), summary(plan)["refused"]
    with pytest.raises(RunError, match=words):
        run_plan(plan, "", Options(1), lambda _: None, rebuild)
    assert not (plan.directory / "plan.json").exists()


def test_a_case_beyond_a_file_is_refused_before_it_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = _plan(tmp_path, load=LONG)
    assert summary(plan)["refused"] == []
    monkeypatch.setattr(room, "MAX_CASE_BYTES", 1_000_000)
    _refused(plan, "of a case file; use fewer")


def test_results_beyond_the_disk_are_refused_before_they_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = _plan(tmp_path, load=LONG)
    monkeypatch.setattr(room, "free_bytes", lambda _: 1_000_000)
    _refused(plan, "of disk left; make room")


def test_the_disk_of_a_directory_that_is_not_there_is_its_parent_s(tmp_path: Path) -> None:
    assert room.free_bytes(tmp_path / "a" / "b") > 0


@pytest.mark.parametrize(
    ("tetrahedra", "measured"), [(1032, 220), (4292, 305), (8256, 472), (17520, 808), (34336, 1304)]
)
def test_finite_strain_declares_the_memory_that_it_takes(tetrahedra: float, measured: float) -> None:
    """Peak in MB of a process, of 130 MB without work, that solves one load of the shipped slab."""
    law = models.find("fem")[0].memory
    assert law is not None
    assert 130e6 + law(Size(0.0, tetrahedra), "linear") == pytest.approx(1e6 * measured, rel=0.25, abs=0)


@pytest.fixture
def theirs(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Registers a model of another package with this formula of its memory."""

    def register(memory: Any) -> None:
        about = models.find("vdm-vector")[0]
        model = dataclasses.replace(about, name="theirs", benched=(), memory=memory)
        monkeypatch.setitem(MODELS, "theirs", model)

    return register


def _theirs(tmp_path: Path) -> str:
    path = tmp_path / "small.toml"
    path.write_text(SMALL_STUDY.replace('"vdm-paper"', '"vdm-paper", "theirs"'))
    return str(path)


def _command(*words: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(list(words))
    return int(ended.value.code or 0)


@pytest.mark.parametrize(("times", "ends"), [(0.5, 0), (1.5, 0), (4.9, 2)])
def test_what_takes_more_memory_than_there_is_is_doubted_and_five_times_as_much_refused(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    theirs: Any,
    times: float,
    ends: int,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(room, "machine_memory", lambda: 25e9)
    theirs(lambda _size, _solver: times * 25e9)
    study = _theirs(tmp_path)
    assert _command("check", study) == ends
    told = _plain("".join(capsys.readouterr()))
    assert (f"would take about {times * 25:,.0f} GB, and this machine has 25" in told) == (times > 1)
    assert ("theirs on a mesh" in told) == (times > 1)
    if ends:
        assert _command("run", study) == ends
        assert "and this machine has 25" in _plain(capsys.readouterr().err)
        assert _command("plan", study) == 0
        assert "will be refused: theirs on a mesh" in _plain(capsys.readouterr().out)


def _plain(told: str) -> str:
    return " ".join(told.split())


def _raise(*_: object) -> float:
    return 1.0 / 0.0


def test_a_formula_that_raises_costs_no_other_model_and_is_told_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], theirs: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    study = _theirs(tmp_path)
    said = "theirs: the memory that it takes is not known, as its formula"
    for formula, why in (
        (_raise, "raises ZeroDivisionError: float division by zero"),
        (lambda *_: exit(0), "raises SystemExit: 0"),
        (lambda *_: float("nan"), "says nan B"),
    ):
        theirs(formula)
        for verb in ("check", "plan"):
            assert _command(verb, study) == 0
            assert f"{said} {why}" in _plain("".join(capsys.readouterr())), verb
    plan = plan_of(tmp_path / "run", tmp_path / "cache", study={"name": "test", "models": ["theirs", "bem"]})
    heard: list[Event] = []
    monkeypatch.setattr(room, "machine_memory", lambda: 1e3)
    monkeypatch.setitem(MODELS, "bem", dataclasses.replace(MODELS["bem"], memory=lambda *_: 1e6))
    with pytest.raises(StudyError, match="bem"):  # which is heard of as if it were alone
        run_plan(plan, "", Options(1), heard.append, rebuild)
    assert any(event.message.startswith(f"warning: {said} says nan B") for event in heard)


def test_plan_tells_what_is_free_beside_what_it_stores(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(room, "free_bytes", lambda _: 1_230_000_000)
    write_study(tmp_path)
    for options in ((), ("--json",)):
        assert _command("plan", "small.toml", *options) == 0
        told = capsys.readouterr().out
        assert ('"disk_free": 1230000000' if options else "MB (1.23 GB free)") in told
        assert not options or '"stored_bytes": ' in told
