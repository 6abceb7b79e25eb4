"""Tries the error bars of two mesh levels on a third on cases of shipped studies.

Studies may be named as arguments: rows of others stay as they are.

Writes `results/error-bars.json`, which the tests read, and `results/error-bars.md`. About half an hour of an idle
core, and 3 GB.
"""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from tools import marked
from tools.runs import CASES, ROOT
from tools.third_level import HEADLINE, audited
from vdmbench.body.surface_measures import Surface, deformations, weighted_norms
from vdmbench.measures.metrics import METRICS, VECTOR
from vdmbench.store.cases import read_run
from vdmbench.study.config import expand, load_study
from vdmbench.study.registry import REFINED
from vdmbench.study.schema import Study, Uncertainty
from vdmbench.verdict.formatting import percent
from vdmbench.work.plan import make_plan
from vdmbench.work.run import Options, run_plan

RUNS = ROOT / "build" / "error-bars"  # what is there is not done again
FOUND = ROOT / "results" / "error-bars.json"
DOCUMENT = ROOT / "results" / "error-bars.md"
# study -> which of its cases, numbered from 1: some of every body, as many as half an hour holds
TRIED = {
    "accuracy-box": (1, 4),
    "anisotropy": (4,),
    "calibrate-box": (1, 5, 9),
    "calibrate-ellipsoid": (1, 5, 9),
    "calibrate-organ": (1, 5, 9),
    "calibrate-sphere": (1, 5, 9),
    "contact-size": (1, 2, 3, 4, 5),
    "convergence": (1, 2),
    "gravity": (1,),
    "liver-palpation": (1,),
    "locking": (1, 6),
    "peers": (1,),
    "poisson-sweep": (1, 6),
    "quickstart": (1, 2, 3),
}
HEAD = """# What the error bars of two mesh levels are worth

Made by `make evidence WHAT=error_bars`.
A study with `uncertainty.levels = 2` has the reference on its mesh split once, and for
a bar the difference to that on the mesh itself. Here, on shipped studies' own meshes, it is split once more. A bar
holds where it is at least the distance of its number from the best estimate: the number for the reference that
Richardson's extrapolation of the three levels gives, by the order observed. "Used" is that distance over the bar:
at most 1 where it holds. Cases are numbered from 1, as `vdmbench plan` lists them.
"""


def tried_on_a_third_level(study: Study, number: int, directory: Path) -> dict[str, Any]:
    """What is kept of a case, numbered from 1: of each metric what is used of each of its bars, to four digits."""
    case = expand(study)[number - 1]
    plans, runs = [], []
    for levels in (2, 3):
        changed = {"uncertainty": Uncertainty(levels=levels), "limits": None}
        alone = dataclasses.replace(case, study=case.study.model_copy(update=changed))
        plan = make_plan(alone.study, [alone], directory / f"{study.study.name}-{number}-{levels}", directory)
        run, _ = run_plan(plan, "", Options(jobs=1), lambda _: None, lambda path, _: (read_run(path), path))
        plans.append(plan)
        runs += run.cases
    found, finer = runs
    reference = str(study.study.reference)
    tried = audited(plans[0], plans[0].cases[0], found, finer)
    used: dict[str, list[float]] = {}
    for bar in tried.bars:
        used.setdefault(bar.metric, []).append(_rounded(bar.used))
    own = {bar.metric: bar for bar in tried.bars if bar.model == reference}
    levels_of = (found.models[reference], *(one.models[reference + REFINED] for one in (found, finer)))
    fields = np.stack([result.displacement[found.full_load] for result in levels_of])
    surface = Surface(found.points, found.triangles)
    deformed = deformations(surface.points, fields, surface.areas)
    gaps = weighted_norms(np.diff(deformed, axis=0), surface.areas)
    return {
        "study": study.study.name,
        "case": number,
        "mesh_size": case.study.geometry.mesh_size,
        "bar": own[VECTOR].bar,
        "order": round(tried.order, 2),
        "order_deformation": round(math.log2(gaps[0] / gaps[1]), 2),
        "own": {metric: _rounded(own[metric].used) for metric in HEADLINE},
        "used": used,
    }


def _rounded(share: float) -> float:
    return float(f"{share:.4g}")


def own_held(rows: Iterable[Mapping[str, Any]], metric: str) -> int:
    """In how many cases the bar holds for the reference on its mesh, whose error is nothing but the reference's."""
    return sum(row["own"][metric] <= 1.0 for row in rows)


def held(rows: Iterable[Mapping[str, Any]], metrics: Iterable[str]) -> tuple[int, int]:
    """How many bars of some metrics hold, of how many."""
    shares = [share for row in rows for metric in metrics for share in row["used"].get(metric, [])]
    return sum(share <= 1.0 for share in shares), len(shares)


def document(rows: Sequence[Mapping[str, Any]]) -> str:
    """The whole of `results/error-bars.md`."""
    by_case = [
        [
            row["study"],
            str(row["case"]),
            f"{1e3 * row['mesh_size']:g} mm",
            f"± {percent(row['bar'])}",
            f"{row['order']:.2f} / {row['order_deformation']:.2f}",
            " / ".join(f"{row['own'][metric]:.2f}" for metric in HEADLINE),
            " / ".join(f"{max(row['used'][metric]):.2f}" for metric in HEADLINE),
        ]
        for row in rows
    ]
    by_metric = []
    for metric in METRICS:
        shares = [share for row in rows for share in row["used"].get(metric, [])]
        if shares:
            count, of = held(rows, [metric])
            by_metric.append(
                [f"`{metric}`", f"{count} of {of}", f"{median(shares):.2g}", f"{max(shares):.2g}"]
            )
    vector, deformation = (own_held(rows, metric) for metric in HEADLINE)
    head = ["study", "case", "mesh", "bar", "order", "used by the reference's own mesh", "used at most"]
    return (
        HEAD
        + "\nThe two errors, displacement / deformation, but for the bar, which is the displacement's:\n\n"
        + marked.table(head, by_case)
        + "\nOf the reference on the study's own mesh the error is its own alone: its bars hold in "
        + f"{vector} / {deformation} of {len(rows)} cases.\nOf all models, and of the reference's own figures:\n\n"
        + marked.table(["number", "bars that hold", "used, median", "used at most"], by_metric)
    )


def write(rows: Sequence[Mapping[str, Any]]) -> None:
    """What was found, a case a line, and the document."""
    FOUND.write_text("[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n")
    DOCUMENT.write_text(document(rows))


def main() -> None:
    """Solve the cases of the studies named, by default of all, and write what came out; rows of others stay."""
    named = sys.argv[1:] or list(TRIED)
    if unknown := set(named) - set(TRIED):
        sys.exit(f"no case of {', '.join(sorted(unknown))} is tried; take some of {', '.join(TRIED)}")
    kept = json.loads(FOUND.read_text())
    found = {study: [one for one in kept if one["study"] == study] for study in TRIED}
    for study in named:
        loaded = load_study(CASES / f"{study}.toml")
        found[study] = [tried_on_a_third_level(loaded, number, RUNS) for number in TRIED[study]]
        write([one for rows in found.values() for one in rows])


if __name__ == "__main__":
    main()
