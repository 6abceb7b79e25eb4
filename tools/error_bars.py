"""Tries the error bars of two mesh levels on a third, on cases of shipped studies.

The best estimate of a number is what it is against Richardson's extrapolation of the reference's displacement, from
its finest level and two coarser ones, by the order that they show. No model is solved again for that.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import tomli_w

from solver_common.arrays import Array
from tools.documents import CASES, table
from tools.evidence import EVIDENCE, MEASURES, ran_text
from vdmbench.body.geometry import build_mesh
from vdmbench.measures.frame import value_bar
from vdmbench.measures.metrics import METRICS, VECTOR, History, evaluate_all
from vdmbench.measures.uncertainty import REASONABLE_ORDERS
from vdmbench.scene.scene import build_scene
from vdmbench.study.config import expand, load_study
from vdmbench.study.registry import REFINED
from vdmbench.verdict.formatting import percent

ROUNDING = 1e-9  # a distance up to this, of a number with a unit times the number, is the solver's tolerance
Row = Sequence[str]  # of a case and a metric, as `head` says: what is used of the bars of all models


def used(metric: str, value: float, bar: float, best: float) -> float:
    """The distance of a number from its best estimate over its bar, at most 1 where the bar holds."""
    distance = abs(value - best)
    if distance <= ROUNDING * (1.0 if METRICS[metric].unit == "1" else abs(value)):
        return 0.0
    return distance / bar if bar else math.inf


def tried(study: str, number: int) -> Iterator[Row]:
    """A row for each metric of a case, numbered from 1, to four digits."""
    case = expand(load_study(CASES / f"{study}.toml"))[number - 1].study
    runs = []
    for levels in (2, 3):
        given = case.model_dump(mode="json", exclude_none=True, exclude={"sweep", "limits"})
        given["uncertainty"] = {"levels": levels}
        runs += ran_text(tomli_w.dumps(given), f"error-bars/{study}-{number}-{levels}").cases
    found, at = runs[0], runs[0].full_load
    reference = str(case.study.reference)
    finest = reference + REFINED
    order, (low, high) = runs[1].reference_error["observed_order"], REASONABLE_ORDERS
    share = 1.0 / (2.0 ** min(max(order, low), high) - 1.0)

    def best(name: str) -> Array:
        before, last = (getattr(one.models[finest], name) for one in runs)
        extrapolated: Array = last + share * (last - before)
        return extrapolated

    histories = {
        name: History(m.displacement, m.reaction_force, found.load_factors)
        for name, m in found.models.items()
    }
    histories[finest] = History(best("displacement"), best("reaction_force"), found.load_factors)
    estimates = evaluate_all(build_scene(case, build_mesh(case.geometry)).surface, histories, finest)
    shares: dict[str, dict[str, float]] = {}
    for model, metrics in found.metrics.items():
        for metric in metrics.keys() & estimates[model].keys():
            value, estimate = float(metrics[metric][at]), float(estimates[model][metric][at])
            if all(map(math.isfinite, numbers := (value, value_bar(found, model, metric), estimate))):
                shares.setdefault(metric, {})[model] = used(metric, *numbers)
    bar = value_bar(found, reference, VECTOR)
    for metric in (one for one in METRICS if one in shares):
        own = f"{shares[metric][reference]:.4g}" if metric in MEASURES else ""
        every = " ".join(f"{one:.4g}" for one in shares[metric].values())
        yield study, f"{number}", f"{bar:.4g}", f"{order:.2f}", metric, own, every


def held(rows: Iterable[Row], metrics: Iterable[str], column: int = -1) -> tuple[int, int]:
    """How many bars of some metrics hold, of how many; by another column those on the study's own mesh."""
    shares = [float(share) for row in rows if row[4] in metrics for share in row[column].split()]
    return sum(share <= 1.0 for share in shares), len(shares)


def error_bars_page(rows: Sequence[Row]) -> str:
    """What all rows come to, and a line for each metric."""
    by_metric = []
    for metric in (one for one in METRICS if any(row[4] == one for row in rows)):
        largest = max(float(share) for row in rows if row[4] == metric for share in row[-1].split())
        by_metric.append([f"`{metric}`", "{} of {}".format(*held(rows, [metric])), f"{largest:.2g}"])
    bars, orders = (sorted(float(row[k]) for row in rows) for k in (2, 3))
    (vector, cases), (deformation, _) = (held(rows, [metric], 5) for metric in MEASURES)
    return (
        f"{cases} cases of {len({row[0] for row in rows})} studies, bars of {percent(bars[0])} to "
        f"{percent(bars[-1])}, orders of {orders[0]:.2g} to {orders[-1]:.2g}. On the study's own\nmesh the "
        f"error of the reference is its own alone: there {vector} / {deformation} of {cases} bars of "
        "displacement / deformation\nhold. Of all models, and of the reference's own figures:\n\n"
    ) + table(["number", "bars that hold", "used at most"], by_metric)


def error_bars(arguments: Sequence[str]) -> Iterator[Row]:
    """Solve the cases of the studies named, by default of all."""
    own: dict[str, list[int]] = EVIDENCE["error_bars"]["cases"]
    for study in arguments or own:
        for number in own[study]:
            yield from tried(study, number)
