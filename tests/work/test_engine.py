"""The engine: what becomes of one node touches only what needs it."""

from __future__ import annotations

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

from fem_reference.progress import Progress, tell
from vdmbench.machine import usable_processors
from vdmbench.work import local, worker
from vdmbench.work.engine import Outcome, run_nodes
from vdmbench.work.local import local_places
from vdmbench.work.nodes import Node
from vdmbench.work.worker import Said, run_node

from ..command import wait_for


def do(payload: Any, node: str) -> list[Said]:
    """What a node of these tests does, by what it is told."""
    kind, path = payload["do"], Path(payload["path"])
    return [worker._attempt(node, lambda: _act(kind, path))]


def _act(kind: str, path: Path) -> None:
    match kind.split():
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
            for iteration in range(60):
                tell(Progress(1, 5, 0.2, 0.35, iteration, 1e-4))
                time.sleep(0.05)
        case ["compute"]:
            end = time.process_time() + 0.5
            while time.process_time() < end:
                pass
        case ["threads"]:
            from threadpoolctl import threadpool_info

            dense = max(pool["num_threads"] for pool in threadpool_info())
            path.write_text(f"{dense} {os.environ['RAYON_NUM_THREADS']}")


def here(text: str) -> str:
    """`run_node` with the kind of node of these tests, in a worker."""
    worker._KINDS["test"] = do  # type: ignore[assignment]
    return run_node(text)


@pytest.fixture(autouse=True)
def kinds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local, "run_node", here)


def node(tmp_path: Path, name: str, kind: str, *needs: str) -> Node:
    return Node(name, "test", name, {"do": kind, "path": str(tmp_path / f"out-{name}")}, frozenset(needs))


def run(tmp_path: Path, nodes: Sequence[Node], jobs: int = 2, **options: Any) -> dict[str, Outcome]:
    memory = options.pop("memory", None)
    settings = {"started": lambda _: None, **options}
    with local_places(jobs, memory) as places:
        found = {o.id: o for o in run_nodes(nodes, places, tmp_path / "logs", **settings)}
    assert list((tmp_path / "logs").iterdir()) == [], "logs travel with the outcome"
    return found


def test_each_failure_costs_its_own_node_only(tmp_path: Path) -> None:
    kinds = [
        "write",
        "raise ValueError",
        "bug",
        "exit 7",
        "exit 0",
        f"kill {signal.SIGSEGV:d}",
        f"kill {signal.SIGKILL:d}",
        "sys.exit",
    ]
    found = run(tmp_path, [node(tmp_path, kind, kind) for kind in kinds])
    codes = {name: outcome.said.code for name, outcome in found.items()}
    assert codes == {
        "write": "done",
        "raise ValueError": "error",
        "bug": "error",
        "exit 7": "crashed",
        "exit 0": "crashed",
        f"kill {signal.SIGSEGV:d}": "crashed",
        f"kill {signal.SIGKILL:d}": "crashed",
        "sys.exit": "error",
    }
    assert "SIGSEGV" in found[f"kill {signal.SIGSEGV:d}"].said.message
    assert "memory" in found[f"kill {signal.SIGKILL:d}"].said.message
    assert "exit code 7" in found["exit 7"].said.message
    assert "exit code 0" in found["exit 0"].said.message
    assert "words before the fall" in found["bug"].said.log
    assert "KeyError" in found["bug"].said.log
    assert all(o.said.remedy for name, o in found.items() if name not in ("write", "raise ValueError"))


def test_what_needs_a_failure_fails_with_its_reason(tmp_path: Path) -> None:
    nodes = [
        node(tmp_path, "a", "raise ValueError"),
        node(tmp_path, "b", "write", "a"),
        node(tmp_path, "c", "write", "b"),
        node(tmp_path, "d", "write"),
    ]
    found = run(tmp_path, nodes)
    assert {name: o.said.message for name, o in found.items()} == {
        "a": "wrong value",
        "b": "wrong value",
        "c": "wrong value",
        "d": "",
    }
    assert not (tmp_path / "out-b").exists()


def test_nodes_are_done_after_those_that_they_need(tmp_path: Path) -> None:
    begun: list[str] = []
    nodes = [
        node(tmp_path, "c", "write", "b"),
        node(tmp_path, "b", "write", "a"),
        node(tmp_path, "a", "write"),
    ]
    run(tmp_path, nodes, jobs=3, started=lambda n: begun.append(n.id))
    assert begun == ["a", "b", "c"]


