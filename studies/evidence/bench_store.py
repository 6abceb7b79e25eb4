"""A benchmark on disk: one sealed HDF5 file, entries as labelled columns."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..machine.files import write_atomically
from ..store.hdf5 import Data, Group, Stored, StoreError, Text, sealed
from ..store.hdf5 import Entry as StoredEntry
from .bench_data import TIMES, Bench, Entry, Growth

SCHEMA = 2  # of 1, re-cuts counted the columns and elements had none
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
    write_atomically(path, sealed(_stored(bench)))


def _stored(bench: Bench) -> list[StoredEntry]:
    columns = dict.fromkeys(TIMES, "s") | dict.fromkeys(_RATIOS, "1") | _NUMBERS
    out: list[StoredEntry] = [
        Group("case", {"schema": SCHEMA, "machine": json.dumps(dict(bench.machine))}),
        Group("entries"),
        *(Text(f"entries/{name}", [getattr(e, name) for e in bench.entries]) for name in _TEXTS),
        Text("entries/counts", [json.dumps(dict(e.counts), sort_keys=True) for e in bench.entries]),
    ]
    for name, unit in columns.items():
        values = np.array([getattr(e, name) for e in bench.entries], dtype=float)
        out.append(Data(f"entries/{name}", values, {"unit": unit}, ("entry", "round")[: values.ndim]))
    out.append(Group("growth"))
    for growth in bench.growths:
        path = f"growth/{growth.what}"
        out += [
            Group(path, {"exponent": growth.exponent}),
            Data(f"{path}/nodes", growth.nodes, {"unit": "1"}),
            Data(f"{path}/values", growth.values, {"unit": growth.unit}),
        ]
    return out


def read_bench(path: Path) -> Bench:
    """Read it back.

    Raises
    ------
    StoreError
        not a benchmark's file, damaged, or of another schema.
    """
    with Stored(path, SCHEMA) as file:
        try:
            return _read(file)
        except (KeyError, ValueError, TypeError, OSError) as error:
            raise StoreError(f"{path}: not a benchmark's file ({error}); delete it and run again") from error


def _read(file: Stored) -> Bench:
    texts = {name: file.texts(f"entries/{name}") for name in (*_TEXTS, "counts")}
    stored = {name: file.floats(f"entries/{name}") for name in (*TIMES, *_RATIOS, *_NUMBERS)}
    entries = []
    for row in range(len(texts["model"])):
        fields: dict[str, Any] = {name: texts[name][row] for name in _TEXTS}
        fields |= {name: stored[name][row] for name in (*TIMES, *_RATIOS)}
        fields |= {name: float(stored[name][row]) for name in _NUMBERS}
        fields |= {name: int(fields[name]) for name in ("nodes", "tetrahedra")}
        entries.append(Entry(**fields, counts=json.loads(texts["counts"][row])))
    growths = [
        Growth(
            what,
            file.text(f"growth/{what}/values", "unit"),
            file.floats(f"growth/{what}/nodes"),
            file.floats(f"growth/{what}/values"),
        )
        for what in file.members("growth")
    ]
    return Bench(json.loads(file.text("case", "machine")), entries, growths)
