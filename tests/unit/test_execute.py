"""Worker processes: what becomes of one task never touches another."""

from __future__ import annotations

import faulthandler
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from studies.execute import AGAIN, Outcome, Task, TaskError, run_tasks
from studies.server import processor_seconds, start_server


def _work(task: Task) -> None:
    faulthandler.disable()  # which pytest has enabled, and a worker inherits
    kind = task["kind"]
    if kind == "write":
        Path(task["path"]).write_text("done")
    elif kind == "task error":
        raise TaskError("too coarse", "refine")
    elif kind == "value error":
        raise ValueError("wrong value")
    elif kind == "bug":
        print("words before the fall")
        raise KeyError("missing")
    elif kind == "exit":
        os._exit(7)
    elif kind == "segfault":
        os.kill(os.getpid(), signal.SIGSEGV)
    elif kind == "out of memory":
        os.kill(os.getpid(), signal.SIGKILL)
    elif kind == "sleep":
        time.sleep(60)
    elif kind == "memory error":
        raise MemoryError
    elif kind == "sleep briefly":
        time.sleep(1.0)
    elif kind == "computes":
        while time.process_time() < float(Path(task["path"]).name[-1]):
            pass
    elif kind == "takes too much":
        np.ones(10**7)  # 80 MB
    elif kind == "takes a little":
        np.ones(10**5)
    elif kind == "aborts for memory":
        os.write(2, b"terminate called after throwing an instance of 'std::bad_alloc'\n")
        os.abort()
    elif kind == "misses a library":
        raise ImportError("libGLU.so.1: failed to map segment from shared object")
    elif kind == "exit by library":
        sys.exit(3)
    elif kind == "threads":
        from threadpoolctl import threadpool_info

        np.ones((4, 4)) @ np.ones((4, 4))
        dense = max(pool["num_threads"] for pool in threadpool_info())
        Path(task["path"]).write_text(f"{dense} {os.environ['RAYON_NUM_THREADS']}")


@contextmanager
def _together(tasks: Sequence[Task]) -> Iterator[Callable[[Task], None]]:
    """What tasks of one set-up share: it may fail as the tasks may, for the sake of any of them."""
    company = {task["setup"]: [other for other in tasks if other["setup"] == task["setup"]] for task in tasks}

    def prepare(task: Task) -> None:
        there = company.pop(task["setup"], [])
        for other in there:
            if other["shared"]:
                _work({"kind": other["shared"]})
        for other in there:
            Path(f"{other['path']}-in-company").write_text(",".join(each["id"] for each in there))

    yield prepare


def _run_group(
    tmp_path: Path,
    *kinds: str,
    shared: str = "",
    culprit: int | None = None,
    setups: str | None = None,
    **options: Any,
) -> tuple[dict[str, Outcome], list[str]]:
    """One group of tasks, what they share failing for each or for one; also the ids of those begun, in order."""
    tasks = [
        {
            "id": f"{n}",
            "kind": kind,
            "path": str(tmp_path / f"out-{n}"),
            "shared": shared if culprit in (None, n) else "",
            "setup": setups[n] if setups else "",
        }
        for n, kind in enumerate(kinds)
    ]
    begun: list[str] = []
    settings = {"jobs": 1, "log_directory": tmp_path / "logs"} | options
    outcomes = run_tasks(
        _work, [tasks], together=_together, started=lambda task: begun.append(task["id"]), **settings
    )
    found = {outcome.task["id"]: outcome for outcome in outcomes}
    assert list((tmp_path / "logs").iterdir()) == []
    return found, begun


def _run(tmp_path: Path, *kinds: str, **options: Any) -> dict[str, Outcome]:
    tasks = [{"id": f"{n}", "kind": kind, "path": str(tmp_path / f"out-{n}")} for n, kind in enumerate(kinds)]
    settings = {"jobs": 2, "log_directory": tmp_path / "logs", "started": lambda _: None} | options
    return {
        outcome.task["kind"]: outcome for outcome in run_tasks(_work, [[task] for task in tasks], **settings)
    }


