"""rslab's LDL^T of symmetric systems: the analysis of a sparsity pattern, its memory needs and its factors."""

from __future__ import annotations

from typing import Protocol

import rslab
from scipy.sparse import csc_array

from fem_reference.memory import reserved_not_counted
from fem_reference.system import LinearSystem
from solver_common.arrays import Array

LIBRARY = "rslab"
"""Name of the library in use, recorded with every solution that it served."""

_LEAST_COMPRESSIBILITY = 1e-7


class Factor(Protocol):
    """A factorised matrix; `inertia` counts its positive, negative and zero eigenvalues."""

    inertia: tuple[int, int, int]

    def solve(self, rhs: Array) -> Array:
        """Solve for (size,)."""
        ...

    def solve_many(self, rhs: Array) -> Array:
        """Solve for (size, S)."""
        ...


class Analysis:
    """Symbolic analysis of all symmetric matrices with the sparsity pattern of this lower triangle."""

    def __init__(self, lower: csc_array) -> None:
        # stacks of its threads, gigabytes for a large matrix, mostly never touched
        with reserved_not_counted():
            self._symbolic = rslab.analyze(lower, path="ldlt")

    def needed_bytes(self, precision: str, columns: int) -> float:
        """Peak memory of a factorisation and of a solve for so many columns [B]."""
        return float(self._symbolic.memory_plan(dtype=precision, nrhs=columns)["peak_bytes"])

    def factor(self, lower: csc_array, precision: str) -> Factor:
        """Factorise the matrix with this lower triangle in "float32" or "float64".

        Raises
        ------
        RuntimeError
            If a pivot is zero at this precision.
        """
        made: Factor = self._symbolic.factor(lower, factor_dtype=precision)
        return made


def pivotable_triangle(system: LinearSystem) -> csc_array:
    """Lower triangle of a system; an incompressible body gets a small pressure block, so that no pivot is zero.

    Refinement on the true residual removes the effect of that block.
    """
    floor = _LEAST_COMPRESSIBILITY if system.compressibility >= 0.0 else system.compressibility
    return system.lower_triangle(max(system.compressibility, floor))
