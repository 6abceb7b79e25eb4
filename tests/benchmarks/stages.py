"""Where the time goes, stage by stage: the quickstart of `make demo` and sweeps of twenty cases; README's table.

Each study runs as a user runs it, on a cache of its own, after a small one that has the modules compiled and read.
Every process of the run times itself (`stage_clock`); what no function names is the program's own: files, plans,
hashes. The system's accounts of all processes add what comes after the clocks, which is counted with the starts.
"""

from __future__ import annotations

import ctypes
import os
import re
import resource
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.benchmarks import stage_clock
from tests.benchmarks.stage_clock import STARTS
from tests.command import vdmbench
from tests.docs import marked

ROOT = Path(__file__).parents[2]
FORCES = '"constraints.finger.force" = { start = "0.05 N", stop = "0.4 N", num = %d }'
RATIOS = '"tissue.poisson_ratio" = [0.45, 0.47, 0.49, 0.499, 0.4999]'
ANGLES = '"regions.finger.cap.angle" = { start = "12 deg", stop = "28 deg", num = 20 }'
STUDIES = {
    "make demo": ("quickstart", None),
    "a ball of 5 tissues under 4 forces": ("quickstart", f"{FORCES % 4}\n{RATIOS}"),
    "an organ under 20 contacts": ("accuracy-organ", ANGLES),
    "a ball under 20 multiples of one load": ("quickstart", FORCES % 20),  # one solve serves all
}
PHYSICS = ("mesh", "set-up and solve")
README = ROOT / "README.md"
_PR_SET_CHILD_SUBREAPER = 36  # linux/prctl.h: orphans of our children become ours, with their times


def studied(directory: Path, name: str, sweep: str | None, mesh_size: str | None = None) -> Path:
    """A shipped study as it is, or with another sweep, or another mesh."""
    text = (ROOT / "studies" / "cases" / f"{name}.toml").read_text()
    if sweep is not None:
        text, swept = re.subn(r"\n\[sweep\]\n.*?\n(?=\n)", f"\n[sweep]\n{sweep}\n", text, flags=re.DOTALL)
        assert swept == 1
    if mesh_size is not None:
        text = re.sub(r'mesh_size = ".*"', f'mesh_size = "{mesh_size}"', text)
    path = directory / "study.toml"
    path.write_text(text)
    return path


@dataclass(frozen=True)
class Spent:
    """Seconds that a run took, processor seconds of its processes by stage, and of their starts by process."""

    seconds: float
    stages: Mapping[str, float]
    starts: Mapping[str, float]


def measure(study: Path, directory: Path) -> Spent:
    """Run a study in a directory as a user does, one case at once. Waits for all children of this process."""
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    clocks = directory / "clocks"
    clocks.mkdir()
    (directory / "sitecustomize.py").write_text(stage_clock.SITE)
    environment = {
        "PYTHONPATH": os.pathsep.join([str(directory), str(ROOT), os.environ.get("PYTHONPATH", "")]),
        "PYTHONDONTWRITEBYTECODE": "",  # a user's modules are compiled once
        stage_clock.DIRECTORY: str(clocks),
    }
    before, start = _spent(), time.perf_counter()
    result = vdmbench("run", study, "--jobs", "1", "--out", "run", cwd=directory, **environment)
    seconds = time.perf_counter() - start
    if result.returncode:
        raise RuntimeError(result.stderr)
    while _another_ended():
        pass
    stages: dict[str, float] = {}
    starts: dict[str, float] = {}
    for clock in clocks.iterdir():
        for line in clock.read_text().splitlines():
            spent, stage = line.split(" ", 1)
            stages[stage] = stages.get(stage, 0.0) + float(spent)
            if stage == STARTS:
                starts[clock.stem] = starts.get(clock.stem, 0.0) + float(spent)
    starts["ends"] = _spent() - before - sum(stages.values())
    stages[STARTS] += starts["ends"]
    return Spent(seconds, stages, starts)


def _spent() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _another_ended() -> bool:
    try:
        os.waitpid(-1, 0)
    except ChildProcessError:
        return False
    return True


def table(seconds: dict[str, float]) -> list[str]:
    """Lines of stages with their share; a star marks what is not physics and above a tenth."""
    whole = sum(seconds.values())
    return [
        f"  {stage:<20} {value:7.2f} s {100 * value / whole:6.1f} %"
        + (" *" if stage not in PHYSICS and value > 0.1 * whole else "")
        for stage, value in sorted(seconds.items(), key=lambda item: -item[1])
    ]


def markdown(found: Mapping[str, Spent]) -> str:
    """README's table: processor time and its shares by study, physics first."""
    stages = dict.fromkeys(stage for spent in found.values() for stage in spent.stages)
    order = [
        *PHYSICS,
        *sorted(set(stages) - set(PHYSICS), key=lambda s: -max(t.stages[s] for t in found.values())),
    ]
    rows = [[stage, *(_share(spent.stages, stage) for spent in found.values())] for stage in order]
    rows.append(["all", *(f"{sum(spent.stages.values()):.1f} s" for spent in found.values())])
    return marked.table(["stage", *found], rows)


def _share(seconds: Mapping[str, float], stage: str) -> str:
    return f"{seconds[stage]:.1f} s, {100.0 * seconds[stage] / sum(seconds.values()):.1f} %"


def main() -> None:
    """Print where the time goes, and write README's table."""
    found: dict[str, Spent] = {}
    for name, what in {"": ("quickstart", FORCES % 2, "25 mm"), **STUDIES}.items():
        with tempfile.TemporaryDirectory() as text:
            spent = measure(studied(Path(text), *what), Path(text))
        if name:  # the first one only has all modules compiled
            starts = ", ".join(f"{part} {seconds:.2f} s" for part, seconds in sorted(spent.starts.items()))
            print(f"{name}: {spent.seconds:.1f} s, one case at once; processor time by stage:")
            print(*table(spent.stages), f"  {STARTS}: {starts}", sep="\n", flush=True)
            found[name] = spent
    marked.show(README, "stages", markdown(found))


if __name__ == "__main__":
    main()
