"""Results on disk: one VTKHDF file per case, complete or absent.

A file gets its final name only after it is safely on disk. `results/FORMAT.md` describes every group,
`vdmbench.store.hdf5` how a tree of arrays and texts becomes a sealed file.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from solver_common.solution import Status

from ..machine import json_text, write_atomically
from ..measures import uncertainty
from ..measures.case import (
    DAMAGED,
    CaseResult,
    Limit,
    MetricSeries,
    ModelLimits,
    Run,
    SmallStrainLimits,
)
from ..measures.frame import COLUMNS, COSTS, frame
from ..measures.metrics import METRICS
from ..scene.result import ModelResult
from ..study.schema import Study
from .hdf5 import (
    MAX_BYTES,
    UNREADABLE,
    Data,
    Entry,
    Group,
    OlderSchemaError,
    Stored,
    StoreError,
    Text,
    sealed,
)
from .input_entries import input_entries, read_inputs
from .measurement_entries import measurement_entries, read_measurement
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
from .shapes import CaseShape, MetricShape, ModelShape, Shape, one_line, parsed

if TYPE_CHECKING:
    from pandas import DataFrame

SCHEMA = 4
MOVED = "surface_distance"
_VTK_TRIANGLE = 5
_TEXTS_BYTES = 64 << 20  # room for a file's texts and structure

# the columns of a model's table of steps that every model has, with their units
_SERIES = {
    "fluid_pressure": "Pa",
    "energy": "J",
    "volume": "m^3",
    "iterations": "1",
    "seconds_per_step": "s",
}
# what is not in arrays: of a case, of a model, of a metric
_ABOUT_CASE = (
    "label",
    "reference",
    "swept",
    "swept_units",
    "provenance",
    "reference_error",
    "mesh_quality",
)
_ABOUT_MODEL = ("seconds_setup", "peak_bytes", "version", "key", "parameters")
_NUMBERS = ("reference_error", "mesh_quality", "seconds_setup", "parameters")  # may hold NaN, stored as null
_ABOUT_METRIC = ("unit", "definition", "version")
# of a small-strain limit, besides the load itself
# of further outputs, where they have one
_OUTPUT_UNITS = {"indenter_force": "N", "contact_area": "m^2", "rest_distance": "m"}
_LIMIT_UNITS = {
    "threshold": "1",
    "bar": "1",
    "indentation": "m",
    "indentation_bar": "1",
    "strain": "1",
    "strain_bar": "1",
    "largest_strain": "1",
}


def write_case(path: Path, case: CaseResult) -> None:
    """Write one case file. Raises ValueError for more results than a file holds."""
    entries = _case_entries(case)
    size = sum(entry.values.nbytes for entry in entries if isinstance(entry, Data))
    if size > MAX_BYTES - _TEXTS_BYTES:
        raise ValueError(f"has {size} bytes of results, more than a case file holds; use fewer load steps")
    write_atomically(path, sealed(entries))


def read_case(path: Path, expected: str | None = None) -> CaseResult:
    """Read one case file back.

    Raises
    ------
    StoreError
        not a case file, damaged, of another schema, or not the case with the hash `expected`.
    """
    with Stored(path, SCHEMA) as file:
        try:
            if expected not in (None, file.text("case", "hash")):
                raise ValueError("it holds another case")
            return _read_case(file)
        except UNREADABLE as error:
            why = one_line(error) if isinstance(error, ValidationError) else error
            raise StoreError(
                f"{path}: not readable as a case file ({why}); delete it and run again"
            ) from error


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
    rows, swept = _without_costs(table), [key for key in table.columns if key not in COLUMNS]
    shown = ["case", *swept, "model", "load_factor", "metric", "value", "unit", "bar"]
    head = [*map(no_formula, shown[:-1]), "reference_error"]
    columns: dict[str, Iterable[str]] = {key: map(_cell, rows[key].tolist()) for key in shown}
    columns["case"] = (text[:12] for text in rows["case"].tolist())
    columns |= {key: map(_known, rows[key].tolist()) for key in swept}
    columns["bar"] = (repr(bar) if math.isfinite(bar) else "" for bar in rows["bar"].tolist())
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([head, *zip(*columns.values(), strict=True)])
    return out.getvalue()


def _cell(value: float | str) -> str:
    return no_formula(value) if isinstance(value, str) else repr(value)


def _known(value: float | str) -> str:
    return "" if value != value else _cell(value)


def no_formula(text: str) -> str:
    """A text that a spreadsheet would run as a formula gets a quote in front."""
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t", "\r")) else text


def read_run(directory: Path, *, damaged: bool = False) -> Run:
    """Read a run directory: what was planned, what is done, what failed, what is missing.

    Works on a directory copied from elsewhere. Cases of an earlier plan are left out. With `damaged` a case whose
    file is damaged counts as failed, with what is wrong with the file as the reason.

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
        if os.path.lexists(path):
            try:
                case = read_case(path, planned["hash"])
            except StoreError as error:
                if not damaged:
                    raise
                about = {"code": DAMAGED, "message": str(error), "remedy": ""}
                failed.append({"hash": planned["hash"], "label": label, **about})
                continue
            frames = times.get(planned.get("mesh", ""), {})
            models = {
                name: dataclasses.replace(model, frames=frames[name]) if name in frames else model
                for name, model in case.models.items()
            }
            cases.append(dataclasses.replace(case, **names, models=models))
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
                if file.text("case", "hash") != case_hash:
                    return "damaged"
                fresh = "metrics" in file and file.text("metrics", "versions", "") == _metric_versions()
        except OlderSchemaError:
            return "missing"
        except UNREADABLE:
            return "damaged"
        return "done" if fresh else "stale"
    return "failed" if has_failed(directory, case_hash, label) else "missing"


