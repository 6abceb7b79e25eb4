"""The sparse Cholesky factor, in one place."""

from __future__ import annotations

import numpy as np
from cholespy import CholeskySolverD, MatrixType
from numpy.typing import NDArray
from scipy import sparse

from vdm.solution import SolverError, Status

Array = NDArray[np.float64]

# growth of a random load, times the largest entry, beyond which the matrix counts as singular
CONDITION_LIMIT = 1e14
SINGULAR = Status(
    "singular",
    "the operator is not positive definite",
    "hold at least three nodes, or give the model a positive foundation or bulk modulus",
)


class Cholesky:
    """Factor of a symmetric positive definite sparse matrix (n, n); solves in place of an inverse.

    Raises
    ------
    SolverError
        a matrix that is not positive definite, or that is so to rounding only.
    """

    def __init__(self, matrix: sparse.csr_array) -> None:
        self.size = matrix.shape[0]
        matrix.sort_indices()
        indptr, indices = (a.astype(np.int32, copy=False) for a in (matrix.indptr, matrix.indices))
        try:
            self._factor = CholeskySolverD(self.size, indptr, indices, matrix.data, MatrixType.CSR)
        except ValueError as error:
            raise SolverError(SINGULAR) from error
        # a singular matrix can pass with pivots of rounding size: a random load then moves without bound
        probe = np.random.default_rng(0).standard_normal(self.size)
        growth = np.linalg.norm(self.solve(probe)) / np.linalg.norm(probe)
        if not growth * np.abs(matrix.data).max() < CONDITION_LIMIT:
            raise SolverError(SINGULAR)

    def solve(self, right_hand_side: Array) -> Array:
        """Solution of (n,) or (n, m) right-hand sides, all columns in one pass through the factor."""
        b = np.ascontiguousarray(right_hand_side)
        x = np.empty_like(b)
        self._factor.solve(b, x)
        return x
