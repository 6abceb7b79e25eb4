"""The result of a VDM solve, in the same form as that of the finite elements."""

from solver_common.solution import CONVERGED, Solution, SolverError, Status

__all__ = ["CONVERGED", "Solution", "SolverError", "Status"]
