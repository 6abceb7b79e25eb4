"""A sparse factor in single precision; refinement can remove the loss of digits."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from solver_common.arrays import Array
from vdm.solution import SolverError, Status

SINGULAR = Status(
    "singular",
    "the operator is not positive definite in single precision",
    "use the linear solver, which has double the digits",
)


class SingleFactor:
    """Factor of a symmetric positive definite sparse matrix (n, n), made and applied in 32 bits.

    It is SuperLU's: cholespy's 32-bit factor is computed and applied in 64 bits, and rounds only input and
    output. Pivots stay on the diagonal. The matrix is scaled to a unit diagonal, so that no modulus is out of
    range. The audit of a step (`vdm.solvers.audit`) shows how many digits an ill-conditioned matrix leaves.

    Raises
    ------
    SolverError
        a pivot that is not positive in single precision.
    """

    def __init__(self, matrix: sparse.csr_array) -> None:
        self.size = matrix.shape[0]
        diagonal = matrix.diagonal()
        if not diagonal.min() > 0.0:
            raise SolverError(SINGULAR)
        self._scale = 1.0 / np.sqrt(diagonal)
        scaling = sparse.diags_array(self._scale)
        scaled = sparse.csc_array(scaling @ matrix @ scaling, dtype=np.float32)
        try:
            self._factors = linalg.splu(
                scaled,
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True, "Equil": False},
            )
        except RuntimeError as error:
            raise SolverError(SINGULAR) from error
        if not self._factors.U.diagonal().min() > 0.0:
            raise SolverError(SINGULAR)

    def solve(self, right_hand_side: Array) -> Array:
        """Solution of (n,) or (n, m) right-hand sides, to seven digits less the loss by the condition."""
        scale = self._scale if right_hand_side.ndim == 1 else self._scale[:, None]
        b = scale * right_hand_side
        # scaled by the largest entry: neither a force of a micronewton nor its square underflows
        largest = float(np.abs(b).max(initial=0.0)) or 1.0
        x = self._factors.solve(np.asarray(b / largest, dtype=np.float32))
        return np.asarray(scale * x.astype(np.float64) * largest)
