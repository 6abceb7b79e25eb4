"""Local contact (Fig. 5): the answer of the surface to each contact node, computed once, then a small product."""

from __future__ import annotations

import numpy as np

from solver_common.arrays import Array, Index
from vdm.constraints import ConstraintError, Load
from vdm.problem import Problem
from vdm.solvers.columns import ContactColumns
from vdm.solvers.linear import LinearSolver

# right-hand sides per pass through the factor: wider blocks no longer gain and cost memory
BATCH = 32
# bytes of columns that are kept for nodes no longer in contact: a contact that wanders ends up everywhere
KEPT = 256 << 20


class ContactCompliance:
    """Displacement and dP per unit contact pressure at chosen nodes, by the linear solver's factor.

    Columns are computed when a node is first used and kept, the latest `KEPT` bytes of them. A frame is a product
    with the columns in use, `vdm.solvers.columns.ContactColumns`, all displacements included; nothing else of the
    model is touched.

    Parameters
    ----------
    problem : formulation and supports; constrained nodes stay where they are
    solver : a linear solver of the same problem, whose factor is shared
    single_precision : hold the columns in 32 bits, and shorten them; False: columns in 64 bits as they are
    push : (N, 3) force of each node's contact at unit pressure [N/Pa], as `Load.contact_force`; None for -g_i
    """

    def __init__(
        self,
        problem: Problem,
        solver: LinearSolver | None = None,
        single_precision: bool = True,
        push: Array | None = None,
    ) -> None:
        self.problem = problem
        self.factor = (solver or LinearSolver(problem)).factor
        self.dtype = np.float32 if single_precision else np.float64
        self.push = push
        self._columns: dict[int, Array] = {}
        self._active: ContactColumns | None = None
        self._key = (
            b""  # the active nodes as they were: quicker to compare, and the caller may change the array
        )

    def prepare(self, nodes: Index) -> ContactColumns:
        """Columns (d N + 1, k) of the contact nodes (k,): unknowns, one component after the other, then dP.

        Raises
        ------
        ConstraintError
            a node outside the surface.
        """
        nodes = np.asarray(nodes, dtype=np.int64)
        key = nodes.tobytes()
        if key == self._key and self._active is not None:
            return self._active
        surface = self.problem.formulation.surface
        n_nodes = surface.n_nodes
        if nodes.size and (nodes.min() < 0 or nodes.max() >= n_nodes):
            raise ConstraintError(f"contact nodes must lie in 0..{n_nodes - 1}")
        missing = [int(i) for i in dict.fromkeys(nodes.tolist()) if i not in self._columns]
        for first in range(0, len(missing), BATCH):
            self._compute(missing[first : first + BATCH])
        size = n_nodes * self.problem.formulation.components + 1
        columns = np.empty((size, len(nodes)), dtype=self.dtype, order="F")
        for k, node in enumerate(nodes.tolist()):
            columns[:, k] = self._columns[node]
        for node in dict.fromkeys(nodes.tolist()):  # the last in use are the last to go
            self._columns[node] = self._columns.pop(node)
        while len(self._columns) > max(nodes.size, KEPT // (size * columns.itemsize)):
            del self._columns[next(iter(self._columns))]
        far = self.problem.formulation.left_out_far
        self._active, self._key = ContactColumns(columns, surface.points, nodes, far), key
        return self._active

    def frame(self, nodes: Index, pressure: Array) -> tuple[Array, float]:
        """Unknowns x (N, d) and dP [Pa] under contact pressures (k,) [Pa] at nodes (k,), no gravity."""
        return self.prepare(nodes).frame(pressure)

    def _compute(self, nodes: list[int]) -> None:
        formulation, factor = self.problem.formulation, self.factor
        n, d = formulation.surface.n_nodes, formulation.components
        forces = np.zeros((n, d, len(nodes)))
        for k, node in enumerate(nodes):
            one = np.zeros(n)
            one[node] = 1.0
            push = None if self.push is None else one[:, None] * self.push
            load = self.problem.support.signed(Load(one, push))
            forces[node, :, k] = formulation.contact_force(load)[node]
        answer, border = factor.solve(
            forces[factor.free].reshape(-1, len(nodes)), np.zeros((factor.n_border, len(nodes)))
        )
        x = np.zeros((n, d, len(nodes)))
        x[factor.free] = answer.reshape(-1, d, len(nodes))
        for k, node in enumerate(nodes):
            self._columns[node] = np.append(x[:, :, k].T.reshape(-1), border[0, k]).astype(self.dtype)
