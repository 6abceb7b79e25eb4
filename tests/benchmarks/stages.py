"""Where the time goes, stage by stage: the quickstart of `make demo` and sweeps of twenty cases; README's table.

Each study runs twice: once as a user runs it, whose processor time is taken with that of all its processes; and
once with its cases in this process, where everything is loaded already, the processor time of whose functions is
taken. What the first takes beyond the second is start and imports of processes; what no function names is the
program's own: files, plans, hashes.
"""

from __future__ import annotations

import ctypes
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from studies import models, reference, store, worker
from studies.explain import summary
from studies.meshing import geometry
from studies.plan import Plan, make_plan, task_of
from studies.study_file.config import expand, load_study
from tests.command import vdmbench
from tests.docs import marked

ROOT = Path(__file__).parents[2]
FORCES = '"constraints.finger.force" = { start = "0.05 N", stop = "0.4 N", num = %d }'
RATIOS = '"tissue.poisson_ratio" = [0.45, 0.47, 0.49, 0.499, 0.4999]'
SWEEPS = {
    "make demo": None,
    "20 cases, 5 tissues under 4 loads": f"{FORCES % 4}\n{RATIOS}",
    "20 cases, one tissue under 20 loads": FORCES % 20,  # what is shared leaves the least physics
}
PHYSICS = ("mesh", "set-up and solve")
STARTS = "start and imports"
README = ROOT / "README.md"
_PR_SET_CHILD_SUBREAPER = 36  # linux/prctl.h: orphans of our children become ours, with their times


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


def studied(directory: Path, sweep: str | None, coarse: bool = False) -> Path:
    """The quickstart as it is, or with another sweep, or on a coarse mesh."""
    text = (ROOT / "studies" / "cases" / "quickstart.toml").read_text()
    if sweep is not None:
        start, end = text.index("[sweep]"), text.index("# the reference is solved again")
        text = f"{text[:start]}[sweep]\n{sweep}\n\n{text[end:]}"
    if coarse:
        text = text.replace('mesh_size = "9 mm"', 'mesh_size = "25 mm"')
    path = directory / "study.toml"
    path.write_text(text)
    return path


def whole(study: Path, directory: Path) -> tuple[float, float]:
    """Seconds, and processor seconds of all its processes, of a study that runs as a user runs it."""
    before, start = _spent(), time.perf_counter()
    result = vdmbench("run", study, "--jobs", "1", "--out", "user", cwd=directory)
    seconds = time.perf_counter() - start
    if result.returncode:
        raise RuntimeError(result.stderr)
    while _another_ended():
        pass
    return seconds, _spent() - before


def _spent() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _another_ended() -> bool:
    try:
        os.waitpid(-1, 0)
    except ChildProcessError:
        return False
    return True


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
    """Median time of a fresh interpreter that runs this code."""
    found = []
    for _ in range(repeats):
        start = time.perf_counter()
        subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
        found.append(time.perf_counter() - start)
    return statistics.median(found)


def table(seconds: dict[str, float]) -> list[str]:
    """Lines of stages with their share; a star marks what is not physics and above a tenth."""
    whole = sum(seconds.values())
    return [
        f"  {stage:<20} {value:7.2f} s {100 * value / whole:6.1f} %"
        + (" *" if stage not in PHYSICS and value > 0.1 * whole else "")
        for stage, value in sorted(seconds.items(), key=lambda item: -item[1])
    ]


def markdown(found: Mapping[str, tuple[float, Mapping[str, float]]]) -> str:
    """README's table: the shares of processor time by study, physics first. `found`: seconds of wall, stages."""
    stages = dict.fromkeys(stage for _, spent in found.values() for stage in spent)
    order = [
        *PHYSICS,
        *sorted(set(stages) - set(PHYSICS), key=lambda s: -max(t[s] for _, t in found.values())),
    ]
    rows = [[stage, *(_share(spent, stage) for _, spent in found.values())] for stage in order]
    rows.append(["all, one case at once", *(f"{wall:.3g} s" for wall, _ in found.values())])
    return marked.table(["stage", *found], rows)


def _share(spent: Mapping[str, float], stage: str) -> str:
    return f"{100.0 * spent[stage] / sum(spent.values()):.1f} %"


def main() -> None:
    """Print where the time goes, and write README's table."""
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    empty, program = (
        start_seconds("pass"),
        start_seconds("import studies.worker, vdm.model, fem_reference.linear"),
    )
    runner = start_seconds("import studies.run, studies.report.page")
    helped = start_seconds(
        "import sys; sys.argv = ['vdmbench', '--help']; import studies.cli; studies.cli.main()", repeats=10
    )
    print(
        f"process start {empty:.2f} s; imports of a worker {program - empty:.2f} s,"
        f" of the runner and its report {runner - empty:.2f} s"
    )
    print(f"vdmbench --help {helped:.2f} s")
    with tempfile.TemporaryDirectory() as text:  # loads everything
        measure(studied(Path(text), FORCES % 2, coarse=True), Path(text))
    found: dict[str, tuple[float, dict[str, float]]] = {}
    for name, sweep in SWEEPS.items():
        with tempfile.TemporaryDirectory() as text:
            directory = Path(text)
            study = studied(directory, sweep)
            seconds, processor = whole(study, directory)
            stages = measure(study, directory)
        stages[STARTS] = max(processor - sum(stages.values()), 0.0)
        print(f"{name}: {seconds:.2f} s as a user runs it, one case at once; processor time by stage:")
        print("\n".join(table(stages)), flush=True)
        found[name] = seconds, stages
    marked.show(README, "stages", markdown(found))


if __name__ == "__main__":
    main()
