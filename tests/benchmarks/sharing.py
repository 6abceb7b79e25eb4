"""What 100 linear loads cost beside one: shared as `run` does it, and the naive way, with the numbers compared.

Run with `make bench-sharing`, or `python -m tests.benchmarks.sharing --loads 20 --naive 5` for less.

A study's cost is everything from its directory to its report: mesh, set-ups, solves, metrics, files, report. Three
studies of the same body are timed whole, by `run_plan` in one worker and with an empty cache each: one load; a load
history of 100 loads in one case; 100 cases, ten places of the finger by ten pressures. The naive way is each of the
100 cases by itself: its own set-ups and factorisation, nothing cached but the mesh, no report.

What is compared is processor time, that of the workers included: what else runs on the machine disturbs it least.
"""

from __future__ import annotations

import argparse
import copy
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from studies.case import CaseResult
from studies.execute import run_tasks
from studies.plan import Plan, make_plan, task_of
from studies.run import Options, run_plan
from studies.store import read_case
from studies.study_file.config import expand
from studies.study_file.schema import Study
from studies.worker import run_case

TABLES: dict[str, Any] = {
    "study": {
        "name": "sharing",
        "title": "Many loads on one body",
        "models": ["vdm-paper", "vdm-consistent", "vdm-vector", "vdm-boundary", "fem-linear"],
        "reference": "fem-linear",
    },
    "geometry": {"shape": "sphere", "radius": 0.05, "mesh_size": 0.01},
    "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.49},
    "regions": {
        "base": {"below": {"axis": "z", "fraction": 0.15}},
        "finger": {"cap": {"direction": [0.0, 0.0, 1.0], "angle": 0.45}},
    },
    "constraints": [
        {"kind": "fixed", "region": "base"},
        {"name": "finger", "kind": "contact", "region": "finger", "pressure": 40.0, "profile": "hertz"},
    ],
}


@dataclass(frozen=True)
class Costs:
    """Processor seconds of each way to do `loads` loads, and how far the stored numbers of two ways are apart.

    Attributes
    ----------
    one : a study of one load
    history : a study of one case whose history has all loads
    cases : a study of a case per load
    naive : a case per load, each alone; measured on some of them and scaled up
    difference : largest difference of a stored displacement, shared to naive, over the case's largest
    """

    loads: int
    one: float
    history: float
    cases: float
    naive: float
    difference: float


def measure(loads: int, naive: int, directory: Path, **changes: Any) -> Costs:
    """Run the studies in `directory`. `loads` is a multiple of ten; `naive` cases are run alone."""
    pressures = np.linspace(8.0, 80.0, loads // 10).tolist()
    places = np.linspace(-0.6, 0.6, 10).tolist()
    sweep = {"regions.finger.cap.direction.0": places, "constraints.finger.pressure": pressures}
    factors = np.linspace(0.02, 2.0, loads).tolist()
    _timed("warm-up", directory, changes)  # the first run also loads the libraries of the report
    one = _timed("one", directory, changes)
    history = _timed("history", directory, changes | {"load": {"factors": factors}})
    shared, seconds = _timed("cases", directory, changes | {"sweep": sweep})
    chosen = shared.cases[:: max(1, len(shared.cases) // naive)]
    alone, seconds_alone = _naive(shared, directory / "naive", [case.hash for case in chosen])
    pairs = [(read_case(shared.case_file(case)), alone[case.hash]) for case in chosen]
    return Costs(
        loads=len(shared.cases),
        one=one[1],
        history=history[1],
        cases=seconds,
        naive=seconds_alone * len(shared.cases) / len(chosen),
        difference=max(_difference(a, b) for a, b in pairs),
    )


def _timed(name: str, directory: Path, changes: dict[str, Any]) -> tuple[Plan, float]:
    began = _processor_seconds()
    plan = _plan(directory / name, directory / name / "cache", changes)
    run, _ = run_plan(plan, "", Options(jobs=1), lambda _: None)
    seconds = _processor_seconds() - began
    if run.failed or run.missing:
        raise RuntimeError(f"{name}: {len(run.failed)} cases failed: {run.failed[:1]}")
    return plan, seconds


def _plan(directory: Path, cache: Path, changes: dict[str, Any]) -> Plan:
    study = Study.model_validate(copy.deepcopy(TABLES) | changes)
    return make_plan(study, expand(study), directory, cache)


def _naive(shared: Plan, directory: Path, hashes: Sequence[str]) -> tuple[dict[str, CaseResult], float]:
    """Each case in a worker of its own that uses nothing of another's but the mesh: results and seconds."""
    plan = Plan(shared.study, shared.cases, shared.meshes, directory, shared.cache)
    tasks = [task_of(case, plan, fresh=True) for case in plan.cases if case.hash in hashes]
    began = _processor_seconds()
    for outcome in run_tasks(
        run_case,
        [[task] for task in tasks],
        jobs=1,
        log_directory=directory / "failed",
        started=lambda _: None,
    ):
        if not outcome.ok:
            raise RuntimeError(f"naive: {outcome.message}")
    seconds = _processor_seconds() - began
    return {task["id"]: read_case(Path(task["path"])) for task in tasks}, seconds


def _processor_seconds() -> float:
    """Of this process, its children and all that they have seen end: the workers' server among them."""
    ticks = 0
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rsplit(")", 1)[1].split()
        except OSError:  # it has ended meanwhile
            continue
        if int(fields[1]) == os.getpid():
            ticks += sum(map(int, fields[11:15]))
    return sum(os.times()[:4]) + ticks / os.sysconf("SC_CLK_TCK")


def _difference(a: CaseResult, b: CaseResult) -> float:
    """Largest difference of displacements of two cases, each model by its own largest displacement."""
    return max(
        float(np.abs(a.models[name].displacement - u).max() / np.abs(u).max())
        for name, u in ((name, result.displacement) for name, result in b.models.items())
    )


def table(costs: Costs) -> str:
    """The costs as text."""
    rows = [
        ("one load", costs.one),
        (f"one case, a history of {costs.loads} loads", costs.history),
        (f"{costs.loads} cases of one load", costs.cases),
        (f"{costs.loads} cases, each alone", costs.naive),
    ]
    lines = [f"{what:<40} {seconds:8.2f} s  {seconds / costs.one:7.2f}" for what, seconds in rows]
    return "\n".join([*lines, f"largest difference, shared to alone: {costs.difference:.1e} of the largest"])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--loads", type=int, default=100, help="how many, a multiple of ten")
    parser.add_argument("--naive", type=int, default=100, help="how many cases to run the naive way too")
    parser.add_argument("--mesh-size", type=float, default=10.0, help="millimetres")
    parser.add_argument("--levels", type=int, default=1, help="mesh levels of the reference, 1 to 3")
    options = parser.parse_args()
    changes: dict[str, Any] = {"geometry": TABLES["geometry"] | {"mesh_size": options.mesh_size / 1e3}}
    if options.levels > 1:
        changes["uncertainty"] = {"levels": options.levels}
    with tempfile.TemporaryDirectory() as directory:
        print(table(measure(options.loads, options.naive, Path(directory), **changes)))


if __name__ == "__main__":
    main()
