"""Which library factorises the symmetric systems: rslab's LDL^T, or SciPy's SuperLU where rslab cannot be loaded.

Both stand behind one interface: an analysis of a sparsity pattern that says what a factor needs, and factors in
single or double precision. Nothing else in the package names either library.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy.sparse import csc_array, csc_matrix, diags_array
from scipy.sparse.linalg import splu

from fem_reference import costs
from fem_reference.costs import superlu_bytes
from fem_reference.memory import reserved_not_counted
from fem_reference.system import LinearSystem
from solver_common.arrays import Array

LIBRARY = "SuperLU" if costs.rslab is None else "rslab"
"""Name of the library in use, recorded with every solution that it served."""

_LEAST_COMPRESSIBILITY = 1e-7


class Factor(Protocol):
    """A factorised matrix."""

    def solve(self, rhs: Array) -> Array:
        """Solve for (size,)."""
        ...

    def solve_many(self, rhs: Array) -> Array:
        """Solve for (size, S)."""
        ...


class Analysis(Protocol):
    """What is known of all matrices with one sparsity pattern."""

    def needed_bytes(self, precision: str, columns: int) -> float:
        """Memory at the peak of a factorisation, and of a solve for so many columns [B]."""
        ...

    def factor(self, lower: csc_array, precision: str) -> Factor:
        """Factorise the symmetric matrix with this lower triangle in "float32" or "float64".

        Raises
        ------
        RuntimeError
            If a pivot is zero at this precision.
        """
        ...


def analyse(lower: csc_array) -> Analysis:
    """Analyse the pattern of the symmetric matrix with this lower triangle."""
    return _SuperLU(lower) if costs.rslab is None else _Rslab(lower)


def pivotable_triangle(system: LinearSystem) -> csc_array:
    """Lower triangle of a system, with a small pressure block in an incompressible body: no pivot must be zero.

    Refinement on the true residual takes the effect of that block out again.
    """
    floor = _LEAST_COMPRESSIBILITY if system.compressibility >= 0.0 else system.compressibility
    return system.lower_triangle(max(system.compressibility, floor))


class _Rslab:
    def __init__(self, lower: csc_array) -> None:
        # stacks of its threads, gigabytes for a large matrix, mostly never touched
        with reserved_not_counted():
            self._symbolic = costs.rslab.analyze(lower, path="ldlt")

    def needed_bytes(self, precision: str, columns: int) -> float:
        return float(self._symbolic.memory_plan(dtype=precision, nrhs=columns)["peak_bytes"])

    def factor(self, lower: csc_array, precision: str) -> Factor:
        made: Factor = self._symbolic.factor(lower, factor_dtype=precision)
        return made


class _SuperLU:
    """Slower and larger: it keeps both triangles, and analyses the pattern again for each factor."""

    def __init__(self, lower: csc_array) -> None:
        self._size = lower.shape[0]

    def needed_bytes(self, precision: str, columns: int) -> float:
        return superlu_bytes(self._size, precision) + 16.0 * self._size * columns

    def factor(self, lower: csc_array, precision: str) -> Factor:
        return SuperLUFactor(lower, precision)


class SuperLUFactor:
    def __init__(self, lower: csc_array, precision: str) -> None:
        self._precision = np.dtype(precision)
        whole = csc_matrix(lower + lower.T - diags_array(lower.diagonal()), dtype=self._precision)
        if (abs(whole).max(axis=0).toarray() == 0.0).any():  # which can crash SuperLU instead of stopping it
            raise RuntimeError("the matrix has a column of zeros")
        # In symmetric mode the diagonal is the pivot wherever it is not tiny: less fill than by any row.
        self._factor = splu(
            whole, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=1e-3, options={"SymmetricMode": True}
        )

    def solve(self, rhs: Array) -> Array:
        found = self._factor.solve(np.asarray(rhs, dtype=self._precision))
        return np.asarray(found, dtype=np.float64)

    def solve_many(self, rhs: Array) -> Array:
        return self.solve(rhs)
