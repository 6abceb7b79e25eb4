"""One load after the other of one body, each reached from the largest equilibrium that is known below it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from fem_reference.newton import Newton, ScaledLoad, Substep


class LoadPath:
    """The states that were reached on the way to some loads, and where the way ended.

    The loads are to lie on one path, of rising size: then a load beyond the end of the way has no solution that is
    near, and is not tried again. On a stable path an elastic body forgets its way: from whichever load below
    Newton's method starts, it is the same equilibrium to the tolerance. Where a path branches it may be another.
    """

    def __init__(self) -> None:
        self._reached: list[Substep] = []
        self._end: Substep | None = None  # the smallest load at which an attempt failed for good

    def follow(self, newton: Newton, load: ScaledLoad) -> Iterator[Substep]:
        """As `Newton.follow`, to a load from the state known below it, which is yielded first."""
        known = (state for state in self._reached if state.load.size <= load.size)
        start = max(known, key=lambda state: state.load.size, default=newton.rest)
        yield replace(start, load_factor=0.0, residuals=start.residuals[-1:])
        if self._end is not None and self._end.load.size <= load.size:
            yield replace(self._end, load_factor=1.0, residuals=self._end.residuals[-1:])
            return
        attempt = start
        for attempt in newton.follow(start.state, start.load, load):
            if attempt.converged:
                self._reached.append(attempt)
            yield attempt
        if not attempt.converged and attempt.code != "too-small":
            self._end = attempt
