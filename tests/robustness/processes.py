"""Runs of the command as processes that can be watched and killed, and what must hold of what they leave."""

import contextlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose

from solver_common.arrays import Array
from vdmbench.machine import read_arrays
from vdmbench.measures.metrics import METRICS
from vdmbench.store import cases as store

from ..command import heed_ctrl_c, wait_for

RUN = Path("results/runs/small")
CACHE = Path("results/cache")
PATH = os.pathsep.join(filter(None, (str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH"))))


def start(*arguments: str, cwd: Path, program: str = "runner") -> subprocess.Popen[str]:
    """The command, at work in the background, by a program of these tests, by default without its report."""
    return subprocess.Popen(
        [sys.executable, "-m", f"tests.robustness.{program}", *arguments],
        cwd=cwd,
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": PATH},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        stdin=subprocess.DEVNULL,
        preexec_fn=heed_ctrl_c,
        text=True,
    )


def output_of(process: subprocess.Popen[str], seconds: float = 300) -> str:
    """What a command prints, once it has ended; one that does not is killed, that it may not hold up its test."""
    try:
        return process.communicate(timeout=seconds)[0]
    except subprocess.TimeoutExpired:
        process.kill()
        raise


def endless(node: str) -> str:
    """A task that never ends."""
    log = Path(json.loads(node)["log"])
    log.with_name(f"begun-{os.getpid()}").touch()
    while True:
        time.sleep(60)


def children(process: int) -> list[int]:
    """Processes that this one has started, by any of its threads."""
    found: list[int] = []
    for of_thread in Path(f"/proc/{process}/task").glob("*/children"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            found += map(int, of_thread.read_text().split())
    return found


def workers(runner: int) -> list[int]:
    """The worker processes of a run: the children of the server of workers."""
    return [worker for server in children(runner) for worker in children(server)]


def wait_until_gone(processes: list[int], seconds: float = 30) -> None:
    """A killed runner's workers end by themselves."""
    wait_for(lambda: not any(Path(f"/proc/{process}/exe").exists() for process in processes), seconds)


def planned_hash(case: Path) -> str:
    """The hash of a case file's case, by the plan beside it; its own name where it is of no case there."""
    planned = json.loads((case.parents[1] / "plan.json").read_text())["cases"]
    return next((e["hash"] for e in planned if case.stem.endswith(e["hash"][:12])), case.stem)


def check_what_is_there(directory: Path) -> dict[str, bytes]:
    """Every case file and cache entry is whole, whatever happened; the case files' bytes by their hash."""
    found = {}
    for path in (directory / RUN / "cases").glob("*.vtkhdf"):
        case_hash = store.read_case(path).hash
        assert path.stem.endswith(f"-{case_hash[:12]}")
        found[case_hash] = path.read_bytes()
    for path in (directory / CACHE).rglob("*.npz"):
        assert read_arrays(path) is not None, path
    if (directory / RUN / "plan.json").exists():
        store.read_run(directory / RUN)
    return found


def half_written(directory: Path) -> list[Path]:
    """Temporary files, which only a killed process leaves."""
    hidden = (directory / "results").rglob(".*")
    return [path for path in hidden if path.is_file() and not path.name.startswith(".lock")]


def assert_same_results(
    run_directory: Path, undisturbed: Path, rounding: float = 1e-12, of_metrics: float = 1e-9
) -> None:
    """All cases of a run are done, with the numbers of an undisturbed one to parts of their largest."""
    run, expected = store.read_run(run_directory), store.read_run(undisturbed)
    assert (run.failed, run.missing) == ([], [])
    assert [case.hash for case in run.cases] == [case.hash for case in expected.cases]
    for ours, theirs in zip(run.cases, expected.cases, strict=True):
        assert ours.models.keys() == theirs.models.keys()
        for name, model in theirs.models.items():
            # a case alone is solved, in company combined from unit loads: rounding apart, the same
            for field in ("displacement", "reaction_force", "volume"):
                assert_near(getattr(ours.models[name], field), getattr(model, field), rounding)
        for name, metrics in theirs.metrics.items():
            for metric, series in metrics.items():
                # some are differences of numbers near one
                atol = 1e-12 if METRICS[metric].unit == "1" else 0.0
                assert_near(ours.metrics[name][metric], series, of_metrics, atol)


def assert_near(values: Array, expected: Array, rounding: float, atol: float = 0.0) -> None:
    """Equal to a part of the largest, NaN where it is expected."""
    most = float(np.abs(np.nan_to_num(expected)).max())
    assert_allclose(values, expected, rtol=rounding, atol=rounding * most + atol)
