"""Results on disk: one VTKHDF file per case, complete or absent. The only file that imports h5py.

A file is built in memory and written with plain Python, because HDF5 crashes the process on a full disk.
It gets its final name only after it is safely on disk. Its last bytes hold the SHA-256 of all before them,
checked before HDF5 sees the file. `results/FORMAT.md` describes every group.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from .case import (
    CaseResult,
    Limit,
    MetricSeries,
    ModelLimits,
    ModelResult,
    Run,
    SmallStrainLimits,
    StepStatus,
)
from .files import write_atomically
from .metrics import METRICS
from .metrics_table import metric_rows, metrics_csv

SCHEMA = 1
CASE_SUFFIX = ".vtkhdf"
MAX_BYTES = 2 << 30
_TRAILER = b"\nvdmbench-sha256 "
_TRAILER_BYTES = len(_TRAILER) + 64 + 1
_VTK_TRIANGLE = 5
_TEXT = h5py.string_dtype("utf-8")

# per-model (S,) arrays that are stored as they are, with their units
_SERIES = {
    "fluid_pressure": "Pa",
    "energy": "J",
    "volume": "m^3",
    "iterations": "1",
    "seconds_per_step": "s",
}
# of a small-strain limit, besides the load itself
_LIMIT_UNITS = {"threshold": "1", "bar": "1", "indentation": "m", "strain": "1"}


class StoreError(ValueError):
    """A stored result is damaged or of a newer schema; the message says which file and what to do."""


def write_case(path: Path, case: CaseResult) -> None:
    """Write one case file."""
    write_atomically(path, sealed(lambda file: _fill_case(file, case)))


def read_case(path: Path) -> CaseResult:
    """Read one case file back.

    Raises
    ------
    StoreError
        not a case file, damaged, or written by a newer schema.
    """
    with open_sealed(path) as file:
        try:
            return _read_case(file)
        except (KeyError, ValueError, OSError, json.JSONDecodeError) as error:
            raise StoreError(
                f"{path}: not readable as a case file ({error}); delete it and run again"
            ) from error


def write_study(directory: Path, run: Run) -> None:
    """Write `study.h5` and `metrics.csv`: every metric of every case, model and step in two tables."""
    write_atomically(directory / "study.h5", sealed(lambda file: _fill_study(file, run)))
    write_atomically(directory / "metrics.csv", metrics_csv(run).encode())


def read_run(directory: Path) -> Run:
    """Read a run directory: what was planned, what is done, what failed, what is missing.

    Works on a directory copied from elsewhere. Cases of an earlier plan are left out.

    Raises
    ------
    StoreError
        not a run directory, or a damaged file in it.
    """
    plan = _read_plan(directory)
    study_text = (directory / "study.toml").read_text()
    cases, failed, missing = [], [], []
    for planned in plan["cases"]:
        path = case_path(directory, planned["hash"])
        state = (
            "done" if path.exists() else case_state(directory, planned["hash"])
        )  # reading it says the rest
        # the swept values and the label belong to the study, not to the case: another study may share it
        names = {key: planned[key] for key in ("label", "swept", "swept_units")}
        if state == "done":
            cases.append(dataclasses.replace(read_case(path), **names))
        elif state == "failed":
            failed.append(_read_failure(directory, planned))
        else:
            missing.append(planned["label"])
    return Run(plan["study"], study_text, cases, failed, missing, plan)


def run_state(directory: Path) -> dict[str, list[Any]]:
    """What is "done", "stale", "damaged" and "missing" (labels) and "failed" (with reasons) in a run directory.

    Raises
    ------
    StoreError
        not a run directory.
    """
    state: dict[str, list[Any]] = {"done": [], "stale": [], "failed": [], "damaged": [], "missing": []}
    for planned in _read_plan(directory)["cases"]:
        kind = case_state(directory, planned["hash"])
        label = planned["label"] or planned["hash"][:12]
        state[kind].append(_read_failure(directory, planned) if kind == "failed" else label)
    return state


def case_state(directory: Path, case_hash: str) -> str:
    """ "done", "stale" (done, but by other versions of the metrics), "damaged", "failed" or "missing"."""
    path = case_path(directory, case_hash)
    if path.exists():
        try:
            with open_sealed(path) as file:
                fresh = "metrics" in file and file["metrics"].attrs.get("versions") == _metric_versions()
        except StoreError:
            return "damaged"
        return "done" if fresh else "stale"
    return "failed" if failure_path(directory, case_hash).exists() else "missing"


def result_keys(path: Path) -> dict[str, str]:
    """Model name -> content key of the results in a case file; nothing where it cannot be read."""
    try:
        with open_sealed(path) as file:
            return {name: str(entry.attrs.get("key", "")) for name, entry in file["models"].items()}
    except (StoreError, KeyError):
        return {}


def _metric_versions() -> str:
    return _json({name: metric.version for name, metric in METRICS.items()})


def _read_plan(directory: Path) -> dict[str, Any]:
    try:
        plan: dict[str, Any] = json.loads((directory / "plan.json").read_text())
        _ = plan["study"]["name"]
        for planned in plan["cases"]:
            _ = planned["hash"], planned["label"], planned["swept"], planned["swept_units"]
    except (FileNotFoundError, NotADirectoryError):
        raise StoreError(f"{directory}: not a run directory (it has no plan.json)") from None
    except (KeyError, TypeError, ValueError) as error:
        raise StoreError(f"{directory}/plan.json: damaged ({error!r}); run the study again") from error
    return plan


def _read_failure(directory: Path, planned: Mapping[str, Any]) -> dict[str, str]:
    path = failure_path(directory, planned["hash"])
    try:
        return {**json.loads(path.read_text()), "label": planned["label"] or planned["hash"][:12]}
    except (TypeError, ValueError) as error:
        raise StoreError(f"{path}: damaged ({error}); delete it and run again") from error


def case_path(directory: Path, case_hash: str) -> Path:
    """Where a run directory keeps a finished case."""
    return directory / "cases" / f"{case_hash}{CASE_SUFFIX}"


def failure_path(directory: Path, case_hash: str) -> Path:
    """Where a run directory keeps the reason why a case failed."""
    return directory / "failed" / f"{case_hash}.json"


# --- the file as bytes ---


def sealed(fill: Any) -> bytes:
    """The bytes of a file that `fill(file)` fills, its SHA-256 at the end."""
    with h5py.File("case.h5", "w", driver="core", backing_store=False, libver="v110") as file:
        fill(file)
        file.flush()
        image: bytes = file.id.get_file_image()
    return image + _TRAILER + hashlib.sha256(image).hexdigest().encode() + b"\n"


def open_sealed(path: Path) -> h5py.File:
    """Open a sealed file for reading. Raises StoreError where it is damaged, newer or holds links."""
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise StoreError(f"{path}: {size} bytes is more than a result file can have")
        data = path.read_bytes()
    except FileNotFoundError:
        raise StoreError(f"{path}: no such file") from None
    image, trailer = data[:-_TRAILER_BYTES], data[-_TRAILER_BYTES:]
    digest = hashlib.sha256(image).hexdigest().encode()
    if trailer != _TRAILER + digest + b"\n":
        raise StoreError(f"{path}: damaged (its SHA-256 does not match); delete it and run again")
    try:
        file = h5py.File(io.BytesIO(image), "r")
    except OSError as error:
        raise StoreError(f"{path}: not an HDF5 file ({error}); delete it and run again") from error
    schema = int(file["case"].attrs.get("schema", 0)) if "case" in file else 0
    if schema > SCHEMA:
        file.close()
        raise StoreError(f"{path}: schema {schema} is newer than this program's {SCHEMA}; update vdmbench")
    try:
        _refuse_links(file, path)
    except StoreError:
        file.close()
        raise
    return file


def _refuse_links(file: h5py.File, path: Path) -> None:
    """External links and external storage could read other files of the machine."""

    def is_link(name: bytes, link: Any) -> str | None:
        return None if link.type == h5py.h5l.TYPE_HARD else name.decode(errors="replace")

    def is_outside(name: bytes) -> str | None:
        item = h5py.h5o.open(file.id, name)
        if not isinstance(item, h5py.h5d.DatasetID):
            return None
        stored = item.get_create_plist()
        outside = stored.get_external_count() or stored.get_layout() == h5py.h5d.VIRTUAL
        return name.decode(errors="replace") if outside else None

    # the low-level interface: a file has hundreds of objects, and neither visit follows a link
    linked = file.id.links.visit(is_link, info=True)
    if linked is not None:
        raise StoreError(f"{path}: holds a link (/{linked}), which a result file never does")
    outside = h5py.h5o.visit(file.id, is_outside)
    if outside is not None:
        raise StoreError(f"{path}: /{outside} is stored outside the file, which a result file never does")


# --- one case ---


def _fill_case(file: h5py.File, case: CaseResult) -> None:
    n_points, n_cells, n_steps = len(case.points), len(case.triangles), len(case.load_factors)
    vtk = file.create_group("VTKHDF", track_order=True)
    vtk.attrs["Version"] = np.array([2, 0], dtype=np.int64)
    vtk.attrs.create("Type", b"UnstructuredGrid", dtype=h5py.string_dtype("ascii", len("UnstructuredGrid")))
    vtk["NumberOfPoints"] = np.array([n_points], dtype=np.int64)
    vtk["NumberOfCells"] = np.array([n_cells], dtype=np.int64)
    vtk["NumberOfConnectivityIds"] = np.array([3 * n_cells], dtype=np.int64)
    put(vtk, "Points", case.points, "m")
    vtk["Connectivity"] = case.triangles.astype(np.int64).ravel()
    vtk["Offsets"] = np.arange(0, 3 * n_cells + 1, 3, dtype=np.int64)
    vtk["Types"] = np.full(n_cells, _VTK_TRIANGLE, dtype=np.uint8)

    steps = vtk.create_group("Steps")
    steps.attrs["NSteps"] = np.int64(n_steps)
    steps["Values"] = case.load_factors
    for name in ("PartOffsets", "PointOffsets"):
        steps[name] = np.zeros(n_steps, dtype=np.int64)
    steps["NumberOfParts"] = np.ones(n_steps, dtype=np.int64)
    for name in ("CellOffsets", "ConnectivityIdOffsets"):
        steps[name] = np.zeros((n_steps, 1), dtype=np.int64)

    point_data = vtk.create_group("PointData", track_order=True)
    offsets = steps.create_group("PointDataOffsets")

    def per_step(name: str, values: NDArray[Any], unit: str) -> None:
        put(point_data, name, values.reshape(n_steps * n_points, *values.shape[2:]), unit)
        offsets[name] = np.arange(n_steps, dtype=np.int64) * n_points

    for name, model in case.models.items():
        per_step(f"{name}.displacement", model.displacement, "m")
        per_step(f"{name}.reaction_force", model.reaction_force, "N")
        for field, values in model.point_fields.items():
            per_step(f"{name}.{field}", values, "")
    for name, mask in case.regions.items():
        put(point_data, f"region.{name}", mask.astype(np.int8), "1")
        offsets[f"region.{name}"] = np.zeros(n_steps, dtype=np.int64)

    group = file.create_group("case")
    group.attrs["schema"] = SCHEMA
    group.attrs["hash"] = case.hash
    for name, text in {
        "label": case.label,
        "reference": case.reference or "",
        "resolved": _json(case.resolved),
        "swept": _json(case.swept),
        "swept_units": _json(case.swept_units),
        "provenance": _json(case.provenance),
        "reference_error": _json(case.reference_error),
        "mesh_quality": _json(case.mesh_quality),
    }.items():
        group.create_dataset(name, data=text, dtype=_TEXT)

    models = file.create_group("models", track_order=True)
    for name, model in case.models.items():
        _fill_model(models.create_group(name), model)
    metrics = file.create_group("metrics", track_order=True)
    metrics.attrs["versions"] = _metric_versions()
    for name, series in case.metrics.items():
        model_group = metrics.create_group(name, track_order=True)
        for metric, entry in series.items():
            dataset = put(model_group, metric, entry.values, entry.unit)
            dataset.attrs["definition"] = entry.definition
            dataset.attrs["version"] = entry.version
    if case.small_strain is not None:
        _fill_limits(file.create_group("limits", track_order=True), case.small_strain)


def _fill_limits(group: h5py.Group, found: SmallStrainLimits) -> None:
    group.attrs["along"] = found.along
    units = {**_LIMIT_UNITS, "load": found.unit}
    for name, entry in found.models.items():
        model = group.create_group(name)
        model.attrs["structural_error"] = entry.structural_error
        model.attrs["structural_bar"] = entry.structural_bar
        for quantity, unit in units.items():
            put(model, quantity, np.array([getattr(limit, quantity) for limit in entry.limits]), unit)
        model.create_dataset("state", data=[limit.state for limit in entry.limits], dtype=_TEXT)


def _read_limits(group: h5py.Group) -> SmallStrainLimits:
    found, unit = {}, "1"
    for name, model in group.items():
        columns = {quantity: model[quantity][()].tolist() for quantity in (*_LIMIT_UNITS, "load")}
        states = model["state"].asstr()[()].tolist()
        limits = tuple(
            Limit(state=state, **{quantity: values[k] for quantity, values in columns.items()})
            for k, state in enumerate(states)
        )
        found[name] = ModelLimits(
            float(model.attrs["structural_error"]), float(model.attrs["structural_bar"]), limits
        )
        unit = str(model["load"].attrs["unit"])
    return SmallStrainLimits(str(group.attrs["along"]), unit, found)


def _fill_model(group: h5py.Group, model: ModelResult) -> None:
    for name, unit in _SERIES.items():
        put(group, name, getattr(model, name), unit)
    group.attrs["seconds_setup"] = model.seconds_setup
    group.attrs["peak_bytes"] = model.peak_bytes
    group.attrs["version"] = model.version
    group.attrs["key"] = model.key
    group.attrs["point_fields"] = _json(list(model.point_fields))
    status = [[s.code, s.message, s.remedy] for s in model.status]
    group.create_dataset("status", data=np.array(status, dtype=object).reshape(-1, 3), dtype=_TEXT)
    group.create_dataset("parameters", data=_json(model.parameters), dtype=_TEXT)
    scalars = group.create_group("scalars", track_order=True)
    for name, values in model.scalars.items():
        put(scalars, name, values, "1")


def _read_case(file: h5py.File) -> CaseResult:
    vtk, group = file["VTKHDF"], file["case"]
    point_data = vtk["PointData"]
    points = vtk["Points"][()]
    load_factors = vtk["Steps/Values"][()]
    shape = (len(load_factors), len(points))

    def text(name: str) -> Any:
        return group[name].asstr()[()]

    def per_step(name: str) -> NDArray[Any]:
        values = point_data[name][()]
        return values.reshape(*shape, *values.shape[1:])

    models = {}
    for name, entry in file["models"].items():
        models[name] = ModelResult(
            displacement=per_step(f"{name}.displacement"),
            reaction_force=per_step(f"{name}.reaction_force"),
            **{series: entry[series][()] for series in _SERIES},
            status=tuple(StepStatus(*row) for row in entry["status"].asstr()[()]),
            seconds_setup=float(entry.attrs["seconds_setup"]),
            peak_bytes=int(entry.attrs["peak_bytes"]),
            version=str(entry.attrs["version"]),
            key=str(entry.attrs.get("key", "")),
            parameters=json.loads(entry["parameters"].asstr()[()]),
            scalars={scalar: values[()] for scalar, values in entry["scalars"].items()},
            point_fields={f: per_step(f"{name}.{f}") for f in json.loads(entry.attrs["point_fields"])},
        )
    metrics = {
        name: {
            metric: MetricSeries(
                values=values[()],
                unit=str(values.attrs["unit"]),
                definition=str(values.attrs["definition"]),
                version=int(values.attrs["version"]),
            )
            for metric, values in entry.items()
        }
        for name, entry in file["metrics"].items()
    }
    return CaseResult(
        hash=str(group.attrs["hash"]),
        label=text("label"),
        swept=json.loads(text("swept")),
        swept_units=json.loads(text("swept_units")),
        resolved=json.loads(text("resolved")),
        provenance=json.loads(text("provenance")),
        points=points,
        triangles=vtk["Connectivity"][()].reshape(-1, 3),
        load_factors=load_factors,
        regions={
            name.removeprefix("region."): values[()].astype(bool)
            for name, values in point_data.items()
            if name.startswith("region.")
        },
        models=models,
        metrics=metrics,
        reference=text("reference") or None,
        reference_error=json.loads(text("reference_error")),
        mesh_quality=json.loads(text("mesh_quality")),
        small_strain=_read_limits(file["limits"]) if "limits" in file else None,
    )


# --- a whole study ---


def _fill_study(file: h5py.File, run: Run) -> None:
    """One (cases, steps) array per model and metric, with labelled dimensions; NaN where a case has none."""
    group = file.create_group("case")
    group.attrs["schema"] = SCHEMA
    group.create_dataset("study", data=run.study_text, dtype=_TEXT)
    group.create_dataset("hash", data=[case.hash for case in run.cases], dtype=_TEXT)
    group.create_dataset("label", data=[case.label for case in run.cases], dtype=_TEXT)
    swept = file.create_group("swept", track_order=True)
    for key in dict.fromkeys(key for case in run.cases for key in case.swept):
        values = [case.swept.get(key) for case in run.cases]
        unit = next(case.swept_units.get(key, "1") for case in run.cases if key in case.swept)
        if all(isinstance(value, int | float) for value in values):
            put(swept, key, np.array(values, dtype=float), unit)
        else:
            swept.create_dataset(key, data=[str(value) for value in values], dtype=_TEXT)
    n_steps = max((len(case.load_factors) for case in run.cases), default=0)
    factors = np.full((len(run.cases), n_steps), np.nan)
    for row, case in enumerate(run.cases):
        factors[row, : len(case.load_factors)] = case.load_factors
    put(file, "load_factor", factors, "1")
    index = {case.hash: row for row, case in enumerate(run.cases)}
    metrics = file.create_group("metrics", track_order=True)
    tables: dict[tuple[str, str], NDArray[np.float64]] = {}
    about: dict[tuple[str, str], MetricSeries] = {}
    for case, model, metric, series in metric_rows(run):
        table = tables.setdefault((model, metric), np.full((len(run.cases), n_steps), np.nan))
        table[index[case.hash], : len(series.values)] = series.values
        about[model, metric] = series
    for (model, metric), table in tables.items():
        dataset = put(metrics.require_group(model), metric, table, about[model, metric].unit)
        dataset.attrs["definition"] = about[model, metric].definition
        dataset.attrs["version"] = about[model, metric].version
        dataset.dims[0].label = "case"
        dataset.dims[1].label = "step"


# --- small helpers ---


def put(group: h5py.Group, name: str, values: NDArray[Any], unit: str) -> h5py.Dataset:
    """Store an array with its unit."""
    values = np.asarray(values)
    large = values.size > 4096
    options = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if large else {}
    dataset = group.create_dataset(name, data=values, **options)
    dataset.attrs["unit"] = unit
    return dataset


def _json(value: Mapping[str, Any] | Sequence[Any]) -> str:
    return json.dumps(value, sort_keys=True, default=_plain)


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} cannot be stored as JSON")