def test_a_node_whose_worker_died_is_tried_again(tmp_path: Path) -> None:
    found = run(tmp_path, [node(tmp_path, "once", "once")])
    assert found["once"].ok


@pytest.mark.parametrize("kind", ["memory", "abort", "library"])
def test_memory_that_ran_out_is_told_as_such(tmp_path: Path, kind: str) -> None:
    """numpy's refusal, C++'s end, a library that finds no room."""
    found = run(tmp_path, [node(tmp_path, "x", kind), node(tmp_path, "y", "write")], memory=300_000_000)
    assert found["x"].said.message == "out of memory"
    assert "--memory" in found["x"].said.remedy
    assert found["y"].ok


def test_a_slow_node_is_stopped(tmp_path: Path) -> None:
    began = time.monotonic()
    found = run(tmp_path, [node(tmp_path, "x", "sleep"), node(tmp_path, "y", "write")], timeout=2.0)
    assert found["x"].said.code == "timeout"
    assert "--timeout" in found["x"].said.remedy
    assert found["y"].ok
    assert time.monotonic() - began < 30, "the worker was stopped, not waited for"


def test_fail_fast_stops_at_the_first(tmp_path: Path) -> None:
    nodes = [node(tmp_path, "x", "raise ValueError"), node(tmp_path, "y", "write")]
    found = run(tmp_path, nodes, jobs=1, fail_fast=True)
    assert list(found) == ["x"]
    assert not (tmp_path / "out-y").exists()


def test_leaving_early_stops_the_workers(tmp_path: Path) -> None:
    nodes = [node(tmp_path, "x", "write"), node(tmp_path, "y", "sleep")]
    began = time.monotonic()
    with local_places(2) as places:
        outcomes = run_nodes(nodes, places, tmp_path / "logs", started=lambda _: None)
        assert next(outcomes).ok
        outcomes.close()
    assert time.monotonic() - began < 30


@pytest.mark.parametrize("jobs", [1, 2])
def test_workers_share_the_cores(tmp_path: Path, jobs: int) -> None:
    run(tmp_path, [node(tmp_path, "x", "threads")], jobs=jobs)
    share = max(1, usable_processors() // jobs)
    assert (tmp_path / "out-x").read_text() == f"1 {share}", (
        "one for dense algebra, a share for sparse factors"
    )


def test_a_node_tells_its_seconds_of_processor(tmp_path: Path) -> None:
    said = run(tmp_path, [node(tmp_path, "x", "compute")])["x"].said
    assert 0.5 <= said.processor < 2.0


def test_a_long_node_says_where_its_solve_is(tmp_path: Path) -> None:
    heard: list[str] = []
    found = run(
        tmp_path, [node(tmp_path, "x", "solve")], where=lambda of, line: heard.append(f"{of.id} {line}")
    )
    assert found["x"].ok
    assert heard
    assert re.fullmatch(r"x load step 2 of 5 at 35 %, iteration \d+, residual 1\.0e-04", heard[0])


def test_a_server_of_workers_killed_amid_a_node_costs_one_more_try(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    def kill(_: Node, line: str) -> None:
        if not killed and line:
            killed.append(forkserver._forkserver._forkserver_pid)
            os.kill(killed[0], signal.SIGKILL)

    killed: list[int] = []
    found = run(tmp_path, [node(tmp_path, "x", "solve"), node(tmp_path, "y", "write", "x")], where=kill)
    assert killed
    assert [found[name].ok for name in "xy"] == [True, True]
    assert "Traceback" not in capfd.readouterr().err


def test_a_killed_server_of_workers_costs_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with local_places(1) as places:
        for name in "xy":
            found = list(run_nodes([node(tmp_path, name, "write")], places, tmp_path / "logs", started=print))
            assert found[0].ok
            server = Path(f"/proc/{forkserver._forkserver._forkserver_pid}/stat")
            os.kill(int(server.parent.name), signal.SIGKILL)
            wait_for(lambda stat=server: stat.read_text().split()[2] == "Z")
    assert "Traceback" not in capfd.readouterr().err
