"""Reads and cleans a mesh file in a separate process: readers crash on damaged files.

That process has little memory and time, by the file's size, and returns arrays or one sentence.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from solver_common.arrays import Array

from ..machine import packed, unpacked
from ..study.errors import MeshError
from ..study.shapes import VOLUME_SUFFIXES
from .repair import Clean, clean_surface, clean_tetrahedra

# a sound file needs a tenth of this; text is the worst, with 100 bytes for a number of 2
MEMORY, MEMORY_PER_BYTE = 1_000_000_000, 100
SECONDS, SECONDS_PER_BYTE = 60.0, 3e-6

_NO_MEMORY = 3  # exit code of a reader that reports lack of memory
_DAMAGED = "it is damaged or of another kind"


def clean_of(path: Path, repair: str = "") -> Clean:
    """The closed surface, repaired as asked, or where a file has them the tetrahedra. Raises MeshError."""
    return Clean(**_apart(f"clean {repair}", path))


def point_fields_of(path: Path) -> tuple[Array, dict[str, Array]]:
    """`mesh_file.read_point_fields` for a file that may be damaged or unpack to any size. Raises MeshError."""
    found = _apart("fields", path)
    return found["points"], found["fields"]


def _apart(what: str, path: Path) -> dict[str, Any]:
    """The answer of `main`, by name. Raises MeshError."""
    size = path.stat().st_size
    memory, seconds = MEMORY + MEMORY_PER_BYTE * size, SECONDS + SECONDS_PER_BYTE * size
    command = [sys.executable, "-P", "-m", "vdmbench.body.read_apart", what, str(path), str(memory)]
    here = str(Path(__file__).parents[2])  # import the same code as this process
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
    too_large = f"takes more than {memory / 1e9:.1f} GB of memory to read; {_DAMAGED}"
    if ended.returncode < 0:  # a library without memory may crash instead of reporting it
        raise MeshError(f"ends its reader with signal {-ended.returncode}, or {too_large}")
    if ended.returncode == _NO_MEMORY:
        raise MeshError(too_large)
    if ended.returncode > 0 or not ended.stdout:
        raise MeshError(f"cannot be read; {_DAMAGED}")
    found = unpacked(ended.stdout)
    if "error" in found:
        raise MeshError(found["error"])
    return found


def read_clean(path: Path, repair: str = "") -> Clean:
    """Content of a file, read in this process. Raises MeshError, and any error of the readers."""
    from .mesh_file import read_surface, read_tetrahedra

    if path.suffix.lower() in VOLUME_SUFFIXES:
        return clean_tetrahedra(*read_tetrahedra(path))
    return clean_surface(*read_surface(path), repair)


def main(what: str, path: Path, memory: int) -> None:
    """Read a file with at most `memory` bytes; standard output gets the answer, without output of the readers."""
    import resource

    from ..machine import limit_memory
    from .mesh_file import read_point_fields

    output = os.dup(1)
    os.dup2(2, 1)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    limit_memory(memory)
    try:
        if what == "fields":
            points, fields = read_point_fields(path)
            answer = packed(points=points, fields=fields)
        else:
            answer = packed(read_clean(path, what.removeprefix("clean ")))
    except MeshError as error:
        answer = packed(error=str(error))
    except MemoryError:
        os._exit(_NO_MEMORY)  # at once: a normal exit would need memory
    with os.fdopen(output, "wb") as file:
        file.write(answer)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]))
