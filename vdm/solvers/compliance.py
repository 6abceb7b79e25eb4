"""Local contact (Fig. 5): the answer of the surface to each contact node, computed once, then a small product."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vdm.constraints import ConstraintError, Load
from vdm.problem import Problem
from vdm.solvers.linear import LinearSolver

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# radii of the contact from its middle, beyond which the columns of its nodes look alike
FAR = 4.0
# what may be left out there, of the largest answer to contact pressures of the same size
LEFT_OUT = 1e-7
# the share of the columns that a shorter basis must save, and of the nodes that must be far, to be worth its making
WORTH = 0.25
# right-hand sides per pass through the factor: wider blocks no longer gain and cost memory
BATCH = 32
# bytes of columns that are kept for nodes no longer in contact: a contact that wanders ends up everywhere
KEPT = 256 << 20


@dataclass(frozen=True)
class _Shortened:
    """Columns (d N + 1, k), but for some rows (m,), as a basis (N, r) times a mix (r, k) for each of d components.

    A component needs half as many directions as all of them together. The rows are kept as block (m, k), the mixes
    are one matrix (sum of r, k).
    """

    bases: tuple[Array, ...]
    mixes: Array
    rows: Index
    block: Array

    @property
    def nbytes(self) -> int:
        """Bytes that an answer reads."""
        return sum(basis.nbytes for basis in self.bases) + self.mixes.nbytes + self.block.nbytes

    def answer(self, pressure: Array) -> Array:
        """The columns times a vector (k,)."""
        n = len(self.bases[0])
        answer = np.empty(len(self.bases) * n + 1, dtype=self.block.dtype)
        mixed = self.mixes @ pressure
        first = 0
        for c, basis in enumerate(self.bases):
            last = first + basis.shape[1]
            np.matmul(basis, mixed[first:last], out=answer[c * n : (c + 1) * n])
            first = last
        answer[self.rows] = self.block @ pressure
        return answer


class ContactCompliance:
    """Displacement and dP per unit contact pressure at chosen nodes, by the linear solver's factor.

    Columns are computed when a node is first used and kept, the latest `KEPT` bytes of them. A frame costs a dense
    product with the columns in use: N d values for each contact node, all displacements included; nothing else of
    the model is touched.

    In single precision, which halves the memory that a frame reads, a contact that stays on the same nodes is
    shortened at its second frame: far from it the columns look alike, and fewer directions than nodes span them.
    Both together err by less than 1e-6 of the largest displacement.

    Parameters
    ----------
    problem : formulation and supports; constrained nodes stay where they are
    solver : a linear solver of the same problem, whose factor is shared
    single_precision : hold the columns in 32 bits, and shorten them; False: columns in 64 bits as they are
    """

    def __init__(
        self, problem: Problem, solver: LinearSolver | None = None, single_precision: bool = True
    ) -> None:
        self.problem = problem
        self.factor = (solver or LinearSolver(problem)).factor
        self.dtype = np.float32 if single_precision else np.float64
        self._columns: dict[int, Array] = {}
        self._active: tuple[Index, Array] = (np.zeros(0, dtype=np.int64), np.zeros((0, 0)))
        self._key = (
            b""  # the active nodes as they were: quicker to compare, and the caller may change the array
        )
        self._frames = 0  # of the active nodes
        self._short: _Shortened | None = None

    def prepare(self, nodes: Index) -> Array:
        """Columns (d N + 1, k) of the contact nodes (k,): unknowns, one component after the other, then dP.

        Raises
        ------
        ConstraintError
            a node outside the surface.
        """
        nodes = np.asarray(nodes, dtype=np.int64)
        key = nodes.tobytes()
        if key == self._key and nodes.size:
            return self._active[1]
        n_nodes = self.problem.formulation.surface.n_nodes
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
        self._active, self._key, self._frames, self._short = (nodes.copy(), columns), key, 0, None
        return columns

    def frame(self, nodes: Index, pressure: Array) -> tuple[Array, float]:
        """Unknowns x (N, d) and dP [Pa] under contact pressures (k,) [Pa] at nodes (k,), no gravity."""
        columns = self.prepare(nodes)
        pressure = pressure.astype(self.dtype, copy=False)
        self._frames += 1
        if self._frames == 2 and self.dtype is np.float32:
            self._short = self._shortened(columns)
        answer = columns @ pressure if self._short is None else self._short.answer(pressure)
        return answer[:-1].reshape(self.problem.formulation.components, -1).T, float(answer[-1])

    @property
    def frame_bytes(self) -> int:
        """Bytes of what the next frame on the same nodes reads."""
        short = self._short
        return self._active[1].nbytes if short is None else short.nbytes

    def _shortened(self, columns: Array) -> _Shortened | None:
        """The columns with a shorter basis for all nodes far from the contact, None where that saves little."""
        formulation = self.problem.formulation
        points, contact = formulation.surface.points, formulation.surface.points[self._active[0]]
        middle = contact.mean(axis=0)
        reach = FAR * float(np.linalg.norm(contact - middle, axis=1).max())
        near = np.linalg.norm(points - middle, axis=1) <= reach
        if np.mean(~near) < WORTH:
            return None
        # dP, in the last row, is not a displacement and is kept as it is
        rows = np.append(np.flatnonzero(np.tile(near, formulation.components)), len(columns) - 1)
        far = columns.astype(np.float64)
        largest = np.sqrt(np.linalg.eigvalsh(far[:-1].T @ far[:-1])[-1])
        far[rows] = 0.0
        bases: list[Array] = []
        mixes: list[Array] = []
        for part in np.split(far[:-1], formulation.components):
            squares, directions = np.linalg.eigh(part.T @ part)
            kept = np.sqrt(np.cumsum(np.maximum(squares, 0.0))) > LEFT_OUT * largest
            bases.append((part @ directions[:, kept]).astype(self.dtype, order="F"))
            mixes.append(directions[:, kept].T)
        mix: Array = np.asarray(np.concatenate(mixes), dtype=self.dtype)
        if len(mix) > (1.0 - WORTH) * columns.shape[1] * len(bases):
            return None
        return _Shortened(tuple(bases), mix, rows, np.asfortranarray(columns[rows]))

    def _compute(self, nodes: list[int]) -> None:
        formulation, factor = self.problem.formulation, self.factor
        n, d = formulation.surface.n_nodes, formulation.components
        forces = np.zeros((n, d, len(nodes)))
        for k, node in enumerate(nodes):
            pressure = np.zeros(n)
            pressure[node] = 1.0
            load = self.problem.support.signed(Load(pressure))
            forces[node, :, k] = formulation.contact_force(load)[node]
        answer, border = factor.solve(
            forces[factor.free].reshape(-1, len(nodes)), np.zeros((factor.n_border, len(nodes)))
        )
        x = np.zeros((n, d, len(nodes)))
        x[factor.free] = answer.reshape(-1, d, len(nodes))
        for k, node in enumerate(nodes):
            self._columns[node] = np.append(x[:, :, k].T.reshape(-1), border[0, k]).astype(self.dtype)
