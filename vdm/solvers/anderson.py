"""Anderson acceleration of a fixed-point iteration."""

from __future__ import annotations

import numpy as np

from solver_common.arrays import Array

# of changes of length one: a smaller singular value of their products says more of the path than of the slope
DEPENDENT = 1e-6


class Anderson:
    """Mixes the last `depth` changes so that the steps they predict cancel (type II, Walker and Ni 2011).

    What is kept are changes of iterate and step from one iteration to the next, scaled to a step's change of length
    one. They say how the map slopes, so they still serve after `begin` when a neighbouring map is iterated.
    """

    def __init__(self, depth: int) -> None:
        self.depth = depth
        self._count = 0
        self._last: tuple[Array, Array] | None = None
        self._steps = np.zeros((depth, 0))
        self._sums = np.zeros((depth, 0))  # of a change of iterate and the change of step that goes with it
        self._gram = np.eye(depth)

    def begin(self) -> None:
        """Start on a neighbouring map: the next iterate does not follow from the last one."""
        self._last = None

    def next(self, iterate: Array, step: Array) -> Array:
        """The next iterate (n,), from the present one and the step that the plain iteration would take."""
        if self._last is not None:
            self._keep(iterate - self._last[0], step - self._last[1])
        self._last = (iterate, step)
        kept = min(self._count, self.depth)
        if kept == 0:
            return iterate + step
        # normal equations: a handful of unknowns, and the minimum-norm solution where the changes are dependent
        mix = np.linalg.lstsq(self._gram[:kept, :kept], self._steps[:kept] @ step, rcond=DEPENDENT)[0]
        mixed: Array = iterate + step - mix @ self._sums[:kept]
        return mixed

    def _keep(self, change_of_iterate: Array, change_of_step: Array) -> None:
        size = float(np.linalg.norm(change_of_step))
        if not size > 0.0:
            return
        if self._steps.shape[1] != len(change_of_step):
            self._steps = np.zeros((self.depth, len(change_of_step)))
            self._sums = np.zeros_like(self._steps)
        place = self._count % self.depth
        self._steps[place] = change_of_step / size
        self._sums[place] = (change_of_iterate + change_of_step) / size
        self._gram[place] = self._gram[:, place] = self._steps @ self._steps[place]
        self._count += 1
