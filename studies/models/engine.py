"""Runs one engine of another project in this process: `python engine.py engine_NAME.py < IN.npz > OUT.npz`.

Imports nothing of this package. The file has `solve(given) -> found`, arrays by name. What the engine prints goes
to the standard error; it ends with the process that started it.
"""

import ctypes
import importlib.util
import io
import os
import signal
import sys
from pathlib import Path

import numpy as np

_DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG of Linux


def main(name: str) -> None:
    """Read, solve, write."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)
    answer = os.dup(1)
    os.dup2(2, 1)
    with np.load(io.BytesIO(sys.stdin.buffer.read())) as file:
        given = dict(file)
    spec = importlib.util.spec_from_file_location(Path(name).stem, name)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    out = io.BytesIO()
    np.savez(out, **module.solve(given))
    with os.fdopen(answer, "wb") as file_out:
        file_out.write(out.getvalue())


if __name__ == "__main__":
    main(sys.argv[1])
