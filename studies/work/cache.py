"""The cache: answers as sealed files under their keys; and results made from answers."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from solver_common.arrays import Index

from ..body.mesh import Mesh
from ..body.surface_measures import enclosed_volumes
from ..machine import read_arrays, write_arrays
from ..scene.result import ModelResult
from ..store.plain import typed

# arrays of a result that have one entry a load step
STEPS = (
    "displacement",
    "fluid_pressure",
    "reaction_force",
    "energy",
    "volume",
    "iterations",
    "seconds_per_step",
)


def answer_path(cache: Path, key: str) -> Path:
    """Where the cache keeps the answer of a key."""
    return cache / "answers" / f"{key}.npz"


def write_answer(path: Path, result: ModelResult) -> None:
    """Store an answer; frames are measured anew in each run. Raises OSError."""
    write_arrays(path, result, frames=None)


def read_answer(path: Path) -> ModelResult | None:
    """The answer stored at `path`; None where none is sound."""
    stored = read_arrays(path)
    if stored is None:
        return None
    arrays = {name: stored[name] for name in (*STEPS, "scalars", "point_fields", "part_of_node")}
    return typed(ModelResult, stored, **arrays)


def stored_answer(cache: Path, key: str) -> ModelResult:
    """An answer that a node before this one has made. Raises OSError where it is gone."""
    path = answer_path(cache, key)
    answer = read_answer(path)
    if answer is None:
        raise FileNotFoundError(2, "an answer is gone, or damaged; run again", str(path))
    return answer


def steps_of(result: ModelResult, steps: Sequence[int] | Index) -> ModelResult:
    """Some steps of a result."""
    chosen = np.asarray(steps, dtype=int)
    return dataclasses.replace(
        result,
        **{name: getattr(result, name)[chosen] for name in STEPS},
        status=tuple(result.status[step] for step in chosen.tolist()),
        scalars={name: values[chosen] for name, values in result.scalars.items()},
    )


def combined(
    answers: Sequence[ModelResult], scales: Sequence[float], mesh: Mesh, datum: float = 0.0
) -> ModelResult:
    """The result of S steps that are each `scales` times an answer of one step.

    Residuals and times are those of the answers.

    Parameters
    ----------
    datum : the pressure that the fluid has without load [Pa]
    """
    factors = np.array(scales)
    first = answers[0]
    if all(answer is first for answer in answers):  # a load history of one load
        answers = [first]
    places = np.zeros(len(factors), dtype=int) if len(answers) == 1 else np.arange(len(factors))
    stacked: Mapping[str, Any] = {
        name: np.concatenate([getattr(answer, name) for answer in answers])[places] for name in STEPS
    }
    displacement = factors[:, None, None] * stacked["displacement"]
    return dataclasses.replace(
        first,
        **{name: stacked[name] for name in ("iterations", "seconds_per_step")},
        displacement=displacement,
        reaction_force=factors[:, None, None] * stacked["reaction_force"],
        fluid_pressure=factors * (stacked["fluid_pressure"] - datum) + datum,
        energy=factors**2 * stacked["energy"],
        volume=enclosed_volumes(mesh.surface_points + displacement, mesh.triangles),
        status=tuple(answers[place].status[0] for place in places.tolist()),
        peak_bytes=max(answer.peak_bytes for answer in answers),
        scalars={
            name: np.concatenate([answer.scalars[name] for answer in answers])[places]
            for name in first.scalars
            if all(name in answer.scalars for answer in answers)
        },
    )
