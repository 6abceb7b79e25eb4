"""Load histories of the plain finite-strain problem: a load step that fails is cut in two.

Method: each load starts from the equilibrium under the one before it. Source: Bonet and Wood, Nonlinear Continuum
Mechanics, 2nd ed., section 9.6.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from fem_reference.loads import Load
from fem_reference.plain_body import Dofs, PlainBody
from fem_reference.solution import CONVERGED, Solution, Status, check_outputs
from solver_common.arrays import Array

OUTPUTS = ("max_det_f_deviation", "max_principal_strain", "volume")
_LEAST_STEP = 2.0**-8  # of a load step


class PlainHistory(ABC):
    """A problem that finds the equilibrium under one load from a state near to it.

    Attributes
    ----------
    body : see `fem_reference.plain_body.PlainBody`
    told : of the material, for the record of a solution
    seconds_setup : [s]
    """

    body: PlainBody
    told: Mapping[str, float | str]
    seconds_setup: float

    @abstractmethod
    def newton(self, x: Array, load: Load) -> tuple[Array, int] | None:
        """The equilibrium under a load from the state x, and the iterations to it; None where there is none."""

    @abstractmethod
    def measured(self, x: Array, load: Load, status: Status) -> Dofs:
        """The state x in equilibrium under a load, with what follows from it."""

    def follow(self, x: Array, start: Load | None, end: Load) -> tuple[Array, float, int]:
        """Go from a load to another in substeps: the state, the share that was reached, the iterations."""
        reached, step, iterations = 0.0, 1.0, 0
        while reached < 1.0 and step >= _LEAST_STEP:
            target = min(1.0, reached + step)
            found = self.newton(x, between(start, end, target))
            if found is None:
                step *= 0.5
                continue
            x, reached, iterations = found[0], target, iterations + found[1]
        return x, reached, iterations

    def history(self, loads: Sequence[Load], outputs: Iterable[str] = OUTPUTS) -> Iterator[Dofs]:
        """The state at each load; each starts from the one before, the first from the undeformed body.

        A load step that fails yields the last equilibrium on the way to it, and is the last one.

        Raises
        ------
        SolverError
            For a load of the wrong shape or with values that are not finite.
        """
        self.body.check(loads)
        x, before = np.zeros(self.body.basis.N + self.body.pressure_basis.N), None
        for number, load in enumerate(loads):
            began = time.perf_counter()
            x, reached, iterations = self.follow(x, before, load)
            status = CONVERGED if reached == 1.0 else _failed(number, reached)
            found = self.measured(x, between(before, load, reached), status)
            scalars = {"load_factor": reached, **{name: found.scalars[name] for name in outputs}}
            seconds = time.perf_counter() - began
            yield replace(found, iterations=iterations, scalars=scalars, seconds=seconds)
            if not status.ok:
                return
            before = load

    def solve(self, loads: Sequence[Load], outputs: frozenset[str] = frozenset()) -> Solution:
        """Follow a load history; as `fem_reference.finite_strain.FiniteStrainProblem.solve`, fewer `outputs`."""
        check_outputs(outputs, OUTPUTS)
        steps = list(self.history(loads, sorted(outputs)))
        return self.body.solution(steps, len(loads), self.seconds_setup, self.told)


def between(start: Load | None, end: Load, share: float) -> Load:
    """The load at a share of the way from a load, or from none, to another."""
    if share == 1.0:
        return end

    def mixed(name: str) -> Any:
        first, last = (None if load is None else getattr(load, name) for load in (start, end))
        if first is None and last is None:
            return None
        parts = ((1.0 - share, first), (share, last))
        return sum(s * np.asarray(value) for s, value in parts if value is not None)

    return Load(**{field.name: mixed(field.name) for field in fields(Load)})


def _failed(number: int, reached: float) -> Status:
    return Status(
        "not-converged",
        f"Newton's method did not converge beyond {reached:.4g} of load step {number}",
        "load the body less, or use a finer mesh where it deforms most",
    )
