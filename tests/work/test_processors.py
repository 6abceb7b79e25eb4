"""As many cases at once, by default, as processors that this process may use."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest

from tests.command import SCRIPT, write_study
from vdmbench.machine import processors


def test_what_a_batch_system_leaves_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {5, 9, 11})
    assert processors.usable_processors() == 3
    monkeypatch.delattr(os, "sched_getaffinity")  # as on other systems than Linux
    assert processors.usable_processors() == 64


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one processor cannot be fewer")
def test_a_run_takes_no_more_processors_than_it_may_use(tmp_path: Path) -> None:
    write_study(tmp_path)
    first = min(os.sched_getaffinity(0))
    result = subprocess.run(
        [SCRIPT, "run", "small.toml"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: os.sched_setaffinity(0, {first}),
    )
    assert result.returncode == 0, result.stderr
    assert json.loads((tmp_path / "results/runs/small/plan.json").read_text())["taken"]["jobs"] == 1


def test_a_machine_that_does_not_name_its_processor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    description = tmp_path / "cpuinfo"
    monkeypatch.setattr(processors, "_DESCRIPTION", description)
    description.write_text("processor\t: 0\nmodel name\t: Abacus 3: the fast one\n")
    assert processors.processor_name() == "Abacus 3: the fast one"
    description.write_text("processor\t: 0\n")
    assert processors.processor_name() == "unknown"
