"""The factor of a matrix that is not positive definite: one error, and nothing on the console beside it."""

from __future__ import annotations

import subprocess
import sys

SCRIPT = """
import numpy as np
from scipy import sparse
from vdm.solution import SolverError
from vdm.solvers.cholesky import Cholesky
for off in (2.0, -1.0):  # indefinite, singular
    try:
        Cholesky(sparse.csr_array(np.array([[1.0, off], [off, 1.0]])))
    except SolverError as error:
        print(error)
"""


def test_a_factor_that_fails_says_one_line():
    """In a process of its own: what a library writes by C passes by what Python captures."""
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    assert len(lines) == 2, done.stdout
    for line in lines:
        assert line.startswith("the operator is not positive definite; hold an area of the surface")
    assert done.stderr == ""