def _metric_versions() -> str:
    versions = {name: metric.version for name, metric in METRICS.items()}
    return json_text({**versions, "error bars": uncertainty.VERSION}, sort_keys=True)


# --- one case ---


def _case_entries(case: CaseResult) -> list[Entry]:
    """Numbers in arrays and tables, all else in one text: HDF5 takes its time for each object, however small."""
    metrics = {name: entry for series in case.metrics.values() for name, entry in series.items()}
    about = {
        **{name: getattr(case, name) for name in _ABOUT_CASE},
        "models": {name: _about_model(model) for name, model in case.models.items()},
        "metrics": {name: {key: getattr(m, key) for key in _ABOUT_METRIC} for name, m in metrics.items()},
    }
    return [
        *_vtk_entries(case),
        Group("case", {"schema": SCHEMA, "hash": case.hash}),
        Text("case/about", json_text(about)),
        Text("case/study", case.study.model_dump_json(by_alias=True, exclude_none=True)),
        Group("models"),
        *(_steps_table(f"models/{name}", model) for name, model in case.models.items()),
        Group("metrics", {"versions": _metric_versions()}),
        *(_metrics_table(f"metrics/{name}", series) for name, series in case.metrics.items() if series),
        *(_limits_entries(case.small_strain) if case.small_strain is not None else ()),
        *(measurement_entries(case.measurement) if case.measurement is not None else ()),
        *(input_entries(case.inputs) if case.inputs is not None else ()),
    ]


def _vtk_entries(case: CaseResult) -> list[Entry]:
    """The surface with its fields, as VTK reads it: load steps as time, one after the other in each array."""
    n_points, n_cells, n_steps = len(case.points), len(case.triangles), len(case.load_factors)
    none = np.zeros(n_steps, dtype=np.int64)
    entries: list[Entry] = [
        Group("VTKHDF", {"Version": np.array([2, 0]), "Type": b"UnstructuredGrid"}),
        Data("VTKHDF/NumberOfPoints", np.array([n_points])),
        Data("VTKHDF/NumberOfCells", np.array([n_cells])),
        Data("VTKHDF/NumberOfConnectivityIds", np.array([3 * n_cells])),
        _data("VTKHDF/Points", case.points, "m"),
        Data("VTKHDF/Connectivity", case.triangles.astype(np.int64).ravel()),
        Data("VTKHDF/Offsets", np.arange(0, 3 * n_cells + 1, 3)),
        Data("VTKHDF/Types", np.full(n_cells, _VTK_TRIANGLE, dtype=np.uint8)),
        Group("VTKHDF/Steps", {"NSteps": n_steps}),
        Data("VTKHDF/Steps/Values", case.load_factors),
        Data("VTKHDF/Steps/PartOffsets", none),
        Data("VTKHDF/Steps/PointOffsets", none),
        Data("VTKHDF/Steps/NumberOfParts", none + 1),
        Data("VTKHDF/Steps/CellOffsets", none[:, None]),
        Data("VTKHDF/Steps/ConnectivityIdOffsets", none[:, None]),
        Group("VTKHDF/PointData"),
        Group("VTKHDF/Steps/PointDataOffsets"),
    ]

    def field(name: str, values: NDArray[Any], unit: str, starts: NDArray[np.int64]) -> None:
        entries.append(_data(f"VTKHDF/PointData/{name}", values, unit))
        entries.append(Data(f"VTKHDF/Steps/PointDataOffsets/{name}", starts))

    def per_step(name: str, values: NDArray[Any], unit: str) -> None:
        flat = values.reshape(n_steps * n_points, *values.shape[2:])
        field(name, flat, unit, np.arange(n_steps) * n_points)

    for name, model in case.models.items():
        per_step(f"{name}.displacement", model.displacement, "m")
        per_step(f"{name}.reaction_force", model.reaction_force, "N")
    for name, mask in case.regions.items():
        field(f"region.{name}", mask.astype(np.int8), "1", none)
    if case.moved is not None:
        field(MOVED, case.moved, "m", none)
    return entries


