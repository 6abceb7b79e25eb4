"""The sparse Cholesky factor."""

from __future__ import annotations

import ctypes

import numpy as np
from cholespy import CholeskySolverD, MatrixType, _cholespy_core
from scipy import sparse

from solver_common.arrays import Array
from vdm.solution import SolverError, Status

# growth of a random load, times the largest entry, beyond which the matrix counts as singular
CONDITION_LIMIT = 1e14
SINGULAR = Status(
    "singular",
    "the operator is not positive definite",
    "hold an area of the surface, or give the model a positive foundation or bulk modulus",
)

# SuiteSparse_config.h, versions 4 and 5: malloc, calloc, realloc, free, printf, hypot, divcomplex
CONFIG_LENGTH, CONFIG_PRINTF = 7, 4


def _silence_cholmod() -> None:
    """Silence CHOLMOD's console message about a matrix that is not positive definite: `SolverError` reports it.

    It sets CHOLMOD's own switch, a null printf. A build of cholespy that hides it or has another layout is left
    alone, and the message stays.
    """
    try:
        library = ctypes.CDLL(_cholespy_core.__file__)
        config = (ctypes.c_void_p * CONFIG_LENGTH).in_dll(library, "SuiteSparse_config")
        printf = ctypes.cast(ctypes.CDLL(None).printf, ctypes.c_void_p).value
    except (OSError, ValueError, AttributeError, TypeError):
        return
    if config[CONFIG_PRINTF] == printf:
        config[CONFIG_PRINTF] = None


_silence_cholmod()


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
            # a symmetric matrix's rows serve as its columns: given rows, the library would transpose them first
            self._factor = CholeskySolverD(self.size, indptr, indices, matrix.data, MatrixType.CSC)
        except ValueError as error:
            raise SolverError(SINGULAR) from error
        # a singular matrix can pass with pivots of rounding size: a random load then causes huge displacements
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
