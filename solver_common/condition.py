"""Estimate of the 1-norm of an inverse from a few solves.

Hager (1984) and Higham (ACM Trans. Math. Softw. 14 (1988) 381, algorithm 4.1). The estimate is a lower bound,
rarely more than three times too small. It uses no random vectors.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import linalg

from solver_common.arrays import Array

Product = Callable[[Array], Array]


def operator(size: int, product: Product, product_transposed: Product) -> linalg.LinearOperator:
    """A (size, size) matrix, given by its products with (size,) vectors."""
    return linalg.LinearOperator(
        (size, size),
        matvec=lambda b: product(b.reshape(-1)),
        rmatvec=lambda b: product_transposed(b.reshape(-1)),
        dtype=np.float64,
    )


def estimated_norm(matrix: linalg.LinearOperator) -> float:
    """Lower bound of the 1-norm of a matrix. For an inverse, the products are solves."""
    size = matrix.shape[1]
    found = float(linalg.onenormest(matrix, t=1))
    # Higham's second guess, for matrices on which Hager's iteration fails
    alternating = 1.0 + np.arange(size) / max(size - 1, 1)
    alternating[1::2] *= -1.0
    return max(found, 2.0 * float(np.abs(matrix @ alternating).sum()) / (3.0 * size))
