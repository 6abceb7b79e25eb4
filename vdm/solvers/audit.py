"""What a linear answer is worth: what its balance lacks, and how far one more correction would move it.

A residual tells a solve that went wrong. In an ill-conditioned problem it can be small where the answer is not: the
correction that the solver's own factor gives for the residual estimates the error of the answer itself (Higham,
Accuracy and Stability of Numerical Algorithms, 2nd ed., chapter 12).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from solver_common.arrays import Array
from vdm.constraints import LARGEST, Load
from vdm.problem import LinearStep, Problem, Step
from vdm.solution import Status

# forces (N, d) that free nodes lack and what the border rows lack (m,) -> change of x (N, d) and of the border (m,)
Correction = Callable[[Array, Array], tuple[Array, Array]]

RESIDUAL_LIMIT = 1e-6  # of the largest force in play: beyond it the answer is not one
SINGLE_LIMIT = 1e-3  # the same where 32 bits were asked for: they leave 1e-4 at 10,000 nodes
ERROR_LIMIT = 1e-3  # of the largest displacement: as good as the accuracy that any of the models has
PATH_LIMIT = 1e-3  # of the largest displacement so far: by how much the steps on the way may move an answer
REFINED = 1e-10  # residual or error above which a correction is worth its price
MOST_SWEEPS = 20  # each must halve what is left: slivers of 1e6 take a dozen in single precision
NOT_FINITE = Status(
    "not-finite",
    f"the solution holds nan, inf or numbers beyond {LARGEST:.0e}",
    "check the size of the loads and moduli",
)


@dataclass(frozen=True)
class Audit:
    """Of one step.

    Attributes
    ----------
    residual : what the balance or the border lacks, over the largest term of it
    error : largest change of displacement that a correction for it makes, over the largest displacement, of the
        body or of a node that the forces in play move alone (`Problem.own_motion`); nan where the solver has no
        factor to correct by
    limit : of the residual, beyond which the step is not one
    path : displacement that is owed to the steps on the way to the load and vanishes with their size, over the
        largest of the history so far; nan where the way does not matter
    """

    residual: float
    error: float = np.nan
    limit: float = RESIDUAL_LIMIT
    path: float = np.nan


def audit(
    problem: Problem, load: Load, step: Step, correction: Correction | None, border: bool = True
) -> Audit:
    """Audit of a step of `K x - columns s = force`, `rows x + corner s = 0`, from the operator itself.

    Parameters
    ----------
    correction : by the solver's factor, None where it has none
    border : whether the border rows are those of the rest surface
    """
    return _audited(problem, load, step, correction, border)[0]


def refined(problem: Problem, load: Load, step: Step, correction: Correction) -> tuple[Step, Audit]:
    """Iterative refinement of a step that is not as good as its factor could make it; most steps are."""
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
    """The step, its status told by the audit where the solver itself saw nothing wrong.

    A step that its path has moved is usable: it is converged, with a message and a remedy.
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
    if load.prescribed is not None:  # of a body that is moved as a whole, rounding is all that is left
        sizes.append(formulation.apply(problem.held_unknown(load)))
    residual = _share(np.abs(lacking).max(), max(np.abs(a).max() for a in sizes))
    # where the forces cancel, under a pressure from all sides, x is their rounding and no measure of it
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
