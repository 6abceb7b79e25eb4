"""Bodies whose shape was measured under their weight (`gravity.scanned`): loads start from that shape.

A fixed-point iteration finds the rest shape. Each step sags the trial rest shape and moves its points by the
distance to the measured shape (Sellier, Journal of Fluids and Structures 27 (2011) 1461), with Anderson
acceleration.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from solver_common.arrays import Array
from solver_common.solution import NO_REST_SHAPE, Solution, SolverError, solver_error

from ..scene.result import REST_DISTANCE
from ..scene.scene import SurfaceLoad

TOLERANCE = 1e-4  # largest distance from the sagged to the measured shape, as a share of the largest sag
_MOST = 40  # most steps
_HALVINGS = 4  # most halvings of one step
_REMEMBERED = 10  # depth of the Anderson acceleration
UNSTABLE = "under its weight the scanned shape is not stable"


def rest_shape(
    measured: Array, sag: Callable[[Array], Array], start: Array | None = None
) -> tuple[Array, Array]:
    """The points of a rest shape that sags into a measured one.

    Parameters
    ----------
    measured : (n, 3) points under the weight [m]
    sag : (n, 3) points at rest -> (n, 3) their displacement under the weight [m]; may raise `SolverError`
    start : (n, 3) points to start from [m]; None for the measured ones

    Returns
    -------
    rest : (n, 3) points at rest [m]
    displacement : (n, 3) displacement of these points under the weight [m]

    Raises
    ------
    SolverError
        the iteration does not converge, as for a body that is too soft for its weight.
    """
    from vdm.solvers.anderson import Anderson

    rest, anderson = measured if start is None else start, Anderson(_REMEMBERED)
    borne, halved = rest, 0
    for _ in range(_MOST):
        try:
            displacement = sag(rest)
        except SolverError as error:
            if rest is borne or halved == _HALVINGS or error.status.code == NO_REST_SHAPE:
                raise no_rest_shape(error.status.message) from error
            rest, halved = 0.5 * (borne + rest), halved + 1
            continue
        borne, halved = rest, 0
        missed = measured - (rest + displacement)
        if np.abs(missed).max() <= TOLERANCE * np.abs(displacement).max():
            return rest, displacement
        rest = anderson.next(rest.ravel(), missed.ravel()).reshape(rest.shape)
    raise no_rest_shape(f"after {_MOST} steps a point is off by {1e3 * float(np.abs(missed).max()):.2g} mm")


def no_rest_shape(why: str) -> SolverError:
    """The error of a scanned body without a rest shape."""
    return solver_error(
        NO_REST_SHAPE,
        f"no rest shape was found that sags into the scanned one: {why}",
        "give a stiffer tissue, bear more of its surface on soft springs (`elastic`), or leave out gravity.scanned",
    )


def from_scan(
    solution: Solution, loads: Sequence[SurfaceLoad], sag: Array, seconds: float, left: float = 0.0
) -> Solution:
    """A solution from the rest shape, with displacements measured from the scanned shape.

    A converged step with the weight alone gets zero displacement, not the solver's residual error.

    Parameters
    ----------
    sag : (N, 3) displacement from the rest shape to the scanned one [m]
    seconds : time of the set-up, with the search for the rest shape [s]
    left : how far a new cut moves the rest shape [m]; if positive, the status says so
    """
    distance = float(np.linalg.norm(sag, axis=1).max())
    rests = [status.ok and not load.acts for status, load in zip(solution.status, loads, strict=True)]
    statuses = solution.status
    if left > 0.0:
        about = f"the rest shape is known to {1e3 * left:.2g} mm, {100 * left / distance:.2g} % of its sag"
        told = f"{about}: it depends on where the body is cut", "give vdm.parts = 1, or take fem"
        statuses = tuple(status.telling(*told) if status.ok else status for status in statuses)
    return dataclasses.replace(
        solution,
        status=statuses,
        displacement=np.where(np.array(rests)[:, None, None], 0.0, solution.displacement - sag),
        seconds_setup=seconds,
        scalars={**solution.scalars, REST_DISTANCE: np.full(len(solution.status), distance)},
    )
