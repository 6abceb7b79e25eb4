"""A model's answer as plain data: a table of load steps, with functions to select, join or lose steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from solver_common.arrays import Array, Index, Mask
from solver_common.solution import Solution, Status

REFUSED = "refused"  # status of a model that could not be set up because of its input

# scalar of a body scanned under its weight: largest distance from its rest shape to the scanned one [m]
REST_DISTANCE = "rest_distance"

LEAST_ROUNDS = 3  # of frames: from here on it is no chance if none is within a limit
CLEAR = 3.0  # times a limit: so long on the processor, one round is enough, as rounds differ by up to 2.2


@dataclass(frozen=True)
class FrameTimes:
    """Times of one model measured in R rounds, in turns with the others, as (R,) arrays of seconds.

    Attributes
    ----------
    setup : operators and factors of a new body
    contact : a load on the fixed contact region, factors kept
    everywhere : a load over the whole free surface, factors kept; NaN for a model without such a frame
    processor : of the machine that measured
    case : label of the case on whose mesh and load they were measured
    contact_worked : time that the processor spent on `contact`; None in results of older versions
    """

    setup: Array
    contact: Array
    everywhere: Array
    processor: str = ""
    case: str = ""
    contact_worked: Array | None = None

    @property
    def worked(self) -> Array:
        """Finite times on the processor alone [s], which other work does not add to; of old results `contact`."""
        times = self.contact if self.contact_worked is None else self.contact_worked
        return times[np.isfinite(times)]

    def is_beyond(self, limit: float) -> bool:
        """Whether a frame of the contact surely takes longer than a limit [s]: in every round, or far in one."""
        enough = LEAST_ROUNDS if not self.is_clear(limit) else 1
        return len(self.worked) >= enough and bool((self.worked > limit).all())

    def is_clear(self, limit: float) -> bool:
        """Whether any one round would be enough to tell that."""
        known = self.contact_worked is not None and len(self.worked) > 0
        return known and bool((self.worked > CLEAR * limit).all())


@dataclass(frozen=True, kw_only=True)
class ModelResult(Solution):
    """One model's solution of S load steps on N surface nodes, with its costs.

    A step that failed holds NaN in its arrays; its status says why.

    Attributes
    ----------
    volume : (S,) exact volume of the deformed surface polyhedron [m^3]
    peak_bytes : peak resident memory that the model added
    version : declared version of the model
    frames : measured at the end of a run; None if not measured
    """

    volume: Array
    peak_bytes: int
    version: str
    frames: FrameTimes | None = None

    @property
    def frame_time(self) -> float:
        """Median of the measured times of a frame of the contact [s]; NaN where none was measured."""
        times = self.frames.contact if self.frames is not None else np.zeros(0)
        known = times[np.isfinite(times)]
        return float(np.median(known)) if len(known) else np.nan

    @property
    def frame_worked(self) -> float:
        """The part of `frame_time` that the processor spent on it [s]; NaN where that was not measured."""
        frames = self.frames
        known = frames.worked if frames is not None and frames.contact_worked is not None else np.zeros(0)
        return float(np.median(known)) if len(known) else np.nan

    def __post_init__(self) -> None:
        taken = self.scalars.keys() & {own.name for own in fields(self)}
        if taken:  # all are columns of one table
            raise ValueError(f"a model's own output cannot be called {min(taken)!r}: every result has one")


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


def steps_of(result: ModelResult, steps: Sequence[int] | Index) -> ModelResult:
    """Some steps of a result."""
    chosen = np.asarray(steps, dtype=int)
    arrays: Any = {name: getattr(result, name)[chosen] for name in STEPS}
    return replace(
        result,
        **arrays,
        status=tuple(result.status[step] for step in chosen.tolist()),
        scalars={name: values[chosen] for name, values in result.scalars.items()},
    )


def joined(first: ModelResult, parts: Sequence[ModelResult]) -> ModelResult:
    """The steps of several results of one model, one after the other; other fields are those of `first`."""
    arrays: Any = {name: np.concatenate([getattr(part, name) for part in parts]) for name in STEPS}
    return replace(
        first,
        **arrays,
        status=tuple(status for part in parts for status in part.status),
        scalars={
            name: np.concatenate(
                [part.scalars.get(name, np.full(len(part.status), np.nan)) for part in parts]
            )
            for name in first.scalars
        },
    )


def answered(result: ModelResult, kept: Mask | bool = False) -> ModelResult:
    """A result without answers to failed steps, except those in `kept` (S,)."""
    lost = np.array([not status.ok for status in result.status], dtype=bool) & ~np.asarray(kept)
    if not lost.any():
        return result
    each = lost[:, None, None]
    return replace(
        result,
        displacement=np.where(each, np.nan, result.displacement),
        reaction_force=np.where(each, np.nan, result.reaction_force),
        fluid_pressure=np.where(lost, np.nan, result.fluid_pressure),
        energy=np.where(lost, np.nan, result.energy),
        volume=np.where(lost, np.nan, result.volume),
    )


def unanswered(status: Sequence[Status], n_nodes: int, version: str) -> ModelResult:
    """A result without any answer on N nodes, with the status of each step."""
    numbers, vectors = np.full(len(status), np.nan), np.full((len(status), n_nodes, 3), np.nan)
    return ModelResult(
        displacement=vectors,
        fluid_pressure=numbers,
        reaction_force=vectors.copy(),
        energy=numbers,
        volume=numbers,
        iterations=np.zeros(len(status), dtype=np.int64),
        status=tuple(status),
        seconds_setup=np.nan,
        seconds_per_step=numbers,
        peak_bytes=0,
        version=version,
    )
