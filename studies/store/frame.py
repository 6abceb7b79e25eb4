"""A run as one long table, the frame: verdict, report, gate, comparisons and tables are selections of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..measures.bars import value_bar
from ..measures.case import CaseResult, Run
from ..measures.metrics import METRICS
from ..study.registry import family_of

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
    at other steps than that of the largest load), `status` the code of the model's step. The costs of `COSTS` are
    metrics like the others. `attrs["full_load"]` maps each case to the step of its largest load.
    """
    import pandas as pd

    from ..study.registry import Family

    parts = [part for case in run.cases for name in case.models for part in _of_model(case, name)]
    keys = list(dict.fromkeys(key for case in run.cases for key in case.swept))
    columns = (*COLUMNS[:3], *keys, *COLUMNS[3:])
    table = pd.concat([pd.DataFrame(part) for part in parts]) if parts else pd.DataFrame(columns=columns)
    table = table.reindex(columns=columns).reset_index(drop=True)
    table["family"] = pd.Categorical(table["family"], [family.value for family in Family], ordered=True)
    table.attrs["full_load"] = {case.hash: case.full_load for case in run.cases}
    return table


def at_full_load(table: DataFrame) -> DataFrame:
    """The rows of a frame at the step of the largest load of each case."""
    return table[table["step"] == table["case"].map(table.attrs["full_load"])]


def _of_model(case: CaseResult, name: str) -> list[dict[str, Any]]:
    result, steps = case.models[name], np.arange(len(case.load_factors))
    about = {
        "case": case.hash,
        "label": case.label,
        **case.swept,
        "model": name,
        "family": family_of(name).value,
        "step": steps,
        "load_factor": case.load_factors,
        "status": [status.code for status in result.status],
    }
    measured = {metric: (one.values, one.unit) for metric, one in case.metrics.get(name, {}).items()}
    costs = {
        cost: (np.broadcast_to(getattr(result, cost), steps.shape), unit) for cost, unit in COSTS.items()
    }
    rows = []
    for metric, (values, unit) in (measured | costs).items():
        bar = value_bar(case, name, metric) if metric in METRICS else np.nan
        bars = np.where(steps == case.full_load, bar, np.nan)
        rows.append({**about, "metric": metric, "value": values, "bar": bars, "unit": unit})
    return rows
