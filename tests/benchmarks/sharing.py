"""What 100 linear loads cost beside one: shared as `run` does it, and the naive way, with the numbers compared.

Run with `make bench-sharing`, or `python -m tests.benchmarks.sharing --mesh-sizes 10 --refined` for less.

A study's cost is everything from its directory to its report: mesh, set-ups, solves, metrics, files, report.
Studies of one body are timed whole, by `run_plan` in one worker and with an empty cache each: one load; 100 cases
that are multiples of one load; and, where the reference has no error bar, a load history of 100 loads in one case
and 100 cases, ten places of the finger by ten pressures, which are ten loads and their multiples. The naive way is
each of the 100 multiples by itself: its own set-ups and solves on every mesh level, nothing cached but the mesh, no
report.

What is compared is processor time, that of the workers included: what else runs on the machine disturbs it least.
All studies are run in turn, in several rounds, every other one backwards: a ratio is that of the medians, and its
range that of the rounds. The solve of one load differs from round to round by as much as all further cases take. So
what they add is measured without it too: one other multiple and 100 others, in studies that find the reference in
the cache.
What cases cannot share is measured too, part by part: the scene, the results' scaling, the metrics, the file that
each of them leaves and its reading for the report. It grows with the surface, one load grows with the body.

The numbers of the two ways are compared, of every model and mesh level.
"""

from __future__ import annotations

import argparse
import copy
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from studies import models
from studies.case import CaseResult
from studies.execute import run_tasks
from studies.plan import Plan, make_plan, task_of
from studies.reference import own_error
from studies.run import Options, run_plan
from studies.scene import build_scene
from studies.setups import next_turn, sharing
from studies.store import read_case, write_case
from studies.study_file.config import expand
from studies.study_file.schema import Study
from studies.worker import _mesh, _surface, compare, run_case
from tests.docs import marked

