"""Anderson acceleration of a fixed-point iteration."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Anderson:
    """Mixes the last `depth` iterates so that the steps they predict cancel (type II, Walker and Ni 2011)."""

    def __init__(self, depth: int) -> None:
        self.depth = depth
        self.iterates: list[Array] = []
        self.steps: list[Array] = []

    def next(self, iterate: Array, step: Array) -> Array:
        """The next iterate (n,), from the present one and the step that the plain iteration would take."""
        self.iterates.append(iterate)
        self.steps.append(step)
        if len(self.iterates) > self.depth + 1:
            del self.iterates[0], self.steps[0]
        if len(self.iterates) == 1:
            return iterate + step
        change_of_steps = np.diff(np.stack(self.steps), axis=0)
        change_of_iterates = np.diff(np.stack(self.iterates), axis=0)
        # normal equations: a handful of unknowns, and the minimum-norm solution where the steps are dependent
        gram = change_of_steps @ change_of_steps.T
        mix = np.linalg.lstsq(gram, change_of_steps @ step, rcond=1e-14)[0]
        mixed: Array = iterate + step - mix @ (change_of_iterates + change_of_steps)
        return mixed
