"""Results on disk: one VTKHDF file per case, complete or absent.

A file gets its final name only after it is safely on disk. `results/FORMAT.md` describes every group,
`vdmbench.store.hdf5` how a tree of arrays and texts becomes a sealed file. A case is fields on its nodes, a table
of its load steps, and one text for all else, which is the dataclass itself (`vdmbench.machine.plain`): HDF5 takes
its time for each object, however small.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from solver_common.arrays import Array

from ..machine import json_text, plain, write_atomically
from ..measures import uncertainty
from ..measures.case import DAMAGED, CaseResult, MetricSeries, Run
from ..measures.frame import COLUMNS, COSTS, frame
from ..measures.metrics import METRICS
from ..scene.result import FrameTimes, ModelResult
from .hdf5 import MAX_BYTES, UNREADABLE, Entry, OlderSchemaError, Stored, StoreError, sealed
from .plain import typed
from .run_directory import (
    METRICS_FILE,
    STUDY_FILE,
    case_path,
    has_failed,
    read_failure,
    read_plan,
    read_study,
    read_times,
    read_told,
)

if TYPE_CHECKING:
    from pandas import DataFrame

SCHEMA = 5
MOVED = "surface_distance"
PART = "part_of_node"
_VTK_TRIANGLE = 5
_TEXTS_BYTES = 64 << 20  # room for a file's texts and structure

# what is not in the text: of a case, of a model what has an entry a load step, of a metric
_NOT_TOLD = ("hash", "points", "triangles", "load_factors", "regions", "models", "metrics", "moved")
_FIELDS = {"displacement": "m", "reaction_force": "N"}
_SERIES = {"fluid_pressure": "Pa", "energy": "J", "volume": "m^3", "iterations": "1", "seconds_per_step": "s"}
# further outputs that have a unit
_OUTPUT_UNITS = {"indenter_force": "N", "contact_area": "m^2", "rest_distance": "m"}


def write_case(path: Path, case: CaseResult) -> None:
    """Write one case file. Raises ValueError for more results than a file holds."""
    steps = _steps(case)
    table = np.array([values for values, _ in steps.values()], dtype=float).T
    metrics = {name: one for series in case.metrics.values() for name, one in series.items()}
    about = plain(case, without=_NOT_TOLD) | {
        "models": {
            name: plain(model, without=(*_FIELDS, *_SERIES, PART, "scalars", "frames"))
            | {"scalars": list(model.scalars)}
            for name, model in case.models.items()
        },
        "metrics": {name: list(series) for name, series in case.metrics.items()},
        "definitions": {name: plain(one, without=("values",)) for name, one in metrics.items()},
        "steps": {name: unit for name, (_, unit) in steps.items()},
    }
    entries = [
        *_vtk_entries(case),
        Entry("case", None, {"schema": SCHEMA, "hash": case.hash, "versions": _metric_versions()}),
        Entry("case/about", json_text(about)),
        Entry("steps", table),
    ]
    size = sum(entry.values.nbytes for entry in entries if isinstance(entry.values, np.ndarray))
    if size > MAX_BYTES - _TEXTS_BYTES:
        raise ValueError(f"has {size} bytes of results, more than a case file holds; use fewer load steps")
    write_atomically(path, sealed(entries))


def _steps(case: CaseResult) -> dict[str, tuple[Array, str]]:
    """The columns of the table of load steps: (S,) values and their unit."""
    found = {"load_factor": (case.load_factors, "1")}
    for name, model in case.models.items():
        found |= {f"{name}.{key}": (getattr(model, key), unit) for key, unit in _SERIES.items()}
        found |= {f"{name}.{key}": (one, _OUTPUT_UNITS.get(key, "1")) for key, one in model.scalars.items()}
        measured = case.metrics.get(name, {})
        found |= {f"{name}.metrics.{key}": (one.values, one.unit) for key, one in measured.items()}
    return found


def _vtk_entries(case: CaseResult) -> list[Entry]:
    """The surface with its fields, as VTK reads it: load steps as time, one after the other in each array."""
    n_points, n_cells, n_steps = len(case.points), len(case.triangles), len(case.load_factors)
    none = np.zeros(n_steps, dtype=np.int64)
    numbers = {
        "NumberOfPoints": np.array([n_points]),
        "NumberOfCells": np.array([n_cells]),
        "NumberOfConnectivityIds": np.array([3 * n_cells]),
        "Connectivity": case.triangles.astype(np.int64).ravel(),
        "Offsets": np.arange(0, 3 * n_cells + 1, 3),
        "Types": np.full(n_cells, _VTK_TRIANGLE, dtype=np.uint8),
    }
    steps = {
        "Values": case.load_factors,
        **dict.fromkeys(("PartOffsets", "PointOffsets"), none),
        "NumberOfParts": none + 1,
        **dict.fromkeys(("CellOffsets", "ConnectivityIdOffsets"), none[:, None]),
    }
    # values, unit, first row of each step
    fields: dict[str, tuple[NDArray[Any], str, NDArray[np.int64]]] = {}
    for name, model in case.models.items():
        for key, unit in _FIELDS.items():
            flat = getattr(model, key).reshape(n_steps * n_points, 3)
            fields[f"{name}.{key}"] = flat, unit, np.arange(n_steps) * n_points
        if model.part_of_node is not None:
            fields[f"{name}.{PART}"] = model.part_of_node.astype(np.int8), "1", none
    fields |= {f"region.{name}": (mask.astype(np.int8), "1", none) for name, mask in case.regions.items()}
    if case.moved is not None:
        fields[MOVED] = np.asarray(case.moved), "m", none
    return [
        Entry("VTKHDF", None, {"Version": np.array([2, 0]), "Type": b"UnstructuredGrid"}),
        Entry("VTKHDF/Points", np.asarray(case.points), {"unit": "m"}),
        *(Entry(f"VTKHDF/{name}", values) for name, values in numbers.items()),
        Entry("VTKHDF/Steps", None, {"NSteps": n_steps}),
        *(Entry(f"VTKHDF/Steps/{name}", values) for name, values in steps.items()),
        Entry("VTKHDF/PointData"),
        Entry("VTKHDF/Steps/PointDataOffsets"),
        *(Entry(f"VTKHDF/PointData/{name}", one, {"unit": unit}) for name, (one, unit, _) in fields.items()),
        *(Entry(f"VTKHDF/Steps/PointDataOffsets/{name}", first) for name, (*_, first) in fields.items()),
    ]


def read_case(
    path: Path,
    expected: str | None = None,
    *,
    fields: bool = True,
    frames: Mapping[str, FrameTimes] | None = None,
    **names: Any,
) -> CaseResult:
    """Read one case file back.

    Parameters
    ----------
    expected : its hash
    fields : whether to read what nodes have; else there are no nodes, in half of the time
    frames : what frames of its models take, which is no part of the file
    names : what a study calls the case, in place of what is in the file

    Raises
    ------
    StoreError
        not a case file, damaged, of another schema, or not the case with the hash `expected`.
    """
    with Stored(path, SCHEMA) as file:
        try:
            names["hash"] = file.attribute("case", "hash")
            if expected not in (None, names["hash"]):
                raise ValueError("it holds another case")
            return _read_case(file, fields, frames or {}, names)
        except UNREADABLE as error:
            why = " ".join(str(error).split())[:300]
            again = "delete it and run again"
            raise StoreError(f"{path}: not readable as a case file ({why}); {again}") from error


def _read_case(
    file: Stored, fields: bool, frames: Mapping[str, FrameTimes], names: dict[str, Any]
) -> CaseResult:
    about = json.loads(file.text("case/about"))
    table = dict(zip(about["steps"], file.floats("steps").T.copy(), strict=True))
    factors = table["load_factor"]
    on_nodes = _read_fields(file, about, len(factors)) if fields else _no_fields(about, len(factors))
    models = {
        name: _read_model(name, one, table, on_nodes.pop(name), frames.get(name))
        for name, one in about["models"].items()
    }
    defined = {key: _definition(tuple(one.items())) for key, one in about["definitions"].items()}
    metrics = {
        name: {key: MetricSeries(table[f"{name}.metrics.{key}"], *defined[key]) for key in keys}
        for name, keys in about["metrics"].items()
    }
    given = {"load_factors": factors, "models": models, "metrics": metrics}
    return typed(CaseResult, about, **names, **on_nodes, **given)


def _read_fields(file: Stored, about: Mapping[str, Any], n_steps: int) -> dict[str, Any]:
    """What nodes have, and of each model its fields."""
    data, there = "VTKHDF/PointData/", file.members("VTKHDF/PointData")
    return {
        "points": file.floats("VTKHDF/Points"),
        "triangles": file.integers("VTKHDF/Connectivity").reshape(-1, 3),
        "regions": {
            name.removeprefix("region."): file.integers(data + name).astype(bool)
            for name in there
            if name.startswith("region.")
        },
        "moved": file.floats(data + MOVED) if MOVED in there else None,
    } | {
        name: {key: _per_step(file.floats(f"{data}{name}.{key}"), n_steps) for key in _FIELDS}
        | {PART: file.integers(f"{data}{name}.{PART}") if f"{name}.{PART}" in there else None}
        for name in about["models"]
    }


def _per_step(rows: Array, n_steps: int) -> Array:
    return rows.reshape(n_steps, len(rows) // max(n_steps, 1), 3)


def _no_fields(about: Mapping[str, Any], n_steps: int) -> dict[str, Any]:
    nothing = np.empty((0, 3))
    fields = dict.fromkeys(_FIELDS, np.empty((n_steps, 0, 3)))
    whole = {"points": nothing, "triangles": nothing.astype(np.int64), "regions": {}, "moved": None}
    return whole | dict.fromkeys(about["models"], fields)


def _read_model(
    name: str,
    about: Mapping[str, Any],
    table: Mapping[str, Array],
    fields: Mapping[str, Any],
    frames: FrameTimes | None,
) -> ModelResult:
    series = {key: table[f"{name}.{key}"] for key in _SERIES}
    series["iterations"] = series["iterations"].astype(np.int64)
    scalars = {key: table[f"{name}.{key}"] for key in about["scalars"]}
    return typed(ModelResult, about, **fields, **series, scalars=scalars, frames=frames)


@lru_cache
def _definition(about: tuple[tuple[str, Any], ...]) -> tuple[str, str, int]:
    """Unit, definition and version of a metric, alike in most cases of a run."""
    one = typed(MetricSeries, dict(about), values=np.zeros(0))
    return one.unit, one.definition, one.version


# --- a run directory ---


def read_run(directory: Path, *, damaged: bool = False, fields: bool = True) -> Run:
    """Read a run directory: what was planned, what is done, what failed, what is missing.

    Works on a directory copied from elsewhere. Cases of an earlier plan are left out. With `damaged` a case whose
    file is damaged counts as failed, with what is wrong with the file as the reason.

    Parameters
    ----------
    fields : see `read_case`

    Raises
    ------
    StoreError
        not a run directory, or a damaged file in it, of a case only without `damaged`.
    """
    plan = read_plan(directory)
    study, study_text = read_study(directory)
    cases, failed, missing = [], [], []
    times = read_times(directory)
    for planned in plan["cases"]:
        label = planned["label"] or plan["study"]["name"]
        path = case_path(directory, planned["hash"], planned["label"])
        # the swept values and the label belong to the study, not to the case: another study may share it
        names = {key: planned[key] for key in ("label", "swept", "swept_units")}
        frames = times.get(planned.get("mesh", ""))
        if os.path.lexists(path):
            try:
                cases.append(read_case(path, planned["hash"], fields=fields, frames=frames, **names))
            except StoreError as error:
                if not damaged:
                    raise
                about = {"code": DAMAGED, "message": str(error), "remedy": ""}
                failed.append({"hash": planned["hash"], "label": label, **about})
        elif has_failed(directory, planned["hash"], planned["label"]):
            failed.append(read_failure(directory, planned["hash"], label))
        else:
            missing.append(planned["label"])
    return Run(study, study_text, cases, failed, missing, plan)


class _OnceAsked(Sequence[CaseResult]):
    """The cases of a run directory, all done, read when the first is asked for."""

    def __init__(self, directory: Path, count: int) -> None:
        self._directory, self._count = directory, count

    @cached_property
    def _cases(self) -> Sequence[CaseResult]:
        return read_run(self._directory).cases

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, place: Any) -> Any:
        return self._cases[place]


def told_run(directory: Path) -> Run | None:
    """A run directory that is as it was when its report was made, which cost no reading of cases; else None."""
    try:
        plan = read_plan(directory)
        told = read_told(directory, plan)
        if told is None or told["done"] != len(plan["cases"]):
            return None
        study, text = read_study(directory)
    except StoreError:
        return None
    return Run(study, text, _OnceAsked(directory, told["done"]), [], [], plan, told)


def case_state(directory: Path, case_hash: str, label: str = "") -> str:
    """ "done", "stale" (done, but by other versions of the metrics), "damaged", "failed" or "missing".

    A file of an older schema counts as missing: the next run writes it anew.
    """
    path = case_path(directory, case_hash, label)
    if os.path.lexists(path):
        try:
            with Stored(path, SCHEMA) as file:
                if file.attribute("case", "hash") != case_hash:
                    return "damaged"
                return "done" if file.attribute("case", "versions") == _metric_versions() else "stale"
        except OlderSchemaError:
            return "missing"
        except UNREADABLE:
            return "damaged"
    return "failed" if has_failed(directory, case_hash, label) else "missing"


def _metric_versions() -> str:
    versions = {name: metric.version for name, metric in METRICS.items()}
    return json_text({**versions, "error bars": uncertainty.VERSION}, sort_keys=True)


# --- a whole study ---


def write_study(directory: Path, run: Run, table: DataFrame | None = None) -> None:
    """Write `study.h5` and `metrics.csv`: every metric of every case, model and step in two tables.

    Parameters
    ----------
    table : the frame of the run, where it is there
    """
    table = frame(run) if table is None else table
    write_atomically(directory / STUDY_FILE, sealed(_study_entries(run, _without_costs(table))))
    write_atomically(directory / METRICS_FILE, metrics_csv(table).encode("utf-8", "replace"))


def _without_costs(table: DataFrame) -> DataFrame:
    return table[~table["metric"].isin(list(COSTS))]


def metrics_csv(table: DataFrame) -> str:
    """The metrics of a frame as CSV; beside a value at full load the reference's own error, where measured."""
    from pandas.api.types import is_numeric_dtype  # slow to load

    rows, swept = _without_costs(table), [key for key in table.columns if key not in COLUMNS]
    shown = rows[["case", *swept, "model", "load_factor", "metric", "value", "unit", "bar"]].copy()
    shown["case"] = shown["case"].map({one: one[:12] for one in shown["case"].unique()})
    shown = shown.rename(columns={"bar": "reference_error"})
    for key in (key for key in shown if not is_numeric_dtype(shown[key])):
        texts = {one: no_formula(one) for one in shown[key].unique() if isinstance(one, str)}
        if any(one != safe for one, safe in texts.items()):
            shown[key] = shown[key].map(lambda one, texts=texts: texts.get(one, one))
    return str(shown.rename(columns=no_formula).to_csv(index=False, lineterminator="\n"))


