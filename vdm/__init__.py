"""The Volume Distribution Method: a surface-only model of soft tissue (Sundaraj and Laugier 2006)."""

from vdm.constraints import ConstraintError, Load
from vdm.formulations import FORMULATIONS
from vdm.material import ParameterError, Parameters
from vdm.model import Model
from vdm.solution import Solution, SolverError, Status
from vdm.surface import SurfaceError, SurfaceMesh

__all__ = [
    "FORMULATIONS",
    "ConstraintError",
    "Load",
    "Model",
    "ParameterError",
    "Parameters",
    "Solution",
    "SolverError",
    "Status",
    "SurfaceError",
    "SurfaceMesh",
]