def test_each_failure_costs_its_own_task_only(tmp_path: Path) -> None:
    outcomes = _run(
        tmp_path,
        "write",
        "task error",
        "value error",
        "bug",
        "exit",
        "segfault",
        "out of memory",
        "memory error",
        "exit by library",
    )
    assert outcomes["write"].ok
    assert (tmp_path / "out-0").read_text() == "done"
    assert {kind: outcome.code for kind, outcome in outcomes.items() if not outcome.ok} == {
        "task error": "error",
        "value error": "error",
        "bug": "error",
        "exit": "crashed",
        "segfault": "crashed",
        "out of memory": "crashed",
        "memory error": "error",
        "exit by library": "crashed",
    }
    assert (outcomes["task error"].message, outcomes["task error"].remedy) == ("too coarse", "refine")
    assert "SIGSEGV" in outcomes["segfault"].message
    assert "memory" in outcomes["out of memory"].message
    assert "memory" in outcomes["memory error"].message
    assert "exit code 7" in outcomes["exit"].message
    assert "words before the fall" in outcomes["bug"].log
    assert "KeyError" in outcomes["bug"].log
    assert all(outcome.remedy for kind, outcome in outcomes.items() if kind not in ("write", "value error"))
    assert list((tmp_path / "logs").iterdir()) == [], "logs travel with the outcome"


@pytest.mark.parametrize("kind", ["takes too much", "aborts for memory", "misses a library"])
def test_memory_that_ran_out_is_told_as_such(tmp_path: Path, kind: str) -> None:
    """Alone and in company: numpy's refusal, C++'s end, a library that finds no room."""
    alone = _run(tmp_path, kind, "takes a little", memory=60_000_000)
    found, _ = _run_group(tmp_path, "takes a little", kind, "write", memory=60_000_000)
    assert alone["takes a little"].ok
    assert [found[n].ok for n in "012"] == [True, False, True]
    for outcome in (alone[kind], found["1"]):
        assert outcome.message == "out of memory"
        assert "--memory" in outcome.remedy


def test_without_a_limit_a_task_takes_what_it_wants(tmp_path: Path) -> None:
    assert _run(tmp_path, "takes too much")["takes too much"].ok


def test_a_slow_task_is_stopped(tmp_path: Path) -> None:
    began = time.monotonic()
    outcomes = _run(tmp_path, "sleep", "write", timeout=2.5)
    assert outcomes["sleep"].code == "timeout"
    assert "--timeout" in outcomes["sleep"].remedy
    assert outcomes["write"].ok
    assert time.monotonic() - began < 30, "the worker was stopped, not waited for"


def test_fail_fast_stops_at_the_first(tmp_path: Path) -> None:
    outcomes = _run(tmp_path, "value error", "write", "write", jobs=1, fail_fast=True)
    assert list(outcomes) == ["value error"]
    assert not (tmp_path / "out-1").exists()


def test_leaving_early_stops_the_workers(tmp_path: Path) -> None:
    tasks = [{"id": "0", "kind": "write", "path": str(tmp_path / "out")}, {"id": "1", "kind": "sleep"}]
    began = time.monotonic()
    runs = run_tasks(
        _work, [[task] for task in tasks], jobs=2, log_directory=tmp_path / "logs", started=lambda _: None
    )
    assert next(runs).ok
    runs.close()
    assert time.monotonic() - began < 30
    assert list((tmp_path / "logs").iterdir()) == []