def _about_model(model: ModelResult) -> dict[str, Any]:
    status = [[s.code, s.message, s.remedy] for s in model.status]
    return {name: getattr(model, name) for name in _ABOUT_MODEL} | {"status": status}


def _steps_table(path: str, model: ModelResult) -> Data:
    columns = {name: getattr(model, name) for name in _SERIES} | dict(model.scalars)
    units = {**_OUTPUT_UNITS, **_SERIES}
    return _table(path, columns, {name: units.get(name, "1") for name in columns})


def _metrics_table(path: str, series: Mapping[str, MetricSeries]) -> Data:
    columns = {name: metric.values for name, metric in series.items()}
    return _table(path, columns, {name: metric.unit for name, metric in series.items()})


def _limits_entries(found: SmallStrainLimits) -> list[Entry]:
    units = {**_LIMIT_UNITS, "load": found.unit}
    entries: list[Entry] = [Group("limits", {"along": found.along})]
    for name, entry in found.models.items():
        path = f"limits/{name}"
        about = {"structural_error": entry.structural_error, "structural_bar": entry.structural_bar}
        columns = {q: np.array([getattr(limit, q) for limit in entry.limits], dtype=float) for q in units}
        entries += [
            Group(path, about),
            *(_data(f"{path}/{quantity}", columns[quantity], unit) for quantity, unit in units.items()),
            Text(f"{path}/state", [limit.state for limit in entry.limits]),
        ]
    return entries


def _read_limits(file: Stored) -> SmallStrainLimits:
    found, unit = {}, "1"
    for name in file.members("limits"):
        path = f"limits/{name}"
        columns = {
            quantity: file.floats(f"{path}/{quantity}").tolist() for quantity in (*_LIMIT_UNITS, "load")
        }
        limits = tuple(
            Limit(state=state, **{quantity: values[k] for quantity, values in columns.items()})
            for k, state in enumerate(file.texts(f"{path}/state"))
        )
        found[name] = ModelLimits(
            file.number(path, "structural_error"), file.number(path, "structural_bar"), limits
        )
        unit = file.text(f"{path}/load", "unit")
    return SmallStrainLimits(file.text("limits", "along"), unit, found)


def _read_case(file: Stored) -> CaseResult:
    points = file.floats("VTKHDF/Points")
    load_factors = file.floats("VTKHDF/Steps/Values")
    shape = (len(load_factors), len(points))

    def per_step(name: str) -> NDArray[np.float64]:
        values = file.floats(f"VTKHDF/PointData/{name}")
        return values.reshape(*shape, *values.shape[1:])

    about = parsed(file.texts("case/about"), CaseShape)
    return CaseResult(
        hash=file.text("case", "hash"),
        **_told(about, _ABOUT_CASE),
        study=Study.model_validate_json(str(file.texts("case/study"))),
        points=points,
        triangles=file.integers("VTKHDF/Connectivity").reshape(-1, 3),
        load_factors=load_factors,
        regions={
            name.removeprefix("region."): file.integers(f"VTKHDF/PointData/{name}").astype(bool)
            for name in file.members("VTKHDF/PointData")
            if name.startswith("region.")
        },
        models={name: _read_model(file, name, model, per_step) for name, model in about.models.items()},
        metrics={name: _read_metrics(file, f"metrics/{name}", about.metrics) for name in about.models},
        small_strain=_read_limits(file) if "limits" in file else None,
        measurement=read_measurement(file) if "measurement" in file else None,
        inputs=read_inputs(file) if "inputs" in file else None,
        moved=file.floats(f"VTKHDF/PointData/{MOVED}") if MOVED in file.members("VTKHDF/PointData") else None,
    )


