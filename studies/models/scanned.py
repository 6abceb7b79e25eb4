"""Bodies whose shape was measured under their weight (`gravity.scanned`): loads start from that shape."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from solver_common.arrays import Array

from ..scene.result import REST_DISTANCE

if TYPE_CHECKING:
    from fem_reference.solution import Solution as FemSolution
    from vdm.solution import Solution as VdmSolution

    S = TypeVar("S", FemSolution, VdmSolution)


def from_scan(solution: S, sag: Array, seconds: float) -> S:
    """A solution from the rest shape as one from the scanned shape, which is (N, 3) `sag` [m] off it.

    `seconds` [s] is what the set-up took with the search for the rest shape.
    """
    distance = float(np.linalg.norm(sag, axis=1).max())
    return dataclasses.replace(
        solution,
        displacement=solution.displacement - sag,
        seconds_setup=seconds,
        scalars={**solution.scalars, REST_DISTANCE: np.full(len(solution.status), distance)},
    )
