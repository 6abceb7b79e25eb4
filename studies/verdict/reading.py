"""What a solver made of a case, beyond what it says: whether its numbers are right as far as can be told.

Codes beside those of solvers: `WRONG`, called converged and not right; "step-too-long": the quasi-linear solver's
volume is that of the last step by its definition (33), an error of second order in the step that no status of one
step can tell; "beyond-linear": a linear answer, right as such, at a load that its assumptions do not reach.
"""

from __future__ import annotations

import math

import numpy as np

from solver_common.arrays import Array
from solver_common.solution import CONVERGED, Status

from ..measures.case import CaseResult
from ..measures.frame import series
from ..scene.result import ModelResult
from ..study.registry import is_linear, split
from .digest import failed_steps
from .formatting import short_percent

WRONG = "wrong"
RESIDUAL = 1e-6  # relative; more is no solution of the system
SINGLE_RESIDUAL = 1e-3  # the same where 32 bits were asked for: they leave 1e-4 at 10,000 nodes
DIFFERENT = 1e-3  # of the largest displacement; more is another answer than the trusted solver's
BEYOND_LINEAR = 0.05  # of the volume, which linear terms keep and the displacement that they give does not
LEFT = 1e-3  # of the largest displacement, left after all loads are taken away


def trusted(case: CaseResult, model: str) -> str | None:
    """The solver of the same linear system whose answer is taken as right: refined, else the direct one."""
    if not is_linear(model):
        return None
    name, _ = split(model)
    candidates = (f"{name}:refined", name, f"{name}:linear")
    return next((other for other in candidates if other in case.models and other != model), None)


def reading(case: CaseResult, model: str) -> Status | None:
    """What came out of a model in a case over all its load history; None where it was not run."""
    result = case.models.get(model)
    if result is None:
        return None
    if failed := failed_steps(result):
        status = result.status[failed[0]]
        where = f" at load factor {case.load_factors[failed[0]]:.3g}" if len(result.status) > 1 else ""
        return Status(status.code, f"{status.message}{where}")
    residual, left = _largest(result.scalars.get("relative_residual")), _left(case, result)
    stays = f"{left:.1e} of the displacement stays without load"
    if model.endswith(":quasi-linear") and left > LEFT:
        return Status("step-too-long", f"the volume lags a step behind: {stays}")
    if residual > (SINGLE_RESIDUAL if model.endswith(":single") else RESIDUAL):
        return Status(WRONG, f"called converged with a relative residual of {residual:.1e}")
    if (difference := _difference(case, model)) > DIFFERENT:
        return Status(WRONG, f"called converged and {difference:.1e} away from {trusted(case, model)}")
    if left > LEFT:
        return Status(WRONG, f"called converged and {stays}")
    if (second := _second_order(case, model)) > BEYOND_LINEAR:
        told = f"second order is {short_percent(second)} of the volume"
        return Status("beyond-linear", f"the load is beyond small displacements: {told}")
    return CONVERGED


def _largest(values: Array | None) -> float:
    """Largest size of what is finite, NaN where nothing is; an infinite value counts as infinite."""
    known = np.abs(values[~np.isnan(values)]) if values is not None else np.zeros(0)
    return float(known.max()) if len(known) else math.nan


def _difference(case: CaseResult, model: str) -> float:
    other = trusted(case, model)
    if other is None:
        return math.nan
    u, v = case.models[model].displacement, case.models[other].displacement
    both = np.isfinite(u).all(axis=(1, 2)) & np.isfinite(v).all(axis=(1, 2))
    size = float(np.linalg.norm(v[both], axis=(1, 2)).max()) if both.any() else 0.0
    if size == 0.0:
        return math.nan
    return float(np.linalg.norm(u[both] - v[both], axis=(1, 2)).max()) / size


def _second_order(case: CaseResult, model: str) -> float:
    """Largest change of volume of a linear model that its own first order does not have, over the volume."""
    names = ("volume_drift", "mean_strain_x", "mean_strain_y", "mean_strain_z")
    known = [values for name in names if (values := series(case, model, name)) is not None]
    if not is_linear(model) or len(known) < len(names):
        return math.nan
    drift, *strains = known
    return _largest(drift - sum(strains))


def _left(case: CaseResult, result: ModelResult) -> float:
    factors, u = case.load_factors, result.displacement
    if len(factors) < 2 or factors[-1] != 0.0 or not np.any(factors):
        return math.nan
    largest = _largest(np.linalg.norm(u, axis=2).max(axis=1))
    if not largest > 0.0:
        return math.nan
    return float(np.linalg.norm(u[-1], axis=1).max()) / largest
