"""The cache: answers as sealed files under their keys; and results combined from answers."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..body.mesh import Mesh
from ..body.surface_measures import enclosed_volumes
from ..machine import read_arrays, write_arrays
from ..scene.result import STEPS, ModelResult, joined, steps_of
from ..store.plain import typed


def answer_path(cache: Path, key: str) -> Path:
    """Path of the answer of a key."""
    return cache / "answers" / f"{key}.npz"


def write_answer(path: Path, result: ModelResult) -> None:
    """Store an answer without frame times, which each run measures. Raises OSError."""
    write_arrays(path, result, frames=None)


def read_answer(path: Path) -> ModelResult | None:
    """The answer stored at `path`; None if there is no sound one."""
    stored = read_arrays(path)
    if stored is None:
        return None
    arrays = {name: stored[name] for name in (*STEPS, "scalars", "part_of_node")}
    return typed(ModelResult, stored, **arrays)


def stored_answer(cache: Path, key: str) -> ModelResult:
    """An answer of an earlier task. Raises OSError if it is gone."""
    path = answer_path(cache, key)
    answer = read_answer(path)
    if answer is None:
        raise FileNotFoundError(2, "an answer is gone, or damaged; run again", str(path))
    return answer


def combined(
    answers: Sequence[ModelResult], scales: Sequence[float], mesh: Mesh, datum: float = 0.0
) -> ModelResult:
    """The result of S steps that are each `scales` times an answer of one step.

    Residuals and times are those of the answers.

    Parameters
    ----------
    datum : pressure of the fluid without load [Pa]
    """
    factors = np.array(scales)
    first = answers[0]
    if all(answer is first for answer in answers):  # a history of a single load
        whole = steps_of(first, np.zeros(len(factors), dtype=int))
    else:
        whole = joined(first, answers)
    displacement = factors[:, None, None] * whole.displacement
    return dataclasses.replace(
        whole,
        displacement=displacement,
        reaction_force=factors[:, None, None] * whole.reaction_force,
        fluid_pressure=factors * (whole.fluid_pressure - datum) + datum,
        energy=factors**2 * whole.energy,
        volume=enclosed_volumes(mesh.surface_points + displacement, mesh.triangles),
        peak_bytes=max(answer.peak_bytes for answer in answers),
    )
