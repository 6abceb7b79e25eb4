"""Arrays on disk with a seal: written whole or not at all, and read only if not a byte has changed.

The seal covers the file's name too, which is its content key: an entry under another's name is no entry.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .files import write_atomically
from .safe_open import UnfitFileError, read_regular

_MAX_BYTES = 8 << 30
_DIGEST_BYTES = 32  # a SHA-256 ends the file; readers of .npz do not mind it


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Store named arrays as .npz. Raises OSError."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    content = buffer.getvalue()
    # many and small, each told by its seal and made again where it is cut: none is worth a wait for the disk
    write_atomically(path, content + _seal(path, content), durable=False)


def read_arrays(path: Path) -> dict[str, NDArray[Any]] | None:
    """The arrays stored at `path`, or None where there is no file, or one that is damaged or not its own.

    Raises
    ------
    OSError
        the file may not be read.
    """
    content = _content(path)
    if content is None:
        return None
    with np.load(io.BytesIO(content), allow_pickle=False) as stored:
        return {name: stored[name] for name in stored}


def is_sound(path: Path) -> bool:
    """Whether `read_arrays` finds arrays at `path`. Raises OSError where the file may not be read."""
    return _content(path) is not None


def _content(path: Path) -> bytes | None:
    try:
        data = read_regular(path, _MAX_BYTES)
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError, UnfitFileError):
        return None  # where something else is in its place, writing it replaces a link, and tells the rest
    content, seal = data[:-_DIGEST_BYTES], data[-_DIGEST_BYTES:]
    return content if _seal(path, content) == seal else None


def _seal(path: Path, content: bytes) -> bytes:
    return hashlib.sha256(path.name.encode() + b"\0" + content).digest()
