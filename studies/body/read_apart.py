"""A mesh file read and cleaned in a process of its own, which may end as it likes: readers crash on damaged files.

That process has little memory and time, by the file's size, and hands back arrays or one sentence.
"""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from ..study.errors import MeshError
from ..study.shapes import VOLUME_SUFFIXES
from .repair import CleanSurface, CleanTetrahedra

# a sound file takes a tenth of it: text is the worst, with 100 bytes for a number of 2
MEMORY, MEMORY_PER_BYTE = 1_000_000_000, 100
SECONDS, SECONDS_PER_BYTE = 60.0, 3e-6

_DAMAGED = "it is damaged or of another kind"


def clean_of(path: Path) -> CleanSurface | CleanTetrahedra:
    """The closed surface or, of a kind of file that has them, the tetrahedra in a file. Raises MeshError."""
    size = path.stat().st_size
    memory, seconds = MEMORY + MEMORY_PER_BYTE * size, SECONDS + SECONDS_PER_BYTE * size
    command = [sys.executable, "-P", "-m", "vdmbench.body.read_apart", str(path), str(memory)]
    here = str(Path(__file__).parents[2])  # the very code of this process, wherever it was found
    code = os.pathsep.join(filter(None, (here, os.environ.get("PYTHONPATH"))))
    try:
        ended = subprocess.run(
            command,
            env={**os.environ, "PYTHONPATH": code, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise MeshError(f"takes more than {seconds:.0f} s to read; {_DAMAGED}") from None
    if ended.returncode < 0:
        raise MeshError(f"ends its reader with signal {-ended.returncode}; {_DAMAGED}")
    if ended.returncode > 0 or not ended.stdout:
        raise MeshError(f"cannot be read; {_DAMAGED}")
    return _unpacked(ended.stdout)


def _packed(clean: CleanSurface | CleanTetrahedra) -> bytes:
    """Arrays and counts by name; of the named masks the names, and the masks one below the other."""
    values = {field.name: getattr(clean, field.name) for field in fields(clean)}
    groups = values.pop("groups", {})
    values["names"] = np.array(json.dumps(list(groups)))
    values["masks"] = np.array(list(groups.values()), dtype=bool)
    file = io.BytesIO()
    np.savez(file, **values)
    return file.getvalue()


def _unpacked(data: bytes) -> CleanSurface | CleanTetrahedra:
    with np.load(io.BytesIO(data), allow_pickle=False) as stored:
        if "error" in stored:
            raise MeshError(str(stored["error"]))
        values: dict[str, Any] = {name: stored[name] for name in stored if name not in ("names", "masks")}
        for name, value in values.items():
            if value.ndim == 0:
                values[name] = int(value)
        if "tetrahedra" not in values:
            return CleanSurface(**values)
        groups = dict(zip(json.loads(str(stored["names"])), stored["masks"], strict=True))
    return CleanTetrahedra(**values, groups=groups)


def read_clean(path: Path) -> CleanSurface | CleanTetrahedra:
    """What is in a file, read in this process. Raises MeshError, and whatever the readers run into."""
    from .mesh_file import read_surface, read_tetrahedra
    from .msh_file import read_msh
    from .repair import clean_surface, clean_tetrahedra

    suffix = path.suffix.lower()
    if suffix not in VOLUME_SUFFIXES:
        return clean_surface(*read_surface(path))
    if suffix == ".msh":
        return clean_tetrahedra(*read_msh(path))
    return clean_tetrahedra(*read_tetrahedra(path), {})


def main(path: Path, memory: int) -> None:
    """Read a file with so many bytes of memory; standard output gets the answer, and no word of the readers."""
    import resource

    from ..machine.memory import limit_memory

    output = os.dup(1)
    os.dup2(2, 1)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    limit_memory(memory)
    try:
        answer = _packed(read_clean(path))
    except MeshError as error:
        answer = _packed_error(str(error))
    except MemoryError:
        answer = _packed_error(f"takes more than {memory / 1e9:.1f} GB of memory to read; {_DAMAGED}")
    with os.fdopen(output, "wb") as file:
        file.write(answer)


def _packed_error(text: str) -> bytes:
    file = io.BytesIO()
    np.savez(file, error=np.array(text))
    return file.getvalue()


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
