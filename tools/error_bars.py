"""Tries the error bars of two mesh levels on a third, on cases of shipped studies.

The best estimate of a number is what it is against Richardson's extrapolation of the reference's displacement, from
its finest level and two coarser ones, by the order that they show. No model is solved again for that.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import tomli_w

from solver_common.arrays import Array
from tools.documents import CASES, ROOT, table
from tools.evidence import EVIDENCE, MEASURES, ran_text
from vdmbench.body.geometry import build_mesh
from vdmbench.body.surface_measures import Surface, deformations, weighted_norm, weighted_norms
from vdmbench.measures.case import CaseResult
from vdmbench.measures.frame import value_bar
from vdmbench.measures.metrics import METRICS, VECTOR, History, evaluate_all
from vdmbench.measures.uncertainty import REASONABLE_ORDERS, estimate_error
from vdmbench.scene.result import ModelResult
from vdmbench.scene.scene import build_scene
from vdmbench.study.config import expand, load_study
from vdmbench.study.registry import REFINED
from vdmbench.verdict.formatting import percent

FOUND = ROOT / "results" / "error-bars.json"
ROUNDING = 1e-9  # a distance up to this, of a number with a unit times the number, is the solver's tolerance
HEAD = """# What the error bars of two mesh levels are worth

A study with `uncertainty.levels = 2` has the reference on its mesh split once; its bar is the difference to that on
the mesh itself. Here shipped studies split it once more. A bar holds where it reaches from its number to the best
estimate: Richardson's extrapolation of the three levels. "Used" is that distance over the bar.
`make evidence WHAT=error_bars` writes this page, and each case to `error-bars.json` beside it.
"""


def used(metric: str, value: float, bar: float, best: float) -> float:
    """The distance of a number from its best estimate over its bar, at most 1 where the bar holds."""
    distance = abs(value - best)
    if distance <= ROUNDING * (1.0 if METRICS[metric].unit == "1" else abs(value)):
        return 0.0
    return distance / bar if bar else math.inf


def tried(study: str, number: int) -> dict[str, Any]:
    """A case, numbered from 1: of each metric what is used of each of its bars, to four digits."""
    case = expand(load_study(CASES / f"{study}.toml"))[number - 1].study
    runs = []
    for levels in (2, 3):
        given = case.model_dump(mode="json", exclude_none=True, exclude={"sweep", "limits"})
        given["uncertainty"] = {"levels": levels}
        runs += ran_text(tomli_w.dumps(given), f"error-bars/{study}-{number}-{levels}").cases
    found = runs[0]
    reference = str(case.study.reference)
    surface = build_scene(case, build_mesh(case.geometry)).surface
    levels_of = [found.models[reference], *(one.models[reference + REFINED] for one in runs)]
    order, best = extrapolated(surface, levels_of, found)
    histories = {
        name: History(m.displacement, m.reaction_force, found.load_factors)
        for name, m in found.models.items()
    }
    estimates = evaluate_all(surface, {**histories, reference + REFINED: best}, reference + REFINED)
    shares: dict[str, dict[str, float]] = {}
    for model, metrics in found.metrics.items():
        for metric, series in metrics.items():
            if metric in estimates[model]:
                at = found.full_load
                numbers = (
                    float(series[at]),
                    value_bar(found, model, metric),
                    float(estimates[model][metric][at]),
                )
                if all(map(math.isfinite, numbers)):
                    shares.setdefault(metric, {})[model] = float(f"{used(metric, *numbers):.4g}")
    fields = np.stack([result.displacement[found.full_load] for result in levels_of])
    deformed = deformations(surface.points, fields, surface.areas)
    gaps = weighted_norms(np.diff(deformed, axis=0), surface.areas)
    return {
        "study": study,
        "case": number,
        "mesh_size": case.geometry.mesh_size,
        "bar": value_bar(found, reference, VECTOR),
        "order": round(order, 2),
        "order_deformation": round(math.log2(gaps[0] / gaps[1]), 2),
        "own": {metric: shares[metric][reference] for metric in MEASURES},
        "used": {metric: list(models.values()) for metric, models in shares.items()},
    }


def extrapolated(surface: Surface, levels: Sequence[ModelResult], found: CaseResult) -> tuple[float, History]:
    """The order that three levels of the reference, coarse first, show in displacement, and the best estimate."""
    step, factors = found.full_load, found.load_factors
    coarse, fine, finest = levels
    gaps = [
        weighted_norm(a.displacement[step] - b.displacement[step], surface.areas)
        for a, b in ((fine, finest), (coarse, fine))
    ]
    order = estimate_error(gaps, 2.0).observed_order
    low, high = REASONABLE_ORDERS
    share = 1.0 / (2.0 ** min(max(order, low), high) - 1.0)

    def limit(last: Array, before: Array) -> Array:
        return last + share * (last - before)

    displacement = limit(finest.displacement, fine.displacement)
    return order, History(displacement, limit(finest.reaction_force, fine.reaction_force), factors)


def held(rows: Iterable[Mapping[str, Any]], metrics: Iterable[str]) -> tuple[int, int]:
    """How many bars of some metrics hold, of how many."""
    shares = [share for row in rows for metric in metrics for share in row["used"].get(metric, [])]
    return sum(share <= 1.0 for share in shares), len(shares)


def document(rows: Sequence[Mapping[str, Any]]) -> str:
    """The whole of `results/error-bars.md`."""
    by_metric = []
    for metric in METRICS:
        if shares := [share for row in rows for share in row["used"].get(metric, [])]:
            counts = "{} of {}".format(*held(rows, [metric]))
            by_metric.append([f"`{metric}`", counts, f"{max(shares):.2g}"])
    vector, deformation = (sum(row["own"][metric] <= 1.0 for row in rows) for metric in MEASURES)
    bars, orders, studies = ([row[key] for row in rows] for key in ("bar", "order", "study"))
    return (
        f"{HEAD}\n{len(rows)} cases of {len(set(studies))} studies, bars of {percent(min(bars))} to "
        f"{percent(max(bars))}, orders of {min(orders):.2g} to {max(orders):.2g}. On the study's own\nmesh the "
        f"error of the reference is its own alone: there {vector} / {deformation} of {len(rows)} bars of "
        "displacement / deformation\nhold. Of all models, and of the reference's own figures:\n\n"
    ) + table(["number", "bars that hold", "used at most"], by_metric)


def error_bars(arguments: Sequence[str]) -> None:
    """Solve the cases of the studies named, by default of all, and write what came out; rows of others stay."""
    own: dict[str, list[int]] = EVIDENCE["error_bars"]["cases"]
    kept = json.loads(FOUND.read_text())
    found = {study: [row for row in kept if row["study"] == study] for study in own}
    for study in arguments or own:
        found[study] = [tried(study, number) for number in own[study]]
        rows = [row for one in found.values() for row in one]
        FOUND.write_text("[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n")
        (ROOT / EVIDENCE["error_bars"]["document"]).write_text(document(rows))
