"""Reference solutions kept on disk by content key, shared between studies: checked before they are read."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np

from .case import ModelResult, StepStatus
from .proportional import Answer
from .sealed import read_arrays, write_arrays

_ARRAYS = (
    "displacement",
    "fluid_pressure",
    "reaction_force",
    "energy",
    "volume",
    "iterations",
    "seconds_per_step",
)
_NUMBERS = ("seconds_setup", "peak_bytes", "version", "key")


def reference_path(cache: Path, key: str) -> Path:
    """Where the cache keeps the solution of a reference's key."""
    return cache / "references" / f"{key}.npz"


def write_reference(path: Path, reference: Answer) -> None:
    """Store a reference at the surface nodes, with the loads that it answers. Raises OSError."""
    arrays: dict[str, Any] = {
        "levels": np.array(len(reference.levels)),
        "loads": np.array(json.dumps(dict(reference.loads))),
        "load_factors": reference.load_factors,
    }
    for number, result in enumerate(reference.levels):
        about = {
            **{name: getattr(result, name) for name in _NUMBERS},
            "parameters": dict(result.parameters),
            "status": [dataclasses.astuple(status) for status in result.status],
        }
        arrays[f"{number}/about"] = np.array(json.dumps(about))
        arrays |= {f"{number}/{name}": getattr(result, name) for name in _ARRAYS}
        arrays |= {f"{number}/scalar/{name}": values for name, values in result.scalars.items()}
    write_arrays(path, arrays)


def read_reference(path: Path) -> Answer | None:
    """The reference stored at `path`, or None where there is nothing or it is damaged."""
    arrays = read_arrays(path)
    if arrays is None:
        return None
    levels = [_level(arrays, f"{number}/") for number in range(int(arrays["levels"]))]
    return Answer(levels, json.loads(str(arrays["loads"])), arrays["load_factors"])


def _level(arrays: dict[str, Any], prefix: str) -> ModelResult:
    about = json.loads(str(arrays[f"{prefix}about"]))

    start = f"{prefix}scalar/"
    scalars = {name.removeprefix(start): values for name, values in arrays.items() if name.startswith(start)}
    return ModelResult(
        **{name: arrays[f"{prefix}{name}"] for name in _ARRAYS},
        **{name: about[name] for name in _NUMBERS},
        status=tuple(StepStatus(*status) for status in about["status"]),
        parameters=about["parameters"],
        scalars=scalars,
    )
