"""Anderson acceleration of a fixed-point iteration."""

from __future__ import annotations

import numpy as np

from solver_common.arrays import Array

# smallest relative singular value of the changes' products, scaled to length one: smaller ones describe the path,
# not the slope
DEPENDENT = 1e-6


class Anderson:
    """Mixes the last `depth` changes so that the steps they predict cancel (type II, Walker and Ni 2011).

    It keeps the changes of iterate and step between iterations, scaled so that the change of step has length one.
    They describe the slope of the map, and so stay useful after `begin` for a neighbouring map.
    """

    def __init__(self, depth: int) -> None:
        self.depth = depth
        self._count = 0
        self._last: tuple[Array, Array] | None = None
        self._steps = np.zeros((depth, 0))
        self._sums = np.zeros((depth, 0))  # change of iterate plus the change of step of the same iteration
        self._gram = np.eye(depth)

    def begin(self) -> None:
        """Start on a neighbouring map: the next iterate does not follow from the last one."""
        self._last = None

    def next(self, iterate: Array, step: Array) -> Array:
        """The next iterate (n,), from the current one and the step of the plain iteration."""
        if self._last is not None:
            self._keep(iterate - self._last[0], step - self._last[1])
        self._last = (iterate, step)
        kept = min(self._count, self.depth)
        if kept == 0:
            return iterate + step
        # normal equations: few unknowns; the minimum-norm solution where the changes are dependent
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
