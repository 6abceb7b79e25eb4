"""Checks the numbers of a model that converged, beyond the status that its solver gives.

Status codes beside those of solvers:

`WRONG`          called converged, but the numbers are not right
"step-too-long"  the quasi-linear solver takes the volume of the last step, by definition (33). This error is of
                 second order in the step; the status of one step cannot show it
"beyond-linear"  a correct linear answer at a load beyond the range of linear models
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
RESIDUAL = 1e-6  # largest relative residual of a solution
SINGLE_RESIDUAL = 1e-3  # the same in single precision, which leaves 1e-4 at 10,000 nodes
DIFFERENT = 1e-3  # largest difference from the trusted solver's answer, over the largest displacement
BEYOND_LINEAR = 0.05  # largest change of volume of second order, over the volume
LEFT = 1e-3  # largest displacement that stays after unloading, over the largest displacement


def trusted(case: CaseResult, model: str) -> str | None:
    """The model that solves the same linear system most reliably: refined, else direct; None if there is none."""
    if not is_linear(model):
        return None
    name, _ = split(model)
    candidates = (f"{name}:refined", name, f"{name}:linear")
    return next((other for other in candidates if other in case.models and other != model), None)


def reading(case: CaseResult, model: str) -> Status | None:
    """The status of a model in a case over its whole load history; None if it was not run."""
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
    """Largest absolute value, without NaN; NaN if there is none."""
    known = np.abs(values[~np.isnan(values)]) if values is not None else np.zeros(0)
    return float(known.max()) if len(known) else math.nan


def _difference(case: CaseResult, model: str) -> float:
    """Largest difference from the trusted solver's displacement, over the largest one; NaN without one."""
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
    """Largest relative change of volume of a linear model beyond first order, the sum of its strains."""
    names = ("volume_drift", "mean_strain_x", "mean_strain_y", "mean_strain_z")
    known = [values for name in names if (values := series(case, model, name)) is not None]
    if not is_linear(model) or len(known) < len(names):
        return math.nan
    drift, *strains = known
    return _largest(drift - sum(strains))


def _left(case: CaseResult, result: ModelResult) -> float:
    """Displacement after the last step, if that has no load, over the largest displacement; else NaN."""
    factors, u = case.load_factors, result.displacement
    if len(factors) < 2 or factors[-1] != 0.0 or not np.any(factors):
        return math.nan
    largest = _largest(np.linalg.norm(u, axis=2).max(axis=1))
    if not largest > 0.0:
        return math.nan
    return float(np.linalg.norm(u[-1], axis=1).max()) / largest
