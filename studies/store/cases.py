"""Results on disk: one VTKHDF file per case, complete or absent.

A file gets its final name only after it is safely on disk. `results/FORMAT.md` describes its content. A case
consists of arrays on its nodes and a text for all else. The text is the dataclass itself
(`vdmbench.machine.plain`), with the positions of the arrays; the end of the file has the position of the text. A
case is thus read in one go, not array by array.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..machine import json_text, plain, write_atomically
from ..measures import uncertainty
from ..measures.case import DAMAGED, CaseResult, Run
from ..measures.frame import COLUMNS, COSTS
from ..measures.metrics import METRICS
from ..scene.result import FrameTimes, ModelResult
from .hdf5 import Block, Entry, hdf5_image
from .plain import OlderSchemaError, StoreError, typed
from .run_directory import (
    METRICS_FILE,
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

SCHEMA = 6
MAX_BYTES = 2_000_000_000  # of the arrays of a case, which is read as a whole
SEAL = b"\nvdmbench-sha256 "  # before the checksum at the end of a file
SEAL_BYTES = len(SEAL) + 64 + 1
ABOUT = "case/about"
_PLACE = "\n{0.start:012d} {0.stop:012d}"  # position of the text, before the seal
_PLACE_BYTES = 26
MOVED = "surface_distance"
PART = "part_of_node"
_VTK_TRIANGLE = 5
_DATA = "VTKHDF/PointData/"
_POINTS, _CONNECTIVITY = "VTKHDF/Points", "VTKHDF/Connectivity"

# not in the text: from a case its arrays, from a model its nodal arrays and the times that each run measures
_NOT_TOLD = ("points", "triangles", "regions", "moved", "models", "metrics")
_FIELDS = {"displacement": "m", "reaction_force": "N"}
# errors of reading a file with inconsistent parts
_UNREADABLE = (LookupError, ValueError, TypeError, AttributeError, ArithmeticError, RuntimeError)


def write_case(path: Path, case: CaseResult) -> None:
    """Write one case file. Raises ValueError for more results than a file holds."""
    entries = _vtk_entries(case)
    size = sum(entry.values.nbytes for entry in entries if entry.values is not None)
    if size > MAX_BYTES:
        raise ValueError(f"has {size} bytes of results, more than a case file holds; use fewer load steps")
    about = {
        "schema": SCHEMA,
        "definitions": _definitions(),
        **plain(case, without=_NOT_TOLD),
        "models": {
            name: plain(model, without=(*_FIELDS, PART, "frames")) for name, model in case.models.items()
        },
        "metrics": case.metrics,
    }
    own = (_POINTS, _CONNECTIVITY, _DATA)
    image, place = hdf5_image(
        [*entries, Entry("case")],
        ABOUT,
        lambda arrays: json_text(
            about | {"arrays": {name: block for name, block in arrays.items() if name.startswith(own)}}
        ),
    )
    content = image + _PLACE.format(place).encode()
    write_atomically(path, content + _seal(content))


def _seal(content: bytes) -> bytes:
    return SEAL + hashlib.sha256(content).hexdigest().encode() + b"\n"


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
        Entry(_POINTS, np.asarray(case.points), {"unit": "m"}),
        *(Entry(f"VTKHDF/{name}", values) for name, values in numbers.items()),
        Entry("VTKHDF/Steps", None, {"NSteps": n_steps}),
        *(Entry(f"VTKHDF/Steps/{name}", values) for name, values in steps.items()),
        Entry("VTKHDF/PointData"),
        Entry("VTKHDF/Steps/PointDataOffsets"),
        *(Entry(f"{_DATA}{name}", one, {"unit": unit}) for name, (one, unit, _) in fields.items()),
        *(Entry(f"VTKHDF/Steps/PointDataOffsets/{name}", first) for name, (*_, first) in fields.items()),
    ]


def read_case(
    path: Path,
    expected: str | None = None,
    *,
    frames: Mapping[str, FrameTimes] | None = None,
    **names: Any,
) -> CaseResult:
    """Read one case file back; its arrays on nodes cannot be written to.

    Parameters
    ----------
    expected : its hash
    frames : times of its models' frames, which are not in the file
    names : label and swept values of the study, which replace those in the file

    Raises
    ------
    StoreError
        not a case file, damaged, of another schema, or not the case with the hash `expected`.
    """
    data, about = _content(path)
    try:
        if expected not in (None, about["hash"]):
            raise ValueError("it holds another case")
        return _case(data, about, frames or {}, names)
    except _UNREADABLE as error:
        why = " ".join(str(error).split())[:300]
        again = "delete it and run again"
        raise StoreError(f"{path}: not readable as a case file ({why}); {again}") from error


def _content(path: Path) -> tuple[bytes, dict[str, Any]]:
    """The bytes of a sound case file of this schema and of these metrics, and its text. Raises StoreError."""
    try:
        data = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise StoreError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise StoreError(f"{path}: a directory is in a file's place; remove it, then run again") from None
    content = data[:-SEAL_BYTES]
    if data[-SEAL_BYTES:] != _seal(content):
        raise StoreError(f"{path}: damaged (its SHA-256 does not match); delete it and run again")
    try:
        about = json.loads(content[slice(*map(int, content[-_PLACE_BYTES:].split()))])
        schema = int(about["schema"])
    except _UNREADABLE:  # an older file has its text at another place
        about, schema = {}, 0
    if schema > SCHEMA:
        raise StoreError(f"{path}: schema {schema} is newer than this program's {SCHEMA}; update vdmbench")
    if schema < SCHEMA or about.get("definitions") != _definitions():
        raise OlderSchemaError(f"{path}: made by an older version of the program; run again")
    return content, about


def _case(
    data: bytes, about: dict[str, Any], frames: Mapping[str, FrameTimes], names: dict[str, Any]
) -> CaseResult:
    blocks = {name: Block(**block) for name, block in about["arrays"].items()}

    def array(name: str) -> NDArray[Any] | None:
        return blocks[name].of(data) if name in blocks else None

    n_steps = len(about["load_factors"])
    models = {
        name: typed(
            ModelResult,
            one,
            **{key: blocks[f"{_DATA}{name}.{key}"].of(data).reshape(n_steps, -1, 3) for key in _FIELDS},
            part_of_node=array(f"{_DATA}{name}.{PART}"),
            frames=frames.get(name),
        )
        for name, one in about["models"].items()
    }
    region = f"{_DATA}region."
    return typed(
        CaseResult,
        about,
        **names,
        points=blocks[_POINTS].of(data),
        triangles=blocks[_CONNECTIVITY].of(data).reshape(-1, 3),
        regions={
            name.removeprefix(region): block.of(data).astype(bool)
            for name, block in blocks.items()
            if name.startswith(region)
        },
        moved=array(f"{_DATA}{MOVED}"),
        models=models,
        metrics={
            name: {key: np.array(found[key], dtype=float) for key in METRICS if key in found}
            for name, found in about["metrics"].items()
        },
    )


# --- a run directory ---


def read_run(directory: Path, *, damaged: bool = False) -> Run:
    """Read a run directory: the plan, and the finished, failed and missing cases.

    It works on a copied directory. Cases of an earlier plan are left out. With `damaged`, a case with a damaged
    file counts as failed, with the damage as the reason.

    Raises
    ------
    StoreError
        not a run directory, or a damaged file in it; with `damaged`, not for the file of a case.
    """
    plan = read_plan(directory)
    study, study_text = read_study(directory)
    cases, failed, missing = [], [], []
    times = read_times(directory)
    for planned in plan["cases"]:
        label = planned["label"] or plan["study"]["name"]
        path = case_path(directory, planned["hash"], planned["label"])
        # label and swept values belong to the study, not to the case: another study may share the case
        names = {key: planned[key] for key in ("label", "swept", "swept_units")}
        frames = times.get(planned.get("mesh", ""))
        if os.path.lexists(path):
            try:
                cases.append(read_case(path, planned["hash"], frames=frames, **names))
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
    """The cases of a run directory, all finished, read at the first access."""

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
    """A run directory that has not changed since its report, without reading its cases; else None."""
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
    """ "done", "damaged", "failed" or "missing".

    A file of an older version counts as missing: the next run writes it again.
    """
    path = case_path(directory, case_hash, label)
    if os.path.lexists(path):
        try:
            _, about = _content(path)
        except OlderSchemaError:
            return "missing"
        except StoreError:
            return "damaged"
        return "done" if about.get("hash") == case_hash else "damaged"
    return "failed" if has_failed(directory, case_hash, label) else "missing"


def _definitions() -> dict[str, dict[str, Any]]:
    """Definitions of all metrics, and the version of the rules for bars."""
    told = ("unit", "definition", "version")
    found = {name: {key: getattr(metric, key) for key in told} for name, metric in METRICS.items()}
    return found | {"error bars": {"version": uncertainty.VERSION}}


# --- the metrics of a run ---


def write_metrics(directory: Path, table: DataFrame) -> None:
    """Write `metrics.csv`, the frame of a run: every metric of every case, model and step in one long table."""
    write_atomically(directory / METRICS_FILE, metrics_csv(table).encode("utf-8", "replace"))


def metrics_csv(table: DataFrame) -> str:
    """The metrics of a frame as CSV, with the reference's own error beside values at full load, if measured."""
    from pandas.api.types import is_numeric_dtype  # slow to load

    rows = table[~table["metric"].isin(list(COSTS))]
    swept = [key for key in table.columns if key not in COLUMNS]
    shown = rows[["case", *swept, "model", "load_factor", "metric", "value", "unit", "bar"]].copy()
    shown["case"] = shown["case"].map({one: one[:12] for one in shown["case"].unique()})
    shown = shown.rename(columns={"bar": "reference_error"})
    for key in (key for key in shown if not is_numeric_dtype(shown[key])):
        texts = {one: no_formula(one) for one in shown[key].unique() if isinstance(one, str)}
        if any(one != safe for one, safe in texts.items()):
            shown[key] = shown[key].map(lambda one, texts=texts: texts.get(one, one))
    return str(shown.rename(columns=no_formula).to_csv(index=False, lineterminator="\n"))


def no_formula(text: str) -> str:
    """Quote a text that a spreadsheet would run as a formula."""
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t", "\r")) else text
