"""What a VDM solve returns, in the form that the elements answer in too."""

from solver_common.solution import CONVERGED, Solution, SolverError, Status

__all__ = ["CONVERGED", "Solution", "SolverError", "Status"]
