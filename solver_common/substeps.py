"""The rule for substep lengths, shared by all solvers that step towards a load."""

from __future__ import annotations

import numpy as np

LEAST_STEP = 2.0**-8  # of a load step


class Substeps:
    """Shares of a load step that a solver attempts: half the substep after a failure, twice after an easy one.

    Attributes
    ----------
    reached : share of the load step at which equilibrium was last found [1]
    """

    def __init__(self) -> None:
        self.reached, self._step = 0.0, 1.0
        self._wall, self._has_failed = np.inf, False  # the wall: the last target that failed

    @property
    def target(self) -> float:
        """The share to attempt next. It includes a remainder that is too short for an attempt of its own."""
        target = self.reached + self._step
        return 1.0 if target > 1.0 - LEAST_STEP else target

    def found(self, is_easy: bool) -> None:
        """Record that the target was reached."""
        step, self.reached = self.target - self.reached, self.target
        if self._wall <= self.reached:
            self._wall = np.inf
        if is_easy and not self._has_failed:
            self._step = 2.0 * step
        else:  # retry a failed length only after an easy step
            self._step = max(min(step, 0.5 * (self._wall - self.reached)), LEAST_STEP)
        self._has_failed = False

    def leap(self, target: float) -> None:
        """Attempt this share next, which is farther than the rule's."""
        self._step = target - self.reached

    def failed(self) -> bool:
        """Record that the target was not reached; returns whether half the substep is worth an attempt."""
        step = self.target - self.reached
        self._step, self._wall, self._has_failed = 0.5 * step, self.target, True
        return step > LEAST_STEP
