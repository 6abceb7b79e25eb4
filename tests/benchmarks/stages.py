"""Where the time goes, stage by stage: the quickstart of `make demo` and a sweep of twenty cases.

Each study runs twice: once as a user runs it, for the whole, and once with its cases in this process, the processor
time of whose functions is taken. What no stage names is the program's own: files, plans, hashes.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from studies import models, reference, store, worker
from studies.explain import summary
from studies.meshing import geometry
from studies.plan import Plan, make_plan, task_of
from studies.study_file.config import expand, load_study
from tests.command import vdmbench

ROOT = Path(__file__).parents[2]
TWENTY = '"constraints.finger.force" = { start = "0.05 N", stop = "0.4 N", num = 20 }'
PHYSICS = ("mesh", "set-up and solve")


class Stages:
    """Processor seconds by stage; what a stage does inside another counts for the inner one only."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._inner = [0.0]

    def timed(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, its time kept."""

        def wrapped(*arguments: Any, **options: Any) -> Any:
            start = time.process_time()
            self._inner.append(0.0)
            try:
                return function(*arguments, **options)
            finally:
                spent = time.process_time() - start
                own = spent - self._inner.pop()
                self._inner[-1] += spent
                self.seconds[stage] = self.seconds.get(stage, 0.0) + own

        return wrapped


def patch(stages: Stages) -> Callable[[], None]:
    """Time the functions of each stage; returns what undoes it."""
    places: list[tuple[Any, str, str]] = [
        (geometry, "build_mesh", "mesh"),
        (models, "run_model", "set-up and solve"),
        (models, "run_together", "set-up and solve"),
        (reference, "refine", "mesh"),
        (worker, "build_scene", "scene"),
        (worker, "compare", "metrics"),
        (worker, "own_error", "metrics"),
        (worker, "write_case", "store"),
        (worker, "write_levels", "store"),
        (store, "read_case", "store"),
        (store, "write_study", "store"),
    ]
    before = [(module, name, getattr(module, name)) for module, name, _ in places]
    for module, name, stage in places:
        setattr(module, name, stages.timed(stage, getattr(module, name)))

    def undo() -> None:
        for module, name, function in before:
            setattr(module, name, function)

    return undo


def studied(directory: Path, twenty: bool) -> Path:
    """The quickstart as it is, or with twenty forces in place of its sweep."""
    text = (ROOT / "studies" / "cases" / "quickstart.toml").read_text()
    if twenty:
        start, end = text.index("[sweep]"), text.index("# the reference is solved again")
        text = f"{text[:start]}[sweep]\n{TWENTY}\n\n{text[end:]}"
    path = directory / "study.toml"
    path.write_text(text)
    return path


def measure(study: Path, directory: Path) -> dict[str, float]:
    """Seconds by stage of a study that runs in this process, on a cache of its own."""
    stages = Stages()
    start = time.process_time()
    undo = patch(stages)
    try:
        loaded = load_study(study)
        plan = make_plan(loaded, expand(loaded), directory / "run", directory / "cache")
        _run(plan)
        stages.timed("report", _report)(plan, study)
    finally:
        undo()
    stages.seconds["the rest"] = time.process_time() - start - sum(stages.seconds.values())
    return stages.seconds


def _run(plan: Plan) -> None:
    for group in plan.groups(plan.cases, 1):
        tasks = [task_of(case, plan) for case in group]
        Path(tasks[0]["path"]).parent.mkdir(parents=True, exist_ok=True)
        with worker.share(tasks):
            for task in tasks:
                worker.run_case(task)


def _report(plan: Plan, study: Path) -> None:
    import json

    from studies.report.page import write_report

    (plan.directory / "study.toml").write_text(study.read_text())
    (plan.directory / "plan.json").write_text(json.dumps(summary(plan)))
    run = store.read_run(plan.directory)
    store.write_study(plan.directory, run)
    write_report(run, plan.directory / "report.html")


def start_seconds(code: str, repeats: int = 3) -> float:
    """Least time of a fresh interpreter that runs this code."""
    found = []
    for _ in range(repeats):
        start = time.perf_counter()
        subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
        found.append(time.perf_counter() - start)
    return min(found)


def table(seconds: dict[str, float]) -> list[str]:
    """Lines of stages with their share; a star marks what is not physics and above a tenth."""
    whole = sum(seconds.values())
    return [
        f"  {stage:<20} {value:7.2f} s {100 * value / whole:6.1f} %"
        + (" *" if stage not in PHYSICS and value > 0.1 * whole else "")
        for stage, value in sorted(seconds.items(), key=lambda item: -item[1])
    ]


def main() -> None:
    """Print where the time goes."""
    empty, program = (
        start_seconds("pass"),
        start_seconds("import studies.worker, vdm.model, fem_reference.linear"),
    )
    plots = start_seconds("import studies.report.page")
    helped = start_seconds(
        "import sys; sys.argv = ['vdmbench', '--help']; import studies.cli; studies.cli.main()"
    )
    print(
        f"process start {empty:.2f} s; imports of a worker {program - empty:.2f} s,"
        f" of the report {plots - empty:.2f} s"
    )
    print(f"vdmbench --help {helped:.2f} s")
    for name, twenty in (("make demo", False), ("20 cases", True)):
        with tempfile.TemporaryDirectory() as text:
            directory = Path(text)
            study = studied(directory, twenty)
            start = time.perf_counter()
            result = vdmbench("run", study, "--jobs", "1", "--out", "user", cwd=directory)
            if result.returncode:
                raise RuntimeError(result.stderr)
            whole = time.perf_counter() - start
            seconds = measure(study, directory)
        print(f"{name}: {whole:.2f} s as a user runs it, one case at once; by stage, imports apart:")
        print("\n".join(table(seconds)), flush=True)


if __name__ == "__main__":
    main()
