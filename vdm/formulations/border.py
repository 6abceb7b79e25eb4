"""Columns of the border: the effect of dP, and of the body's rotation where it is free, on every node."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from solver_common.arrays import Array, Mask

# e_abc of the cross product: (w x p)_a = sum e_abc w_b p_c
LEVI_CIVITA = np.zeros((3, 3, 3))
LEVI_CIVITA[(0, 1, 2), (1, 2, 0), (2, 0, 1)] = 1.0
LEVI_CIVITA[(0, 2, 1), (2, 1, 0), (1, 0, 2)] = -1.0


class Columns(ABC):
    """m columns of n nodes with d components each; `first` (n, d) is that of dP."""

    first: Array
    count: int

    @abstractmethod
    def times(self, border: Array) -> Array:
        """(n, d) sum of the columns weighted by border unknowns (m,); (n, d, k) for k sets (m, k)."""

    @abstractmethod
    def dotted(self, vector: Array) -> Array:
        """(m,) products of the columns with a vector (n d,); (m, k) with k vectors (n d, k)."""

    @abstractmethod
    def magnitude(self, vector: Array) -> Array:
        """(m,) products of the columns with a vector (n d,), in absolute values: the scale of rounding errors."""

    @abstractmethod
    def at(self, nodes: Mask) -> Columns:
        """The columns at some nodes (n,)."""

    @abstractmethod
    def dense(self) -> Array:
        """(n, d, m), a new array."""


class DenseColumns(Columns):
    """Columns stored as an array (n, d, m)."""

    def __init__(self, values: Array) -> None:
        self.values = values
        self.first = values[:, :, 0]
        self.count = values.shape[2]

    def times(self, border: Array) -> Array:
        if border.shape == (1,):  # ten times as fast as a product with a matrix of one column
            return self.first * border
        return np.asarray(self.values @ border)

    def dotted(self, vector: Array) -> Array:
        return np.asarray(self.values.reshape(-1, self.count).T @ vector)

    def magnitude(self, vector: Array) -> Array:
        return np.asarray(np.abs(self.values).reshape(-1, self.count).T @ np.abs(vector))

    def at(self, nodes: Mask) -> DenseColumns:
        return DenseColumns(self.values[nodes])

    def dense(self) -> Array:
        return self.values.copy()


class TurningColumns(Columns):
    """The column of dP and those of three unit rotations, e_k x pull: 6 numbers per node instead of 12."""

    count = 4

    def __init__(self, first: Array, pull: Array) -> None:
        self.first = first
        self.pull = pull

    def times(self, border: Array) -> Array:
        n = len(self.pull)
        # p -> w x p as one small product for all nodes and all k sets
        turn = np.einsum("abc,bk->cak", LEVI_CIVITA, border[1:].reshape(3, -1))
        total: Array = (self.pull @ turn.reshape(3, -1)).reshape(n, 3, *border.shape[1:])
        total += self.first.reshape(n, 3, *(1,) * (border.ndim - 1)) * border[0]
        return total

    def dotted(self, vector: Array) -> Array:
        moments = (self.pull.T @ vector.reshape(len(self.pull), -1)).reshape(3, 3, -1)
        turned = np.einsum("abc,cak->bk", LEVI_CIVITA, moments)
        pressed = np.atleast_1d(self.first.reshape(-1) @ vector)
        return np.concatenate([pressed[None], turned]).reshape(4, *vector.shape[1:])

    def magnitude(self, vector: Array) -> Array:
        sizes = np.abs(vector)
        moments = np.abs(self.pull).T @ sizes.reshape(-1, 3)
        pressed = np.abs(self.first).reshape(-1) @ sizes
        return np.append(pressed, np.einsum("abc,ca->b", np.abs(LEVI_CIVITA), moments))

    def at(self, nodes: Mask) -> TurningColumns:
        return TurningColumns(self.first[nodes], self.pull[nodes])

    def dense(self) -> Array:
        turns = (self.pull @ LEVI_CIVITA.reshape(9, 3).T).reshape(-1, 3, 3)
        return np.concatenate([self.first[:, :, None], turns], axis=2)