def no_formula(text: str) -> str:
    """A text that a spreadsheet would run as a formula gets a quote in front."""
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t", "\r")) else text


def _study_entries(run: Run, rows: DataFrame) -> list[Entry]:
    """One (cases, steps) array per model and metric of a frame, with dimension scales; NaN where a case has none.

    Beside it, where it is measured, one (cases,) of the reference's own error in the value at full load.
    """
    cases, steps = ("cases",), ("cases", "steps")
    shape = (len(run.cases), max((len(case.load_factors) for case in run.cases), default=0))
    factors = np.full(shape, np.nan)
    for row, case in enumerate(run.cases):
        factors[row, : len(case.load_factors)] = case.load_factors
    entries = [
        Entry("case", None, {"schema": SCHEMA}),
        Entry("case/study", run.study_text),
        Entry("cases", [case.label or case.hash[:8] for case in run.cases]),
        Entry("steps", np.arange(shape[1])),
        Entry("case/hash", [case.hash for case in run.cases], labels=cases),
        Entry("case/label", [case.label for case in run.cases], labels=cases),
        Entry("load_factor", factors, {"unit": "1"}, steps),
        Entry("swept"),
    ]
    for key in dict.fromkeys(key for case in run.cases for key in case.swept):
        values = [case.swept.get(key) for case in run.cases]
        unit = next(case.swept_units.get(key, "1") for case in run.cases if key in case.swept)
        if all(isinstance(value, int | float) for value in values):
            entries.append(Entry(f"swept/{key}", np.array(values, dtype=float), {"unit": unit}, cases))
        else:
            entries.append(Entry(f"swept/{key}", [str(value) for value in values], labels=cases))
    index = {case.hash: row for row, case in enumerate(run.cases)}
    named = {
        (model, metric): one
        for case in run.cases
        for model, metrics in case.metrics.items()
        for metric, one in metrics.items()
    }
    tables, bars = [], []
    for (model, metric), part in rows.groupby(["model", "metric"], sort=False):
        at, about, full = (
            part["case"].map(index).to_numpy(),
            plain(named[model, metric], without=("values",)),
            part["full_load"].to_numpy(),
        )
        series, bar = np.full(shape, np.nan), np.full(shape[0], np.nan)
        series[at, part["step"].to_numpy()] = part["value"]
        bar[at[full]] = part["bar"][full]
        tables.append(Entry(f"metrics/{model}/{metric}", series, about, steps))
        if np.isfinite(bar).any():
            bars.append(Entry(f"reference_error/{model}/{metric}", bar, {"unit": about["unit"]}, cases))
    return entries + _in_groups("metrics", tables) + _in_groups("reference_error", bars)


def _in_groups(whole: str, entries: Sequence[Entry]) -> list[Entry]:
    groups = dict.fromkeys(entry.path.rpartition("/")[0] for entry in entries)
    return [Entry(whole), *map(Entry, groups), *entries]
