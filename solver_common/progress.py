"""Progress of a nonlinear solve, reported while it runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import NamedTuple


class Progress(NamedTuple):
    """Progress of one solve.

    Attributes
    ----------
    step, steps : current load step, from 0; number of steps, 0 if unknown
    reached : share of that step's load at which equilibrium was last found
    share : share of the load that is attempted now
    iteration : iterations done in this attempt
    residual : relative residual after them
    """

    step: int
    steps: int
    reached: float
    share: float
    iteration: int
    residual: float


Report = Callable[[Progress], None]
_REPORT: ContextVar[Report | None] = ContextVar("report", default=None)


@contextmanager
def reported(report: Report) -> Iterator[None]:
    """Call `report` before every iteration and after the last, in this thread, inside the `with` block.

    An exception that `report` raises ends the solve.

    Examples
    --------
    >>> with reported(print):
    ...     pass
    """
    token = _REPORT.set(report)
    try:
        yield
    finally:
        _REPORT.reset(token)


def tell(progress: Progress) -> None:
    """Pass progress to the innermost `reported`, if there is one."""
    report = _REPORT.get()
    if report is not None:
        report(progress)
