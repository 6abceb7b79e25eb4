"""Local contact (Fig. 5): the answer of the surface to each contact node, computed once, then a small product."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vdm.constraints import ConstraintError, Load
from vdm.problem import Problem
from vdm.solvers.linear import LinearSolver

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# right-hand sides per pass through the factor: wider blocks no longer gain and cost memory
BATCH = 32


class ContactCompliance:
    """Displacement and dP per unit contact pressure at chosen nodes, by the linear solver's factor.

    Columns are computed when a node is first used and kept. A frame costs a dense product with the columns in
    use: N d values for each contact node, all displacements included; nothing else of the model is touched.

    Parameters
    ----------
    problem : formulation and supports; constrained nodes stay where they are
    solver : a linear solver of the same problem, whose factor is shared
    single_precision : hold the columns in 32 bits: half the memory traffic, errors of 1e-7
    """

    def __init__(
        self, problem: Problem, solver: LinearSolver | None = None, single_precision: bool = False
    ) -> None:
        self.problem = problem
        self.factor = (solver or LinearSolver(problem)).factor
        self.dtype = np.float32 if single_precision else np.float64
        self._columns: dict[int, Array] = {}
        self._active: tuple[Index, Array] = (np.zeros(0, dtype=np.int64), np.zeros((0, 0)))

    def prepare(self, nodes: Index) -> Array:
        """Columns (n d + 1, k) of the contact nodes (k,): unknowns, then dP.

        Raises
        ------
        ConstraintError
            a node outside the surface.
        """
        nodes = np.asarray(nodes, dtype=np.int64)
        if np.array_equal(nodes, self._active[0]):
            return self._active[1]
        n_nodes = self.problem.formulation.surface.n_nodes
        if nodes.size and (nodes.min() < 0 or nodes.max() >= n_nodes):
            raise ConstraintError(f"contact nodes must lie in 0..{n_nodes - 1}")
        missing = [int(i) for i in dict.fromkeys(nodes.tolist()) if i not in self._columns]
        for first in range(0, len(missing), BATCH):
            self._compute(missing[first : first + BATCH])
        size = n_nodes * self.problem.formulation.components + 1
        columns = np.empty((size, len(nodes)), dtype=self.dtype, order="F")
        for k, node in enumerate(nodes):
            columns[:, k] = self._columns[int(node)]
        self._active = (nodes, columns)
        return columns

    def frame(self, nodes: Index, pressure: Array) -> tuple[Array, float]:
        """Unknowns x (N, d) and dP [Pa] under contact pressures (k,) [Pa] at nodes (k,), no gravity."""
        answer = self.prepare(nodes) @ pressure.astype(self.dtype, copy=False)
        return answer[:-1].reshape(-1, self.problem.formulation.components), float(answer[-1])

    def _compute(self, nodes: list[int]) -> None:
        formulation, factor = self.problem.formulation, self.factor
        n, d = formulation.surface.n_nodes, formulation.components
        forces = np.zeros((n, d, len(nodes)))
        for k, node in enumerate(nodes):
            pressure = np.zeros(n)
            pressure[node] = 1.0
            load = self.problem.support.signed(Load(pressure))
            forces[node, :, k] = formulation.contact_force(load)[node]
        first = factor.block.solve(forces[factor.free].reshape(-1, len(nodes)))
        border = np.linalg.solve(factor.schur, -factor.free_rows.T @ first)
        x = np.zeros((n, d, len(nodes)))
        x[factor.free] = (first + factor.response @ border).reshape(-1, d, len(nodes))
        for k, node in enumerate(nodes):
            self._columns[node] = np.append(x[:, :, k].reshape(-1), border[0, k]).astype(self.dtype)