def _told(about: Shape, names: Sequence[str]) -> dict[str, Any]:
    """These entries of a text, with NaN where a number is null."""
    found = {name: getattr(about, name) for name in names}
    return {name: _or_nan(value) if name in _NUMBERS else value for name, value in found.items()}


def _or_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _or_nan(entry) for key, entry in value.items()}
    return np.nan if value is None else value


def _read_model(
    file: Stored, name: str, about: ModelShape, per_step: Callable[[str], NDArray[np.float64]]
) -> ModelResult:
    steps: dict[str, Any] = dict(file.table(f"models/{name}"))
    return ModelResult(
        displacement=per_step(f"{name}.displacement"),
        reaction_force=per_step(f"{name}.reaction_force"),
        **{series: steps.pop(series) for series in _SERIES if series != "iterations"},
        iterations=steps.pop("iterations").astype(np.int64),
        status=tuple(Status(*row) for row in about.status),
        **_told(about, _ABOUT_MODEL),
        scalars=steps,
    )


def _read_metrics(file: Stored, path: str, about: Mapping[str, MetricShape]) -> dict[str, MetricSeries]:
    table = file.table(path) if path in file else {}
    return {name: MetricSeries(values, **_told(about[name], _ABOUT_METRIC)) for name, values in table.items()}


# --- a whole study ---


def _study_entries(run: Run, rows: DataFrame) -> list[Entry]:
    """One (cases, steps) array per model and metric of a frame, with dimension scales; NaN where a case has none.

    Beside it, where it is measured, one (cases,) of the reference's own error in the value at full load.
    """
    cases, steps = ("cases",), ("cases", "steps")
    shape = (len(run.cases), max((len(case.load_factors) for case in run.cases), default=0))
    factors = np.full(shape, np.nan)
    for row, case in enumerate(run.cases):
        factors[row, : len(case.load_factors)] = case.load_factors
    entries: list[Entry] = [
        Group("case", {"schema": SCHEMA}),
        Text("case/study", run.study_text),
        Text("cases", [case.label or case.hash[:8] for case in run.cases]),
        Data("steps", np.arange(shape[1])),
        Text("case/hash", [case.hash for case in run.cases], cases),
        Text("case/label", [case.label for case in run.cases], cases),
        Data("load_factor", factors, {"unit": "1"}, steps),
        Group("swept"),
    ]
    for key in dict.fromkeys(key for case in run.cases for key in case.swept):
        values = [case.swept.get(key) for case in run.cases]
        unit = next(case.swept_units.get(key, "1") for case in run.cases if key in case.swept)
        if all(isinstance(value, int | float) for value in values):
            entries.append(Data(f"swept/{key}", np.array(values, dtype=float), {"unit": unit}, cases))
        else:
            entries.append(Text(f"swept/{key}", [str(value) for value in values], cases))
    index = {case.hash: row for row, case in enumerate(run.cases)}
    named = {
        (model, metric): one
        for case in run.cases
        for model, metrics in case.metrics.items()
        for metric, one in metrics.items()
    }
    tables, bars = [], []
    for (model, metric), part in rows.groupby(["model", "metric"], sort=False):
        at, series, bar = (
            part["case"].map(index).to_numpy(),
            np.full(shape, np.nan),
            np.full(shape[0], np.nan),
        )
        series[at, part["step"].to_numpy()] = part["value"]
        full = part["full_load"].to_numpy()
        bar[at[full]] = part["bar"][full]
        about = {key: getattr(named[model, metric], key) for key in _ABOUT_METRIC}
        tables.append(Data(f"metrics/{model}/{metric}", series, about, steps))
        if np.isfinite(bar).any():
            bars.append(Data(f"reference_error/{model}/{metric}", bar, {"unit": about["unit"]}, cases))
    return entries + _in_groups("metrics", tables) + _in_groups("reference_error", bars)


def _in_groups(whole: str, entries: Sequence[Data]) -> list[Entry]:
    groups = dict.fromkeys(entry.path.rpartition("/")[0] for entry in entries)
    return [Group(whole), *map(Group, groups), *entries]


# --- small helpers ---


def _data(path: str, values: NDArray[Any], unit: str) -> Data:
    return Data(path, np.asarray(values), {"unit": unit})


def _table(path: str, columns: Mapping[str, NDArray[Any]], units: Mapping[str, str]) -> Data:
    """Columns of (S,) numbers by name as one array of S rows."""
    rows = np.empty(
        len(next(iter(columns.values()))), [(name, values.dtype) for name, values in columns.items()]
    )
    for name, values in columns.items():
        rows[name] = values
    return Data(path, rows, {"units": json_text(units, sort_keys=True)})
