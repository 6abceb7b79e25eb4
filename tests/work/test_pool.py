"""The pool: what becomes of one task touches only what needs it."""

import os
import re
import signal
import sys
import time
from collections.abc import Sequence
from multiprocessing import forkserver
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver_common.progress import Progress, tell
from vdmbench.machine import usable_processors
from vdmbench.work import pool, worker
from vdmbench.work.pool import local_pool, run_tasks
from vdmbench.work.tasks import Task
from vdmbench.work.worker import Said, do_task

from ..in_process import HerePool


def do(payload: Any) -> None:
    """What a task of these tests does, by what it is told."""
    path = Path(payload["path"])
    match payload["do"].split():
        case ["write"]:
            path.write_text("done")
        case ["raise", "ValueError"]:
            raise ValueError("wrong value")
        case ["bug"]:
            print("words before the fall")
            raise KeyError("missing")
        case ["exit", code]:
            os._exit(int(code))
        case ["kill", number]:
            os.kill(os.getpid(), int(number))
        case ["once"]:  # dies the first time
            if not path.exists():
                path.write_text("tried")
                os._exit(7)
        case ["sleep"]:
            time.sleep(60)
        case ["memory"]:
            np.ones(10**8)  # 800 MB
        case ["abort"]:
            os.write(2, b"terminate called after throwing an instance of 'std::bad_alloc'\n")
            os.abort()
        case ["library"]:
            raise ImportError("libGLU.so.1: failed to map segment from shared object")
        case ["sys.exit"]:
            sys.exit(3)
        case ["solve"]:
            for iteration in range(20):
                tell(Progress(1, 5, 0.2, 0.35, iteration, 1e-4))
                time.sleep(0.05)
        case ["threads"]:
            from threadpoolctl import threadpool_info

            dense = max(pool["num_threads"] for pool in threadpool_info())
            path.write_text(f"{dense} {os.environ['RAYON_NUM_THREADS']}")


def here(text: str) -> str:
    """`do_task` with the kind of task of these tests, in a worker."""
    worker._KINDS["test"], worker._APART = do, 0.0  # every iteration is told
    return do_task(text)


@pytest.fixture(autouse=True)
def kinds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "do_task", here)


def task(tmp_path: Path, name: str, kind: str, *needs: str) -> Task:
    return Task(name, "test", name, {"do": kind, "path": str(tmp_path / f"out-{name}")}, frozenset(needs))


def run_here(tmp_path: Path, tasks: Sequence[Task], **options: Any) -> dict[str, Said]:
    """What needs no process: the order of tasks, and what waits for them."""
    monkey = options.pop("monkey")
    monkey.setitem(worker._KINDS, "test", do)
    return {task.id: said for task, said in run_tasks(tasks, HerePool(), tmp_path / "logs", **options)}


def run(tmp_path: Path, tasks: Sequence[Task], jobs: int = 2, **options: Any) -> dict[str, Said]:
    memory = options.pop("memory", None)
    with local_pool(jobs, memory) as workers:
        found = {task.id: said for task, said in run_tasks(tasks, workers, tmp_path / "logs", **options)}
    assert list((tmp_path / "logs").iterdir()) == [], "logs travel with the outcome"
    return found


def test_each_failure_costs_its_own_task_only(tmp_path: Path) -> None:
    kinds = [
        "write",
        "raise ValueError",
        "bug",
        "exit 7",
        "exit 0",
        f"kill {signal.SIGSEGV:d}",
        f"kill {signal.SIGKILL:d}",
        "sys.exit",
        "once",
    ]
    found = run(tmp_path, [task(tmp_path, kind, kind) for kind in kinds])
    codes = {name: said.code for name, said in found.items()}
    assert codes == {
        "write": "done",
        "raise ValueError": "error",
        "bug": "error",
        "exit 7": "crashed",
        "exit 0": "crashed",
        f"kill {signal.SIGSEGV:d}": "crashed",
        f"kill {signal.SIGKILL:d}": "crashed",
        "sys.exit": "error",
        "once": "done",
    }
    assert "SIGSEGV" in found[f"kill {signal.SIGSEGV:d}"].message
    assert "memory" in found[f"kill {signal.SIGKILL:d}"].message
    assert "exit code 7" in found["exit 7"].message
    assert "exit code 0" in found["exit 0"].message
    assert "words before the fall" in found["bug"].log
    assert "KeyError" in found["bug"].log
    assert all(o.remedy for name, o in found.items() if not o.ok and name != "raise ValueError")


def test_what_needs_a_failure_fails_with_its_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tasks = [
        task(tmp_path, "a", "raise ValueError"),
        task(tmp_path, "b", "write", "a"),
        task(tmp_path, "c", "write", "b"),
        task(tmp_path, "d", "write"),
    ]
    found = run_here(tmp_path, tasks, monkey=monkeypatch)
    assert {name: o.message for name, o in found.items()} == {
        "a": "wrong value",
        "b": "wrong value",
        "c": "wrong value",
        "d": "",
    }
    assert not (tmp_path / "out-b").exists()


def test_tasks_are_done_after_those_that_they_need(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[str] = []
    tasks = [
        task(tmp_path, "c", "write", "b"),
        task(tmp_path, "b", "write", "a"),
        task(tmp_path, "a", "write"),
    ]
    run_here(tmp_path, tasks, monkey=monkeypatch, started=lambda n: begun.append(n.id))
    assert begun == ["a", "b", "c"]


def test_memory_that_ran_out_is_told_as_such(tmp_path: Path) -> None:
    """numpy's refusal, C++'s end, a library that finds no room."""
    kinds = ("memory", "abort", "library", "write")
    found = run(tmp_path, [task(tmp_path, kind, kind) for kind in kinds], memory=300_000_000)
    assert found.pop("write").ok
    for said in found.values():
        assert said.message == "out of memory"
        assert "--jobs" in said.remedy


def test_a_slow_task_is_stopped(tmp_path: Path) -> None:
    began = time.monotonic()
    found = run(tmp_path, [task(tmp_path, "x", "sleep"), task(tmp_path, "y", "write")], timeout=2.0)
    assert found["x"].code == "timeout"
    assert "--timeout" in found["x"].remedy
    assert found["y"].ok
    assert time.monotonic() - began < 30, "the worker was stopped, not waited for"


def test_workers_share_the_cores(tmp_path: Path) -> None:
    run(tmp_path, [task(tmp_path, "x", "threads")], jobs=2)
    share = max(1, usable_processors() // 2)
    assert (tmp_path / "out-x").read_text() == f"1 {share}", (
        "one for dense algebra, a share for sparse factors"
    )


def test_a_server_of_workers_killed_amid_a_task_costs_one_more_try(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(pool, "_LOOK", 0.1)  # s

    def kill(_: Task, line: str) -> None:
        heard.append(line)
        if not killed and line:
            killed.append(forkserver._forkserver._forkserver_pid)
            os.kill(killed[0], signal.SIGKILL)

    killed: list[int] = []
    heard: list[str] = []
    found = run(tmp_path, [task(tmp_path, "x", "solve"), task(tmp_path, "y", "write", "x")], where=kill)
    assert re.fullmatch(r"load step 2 of 5 at 35 %, iteration \d+, residual 1\.0e-04", heard[0])
    assert killed
    assert [found[name].message for name in "xy"] == ["", ""]
    assert "Traceback" not in capfd.readouterr().err