@pytest.mark.parametrize("jobs", [1, 2])
def test_workers_share_the_cores(tmp_path: Path, jobs: int) -> None:
    _run(tmp_path, "threads", jobs=jobs)
    share = max(1, len(os.sched_getaffinity(0)) // jobs)
    assert (tmp_path / "out-0").read_text() == f"1 {share}", (
        "one for dense algebra, a share for sparse factors"
    )


@pytest.mark.parametrize("kind", ["segfault", "out of memory", "exit", "memory error"])
def test_a_worker_that_dies_costs_its_group_one_task(tmp_path: Path, kind: str) -> None:
    """What was finished stays, the culprit is tried once more alone, the rest goes on in a new worker."""
    outcomes, begun = _run_group(tmp_path, "write", kind, "write", "write")
    assert [outcomes[n].ok for n in "0123"] == [True, False, True, True]
    assert begun == ["0", "1", "2", "3", "1"] or begun == ["0", "1", "1", "2", "3"]
    assert outcomes["1"].code == ("error" if kind == "memory error" else "crashed")
    assert outcomes["1"].remedy


def test_a_failure_in_a_group_ends_its_task_only(tmp_path: Path) -> None:
    outcomes, begun = _run_group(tmp_path, "bug", "task error", "write")
    assert [outcomes[n].code for n in "012"] == ["error", "error", "done"]
    assert begun == ["0", "1", "2"], "one worker did them all"
    assert "words before the fall" in outcomes["0"].log
    assert "words before the fall" not in outcomes["1"].log, "each task has its own log"


def test_a_slow_task_of_a_group_is_stopped_alone(tmp_path: Path) -> None:
    outcomes, begun = _run_group(tmp_path, "write", "sleep", "write", timeout=2.5)
    assert [outcomes[n].code for n in "012"] == ["done", "timeout", "done"]
    assert begun == ["0", "1", "2"], "a task that took its time is not tried again"


@pytest.mark.parametrize("shared", ["segfault", "bug", "sleep"])
def test_what_a_group_shares_may_fail(tmp_path: Path, shared: str) -> None:
    """Then each task is done alone."""
    outcomes, begun = _run_group(tmp_path, "write", "write", shared=shared, timeout=2.5)
    assert [outcomes[n].code for n in "01"] == ["done", "done"]
    assert sorted(begun) == ["0", "0", "1"]


@pytest.mark.parametrize("shared", ["segfault", "out of memory"])
def test_one_that_kills_what_a_group_shares_leaves_the_others_their_share(
    tmp_path: Path, shared: str
) -> None:
    """By halves: only who is left with the culprit goes on alone."""
    outcomes, begun = _run_group(tmp_path, *["write"] * 8, shared=shared, culprit=5)
    assert [outcomes[f"{n}"].code for n in range(8)] == ["done"] * 8
    company = {path.name[4]: path.read_text() for path in tmp_path.glob("*-in-company")}
    assert company == dict.fromkeys("0123", "0,1,2,3") | dict.fromkeys("67", "6,7")
    assert len(begun) == 8 + 3, "three workers died before their first task"


@pytest.mark.parametrize("shared", ["segfault", "sleep"])
def test_what_some_of_a_group_share_fails_for_these_only(tmp_path: Path, shared: str) -> None:
    """In the midst of the group: halves of those on the set-up, and of time what these may take together."""
    began = time.monotonic()
    kinds, options = ["write"] * 8, {"setups": "aabbbbcc", "timeout": 1.5}
    outcomes, begun = _run_group(tmp_path, *kinds, shared=shared, culprit=3, **options)
    assert time.monotonic() - began < 1.5 * (4 + 2) + 20.0, "not what all that are left may take"
    assert [outcomes[f"{n}"].code for n in range(8)] == ["done"] * 8
    company = {path.name[4]: path.read_text() for path in tmp_path.glob("*-in-company")}
    assert company == dict.fromkeys("01", "0,1") | dict.fromkeys("45", "4,5") | dict.fromkeys("67", "6,7")
    # who has lost a worker is told so
    again = {n for n, outcome in outcomes.items() if outcome.task.get(AGAIN)}
    assert again == set("234567")
    assert begun[:2] == ["0", "1"]


def test_fail_fast_stops_within_a_group(tmp_path: Path) -> None:
    outcomes, _ = _run_group(tmp_path, "value error", "sleep", fail_fast=True)
    assert list(outcomes) == ["0"]


def test_what_workers_had_of_processors_is_known_once_they_have_ended(tmp_path: Path) -> None:
    server = start_server()
    before = processor_seconds(server)
    outcomes = _run(tmp_path, "sleep briefly", "computes")
    assert all(outcome.ok for outcome in outcomes.values())
    # the worker of this name computed until it had had a second; nothing else here takes long
    assert 1.0 <= processor_seconds(server) - before < 3.0
