"""A run as one long table, the frame: verdict, report, gate, comparisons and tables are selections of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from solver_common.arrays import Array

from ..study.registry import Family, family_of
from .bars import value_bar
from .case import Run
from .metrics import METRICS

if TYPE_CHECKING:
    from pandas import DataFrame

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
COSTS = {"seconds_setup": "s", "seconds_per_step": "s", "peak_bytes": "B"}


def frame(run: Run) -> DataFrame:
    """The frame of a run: a row for each case, model, metric and load step.

    Returns
    -------
    DataFrame with the columns of `COLUMNS` and one more for each swept key (SI). `case` is the hash, `family` a
    category in the order of `Family`, `bar` the reference's own part in the value (GCI; NaN where not measured, and
    at other steps than that of the largest load that it reached), `full_load` whether it is the step of the largest
    load, `status` the code of the model's. The costs of `COSTS` are metrics like the others.
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
            at = (case.full_load, case.reached) if n_steps else (0, 0)
            for metric, one in measured.items():
                bar = value_bar(case, name, metric) if metric in METRICS and n_steps else np.nan
                series.append((len(about), metric, one.unit, bar, *at))
                values.append(one.values)
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
    # one long column of each kind: a table made piece by piece takes a minute for 2,000 cases
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
