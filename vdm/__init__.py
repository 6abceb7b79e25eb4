"""The Volume Distribution Method: a surface-only model of soft tissue (Sundaraj and Laugier 2006)."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vdm.constraints import ConstraintError, Load
    from vdm.material import ParameterError, Parameters
    from vdm.model import FORMULATIONS, Model
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


def __getattr__(name: str) -> Any:
    """Load a public name at its first use: `vdm.solvers` can be imported without the solvers and SciPy."""
    if name in __all__:
        for home in ("constraints", "material", "solution", "surface", "model"):
            module = import_module(f"vdm.{home}")
            if hasattr(module, name):
                return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