REFERENCE = "fem-linear"
FORMAT = Path(__file__).parents[2] / "results" / "FORMAT.md"
BY_PARTS = "one load, and what 99 others add to one where the reference is cached"
SHOWN = [(10.0, False), (5.0, False), (4.0, True)]  # mesh size [mm], with error bar
TABLES: dict[str, Any] = {
    "study": {
        "name": "sharing",
        "title": "Many loads on one body",
        "models": ["vdm-paper", "vdm-consistent", "vdm-vector", "vdm-boundary", REFERENCE],
        "reference": REFERENCE,
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
    nodes : of the surface
    rounds : study -> processor seconds, that of one load first, in each round
    added : in each round what the further cases add to one, where the reference is cached [s]
    naive : a case per load, each alone; measured on some of them and scaled up
    difference : largest difference of a stored number, shared to naive, over the model's largest of its kind
    further : part -> processor seconds of one further case that is a multiple, median
    """

    loads: int
    nodes: int
    rounds: Sequence[dict[str, float]]
    added: Sequence[float]
    naive: float
    difference: float
    further: dict[str, float]

    @property
    def seconds(self) -> dict[str, float]:
        """Study -> median processor seconds, that of one load first."""
        medians = {
            study: float(np.median([seconds[study] for seconds in self.rounds])) for study in self.rounds[0]
        }
        return medians | {f"the {self.loads} multiples, each alone": self.naive}

    def ratio(self, study: str) -> tuple[float, float, float]:
        """A study over one load: the ratio of the medians, and the least and the largest of a round."""
        one = next(iter(self.rounds[0]))
        each = [seconds.get(study, self.naive) / seconds[one] for seconds in self.rounds]
        return self.seconds[study] / self.seconds[one], min(each), max(each)

    def ratio_by_parts(self) -> tuple[float, float, float]:
        """One load and what the further cases add over one load: of the medians, the least and the largest."""
        one = next(iter(self.seconds.values()))
        return (
            1.0 + float(np.median(self.added)) / one,
            1.0 + min(self.added) / one,
            1.0 + max(self.added) / one,
        )


def measure(
    loads: int, naive: int, directory: Path, *, rounds: int = 1, bar: bool = False, **changes: Any
) -> Costs:
    """Run the studies in `directory`. `loads` is a multiple of ten; `naive` cases are run alone."""
    if bar:
        changes = changes | {"uncertainty": {"levels": 2}}
    pressures = np.linspace(8.0, 80.0, loads // 10).tolist()
    places = np.linspace(-0.6, 0.6, 10).tolist()
    factors = np.linspace(0.02, 2.0, loads).tolist()
    one, multiples = "one load", f"{loads} cases, multiples of one load"
    swept = np.linspace(0.8, 80.0, loads).tolist()
    studies: dict[str, dict[str, Any]] = {
        one: {"sweep": {"constraints.finger.pressure": swept[:1]}},
        multiples: {"sweep": {"constraints.finger.pressure": swept}},
    }
    if not bar:
        studies |= {
            f"one case, a history of {loads} loads": {"load": {"factors": factors}},
            f"{loads} cases, {loads // 10} multiples each of 10 loads": {
                "sweep": {"regions.finger.cap.direction.0": places, "constraints.finger.pressure": pressures}
            },
        }
    # the first run also loads the libraries of the report
    _timed("warm-up", directory, {"geometry": TABLES["geometry"] | {"mesh_size": 0.02}})
    others = (1.1 * np.array(swept)).tolist()
    plans: dict[str, Plan] = {}
    taken: list[dict[str, float]] = []
    added = []
    for number in range(rounds):
        taken.append({})
        for study in list(studies)[:: -1 if number % 2 else 1]:  # none is always the one after the other
            name = f"{number}-{list(studies).index(study)}"
            plans[study], taken[-1][study] = _timed(name, directory, changes | studies[study])
        cached = []
        for few in (others[:1], others):
            own = {"sweep": {"constraints.finger.pressure": few}}
            name = f"{number}-cached-{len(few)}"
            cached.append(_timed(name, directory, changes | own, plans[multiples].cache)[1])
        added.append(cached[1] - cached[0])
    plan = plans[multiples]
    chosen = plan.cases[loads // naive // 2 :: loads // naive]  # none of them the first, which is solved
    alone, seconds_alone = _naive(plan, directory / "naive", [case.hash for case in chosen])
    pairs = [(read_case(plan.case_file(case)), alone[case.hash]) for case in chosen]
    costs = Costs(
        loads=loads,
        nodes=len(pairs[0][0].points),
        rounds=taken,
        added=added,
        naive=seconds_alone * loads / len(chosen),
        difference=max(_difference(a, b, name) for a, b in pairs for name in b.models),
        further={},
    )
    further = (costs.seconds[multiples] - costs.seconds[one]) / (loads - 1)
    return replace(costs, further=_further(plan, further))


def _further(plan: Plan, seconds: float) -> dict[str, float]:
    """What a further case of multiples takes, of `seconds` in all, part by part."""
    taken: dict[str, list[float]] = {}

    def timed(part: str, work: Callable[[], Any]) -> Any:
        began = time.process_time()
        out = work()
        taken.setdefault(part, []).append(time.process_time() - began)
        return out

    with threadpool_limits(1), sharing():
        for planned in plan.cases[-12:]:
            next_turn()
            study, path = planned.study, plan.case_file(planned)
            case = timed("reading it for the report", partial(read_case, path))
            mesh = _mesh(study, task_of(planned, plan))
            scene = timed("scene on the mesh", partial(build_scene, study, mesh))
            names = [name for name in study.study.models if not models.find(name)[0].volumetric]
            timed("results of the surface models", lambda: [models.run_model(scene, n) for n in names])  # noqa: B023
            found = timed("metrics", partial(compare, scene, case.models, case.reference))
            if case.reference_error:
                levels = [case.models[name] for name in (case.reference or "", REFERENCE)]
                known = {name: series.values for name, series in found[REFERENCE].items()}
                timed("error bar", partial(own_error, _surface(scene), levels, case.load_factors, known))
            timed("file", partial(write_case, path, case))
    parts = {part: float(np.median(values[2:])) for part, values in taken.items()}
    return parts | {"the rest": seconds - sum(parts.values())}


def _timed(
    name: str, directory: Path, changes: dict[str, Any], cache: Path | None = None
) -> tuple[Plan, float]:
    began = _processor_seconds()
    plan = _plan(directory / name, cache or directory / name / "cache", changes)
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
    plan = replace(shared, directory=directory, fresh=True)
    tasks = [task_of(case, plan) for case in plan.cases if case.hash in hashes]
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


def _difference(a: CaseResult, b: CaseResult, name: str) -> float:
    """Largest difference of a model's displacements, forces, energies or volumes, over the largest of its kind."""
    gaps = []
    for field in ("displacement", "reaction_force", "energy", "volume"):
        found, alone = (getattr(case.models[name], field) for case in (a, b))
        gaps.append(np.abs(found - alone).max() / np.abs(alone).max())
    return float(max(gaps))


def written(columns: Sequence[tuple[str, Costs]]) -> str:
    """Body -> its costs as the Markdown table of `results/FORMAT.md`: seconds of one load, the others over it."""
    first, *others = columns[0][1].seconds

    def times(ratio: float, least: float, most: float) -> str:
        return f"{ratio:.3g} times ({least:.3g} to {most:.3g})"

    def cell(costs: Costs, study: str) -> str:
        if study not in costs.seconds:
            return "not run"
        measured = costs.ratio(study)
        return times(*measured) if study in costs.rounds[0] else f"{measured[0]:.3g} times"

    rows = [
        [first, *(f"{c.seconds[first]:.3g} s" for _, c in columns)],
        *([study, *(cell(c, study) for _, c in columns)] for study in others),
        [BY_PARTS, *(times(*c.ratio_by_parts()) for _, c in columns)],
        ["a further multiple", *(f"{1e3 * sum(c.further.values()):.0f} ms" for _, c in columns)],
        *(
            [f"of it {part}", *(f"{1e3 * c.further.get(part, 0.0):.1f} ms" for _, c in columns)]
            for part in dict.fromkeys(part for _, c in columns for part in c.further)
        ),
        ["difference of a multiple's numbers", *(f"{c.difference:.0e}" for _, c in columns)],
    ]
    return marked.table(["study", *(body for body, _ in columns)], rows)


def table(costs: Costs) -> str:
    """The costs as text."""
    further = ", ".join(f"{part} {1e3 * seconds:.1f}" for part, seconds in costs.further.items())
    lines = []
    for study, seconds in costs.seconds.items():
        ratio, least, most = costs.ratio(study)
        lines.append(f"{study:<44} {seconds:8.2f} s  {ratio:7.3f} ({least:.3f} to {most:.3f})")
    lines.append("{}: {:.3f} ({:.3f} to {:.3f})".format(BY_PARTS, *costs.ratio_by_parts()))
    return "\n".join(
        [
            f"{costs.nodes} surface nodes, {len(costs.rounds)} rounds",
            *lines,
            f"largest difference of a number, shared to alone, over the largest: {costs.difference:.1e}",
            f"a further case that is a multiple, ms: {1e3 * sum(costs.further.values()):.0f}: {further}",
        ]
    )


def main() -> None:
    """Print the tables; with the sizes that `results/FORMAT.md` shows, write its table too."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--loads", type=int, default=100, help="how many, a multiple of ten")
    parser.add_argument("--naive", type=int, default=2, help="how many cases to run the naive way too")
    parser.add_argument("--rounds", type=int, default=3, help="how often to run each study of the shared way")
    parser.add_argument("--mesh-sizes", type=float, nargs="*", default=[10.0, 5.0], help="millimetres")
    parser.add_argument(
        "--refined",
        type=float,
        nargs="*",
        default=[4.0],
        help="mesh sizes with the reference's error bar",
    )
    options = parser.parse_args()
    columns = []
    runs = [(size, False) for size in options.mesh_sizes] + [(size, True) for size in options.refined]
    for size, bar in runs:
        geometry = TABLES["geometry"] | {"mesh_size": size / 1e3}
        with tempfile.TemporaryDirectory() as directory:
            how = "with" if bar else "no"
            print(f"mesh of {size:g} mm, {how} error bar of the reference:", end=" ", flush=True)
            costs = measure(
                options.loads,
                options.naive,
                Path(directory),
                rounds=options.rounds,
                bar=bar,
                geometry=geometry,
            )
            print(table(costs), flush=True)
        columns.append((f"{size:g} mm, {costs.nodes:,} nodes{', with error bar' if bar else ''}", costs))
    if runs == SHOWN:
        marked.show(FORMAT, "sharing", written(columns))


if __name__ == "__main__":
    main()
