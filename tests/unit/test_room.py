"""Results have room in a case file, in memory and on the disk; what has none is refused before it runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.command import write_study
from tests.work.shared_work import plan_of
from vdmbench.cli.main import main
from vdmbench.report.rebuild import rebuild
from vdmbench.study.registry import Size
from vdmbench.work import estimate as room
from vdmbench.work.estimate import case_bytes, estimate
from vdmbench.work.explain import summary
from vdmbench.work.plan import Plan
from vdmbench.work.run import Options, RunError, run_plan

LONG = {"factors": [k / 10_000 for k in range(1, 10_001)]}


def _plan(directory: Path, **tables: object) -> Plan:
    return plan_of(directory / "run", directory / "cache", sweep={}, **tables)


def test_the_bytes_of_a_case_are_those_of_its_fields(tmp_path: Path) -> None:
    (case,) = _plan(tmp_path, load=LONG).cases
    results = len(case.study.study.models) + (case.study.uncertainty is not None)
    assert case_bytes(case, Size(100.0, 0.0)) == 2 * 3 * 8 * 100 * 10_000 * results


def test_the_load_history_counts_in_the_memory_of_a_worker(tmp_path: Path) -> None:
    short, long = (_plan(tmp_path, load={"factors": LONG["factors"][-steps:]}) for steps in (1, 10_000))
    few, many = (estimate(plan, plan.cases) for plan in (short, long))
    assert few is not None
    assert many is not None
    known = room.expected_mesh(long, next(iter(long.meshes.values())))
    assert known is not None
    assert many.memory - few.memory > 2 * case_bytes(long.cases[0], known.size)


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


def test_plan_tells_what_is_free_beside_what_it_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(room, "free_bytes", lambda _: 1_230_000_000)
    write_study(tmp_path)
    for options in ((), ("--json",)):
        with pytest.raises(SystemExit) as ended:
            main(["plan", "small.toml", *options])
        assert ended.value.code == 0
        told = capsys.readouterr().out
        assert ('"disk_free": 1230000000' if options else "MB on disk (1.23 GB free); each") in told
