"""Audit of a linear answer: the residual of its balance, and the size of one more correction.

The residual shows a failed solve. In an ill-conditioned problem it can be small although the answer is wrong. The
correction by the solver's own factor for that residual then estimates the error of the answer (Higham, Accuracy
and Stability of Numerical Algorithms, 2nd ed., chapter 12).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from solver_common.arrays import Array
from vdm.constraints import LARGEST, Load
from vdm.problem import LinearStep, Problem, Step
from vdm.solution import Status

# forces (N, d) missing at free nodes, residual of the border rows (m,) -> change of x (N, d) and of the border (m,)
Correction = Callable[[Array, Array], tuple[Array, Array]]

RESIDUAL_LIMIT = 1e-6  # of the largest force: beyond it the answer is rejected
SINGLE_LIMIT = 1e-3  # the same for a factor in 32 bits, which leaves 1e-4 at 10,000 nodes
ERROR_LIMIT = 1e-3  # of the largest displacement: the accuracy of the models themselves
PATH_LIMIT = 1e-3  # of the largest displacement so far: largest effect of the steps on the way
REFINED = 1e-10  # residual or error above which a correction is made
MOST_SWEEPS = 20  # each must halve the error: slivers of 1e6 take a dozen in single precision
NOT_FINITE = Status(
    "not-finite",
    f"the solution holds nan, inf or numbers beyond {LARGEST:.0e}",
    "check the size of the loads and moduli",
)


@dataclass(frozen=True)
class Audit:
    """The audit of one step.

    Attributes
    ----------
    residual : missing force of the balance or of the border, over its largest term
    error : largest displacement of a correction for the residual, over the largest displacement of the body, or
        of a node that the acting forces move alone (`Problem.own_motion`); nan where the solver has no factor
    limit : largest residual of a valid step
    path : displacement due to the load steps on the way, which vanishes with their size, over the largest of the
        history so far; nan where the path does not matter
    """

    residual: float
    error: float = np.nan
    limit: float = RESIDUAL_LIMIT
    path: float = np.nan


def audit(
    problem: Problem, load: Load, step: Step, correction: Correction | None, border: bool = True
) -> Audit:
    """Audit of a step of `K x - columns s = force`, `rows x + corner s = 0`, with the operator itself.

    Parameters
    ----------
    correction : by the solver's factor; None without one
    border : whether the border rows are those of the rest surface
    """
    return _audited(problem, load, step, correction, border)[0]


def refined(problem: Problem, load: Load, step: Step, correction: Correction) -> tuple[Step, Audit]:
    """Iterative refinement, while it at least halves the error; most steps need none. Returns step and audit."""
    found, change = _audited(problem, load, step, correction, border=True)
    for _ in range(MOST_SWEEPS):
        worst = max(found.residual, found.error)
        if not worst > REFINED or change is None:
            break
        x, s = step.unknown + change[0], step.border + change[1]
        better = LinearStep(
            problem=problem,
            unknown=x,
            border=s,
            force=problem.force(load),
            iterations=step.iterations,
            status=step.status,
        )
        after, next_change = _audited(problem, load, better, correction, border=True)
        if not max(after.residual, after.error) < 0.5 * worst:
            break
        step, found, change = better, after, next_change
    return step, found


def judged(step: Step, found: Audit) -> Step:
    """The step, with the audit's status where the solver itself reported no failure.

    A step with a large path error is usable: it is converged, with a message and a remedy.
    """
    if not step.status.ok:
        return step
    if not np.abs(step.displacement).max() <= LARGEST:
        return replace(step, status=NOT_FINITE)
    if not found.residual <= found.limit:
        message = f"the balance lacks {found.residual:.1e} of the largest force"
        return replace(step, status=Status("inaccurate", message, _REMEDY))
    if found.error > ERROR_LIMIT:
        message = f"ill-conditioned: rounding alone moves the answer by {found.error:.1e} of itself"
        return replace(step, status=Status("ill-conditioned", message, _REMEDY))
    if found.path > PATH_LIMIT:
        message = f"the load steps on the way move the answer by {found.path:.1e} of the largest displacement"
        return replace(step, status=replace(step.status, message=message, remedy=_SMALLER_STEPS))
    return step


_SMALLER_STEPS = "take more and smaller load steps, or the nonlinear solver"
_REMEDY = "take moduli nearer to each other, a smaller penalty, a wider support or a mesh without slivers"


def _audited(
    problem: Problem, load: Load, step: Step, correction: Correction | None, border: bool
) -> tuple[Audit, tuple[Array, Array] | None]:
    formulation, free = problem.formulation, problem.free
    x, s = step.unknown, step.border
    if not (np.isfinite(x).all() and np.isfinite(s).all()):
        return Audit(np.inf, np.inf), None
    force, pushed, internal = problem.force(load), formulation.columns.times(s), step.product
    lacking = np.where(free[:, None], force + pushed - internal, 0.0)
    sizes = [force, pushed, internal]
    if load.prescribed is not None:  # a body moved as a whole has forces of rounding size only
        sizes.append(formulation.apply(problem.held_unknown(load)))
    residual = _share(np.abs(lacking).max(), max(np.abs(a).max() for a in sizes))
    # where forces cancel, as under a pressure from all sides, x is rounding and no scale
    own = problem.own_motion(np.maximum(np.abs(force), np.abs(pushed)))
    open_rows = np.zeros_like(s)
    if border:
        open_rows = -(formulation.rows.dotted(x.reshape(-1)) + formulation.corner @ s)
        size: Array = formulation.rows.magnitude(np.maximum(np.abs(x), own).reshape(-1))
        size += np.abs(formulation.corner) @ np.abs(s)
        residual = max(residual, *map(_share, np.abs(open_rows).tolist(), size.tolist()))
    if correction is None:
        return Audit(residual), None
    change = correction(lacking, open_rows)
    moved, largest, alone = (float(np.abs(formulation.displacement(a)).max()) for a in (change[0], x, own))
    return Audit(residual, _share(moved, max(largest, alone))), change


def _share(part: float, whole: float) -> float:
    return float(part / whole) if whole > 0.0 else 0.0
