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

    blocks = [_of_model(case, name) for case in run.cases for name in case.models]
    keys = list(dict.fromkeys(key for case in run.cases for key in case.swept))
    about = pd.DataFrame(
        [block["about"] for block in blocks], columns=None if blocks else [*COLUMNS[:3], "family"]
    )
    # one row of `about` for each metric and step: a table made piece by piece takes a minute for 2,000 cases
    table = about.loc[np.arange(len(blocks)).repeat([len(block["value"]) for block in blocks])]
    table = table.reset_index(drop=True)
    for column in ("metric", "step", "load_factor", "value", "bar", "unit", "status"):
        table[column] = np.concatenate([block[column] for block in blocks] or [[]])
    table = table[[*COLUMNS[:3], *keys, *COLUMNS[3:]]]
    table["family"] = pd.Categorical(table["family"], [family.value for family in Family], ordered=True)
    table.attrs["full_load"] = {case.hash: case.full_load for case in run.cases}
    return table


def at_full_load(table: DataFrame) -> DataFrame:
    """The rows of a frame at the step of the largest load of each case."""
    return table[table["step"] == table["case"].map(table.attrs["full_load"])]


def _of_model(case: CaseResult, name: str) -> dict[str, Any]:
    """What all rows of a model in a case share, and the (M S,) columns of its M metrics over S steps."""
    result, n_steps = case.models[name], len(case.load_factors)
    measured = {metric: (one.values, one.unit) for metric, one in case.metrics.get(name, {}).items()}
    costs = {cost: (np.broadcast_to(getattr(result, cost), n_steps), unit) for cost, unit in COSTS.items()}
    found = measured | costs
    bars = np.full((len(found), n_steps), np.nan)
    if n_steps:
        bars[:, case.full_load] = [
            value_bar(case, name, metric) if metric in METRICS else np.nan for metric in found
        ]
    about = {"case": case.hash, "label": case.label, **case.swept, "model": name}
    return {
        "about": about | {"family": family_of(name).value},
        "metric": np.repeat(np.array(list(found), dtype=object), n_steps),
        "step": np.tile(np.arange(n_steps), len(found)),
        "load_factor": np.tile(case.load_factors, len(found)),
        "value": np.concatenate([values for values, _ in found.values()]),
        "bar": bars.ravel(),
        "unit": np.repeat(np.array([unit for _, unit in found.values()], dtype=object), n_steps),
        "status": np.tile(np.array([status.code for status in result.status], dtype=object), len(found)),
    }
