"""The engine: what becomes of one node touches only what needs it."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vdmbench.graph import local, work
from vdmbench.graph.engine import Outcome, run_nodes
from vdmbench.graph.local import LocalPlaces, _deaf, local_places
from vdmbench.graph.nodes import Node
from vdmbench.graph.work import Said, run_node
from vdmbench.machine.processors import usable_processors


def do(payload: Any, node: str) -> list[Said]:
    """What a node of these tests does, by what it is told."""
    kind, path = payload["do"], Path(payload["path"])
    return [work._attempt(node, lambda: _act(kind, path))]


def _act(kind: str, path: Path) -> None:
    match kind.split():
        case ["write"]:
            path.write_text("done")
        case ["raise", "ValueError"]:
            raise ValueError("wrong value")
        case ["bug"]:
            print("words before the fall")
            raise KeyError("missing")
        case ["exit"]:
            os._exit(7)
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
    work._KINDS["test"] = do  # type: ignore[assignment]
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
        "exit",
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
        "exit": "crashed",
        f"kill {signal.SIGSEGV:d}": "crashed",
        f"kill {signal.SIGKILL:d}": "crashed",
        "sys.exit": "error",
    }
    assert "SIGSEGV" in found[f"kill {signal.SIGSEGV:d}"].said.message
    assert "memory" in found[f"kill {signal.SIGKILL:d}"].said.message
    assert "exit code 7" in found["exit"].said.message
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


def test_a_broken_pool_is_started_again(tmp_path: Path) -> None:
    places = LocalPlaces(1)
    try:
        places._places[0].stop()
        text = json.dumps(
            {
                "id": "x",
                "kind": "test",
                "payload": {"do": "write", "path": str(tmp_path / "out")},
                "log": str(tmp_path / "log"),
            }
        )
        future: Future[str] = places.submit(text, tmp_path / "log", None)
        assert json.loads(future.result())[0]["code"] == "done"
    finally:
        places.close()


def test_a_node_that_a_broken_pool_has_lost_is_told_of(tmp_path: Path) -> None:
    payload = {"do": "sleep", "path": str(tmp_path / "out")}
    text = json.dumps({"id": "x", "kind": "test", "payload": payload, "log": str(tmp_path / "log")})
    places = LocalPlaces(1)
    try:
        lost = places.submit(text, tmp_path / "log", None)
        places.look()
        assert not lost.done(), "a node at work is left alone"
        places._places[0].stop()
        places.look()
        assert isinstance(lost.exception(timeout=0), BrokenProcessPool)
    finally:
        places.close()


def test_a_worker_is_stopped_before_its_pool_takes_its_locks_away(monkeypatch: pytest.MonkeyPatch) -> None:
    places = LocalPlaces(1)
    worker = multiprocessing.active_children()[-1]
    pool, alive = places._places[0].start(), []
    join = pool.join

    def watched() -> None:
        worker.join(2.0)
        alive.append(worker.is_alive())
        join()

    monkeypatch.setattr(pool, "join", watched)
    places.close()
    assert alive == [False], "one that is about to open a lock prints a traceback"


def test_a_signal_that_another_thread_lets_through_comes_after_the_start() -> None:
    told = []

    def start() -> None:
        with _deaf():
            told.append("begun")
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.1)
            told.append("ended")

    threading.Thread(target=time.sleep, args=(1.0,)).start()
    with pytest.raises(KeyboardInterrupt):
        start()
    assert told == ["begun", "ended"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
