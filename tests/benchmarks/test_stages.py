"""The table of stages, on seconds chosen by hand; times themselves are never tested."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from studies.study_file.config import expand, load_study
from tests.benchmarks import stage_clock
from tests.benchmarks.stage_clock import STARTS, Stages
from tests.benchmarks.stages import PHYSICS, STUDIES, Spent, markdown, studied, table

SPENT = {"report": 1.0, "mesh": 1.0, "set-up and solve": 6.0, "start and imports": 2.0}


def test_shares_are_of_the_whole_and_the_large_that_are_no_physics_are_marked() -> None:
    lines = table(SPENT)
    assert [line.split()[0] for line in lines] == ["set-up", "start", "report", "mesh"]
    assert [line.endswith("*") for line in lines] == [False, True, False, False], (
        "a tenth is not above a tenth"
    )
    assert "60.0 %" in lines[0]


def test_readme_has_a_column_for_each_study_and_physics_first() -> None:
    found = {"one": Spent(12.0, SPENT, {}), "two": Spent(25.0, SPENT | {"report": 11.0}, {})}
    rows = markdown(found).splitlines()
    assert rows[0] == "| stage | one | two |"
    assert rows[2:] == [
        "| mesh | 1.0 s, 10.0 % | 1.0 s, 5.0 % |",
        "| set-up and solve | 6.0 s, 60.0 % | 6.0 s, 30.0 % |",
        "| report | 1.0 s, 10.0 % | 11.0 s, 55.0 % |",
        "| start and imports | 2.0 s, 20.0 % | 2.0 s, 10.0 % |",
        "| all | 10.0 s | 20.0 s |",
    ]


@pytest.mark.parametrize("name", STUDIES)
def test_the_studies_are_of_the_size_that_they_are_said_to_be(tmp_path: Path, name: str) -> None:
    cases = expand(load_study(studied(tmp_path, *STUDIES[name])))
    assert len(cases) == (6 if name == "make demo" else 20)
    assert all(case.study.uncertainty for case in cases), "the reference's bar is part of the physics"


def test_every_process_of_a_run_tells_every_stage(tmp_path: Path) -> None:
    code = (
        "import json, sys\n"
        "from pathlib import Path\n"
        "from tests.benchmarks.stages import FORCES, measure, studied\n"
        "directory = Path(sys.argv[1])\n"
        "spent = measure(studied(directory, 'quickstart', FORCES % 2, '25 mm'), directory)\n"
        "print(json.dumps([dict(spent.stages), dict(spent.starts)]))"
    )
    run = subprocess.run([sys.executable, "-c", code, tmp_path], capture_output=True, text=True, check=True)
    stages, starts = json.loads(run.stdout)
    assert set(starts) == {"runner", "server", "worker", "ends"}
    named = {stage for functions in stage_clock.FUNCTIONS.values() for stage in functions.values()}
    assert set(stages) == named | {STARTS, "the rest"}
    assert set(PHYSICS) < named
    assert min(stages.values()) > 0.0
    assert min(starts.values()) > 0.0, "the system's account of all processes is more than their own"


def test_a_stage_inside_another_counts_once(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 1.0, 4.0, 10.0])
    monkeypatch.setattr(time, "process_time", lambda: next(clock))
    stages = Stages()
    stages.timed("outer", stages.timed("inner", str))()
    assert stages.seconds == {"inner": 3.0, "outer": 7.0}
