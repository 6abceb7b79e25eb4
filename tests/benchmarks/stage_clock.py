"""Processor seconds by stage inside every process of a run: the runner, the server of workers, each worker.

`SITE` is a `sitecustomize` that starts the clock before the program does. What a process spends before that, its
imports wherever they happen, and what a worker does between its fork and its work count as `STARTS`; the functions
of the other stages are timed from when their module is there. Each process leaves its seconds as a file in the
directory that the environment names. This file imports nothing that every program does not start with.
"""

from __future__ import annotations

import atexit
import importlib
import os
import time
from collections.abc import Callable
from functools import partial, wraps
from typing import Any

DIRECTORY = "STAGES_DIRECTORY"
SITE = "from tests.benchmarks import stage_clock\nstage_clock.start()\n"
Function = Callable[..., Any]
STARTS, REST = "start and imports", "the rest"
FUNCTIONS = {
    "studies.meshing.geometry": {"build_mesh": "mesh"},
    "studies.meshing.refine": {"refine": "mesh"},
    "studies.models": {"run_model": "set-up and solve", "run_together": "set-up and solve"},
    "studies.scene": {"build_scene": "scene"},
    "studies.worker": {"compare": "metrics"},
    "studies.reference": {"own_error": "metrics"},
    "studies.store": {"write_case": "store", "read_case": "store", "write_study": "store"},
    "studies.result_cache": {"write_reference": "store"},
    "studies.report.page": {"write_report": "report"},
}


class Stages:
    """Processor seconds by stage; what a stage does inside another counts for the inner one only."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._inner = [0.0]

    def timed(self, stage: str, function: Function) -> Function:
        """The function, its time kept."""

        @wraps(function)
        def wrapped(*arguments: Any, **options: Any) -> Any:
            start = time.process_time()
            self._inner.append(0.0)
            try:
                return function(*arguments, **options)
            finally:
                spent = time.process_time() - start
                self.seconds[stage] = self.seconds.get(stage, 0.0) + spent - self._inner.pop()
                self._inner[-1] += spent

        return wrapped

    def rest_is(self, stage: str) -> None:
        """Count what this process has spent, and no stage yet has been given, for this one."""
        unnamed = time.process_time() - sum(self.seconds.values())
        self.seconds[stage] = self.seconds.get(stage, 0.0) + unnamed


def start() -> None:
    """Time this process and those that it forks, until each ends."""
    stages = Stages()
    stages.rest_is(STARTS)
    process = "runner"

    def work(function: Function) -> Function:
        @wraps(function)
        def wrapped(*arguments: Any) -> None:
            stages.rest_is(STARTS)
            function(*arguments)

        return wrapped

    changes: dict[str, dict[str, Callable[[Function], Function]]] = {
        module: {name: partial(stages.timed, stage) for name, stage in functions.items()}
        for module, functions in FUNCTIONS.items()
    }
    changes["studies.execute"] = {"_main": work}  # where a worker begins

    def loading(name: str, import_: Function) -> Any:
        module = load(name, import_)
        for part, change in changes.pop(name, {}).items():
            setattr(module, part, change(getattr(module, part)))
        return module

    def leave() -> None:
        stages.rest_is(REST)
        with open(os.path.join(os.environ[DIRECTORY], f"{process}.{os.getpid()}"), "w") as file:
            file.writelines(f"{seconds!r} {stage}\n" for stage, seconds in stages.seconds.items())

    def ending(function: Function) -> Function:  # of a forked process
        def wrapped(code: int) -> None:
            leave()
            function(code)

        return wrapped

    def forked() -> None:
        nonlocal process
        process = "server" if process == "runner" else "worker"
        stages.seconds.clear()

    # what Python calls for each module that is not loaded yet, and only then: some thousand times in all
    load = stages.timed(STARTS, importlib._bootstrap._find_and_load)
    importlib._bootstrap._find_and_load = loading
    os._exit = ending(os._exit)  # type: ignore[assignment]
    os.register_at_fork(after_in_child=forked)
    atexit.register(leave)
