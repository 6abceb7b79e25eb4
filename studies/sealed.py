"""Arrays on disk with a seal: written whole or not at all, and read only if not a byte has changed."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .files import write_atomically

_DIGEST_BYTES = 32  # the SHA-256 of all before it ends the file; readers of .npz do not mind it


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Store named arrays as .npz. Raises OSError."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    content = buffer.getvalue()
    write_atomically(path, content + hashlib.sha256(content).digest())


def read_arrays(path: Path) -> dict[str, NDArray[Any]] | None:
    """The arrays stored at `path`, or None where there is no file or it is damaged."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return None
    content, digest = data[:-_DIGEST_BYTES], data[-_DIGEST_BYTES:]
    if hashlib.sha256(content).digest() != digest:
        return None
    with np.load(io.BytesIO(content), allow_pickle=False) as stored:
        return {name: stored[name] for name in stored}
