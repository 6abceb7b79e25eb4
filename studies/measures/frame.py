"""A run as one long table with error bars, the frame; verdict, report, gate and tables select from it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from solver_common.arrays import Array

from ..study.registry import REFINED, Family, family_of
from .case import CaseResult, Run
from .metrics import METRICS, VECTOR
from .uncertainty import SIGNED, estimate_error, least_bar, reference_bar

if TYPE_CHECKING:
    from pandas import DataFrame


def series(case: CaseResult, model: str, metric: str) -> Array | None:
    """(S,) values of a metric, None where the case has none."""
    return case.metrics.get(model, {}).get(metric)


def where_reached(case: CaseResult, model: str, metric: str) -> float:
    """A metric at the largest load that the reference reached; NaN where there is none."""
    values = series(case, model, metric)
    return math.nan if values is None or not len(values) else float(values[case.reached])


def value_bar(case: CaseResult, model: str, metric: str) -> float:
    """The bar of a metric's value at the largest load that the reference reached; NaN where it has none.

    It is at least `least_bar`. For a compared model it is the reference's own part in the metric. For the
    reference's own figures, such as its volume drift, it is the GCI from all its levels, or from
    the two that are there. A model that is not compared in a metric has an exact figure on its own mesh.
    """
    bar = _measured_bar(case, model, metric)
    if not math.isfinite(bar) or metric not in SIGNED:
        return bar
    figures = {name: where_reached(case, model, name) for name in SIGNED}
    least = least_bar(metric, figures, reference_bar(case.reference_error, VECTOR))
    return max(bar, least) if math.isfinite(least) else bar


def _measured_bar(case: CaseResult, model: str, metric: str) -> float:
    levels = case.reference_error.get("levels", 1.0)
    if model != case.reference or levels < 2.0:
        return reference_bar(case.reference_error, metric)
    if f"own_gci:{metric}" in case.reference_error:
        return case.reference_error[f"own_gci:{metric}"]
    fine, coarse = (where_reached(case, name, metric) for name in (model, model.removesuffix(REFINED)))
    if not math.isfinite(coarse - fine):
        return math.nan
    return estimate_error([coarse - fine], 2.0 ** (levels - 1.0)).gci


COLUMNS = (
    "case",
    "label",
    "model",
    "family",
    "metric",
    "step",
    "load_factor",
    "full_load",
    "value",
    "bar",
    "unit",
    "status",
)
COSTS = {"seconds_setup": "s", "seconds_per_step": "s", "frame_time": "s", "peak_bytes": "B"}


def frame(run: Run) -> DataFrame:
    """The frame of a run: a row for each case, model, metric and load step.

    Returns
    -------
    DataFrame with the columns of `COLUMNS` and one more for each swept key (SI). `case` is the hash, `family` a
    category in the order of `Family`, `bar` the reference's own part in the value (GCI), `full_load` whether the
    step has the largest load, `status` the code of the model's status. `bar` is NaN where it was not measured,
    and at all steps but the largest load that the reference reached. The costs of `COSTS` are metrics like the
    others.
    """
    import pandas as pd

    about: list[dict[str, Any]] = []  # of each case and model
    series: list[tuple[int, str, str, float, int, int]] = []  # of each of their metrics
    values: list[Array] = []
    factors: list[Array] = []
    codes: list[str] = []
    for case in run.cases:
        for name, result in case.models.items():
            measured, n_steps = case.metrics.get(name, {}), len(case.load_factors)
            known = case.reference_error and n_steps  # without levels there is no bar
            at = (case.full_load, case.reached) if n_steps else (0, 0)
            for metric, one in measured.items():
                bar = value_bar(case, name, metric) if known else np.nan
                series.append((len(about), metric, METRICS[metric].unit, bar, *at))
                values.append(one)
            for cost, unit in COSTS.items():
                series.append((len(about), cost, unit, np.nan, *at))
                values.append(np.broadcast_to(getattr(result, cost), n_steps))
            count = len(measured) + len(COSTS)
            factors += [case.load_factors] * count
            codes += [status.code for status in result.status] * count
            about.append(
                {"case": case.hash, "label": case.label, **case.swept, "model": name}
                | {"family": family_of(name).value}
            )
    # one long column of each kind: building the table piece by piece takes a minute for 2,000 cases
    lengths = np.array([len(one) for one in values], dtype=int)
    row = np.arange(len(values)).repeat(lengths)
    step = np.arange(len(row)) - (np.cumsum(lengths) - lengths)[row]
    of = pd.DataFrame(series, columns=["about", "metric", "unit", "bar", "full", "reached"]).take(row)
    keys = list(dict.fromkeys(key for case in run.cases for key in case.swept))
    columns = [*COLUMNS[:2], *keys, "model", "family"]
    table = pd.DataFrame(about, columns=columns).take(of["about"].astype(int)).reset_index(drop=True)
    table["metric"], table["step"] = of["metric"].to_numpy(), step
    table["load_factor"] = np.concatenate([*factors, []])
    table["value"] = np.concatenate([*values, []])
    table["full_load"] = step == of["full"].to_numpy(dtype=int)
    table["bar"] = np.where(step == of["reached"].to_numpy(dtype=int), of["bar"], np.nan)
    table["unit"], table["status"] = of["unit"].to_numpy(), codes
    table = table[[*COLUMNS[:2], "model", *keys, *COLUMNS[3:]]]
    table["family"] = pd.Categorical(table["family"], [family.value for family in Family], ordered=True)
    return table


def at_full_load(table: DataFrame) -> DataFrame:
    """The rows of a frame at the step of the largest load of each case."""
    return table[table["full_load"]]
