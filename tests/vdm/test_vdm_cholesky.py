"""The factor of a matrix that is not positive definite: one error, and nothing on the console beside it."""

from __future__ import annotations

import subprocess
import sys

import pytest

MATRICES = {"indefinite": "[[1.0, 2.0], [2.0, 1.0]]", "singular": "[[1.0, -1.0], [-1.0, 1.0]]"}
SCRIPT = """
import numpy as np
from scipy import sparse
from vdm.solution import SolverError
from vdm.solvers.cholesky import Cholesky
try:
    Cholesky(sparse.csr_array(np.array({matrix})))
except SolverError as error:
    print(error)
"""


# in a process of its own: what a library writes by C passes by what Python captures
@pytest.mark.parametrize("matrix", MATRICES.values(), ids=MATRICES)
def test_a_factor_that_fails_says_one_line(matrix):
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT.format(matrix=matrix)], capture_output=True, text=True, check=True
    )
    lines = done.stdout.splitlines()
    assert len(lines) == 1, done.stdout
    assert lines[0].startswith("the operator is not positive definite; hold an area of the surface")
    assert done.stderr == ""
