"""A small dense product per frame: the answers of a surface to unit pressures on the nodes of a contact at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_common.arrays import Array, Index

# radii of the contact from its middle, beyond which the columns of its nodes may be taken to look alike
REACHES = np.arange(2.0, 9.0)
# what may be left out there, of the largest answer to contact pressures of the same size, where the form that the
# columns are of says no other
LEFT_OUT = 1e-7


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


class ContactColumns:
    """Answers to pressures on the nodes of a contact that rests, whatever model its columns come from.

    A frame is a dense product with the columns: d N + 1 values for each contact node. In single precision, which
    halves the memory that a frame reads, the columns are shortened at the second frame: far from the contact they
    look alike, and fewer directions than nodes span them. Both together err by less than 1e-6 of the
    largest displacement that pressures of the same size can cause, or by `left_out` where that is more.

    Parameters
    ----------
    columns : (d N + 1, k) answers to unit pressures, one component of all nodes after the other, then a pressure;
        in 32 bits, which are shortened, or in 64 bits, which stay as they are
    points : (N, 3) of the surface
    nodes : (k,) of the contact
    left_out : largest error of the shortened columns, of the largest answer to pressures of the same size
    """

    def __init__(self, columns: Array, points: Array, nodes: Index, left_out: float = LEFT_OUT) -> None:
        self.columns = np.asfortranarray(columns)
        self._points, self._nodes = points, nodes.copy()  # the caller may change its array
        self._left_out = left_out
        self._frames = 0
        self._short: _Shortened | None = None

    @property
    def nbytes(self) -> int:
        """Bytes of what the next frame reads."""
        return self.columns.nbytes if self._short is None else self._short.nbytes

    def frame(self, pressure: Array) -> tuple[Array, float]:
        """Unknowns x (N, d) and dP [Pa] under contact pressures (k,) [Pa]."""
        pressure = pressure.astype(self.columns.dtype, copy=False)
        self._frames += 1
        if self._frames == 2 and self.columns.dtype == np.float32 and pressure.size:
            self._short = self._shortened()
        answer = self.columns @ pressure if self._short is None else self._short.answer(pressure)
        return answer[:-1].reshape(-1, len(self._points)).T, float(answer[-1])

    def _shortened(self) -> _Shortened | None:
        """The columns with a shorter basis for all nodes far from the contact, None where a frame reads no less.

        The nearer far begins, the fewer rows stay whole, and the more directions the others have: the reach with
        the fewest bytes is taken.
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
        # of all beyond each reach
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
        # dP, in the last row, is not a displacement and is kept as it is
        rows = np.append(np.flatnonzero(np.tile(~far, len(parts))), len(columns) - 1)
        short = _Shortened(tuple(bases), mix.astype(columns.dtype), rows, np.asfortranarray(columns[rows]))
        return short if short.nbytes < columns.nbytes else None
