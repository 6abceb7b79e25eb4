"""What a model answers, as plain data."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from solver_common.arrays import Array
from solver_common.solution import Solution

REFUSED = "refused"  # status of a model that could not be set up: before any solve, for a reason of the input

# scalar of a body scanned under its weight: largest distance from its rest shape to the scanned one [m]
REST_DISTANCE = "rest_distance"


@dataclass(frozen=True)
class FrameTimes:
    """What one model was measured to take in R rounds, in turns with the others, as (R,) arrays of seconds.

    Attributes
    ----------
    setup : operators and factors of a new body
    contact : a load on the fixed contact region, factors kept
    everywhere : a load over the whole free surface, factors kept; NaN of a model that has no such frame
    processor : of the machine that measured
    case : label of the case on whose mesh and load they were measured
    """

    setup: Array
    contact: Array
    everywhere: Array
    processor: str = ""
    case: str = ""


@dataclass(frozen=True, kw_only=True)
class ModelResult(Solution):
    """One model's solution of S load steps on N surface nodes, with what it took.

    A step that failed holds NaN in its arrays; its status says why.

    Attributes
    ----------
    volume : (S,) exact volume of the deformed surface polyhedron [m^3]
    peak_bytes : peak resident memory that the model added
    version : declared version of the model
    frames : measured anew when the run ended; None where they were not
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

    def __post_init__(self) -> None:
        taken = self.scalars.keys() & {own.name for own in fields(self)}
        if taken:  # they are columns of one table
            raise ValueError(f"a model's own output cannot be called {min(taken)!r}: every result has one")
