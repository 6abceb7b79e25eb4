"""Local contact (Fig. 5) as one small dense product per frame.

The responses to unit pressures on the nodes of a contact at rest are computed once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver_common.arrays import Array, Index
from vdm.constraints import ConstraintError, Load
from vdm.formulations.base import LEFT_OUT
from vdm.solvers.linear import LinearSolver

# right-hand sides per pass through the factor: wider blocks gain nothing and cost memory
BATCH = 32
# distances from the contact's middle, in its radii, from which its columns may be treated as similar
REACHES = np.arange(2.0, 9.0)


@dataclass(frozen=True)
class _Shortened:
    """Columns (d N + 1, k) as a basis (N, r) times a mix (r, k) per component, except for some rows (m,).

    Separate bases need half as many directions as a common one. The rows are stored as block (m, k), the mixes as
    one matrix (sum of r, k).
    """

    bases: tuple[Array, ...]
    mixes: Array
    rows: Index
    block: Array

    @property
    def nbytes(self) -> int:
        """Bytes that a product reads."""
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


class ContactColumns:
    """Responses to pressures on the nodes of a contact at rest, for columns of any model.

    A frame is a dense product with the columns: d N + 1 values per contact node. Single precision halves the
    memory that it reads. At the second frame the columns are shortened: far from the contact they are similar,
    and fewer directions than nodes span them. The total error is below 1e-6 of the largest displacement under
    pressures of the same size, or below `left_out` where that is more.

    Parameters
    ----------
    columns : (d N + 1, k) responses to unit pressures: all nodes for one component after the other, then a pressure
    points : (N, 3) of the surface
    nodes : (k,) of the contact
    left_out : largest error of the shortened columns, over the largest response to pressures of the same size
    """

    def __init__(
        self, columns: NDArray[np.floating], points: Array, nodes: Index, left_out: float = LEFT_OUT
    ) -> None:
        self.columns: Array = np.asfortranarray(columns, dtype=np.float32)
        self._points, self._nodes = points, nodes
        self._left_out = left_out
        self._frames = 0
        self._short: _Shortened | None = None

    @property
    def nbytes(self) -> int:
        """Bytes that the next frame reads."""
        return self.columns.nbytes if self._short is None else self._short.nbytes

    def frame(self, pressure: Array) -> tuple[Array, float]:
        """Unknowns x (N, d) and dP [Pa] under contact pressures (k,) [Pa]."""
        pressure = pressure.astype(np.float32, copy=False)
        self._frames += 1
        if self._frames == 2 and pressure.size:
            self._short = self._shortened()
        answer = self.columns @ pressure if self._short is None else self._short.answer(pressure)
        return answer[:-1].reshape(-1, len(self._points)).T, float(answer[-1])

    def _shortened(self) -> _Shortened | None:
        """The columns with a shorter basis for the nodes far from the contact; None where that saves no memory.

        A smaller reach leaves fewer rows whole but needs more directions; the reach with the fewest bytes is taken.
        """
        columns, (n, k) = self.columns, (len(self._points), self.columns.shape[1])
        contact = self._points[self._nodes]
        middle = contact.mean(axis=0)
        reach = float(np.linalg.norm(contact - middle, axis=1).max())
        rings = np.searchsorted(reach * REACHES, np.linalg.norm(self._points - middle, axis=1))
        parts = [np.asarray(part, np.float64) for part in np.split(columns[:-1], len(columns) // n)]
        squares = np.array(
            [[p[rings == ring].T @ p[rings == ring] for p in parts] for ring in range(len(REACHES) + 1)]
        )
        bound = self._left_out * np.sqrt(np.linalg.eigvalsh(squares.sum(axis=(0, 1)))[-1])
        # products of the nodes beyond each reach
        beyond = np.cumsum(squares[:0:-1], axis=0)[::-1]
        values, directions = np.linalg.eigh(beyond)
        kept = np.sqrt(np.cumsum(np.maximum(values, 0.0), axis=-1)) > bound
        near = np.array([(rings <= ring).sum() for ring in range(len(REACHES))])
        numbers = kept.sum(axis=(1, 2)) * (n + k) + near * len(parts) * k
        best = int(np.argmin(numbers))
        far = rings > best
        bases = [
            (np.where(far[:, None], part, 0.0) @ directions[best, c][:, kept[best, c]]).astype(
                columns.dtype, order="F"
            )
            for c, part in enumerate(parts)
        ]
        mix = np.concatenate([directions[best, c][:, kept[best, c]].T for c in range(len(parts))])
        # dP, in the last row, is not a displacement and stays whole
        rows = np.append(np.flatnonzero(np.tile(~far, len(parts))), len(columns) - 1)
        short = _Shortened(tuple(bases), mix.astype(columns.dtype), rows, np.asfortranarray(columns[rows]))
        return short if short.nbytes < columns.nbytes else None


def contact_columns(solver: LinearSolver, nodes: Index, push: Array | None = None) -> ContactColumns:
    """Responses to unit contact pressures at nodes (k,), by a linear solver's factor: d components of x, then dP.

    `ContactColumns.frame` then gives all displacements without the rest of the model. There is no gravity, and
    constrained nodes stay in place.

    Parameters
    ----------
    push : (N, 3) force of each node's contact at unit pressure [N/Pa], as `Load.contact_force`; None for -g_i

    Raises
    ------
    ConstraintError
        a node outside the surface.
    """
    problem, factor = solver.problem, solver.factor
    formulation = problem.formulation
    n, d = formulation.surface.n_nodes, formulation.components
    nodes = np.array(nodes, dtype=np.int64)  # a copy: the caller may change its own
    if nodes.size and (nodes.min() < 0 or nodes.max() >= n):
        raise ConstraintError(f"contact nodes must lie in 0..{n - 1}")
    columns = np.empty((n * d + 1, len(nodes)), dtype=np.float32, order="F")
    for first in range(0, len(nodes), BATCH):
        batch = slice(first, first + BATCH)
        forces = np.zeros((n, d, len(nodes[batch])))
        for k, node in enumerate(nodes[batch].tolist()):
            one = np.zeros(n)
            one[node] = 1.0
            load = problem.support.signed(Load(one, None if push is None else one[:, None] * push))
            forces[node, :, k] = formulation.contact_force(load)[node]
        x = np.zeros_like(forces)
        answer, border = factor.solve(
            forces[factor.free].reshape(-1, forces.shape[2]), np.zeros((factor.n_border, forces.shape[2]))
        )
        x[factor.free] = answer.reshape(-1, *forces.shape[1:])
        columns[:-1, batch] = x.transpose(1, 0, 2).reshape(n * d, -1)
        columns[-1, batch] = border[0]
    return ContactColumns(columns, formulation.surface.points, nodes, formulation.left_out_far)
