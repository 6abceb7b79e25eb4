"""Restarted GMRES with a fixed right preconditioner, which minimises the true residual.

Method: modified Gram-Schmidt and Givens rotations. Order: exact to the requested tolerance.
Source: Saad and Schultz 1986, doi 10.1137/0907058.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr, solve_triangular
from scipy.linalg.blas import daxpy
from threadpoolctl import ThreadpoolController

from fem_reference.costs import RESTART
from solver_common.arrays import Array

Operator = Callable[[Array], Array]


def gmres(
    apply: Operator,
    precondition: Operator,
    rhs: Array,
    start: Array,
    *,
    tolerance: float,
    max_iterations: int,
) -> tuple[Array, int]:
    """Solve from `start` until norm(rhs - A x) <= tolerance * norm(rhs) or `max_iterations`.

    Saad and Schultz 1986, doi 10.1137/0907058, with modified Gram-Schmidt and Givens rotations. `precondition`
    must be linear. Returns the solution and the number of iterations; the caller checks the residual.
    """
    target = tolerance * float(np.linalg.norm(rhs))
    x = start
    done = 0
    # one thread: the vectors are too short for more, and on a busy machine waiting threads are many times slower
    with _threads().limit(limits=1, user_api="blas"):
        while done < max_iterations:
            residual = rhs - apply(x)
            norm = float(np.linalg.norm(residual))
            if not np.isfinite(norm) or norm <= target:
                break
            correction, used = _cycle(
                apply, precondition, residual, norm, target, min(RESTART, max_iterations - done)
            )
            x = x + correction
            done += used
    return x, done


@cache
def _threads() -> ThreadpoolController:
    return ThreadpoolController()


def _cycle(
    apply: Operator, precondition: Operator, residual: Array, norm: float, target: float, length: int
) -> tuple[Array, int]:
    basis = [residual / norm]
    triangle = np.zeros((length, length))
    rotations: list[tuple[float, float]] = []
    projected = np.zeros(length + 1)
    projected[0] = norm
    count = 0
    for j in range(length):
        w = apply(precondition(basis[j]))
        column = np.empty(j + 2)
        for i, v in enumerate(basis):
            column[i] = w @ v
            daxpy(v, w, a=-column[i])  # in place
        column[j + 1] = np.linalg.norm(w)
        fresh = column[j + 1]
        for i, (c, s) in enumerate(rotations):
            column[i], column[i + 1] = c * column[i] + s * column[i + 1], c * column[i + 1] - s * column[i]
        length_j = float(np.hypot(column[j], column[j + 1]))
        if not np.isfinite(length_j) or length_j == 0.0:
            break
        c, s = column[j] / length_j, column[j + 1] / length_j
        rotations.append((c, s))
        triangle[:j, j] = column[:j]
        triangle[j, j] = length_j
        projected[j], projected[j + 1] = c * projected[j], -s * projected[j]
        count = j + 1
        if abs(projected[count]) <= target or fresh == 0.0:
            break
        basis.append(w / fresh)
    if count == 0:
        return np.zeros_like(residual), 1
    weights = solve_triangular(triangle[:count, :count], projected[:count])
    combined = sum((a * v for a, v in zip(weights, basis, strict=False)), start=np.zeros_like(residual))
    return precondition(combined), count


def independent_columns(columns: Array, tolerance: float) -> tuple[NDArray[np.int64], Array]:
    """A subset of the columns that spans the others, and the coefficients.

    A load history is mostly one load times a factor: solving for the subset is then enough.

    Returns
    -------
    chosen : (r,) column numbers
    coefficients : (r, S) with columns = columns[:, chosen] @ coefficients to `tolerance`
    """
    norms = np.linalg.norm(columns, axis=0)
    unit = np.where(norms > 0.0, norms, 1.0)
    _, upper, order = qr(columns / unit, mode="economic", pivoting=True)
    diagonal = np.abs(np.diag(upper))
    rank = int((diagonal > tolerance).sum())
    coefficients = np.zeros((rank, columns.shape[1]))
    if rank:
        coefficients[:, order] = solve_triangular(upper[:rank, :rank], upper[:rank])
    chosen = np.asarray(order[:rank], dtype=np.int64)
    return chosen, coefficients * unit / unit[chosen][:, None]
