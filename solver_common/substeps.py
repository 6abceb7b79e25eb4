"""How far to go towards a load at once: the rule of all solvers that step."""

from __future__ import annotations

import numpy as np

LEAST_STEP = 2.0**-8  # of a load step


class Substeps:
    """Shares of the way to a load, tried one after another: half as far where one fails, twice where it is easy.

    Attributes
    ----------
    reached : share of the way [1]
    """

    def __init__(self) -> None:
        self.reached, self._step = 0.0, 1.0
        self._wall, self._has_failed = np.inf, False  # the wall: where an attempt failed last

    @property
    def target(self) -> float:
        """The share that is to be tried. A remainder too short to be tried alone is taken along."""
        target = self.reached + self._step
        return 1.0 if target > 1.0 - LEAST_STEP else target

    def found(self, is_easy: bool) -> None:
        """The target was reached."""
        step, self.reached = self.target - self.reached, self.target
        if self._wall <= self.reached:
            self._wall = np.inf
        if is_easy and not self._has_failed:
            self._step = 2.0 * step
        else:  # what failed is tried again after an easy step only
            self._step = max(min(step, 0.5 * (self._wall - self.reached)), LEAST_STEP)
        self._has_failed = False

    def leap(self, target: float) -> None:
        """Try a share next that is farther than the rule has it."""
        self._step = target - self.reached

    def failed(self) -> bool:
        """The target was not reached; whether half of the way there is worth a try."""
        step = self.target - self.reached
        self._step, self._wall, self._has_failed = 0.5 * step, self.target, True
        return step > LEAST_STEP
