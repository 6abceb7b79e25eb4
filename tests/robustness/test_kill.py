"""Runners and workers killed at random moments: what is complete stays, what is half-written is never read."""

import contextlib
import os
import random
import shutil
import signal
import subprocess
import time
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


@pytest.mark.parametrize("kills", [2, pytest.param(200, marks=pytest.mark.slow)])
def test_kills_at_random_moments(undisturbed: tuple[Path, float], tmp_path: Path, kills: int) -> None:
    """Runner and worker in turns; what is done is done again where a kill came too late."""
    peace, seconds = undisturbed
    chance = random.Random(SEED)
    shutil.copy(peace / "small.toml", tmp_path)
    done = 0
    while done < kills:
        before = check_what_is_there(tmp_path)
        kill = (_kill_runner, _kill_worker)[done % 2]
        with processes.start("run", "small.toml", "--jobs", "2", cwd=tmp_path) as process:
            killed = kill(process, chance.uniform(0, seconds))
        done += killed
        after = check_what_is_there(tmp_path)
        assert before.items() <= after.items(), "what was complete is there as it was"
        failed = list((tmp_path / RUN / "failed").glob("*.json"))
        assert kill is not _kill_worker or len(failed) <= killed, (
            "a worker that is killed costs its case only"
        )
        if len(after) == 6:  # begin again, with more or less of the work done
            shutil.rmtree(tmp_path / RUN)
            if chance.random() < 0.5:
                shutil.rmtree(tmp_path / CACHE)
    process = processes.start("run", "small.toml", "--jobs", "2", cwd=tmp_path)
    output = processes.output_of(process)
    assert process.returncode == 0, output
    assert half_written(tmp_path) == [], "what killed runs left is cleared away"
    assert_same_results(tmp_path / RUN, peace / RUN)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 130), (signal.SIGKILL, -signal.SIGKILL)])
def test_nothing_outlives_its_runner(tmp_path: Path, number: signal.Signals, code: int) -> None:
    write_study(tmp_path)
    process = processes.start("run", "small.toml", cwd=tmp_path, program="endless")
    try:
        assert _until(lambda: list((tmp_path / RUN / "failed").glob("begun-*")) != [], process)
        family = processes.children(process.pid)
        family += [worker for server in family for worker in processes.children(server)]
        assert len(family) >= 2, "a server of workers and a worker"
        process.send_signal(number)
        processes.output_of(process, 60)
        processes.wait_until_gone(family, 2)
    finally:
        process.kill()  # a failed assertion waits for no endless run
        process.communicate()
    assert process.returncode == code
