"""The table of stages, on seconds chosen by hand; times themselves are never tested."""

from __future__ import annotations

import time

import pytest

from tests.benchmarks.stages import Stages, markdown, table

SPENT = {"report": 1.0, "mesh": 1.0, "set-up and solve": 6.0, "start and imports": 2.0}


def test_shares_are_of_the_whole_and_the_large_that_are_no_physics_are_marked() -> None:
    lines = table(SPENT)
    assert [line.split()[0] for line in lines] == ["set-up", "start", "report", "mesh"]
    assert [line.endswith("*") for line in lines] == [False, True, False, False], (
        "a tenth is not above a tenth"
    )
    assert "60.0 %" in lines[0]


def test_readme_has_a_column_for_each_study_and_physics_first() -> None:
    rows = markdown({"one": (4.0, SPENT), "two": (8.5, SPENT | {"report": 11.0})}).splitlines()
    assert rows[0] == "| stage | one | two |"
    assert rows[2:] == [
        "| mesh | 10.0 % | 5.0 % |",
        "| set-up and solve | 60.0 % | 30.0 % |",
        "| report | 10.0 % | 55.0 % |",
        "| start and imports | 20.0 % | 10.0 % |",
        "| all, one case at once | 4 s | 8.5 s |",
    ]


def test_a_stage_inside_another_counts_once(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 1.0, 4.0, 10.0])
    monkeypatch.setattr(time, "process_time", lambda: next(clock))
    stages = Stages()
    stages.timed("outer", stages.timed("inner", str))()
    assert stages.seconds == {"inner": 3.0, "outer": 7.0}
