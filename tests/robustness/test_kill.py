"""Runners and workers killed at random moments: what is complete stays, what is half-written is never read."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.command import write_study

from . import processes
from .processes import CACHE, RUN, assert_same_results, check_what_is_there, half_written

SEED = 26


def _until(condition: Callable[[], bool], process: subprocess.Popen[str]) -> bool:
    """Wait for a condition; False where the process ends before."""
    while process.poll() is None:
        if condition():
            return True
        time.sleep(0.002)
    return False


def _kill_runner(process: subprocess.Popen[str], delay: float) -> bool:
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(delay)
    family = processes.children(process.pid)
    family += [worker for server in family for worker in processes.children(server)]
    alive = process.poll() is None
    process.kill()
    process.communicate()
    processes.wait_until_gone(family)
    return alive


def _kill_worker(process: subprocess.Popen[str], delay: float) -> bool:
    if not _until(lambda: bool(processes.workers(process.pid)), process):
        return False
    time.sleep(delay / 3)  # workers live for a part of the run only
    victims: list[int] = []
    if not _until(lambda: victims.extend(processes.workers(process.pid)) or victims != [], process):
        return False
    try:
        os.kill(victims[-1], signal.SIGKILL)
    except ProcessLookupError:
        return False
    output = processes.output_of(process)
    assert process.returncode in (0, 3), output
    assert "Traceback" not in output
    return True


def _survive(kills: int, undisturbed: tuple[Path, float], directory: Path) -> Counter[str]:
    """Kill until it was done so often; what happened, counted."""
    peace, seconds = undisturbed
    chance = random.Random(SEED)
    shutil.copy(peace / "small.toml", directory)
    seen: Counter[str] = Counter()
    while seen["runner"] + seen["worker"] < kills:
        before = check_what_is_there(directory)
        kind = min(("runner", "worker"), key=lambda each: seen[each])  # in turns
        with processes.start("run", "small.toml", "--jobs", "2", cwd=directory) as process:
            kill = {"runner": _kill_runner, "worker": _kill_worker}[kind]
            killed = kill(process, chance.uniform(0, seconds))
        seen[kind] += killed
        after = check_what_is_there(directory)
        assert before.items() <= after.items(), "what was complete is there as it was"
        failed = list((directory / RUN / "failed").glob("*.json"))
        assert kind != "worker" or len(failed) <= killed, "a worker that is killed costs its case only"
        seen["failed"] += len(failed) if kind == "worker" else 0
        seen["half-written"] += len(half_written(directory))
        if len(after) == 6 and process.returncode == 0:
            assert half_written(directory) == [], "what killed runs left is cleared away"
            assert_same_results(directory, peace)
            seen["complete"] += 1
        if len(after) == 6:  # begin again, with more or less of the work done
            shutil.rmtree(directory / RUN)
            if chance.random() < 0.5:
                shutil.rmtree(directory / CACHE)
    process = processes.start("run", "small.toml", "--jobs", "2", cwd=directory)
    output = processes.output_of(process)
    assert process.returncode == 0, output
    assert half_written(directory) == []
    assert_same_results(directory, peace)
    return seen


def test_kills_at_random_moments(undisturbed: tuple[Path, float], tmp_path: Path) -> None:
    _survive(2, undisturbed, tmp_path)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 130), (signal.SIGKILL, -signal.SIGKILL)])
def test_nothing_outlives_its_runner(tmp_path: Path, number: signal.Signals, code: int) -> None:
    write_study(tmp_path)
    process = processes.start("run", "small.toml", cwd=tmp_path, program="endless")
    try:
        assert _until(lambda: list((tmp_path / RUN / "failed").glob("begun-*")) != [], process)
        family = processes.children(process.pid)
        family += [worker for server in family for worker in processes.children(server)]
        assert len(family) >= 2, "a server of workers and a worker"
        began = time.monotonic()
        process.send_signal(number)
        processes.output_of(process, 60)
        processes.wait_until_gone(family, 2)
        print(f"{time.monotonic() - began:.2f} s")
    finally:
        process.kill()  # a failed assertion waits for no endless run
        process.communicate()
    assert process.returncode == code


@pytest.mark.slow
def test_two_hundred_kills(undisturbed: tuple[Path, float], tmp_path: Path) -> None:
    seen = _survive(200, undisturbed, tmp_path)
    print(dict(seen))
