"""The result of a FEM solve, in the same form as that of the surface models."""

from __future__ import annotations

from collections.abc import Iterable

from solver_common.solution import CONVERGED, Solution, SolverError, Status, solver_error

__all__ = ["CONVERGED", "Solution", "SolverError", "Status", "check_outputs"]


def check_outputs(outputs: frozenset[str], known: Iterable[str]) -> None:
    """Refuse outputs that a model does not have. Raises SolverError."""
    unknown = sorted(outputs - set(known))
    if unknown:
        remedy = f"use some of {', '.join(known)}"
        raise solver_error("bad-output", f"output {unknown[0]!r} is unknown", remedy)
