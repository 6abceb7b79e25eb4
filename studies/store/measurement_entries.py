"""What was measured on a case, and how far its models are from it, as entries of its file."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..machine import json_text
from ..measures.measurement import Measurement, Quantity
from .hdf5 import Data, Entry, Group, Stored, Text
from .shapes import MeasurementShape, parsed

_VALUES = ("value", "uncertainty")
_LENGTHS = (*_VALUES, "distance")
_TEXTS = ("table", "point", "component")
_SERIES = ("simulated", "numerical", "inputs")


def measurement_entries(found: Measurement) -> list[Entry]:
    """The group `measurement` of a case file; see results/FORMAT.md."""
    rows = found.quantities
    entries: list[Entry] = [Group("measurement")]
    entries += [Text(f"measurement/{key}", [getattr(row, key) for row in rows]) for key in _TEXTS]
    units = " or ".join(dict.fromkeys(row.unit for row in rows))
    entries += [_lengths(key, np.array([getattr(row, key) for row in rows]), units) for key in _VALUES]
    entries.append(_lengths("distance", np.array([row.distance for row in rows])))
    entries.append(Text("measurement/unit", [row.unit for row in rows]))
    entries.append(Data("measurement/facet", np.array([row.facet for row in rows], dtype=np.int64)))
    entries.append(
        Data("measurement/weights", np.array([row.weights for row in rows], dtype=float), {"unit": "1"})
    )
    entries.append(_lengths("depth", np.array([row.depth for row in rows])))
    entries.append(Data("measurement/step", np.array([row.step for row in rows], dtype=np.int64)))
    about = {"sources": dict(found.sources), "others": list(found.others)}
    entries.append(Text("measurement/about", json_text(about)))
    for key in _SERIES:
        entries.append(Group(f"measurement/{key}"))
        entries += [_lengths(f"{key}/{name}", values, units) for name, values in getattr(found, key).items()]
    return entries


def read_measurement(file: Stored) -> Measurement:
    """What `measurement_entries` wrote. Raises ValueError for another shape."""
    columns: dict[str, list[Any]] = {key: file.texts(f"measurement/{key}") for key in _TEXTS}
    columns |= {key: file.floats(f"measurement/{key}").tolist() for key in _LENGTHS}
    columns["step"] = file.integers("measurement/step").tolist()
    columns |= _since(file, len(columns["step"]))
    rows = zip(*columns.values(), strict=True)
    quantities = [Quantity(**dict(zip(columns, row, strict=True))) for row in rows]
    about = parsed(file.texts("measurement/about"), MeasurementShape)
    series = {
        key: {name: file.floats(f"measurement/{key}/{name}") for name in file.members(f"measurement/{key}")}
        for key in _SERIES
        if key != "inputs" or "measurement/inputs" in file
    }
    return Measurement(
        quantities,
        series["simulated"],
        series["numerical"],
        about.sources,
        tuple(about.others),
        series.get("inputs", {}),
    )


def _since(file: Stored, count: int) -> dict[str, list[Any]]:
    """The depth, facet and weights of each quantity, which a file of an older program has not."""
    if "measurement/weights" not in file:
        return {}
    weights = file.floats("measurement/weights").reshape(count, 3).tolist()
    return {
        "depth": file.floats("measurement/depth").tolist(),
        "facet": file.integers("measurement/facet").tolist(),
        "weights": list(map(tuple, weights)),
    }


def _lengths(path: str, values: np.ndarray, unit: str = "m") -> Data:
    return Data(f"measurement/{path}", np.asarray(values, dtype=float), {"unit": unit})
