"""The result of a solve, and the error that a solver raises."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from solver_common.arrays import Array


@dataclass(frozen=True)
class Status:
    """The outcome of one load step: "converged" or a kind of failure, what happened, and what to change."""

    code: str
    message: str = ""
    remedy: str = ""

    @property
    def ok(self) -> bool:
        """Whether the step converged."""
        return self.code == "converged"

    def telling(self, message: str, remedy: str) -> Status:
        """The same outcome with one more message and remedy."""
        told = zip((self.message, self.remedy), (message, remedy), strict=True)
        return Status(self.code, *("; ".join(filter(None, both)) for both in told))


CONVERGED = Status("converged")
NO_REST_SHAPE = "no-rest-shape"  # status code of a scanned body without a rest shape
NO_MOTION = 1e-12  # of a body's size: smaller displacements are solver rounding
ENDED = "{} beyond {:.4g} of load step {} (after {} iterations {})"
RESIDUAL = "the relative residual was {:.1e}"


class SolverError(ValueError):
    """The model cannot be set up or solved. `status` says why, and what to change."""

    def __init__(self, status: Status) -> None:
        super().__init__(f"{status.message}; {status.remedy}" if status.remedy else status.message)
        self.status = status


def solver_error(code: str, message: str, remedy: str = "") -> SolverError:
    """A `SolverError` with this status."""
    return SolverError(Status(code, message, remedy))


@dataclass(frozen=True)
class Solution:
    """A load history of S steps on a surface of N nodes, SI units.

    Attributes
    ----------
    displacement : (S, N, 3) displacement of the surface nodes [m]
    fluid_pressure : (S,) pressure of the fluid; for a solid the volume mean of -tr(stress)/3 [Pa]
    reaction_force : (S, N, 3) force that supports and springs exert on the body, zero at free nodes [N]
    energy : (S,) elastic energy [J]
    iterations : (S,) solver iterations, 0 for a direct solve
    status : S outcomes, one per step
    seconds_setup : time of checks, parameter rules, assembly and factorisation [s]
    seconds_per_step : (S,) time of each step after set-up [s]
    parameters : the material and solver parameters that were used
    scalars : further (S,) outputs by name
    part_of_node : (N,) part of each node, from 1; None if the body is not cut. A node on a cut has its highest part
    """

    displacement: Array
    fluid_pressure: Array
    reaction_force: Array
    energy: Array
    iterations: NDArray[np.int64]
    status: tuple[Status, ...]
    seconds_setup: float
    seconds_per_step: Array
    parameters: dict[str, float | str] = field(default_factory=dict)
    scalars: dict[str, Array] = field(default_factory=dict)
    part_of_node: NDArray[np.int64] | None = None
