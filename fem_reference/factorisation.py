"""Which library factorises the symmetric systems: rslab's LDL^T, or SciPy's SuperLU where rslab cannot be loaded.

Both stand behind one interface: an analysis of a sparsity pattern that says what a factor needs, and factors in
single or double precision. Nothing else in the package names either library.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csc_matrix, diags_array
from scipy.sparse.linalg import splu

from fem_reference.system import LinearSystem

try:
    import rslab
except (ImportError, OSError):  # no wheel for this machine, or one whose shared libraries are missing
    rslab = None  # type: ignore[assignment]

Array = NDArray[np.float64]

LIBRARY = "SuperLU" if rslab is None else "rslab"
"""Name of the library in use, recorded with every solution that it served."""

_LEAST_COMPRESSIBILITY = 1e-7
# Entries of SuperLU's L and U of a P2-P1 system with 1e5 unknowns and the exponent of their growth, and the bytes
# that an entry takes at the peak in single and double precision: balls and cubes of 4,000 to 28,000 unknowns.
_FILL, _FILL_EXPONENT = 5.5e8, 1.6
_BYTES_PER_ENTRY = {"float32": 8.5, "float64": 13.0}


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
    return _SuperLU(lower) if rslab is None else _Rslab(lower)


def pivotable_triangle(system: LinearSystem) -> csc_array:
    """Lower triangle of a system, with a small pressure block in an incompressible body: no pivot must be zero.

    Refinement on the true residual takes the effect of that block out again.
    """
    floor = _LEAST_COMPRESSIBILITY if system.compressibility >= 0.0 else system.compressibility
    return system.lower_triangle(max(system.compressibility, floor))


def direct_seconds(unknowns: float, loads: float) -> float:
    """Estimate for one core: a factorisation and the solves of the mixed system, by the library in use [s]."""
    size = unknowns / 1e5
    if rslab is None:
        return 450.0 * size**2.35 + loads * 0.7 * size**_FILL_EXPONENT
    return 10.0 * size**1.6 + loads * 0.1 * size**1.3


def direct_bytes(unknowns: float) -> float:
    """Estimate: memory of a factor of the mixed system in single precision [B]."""
    if rslab is None:
        return _superlu_bytes(unknowns, "float32")
    return 8.4e8 * (unknowns / 1e5) ** 1.3


class _Rslab:
    def __init__(self, lower: csc_array) -> None:
        self._symbolic = rslab.analyze(lower, path="ldlt")

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
        return _superlu_bytes(self._size, precision) + 16.0 * self._size * columns

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


def _superlu_bytes(unknowns: float, precision: str) -> float:
    return _BYTES_PER_ENTRY[precision] * _FILL * (unknowns / 1e5) ** _FILL_EXPONENT
