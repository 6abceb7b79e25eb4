"""A benchmark on disk: one sealed HDF5 file, entries as labelled columns."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from .bench_data import Bench, Entry, Growth
from .files import write_atomically
from .store import SCHEMA, StoreError, open_sealed, put, sealed

_SERIES = ("setup", "frame_all", "frame_local", "columns", "recut")  # (rounds,) [s]
_RATIOS = ("ratio_setup", "ratio_frame")
_NUMBERS = {
    "nodes": "1",
    "tetrahedra": "1",
    "peak_bytes": "B",
    "error": "1",
    "deformation_error": "1",
    "bar": "1",
    "iterations": "1",
}
_TEXTS = ("body", "model", "status")


def write_bench(path: Path, bench: Bench) -> None:
    """Write one file.

    Raises
    ------
    OSError
        disk full or read-only.
    """
    write_atomically(path, sealed(lambda file: _fill(file, bench)))


def _fill(file: Any, bench: Bench) -> None:
    case = file.create_group("case")
    case.attrs["schema"] = SCHEMA
    case.attrs["machine"] = json.dumps(dict(bench.machine))
    entries = file.create_group("entries")
    for name in _TEXTS:
        entries.create_dataset(name, data=[getattr(e, name).encode() for e in bench.entries])
    counts = [json.dumps(dict(e.counts), sort_keys=True).encode() for e in bench.entries]
    entries.create_dataset("counts", data=counts)
    for name, unit in (dict.fromkeys(_SERIES, "s") | dict.fromkeys(_RATIOS, "1") | _NUMBERS).items():
        stored = put(entries, name, np.array([getattr(e, name) for e in bench.entries], dtype=float), unit)
        for axis, label in zip(stored.dims, ("entry", "round"), strict=False):
            axis.label = label
    grown = file.create_group("growth", track_order=True)
    for growth in bench.growths:
        group = grown.create_group(growth.what)
        put(group, "nodes", growth.nodes, "1")
        put(group, "values", growth.values, growth.unit)
        group.attrs["exponent"] = growth.exponent


def read_bench(path: Path) -> Bench:
    """Read it back.

    Raises
    ------
    StoreError
        not a benchmark's file, damaged, or written by a newer schema.
    """
    with open_sealed(path) as file:
        try:
            return _read(file)
        except (KeyError, ValueError) as error:
            raise StoreError(f"{path}: not a benchmark's file ({error}); delete it and run again") from error


def _read(file: Any) -> Bench:
    stored = {name: values[()] for name, values in file["entries"].items()}
    entries = []
    for row in range(len(stored["model"])):
        fields: dict[str, Any] = {name: stored[name][row].decode() for name in _TEXTS}
        fields |= {name: stored[name][row] for name in (*_SERIES, *_RATIOS)}
        fields |= {name: float(stored[name][row]) for name in _NUMBERS}
        fields |= {name: int(fields[name]) for name in ("nodes", "tetrahedra")}
        entries.append(Entry(**fields, counts=json.loads(stored["counts"][row])))
    growths = [
        Growth(what, str(group["values"].attrs["unit"]), group["nodes"][()], group["values"][()])
        for what, group in file["growth"].items()
    ]
    return Bench(json.loads(file["case"].attrs["machine"]), entries, growths)
