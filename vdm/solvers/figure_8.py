"""Figure 8 as printed: K rebuilt at each time-step on the moved surface, BiCG from the last solution."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from solver_common.arrays import Array
from vdm.constraints import Load
from vdm.formulations.paper import PaperFormulation
from vdm.problem import Problem, Step
from vdm.solution import CONVERGED, Status
from vdm.solvers.audit import RESIDUAL_LIMIT, Audit
from vdm.solvers.bicg import NOT_CONVERGED, TOLERANCE
from vdm.solvers.nonlinear import FURTHEST, DeformedStep
from vdm.solvers.quasi_linear import VolumeRow

Stop = Literal["printed", "intended", "residual"]
STOPS: tuple[Stop, ...] = get_args(Stop)


class _StoppedError(Exception):
    """The stopping rule is met."""


@dataclass(frozen=True, kw_only=True)
class Figure8Step(DeformedStep):
    """A step of Figure 8.

    Attributes
    ----------
    areas : (N,) A_i [m^2] of the surface that its matrix is built on
    residual : |R - K dL| over |R| (38), rows and unknowns without units; nan where the step failed
    """

    areas: Array = field(repr=False)
    residual: float


class Figure8Solver:
    """One time-step is one solve of K dL = R (22), with K and R of the surface after the last step.

    dL is the whole displacement along the normals at rest, as in the other solvers. Rows and unknowns are scaled,
    so that units do not matter, and held nodes are eliminated. An answer depends on the steps on the way to its
    load. The figure prints its rule without the outer bars; the first iterate that shrinks would then end it.

    Parameters
    ----------
    problem : the printed form and its supports
    stop : the rule that ends an iteration; dL^i is the i-th iterate and eps the tolerance.
        "printed": | |dL^(i+1)| - |dL^i| | <= eps |dL^(i+1)|, which ignores an iterate's direction.
        "intended": |dL^(i+1) - dL^i| <= eps |dL^(i+1)|.
        "residual": |R - K dL^i| <= eps |R|, with the true residual (38).
    volume_row : "printed": the sum of A_i (L_i - L_i,last) + L_i,last dA_i is zero (33), with dA_i the change of
        A_i in the last step. "corrected": the gradient of the volume, which closes the last step's volume error.
    tolerance : eps
    """

    def __init__(
        self,
        problem: Problem,
        stop: Stop = "printed",
        volume_row: VolumeRow = "printed",
        tolerance: float = TOLERANCE,
    ) -> None:
        assert isinstance(problem.formulation, PaperFormulation)
        self.problem, self.formulation = problem, problem.formulation
        self.stop, self.volume_row, self.tolerance = stop, volume_row, tolerance
        self.rest_areas = self.formulation.surface.nodal_areas
        self.rest_volume = problem.body.at(np.zeros_like(problem.body.rest)).volume
        self.reach = FURTHEST * float(np.ptp(problem.body.rest, axis=0).max())

    def system(self, load: Load, previous: Step | None = None) -> tuple[sparse.csr_array, Array]:
        """K (N + 1, N + 1) and R (N + 1,) of (22) for L_1..L_N [m] and dP [Pa]; rows in Pa, the last in m^3.

        Held nodes are included as if free.
        """
        problem, form = self.problem, self.formulation
        last = np.zeros((len(self.rest_areas), 1)) if previous is None else previous.unknown
        length, state = last[:, 0] / self.rest_areas, problem.deformed(last)
        areas = state.nodal_areas
        # the operator at rest holds B_i A / V and B_ij A / V of the surface at rest
        slimmer = (self.formulation.surface.volume / self.rest_areas.sum()) / (state.volume / areas.sum())
        block = sparse.diags_array(slimmer / areas) @ form.operator @ sparse.diags_array(areas)
        if self.volume_row == "printed":
            row = areas
            before = previous.areas if isinstance(previous, Figure8Step) else areas
            closing = float(areas @ length - length @ (areas - before))
        else:
            row = form.deformed_columns(state)[1][:, 0] * self.rest_areas
            closing = float(row @ length) - (form.kept_volume(last, state) - self.rest_volume)
        matrix = sparse.block_array(
            [[block, sparse.csr_array(-np.ones((len(areas), 1)))], [sparse.csr_array(row[None, :]), None]]
        )
        pressures = problem.deformed_force(load, state, areas[:, None])[:, 0] / areas
        return sparse.csr_array(matrix), np.append(pressures, closing)

    def step(self, load: Load, previous: Step | None = None) -> Step:
        """Solution of one time-step; `iterations` counts products with K and with its transpose."""
        problem, n = self.problem, len(self.rest_areas)
        if previous is not None and not np.isfinite(previous.unknown).all():
            return self._failed(previous.iterations)
        matrix, right = self.system(load, previous)
        free = np.append(problem.free, True)
        given = np.append(problem.held_unknown(load)[:, 0] / self.rest_areas, 0.0)
        block, b = matrix[free][:, free], (right - matrix @ given)[free]
        unit = 1.0 / np.sqrt(np.append(np.abs(block.diagonal()[:-1]), 1.0))
        rows, columns = unit.copy(), unit.copy()
        border = block[:-1, [-1]].toarray()[:, 0], block[[-1], :-1].toarray()[0]
        columns[-1] = 1.0 / np.linalg.norm(unit[:-1] * border[0])
        rows[-1] = 1.0 / np.linalg.norm(unit[:-1] * border[1])
        scaled = sparse.csr_array(sparse.diags_array(rows) @ block @ sparse.diags_array(columns))
        start = np.zeros(len(b))
        if previous is not None:
            start = np.append(previous.unknown[:, 0] / self.rest_areas, previous.border)[free] / columns
        still = float(np.linalg.norm(given[:n]))
        y, iterations, met = self._iterate(scaled, rows * b, start, columns[:-1], still)
        answer = given.copy()
        answer[free] = columns * y
        length = answer[:n]
        if not np.abs(length).max() < self.reach:
            return self._failed(iterations)
        x = (length * self.rest_areas)[:, None]
        before = np.zeros_like(x) if previous is None else previous.unknown
        state = problem.deformed(before)
        size = float(np.linalg.norm(rows * b))
        lack = float(np.linalg.norm(rows * b - scaled @ y))
        lacking = ((matrix @ answer - right)[:n] * state.nodal_areas)[:, None]
        return Figure8Step(
            problem=problem,
            unknown=x,
            border=answer[n:],
            iterations=iterations,
            status=CONVERGED if met else NOT_CONVERGED,
            lacking=lacking[problem.held_nodes],
            stored=self.formulation.deformed_energy(x, state),
            areas=state.nodal_areas,
            residual=lack / size if size > 0.0 else 0.0,
        )

    def audited(self, load: Load, step: Step) -> tuple[Step, Audit]:  # noqa: ARG002 - one interface for all solvers
        """The step and the residual of its own K; a remark where a stop without a residual leaves a large one."""
        assert isinstance(step, Figure8Step)
        if self.stop == "residual" or not step.status.ok:
            return step, Audit(step.residual, limit=max(RESIDUAL_LIMIT, 2.0 * self.tolerance))
        if step.residual > RESIDUAL_LIMIT:
            message = f"the {self.stop} stop of Figure 8 leaves a residual of {step.residual:.1e} of the load"
            step = replace(step, status=Status("converged", message, 'take stop = "residual"'))
        return step, Audit(step.residual, limit=np.inf)

    def _iterate(
        self, matrix: sparse.csr_array, b: Array, start: Array, unit: Array, still: float
    ) -> tuple[Array, int, bool]:
        """BiCG until the rule is met; lengths [m] are `unit` times an iterate, `still` that of the held nodes."""
        y, count, size = start, 0, float(np.linalg.norm(b))

        def norm(iterate: Array) -> float:
            return float(np.hypot(np.linalg.norm(unit * iterate[:-1]), still))

        def rule(new: Array, old: Array) -> bool:
            if self.stop == "residual":
                return bool(np.linalg.norm(b - matrix @ new) <= self.tolerance * size)
            moved = abs(norm(new) - norm(old))
            if self.stop == "intended":
                moved = float(np.linalg.norm(unit * (new - old)[:-1]))
            return moved <= self.tolerance * norm(new)

        if self.stop == "residual" and rule(start, start):
            return start, 0, True

        def watch(change: Array) -> None:
            nonlocal y, count
            old, y, count = y, start + change, count + 1
            if rule(y, old):
                raise _StoppedError

        try:
            _, info = linalg.bicg(matrix, b - matrix @ start, rtol=0.0, maxiter=10 * len(b), callback=watch)
        except _StoppedError:
            return y, count, True
        return y, count, info == 0

    def _failed(self, iterations: int) -> Step:
        lost = np.full((len(self.rest_areas), 1), np.nan)
        return Figure8Step(
            problem=self.problem,
            unknown=lost,
            border=np.array([np.nan]),
            iterations=iterations,
            status=DIVERGED,
            lacking=lost[self.problem.held_nodes],
            stored=np.nan,
            areas=self.rest_areas,
            residual=np.nan,
        )


DIVERGED = Status(
    "diverged",
    "a time-step of Figure 8 throws nodes off the body",
    "take more and smaller load steps, or the nonlinear solver",
)
