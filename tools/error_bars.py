"""Tries the error bars of two mesh levels on a third.

Cases of shipped studies, each on its own mesh, get their reference on three levels: the mesh, split once as with
`uncertainty.levels = 2`, and split twice. Of every number with a bar its distance from the best estimate is held
against the bar that two levels give. The best estimate is the number for Richardson's extrapolation of the
reference's displacement from all three, by the order observed in it. Studies may be named as arguments: rows of
others stay as they are.

Writes `results/error-bars.json`, which the tests read, and `results/error-bars.md`. About half an hour of an idle
core, and 3 GB.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from tools import marked
from vdmbench import models
from vdmbench.body.geometry import build_mesh
from vdmbench.body.refine import Hierarchy, refined
from vdmbench.body.surface_measures import Surface, weighted_norms, without_motions
from vdmbench.evidence.audit import HEADLINE, Bar, extrapolated
from vdmbench.measures.metrics import (
    METRICS,
    VECTOR,
    History,
    evaluate,
    evaluate_all,
    full_load_step,
)
from vdmbench.measures.reference import level_scene, own_error, require_converged, restricted
from vdmbench.measures.uncertainty import SIGNED, estimate_error, no_less, reference_bar
from vdmbench.scene.result import ModelResult
from vdmbench.scene.scene import build_scene
from vdmbench.study.config import expand, geometry_of, load_study
from vdmbench.study.model_name import REFINED
from vdmbench.study.schema import Study
from vdmbench.verdict.formatting import percent

ROOT = Path(__file__).parents[1]
CASES = ROOT / "studies" / "cases"
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


@dataclass(frozen=True)
class Levels:
    """A case, its models' results, and its reference on the mesh, split once and split twice."""

    study: str
    number: int  # of the case in the study, from 1
    mesh_size: float  # [m]
    surface: Surface
    load_factors: np.ndarray
    models: Mapping[str, ModelResult]  # the reference's on the mesh among them
    reference: str
    levels: Sequence[ModelResult]


def solved(study: Study, tried: Sequence[int]) -> Iterator[Levels]:
    """Some cases of a study, by number, the reference on three levels."""
    hierarchies: dict[str, Hierarchy] = {}
    for number in tried:
        case = expand(study)[number - 1].study
        geometry = geometry_of(case)
        meshes = hierarchies.setdefault(repr(geometry), refined(build_mesh(geometry), 2))
        yield _solved(case, number, meshes)


def _solved(study: Study, number: int, meshes: Hierarchy) -> Levels:
    info, scene = study.study, build_scene(study, meshes.meshes[0])
    reference = info.reference or ""
    levels = []
    for k in range(3):
        part = Hierarchy(meshes.meshes[: k + 1], meshes.parents[:k])
        result = restricted(models.run_model(level_scene(study, part), reference), part)
        require_converged(reference, result)
        levels.append(result)
    results = {name: models.run_model(scene, name) for name in info.models if name != reference}
    points, triangles, weighs = scene.mesh.surface_points, scene.mesh.triangles, bool(scene.gravity.any())
    return Levels(
        info.name,
        number,
        study.geometry.mesh_size,
        Surface(points, triangles, scene.contact, scene.contact_force, weighs),
        scene.load_factors,
        {**results, reference: levels[0]},
        reference,
        levels,
    )


def bars(case: Levels) -> list[Bar]:
    """Every number that two levels give a bar, at full load; the model of the reference's own is `REFINED`."""
    coarse, fine, _ = case.levels
    step = full_load_step(case.load_factors)
    own = evaluate(case.surface, _history(case, coarse), None)
    told = own_error(case.surface, [fine, coarse], case.load_factors)
    _, estimate = extrapolated(case.surface, case.levels, case.load_factors)
    best = _metrics(case, estimate)
    found = []
    for model, series in _metrics(case, _history(case, fine)).items():
        for metric, values in series.items():
            value = float(values[step])
            bar = _bar(float(own[metric][step]), value) if model == REFINED else reference_bar(told, metric)
            figures = {name: float(series[name][step]) for name in SIGNED if name in series}
            bar = no_less(bar, metric, figures, reference_bar(told, VECTOR))
            if math.isfinite(value) and math.isfinite(bar):
                found.append(Bar(model, metric, value, bar, float(best[model][metric][step])))
    return found


def _bar(coarse: float, fine: float) -> float:
    """Of a figure of the reference itself."""
    difference = coarse - fine
    return estimate_error([difference]).gci if math.isfinite(difference) else math.nan


def orders(case: Levels) -> tuple[float, float]:
    """The orders observed in displacement and deformation."""
    step = full_load_step(case.load_factors)
    surface = case.surface
    fields = np.stack([level.displacement[step] for level in case.levels])
    deformed = without_motions(surface.rigid_motions, fields, surface.areas)
    (vector, deformation) = (
        math.log2(float(np.divide(*weighted_norms(np.diff(of, axis=0), surface.areas))))
        for of in (fields, deformed)
    )
    return vector, deformation


def _history(case: Levels, result: ModelResult) -> History:
    return History(result.displacement, result.reaction_force, case.load_factors)


def _metrics(case: Levels, reference: History) -> dict[str, dict[str, np.ndarray]]:
    """Model -> metric -> (S,) values against a reference, whose own are those of `REFINED`."""
    histories = {name: _history(case, result) for name, result in case.models.items()}
    return evaluate_all(case.surface, {**histories, REFINED: reference}, REFINED)


def row(case: Levels) -> dict[str, Any]:
    """What is kept of a case: of each metric what is used of each of its bars, to four digits."""
    found = bars(case)
    used: dict[str, list[float]] = {}
    for bar in found:
        used.setdefault(bar.metric, []).append(bar.used)
    own = {bar.metric: bar.used for bar in found if bar.model == case.reference}
    vector, deformation = orders(case)
    return {
        "study": case.study,
        "case": case.number,
        "mesh_size": case.mesh_size,
        "bar": next(bar.bar for bar in found if bar.metric == VECTOR),
        "order": round(vector, 2),
        "order_deformation": round(deformation, 2),
        "own": {metric: _rounded(own[metric]) for metric in HEADLINE},
        "used": {metric: [*map(_rounded, shares)] for metric, shares in used.items()},
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
        found[study] = [row(case) for case in solved(load_study(CASES / f"{study}.toml"), TRIED[study])]
        write([one for rows in found.values() for one in rows])


if __name__ == "__main__":
    main()
