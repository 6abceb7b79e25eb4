"""Writing files whole or not at all, clearing away what a killed process left half-written, and strict JSON."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import math
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from .safe_open import open_regular, require_replaceable

_PART = ".part"  # ends the names of files being written, which nothing reads
_LONGEST = 200  # characters of a name that its temporary file repeats: file systems take 255 bytes


def json_text(value: Any, *, indent: int | None = None, sort_keys: bool = False) -> str:
    """JSON as every program reads it: null for a number that is not finite, for which JSON has no word."""
    return json.dumps(_plain(value), indent=indent, sort_keys=sort_keys, allow_nan=False)


def _plain(value: Any) -> Any:
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return _plain(value.tolist()) if hasattr(value, "tolist") else value  # of NumPy, not loaded for this


def write_atomically(path: Path, data: bytes, *, durable: bool = True) -> None:
    """Write `data` so that `path` is either absent (or what it was) or complete, also after a crash.

    Parameters
    ----------
    durable : wait for the disk; without it a loss of power may leave the file cut, which no killed program does

    Raises
    ------
    OSError
        disk full or read-only, or a directory, FIFO or device of that name; it names `path`, and nothing is
        left behind. A link of that name is replaced, not followed.
    """
    require_replaceable(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        _replace(path, data, durable)
    except OSError as error:  # a write names no file, and others the one that was to become this
        raise OSError(error.errno, error.strerror, str(path)) from error


@contextlib.contextmanager
def whole_directory(out: Path) -> Iterator[Path]:
    """A hidden directory beside `out` to write in, which takes the place of `out` at the end, else goes.

    `out` is new or empty. Raises OSError.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    begun = Path(tempfile.mkdtemp(prefix=f".{out.name[:_LONGEST]}.", suffix=_PART, dir=out.absolute().parent))
    try:
        begun.chmod(0o755)
        yield begun
        if out.exists():
            out.rmdir()
        begun.rename(out)
    except BaseException:
        shutil.rmtree(begun, ignore_errors=True)
        raise


def require_end(path: Path, end: bytes) -> None:
    """Raises OSError where a file that a library wrote does not end with `end`: a full disk, or a limit, cut it."""
    if not path.read_bytes()[-100:].rstrip().endswith(end):
        raise OSError(errno.EFBIG, "is cut: the disk is full, or a limit of file size is reached", str(path))


def _replace(path: Path, data: bytes, durable: bool) -> None:
    handle, name = _temporary(path)
    try:
        with os.fdopen(handle, "wb") as file:  # its lock is held until it has its final name
            file.write(data)
            file.flush()
            if durable:
                os.fsync(file.fileno())
            name.replace(path)
    except BaseException:
        name.unlink(missing_ok=True)
        raise
    if not durable:
        return
    directory = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(directory)
    finally:
        os.close(directory)


def _temporary(path: Path) -> tuple[int, Path]:
    """A new file beside `path`, locked as long as this process has it open."""
    while True:
        name = path.with_name(f".{path.name[:_LONGEST]}.{secrets.token_hex(8)}{_PART}")
        handle = open_regular(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL)
        fcntl.flock(handle, fcntl.LOCK_EX)
        if os.fstat(handle).st_nlink:
            return handle, name
        os.close(handle)  # another process cleared it away between its making and its locking


def clear_abandoned(directory: Path, suffix: str = _PART) -> None:
    """Remove the hidden files with this suffix that no living process has locked.

    A lock goes with its process, however that ends: no age of a file is judged, and so no clock is asked.
    """
    for path in directory.glob(f".*{suffix}"):
        with contextlib.suppress(OSError):  # gone meanwhile, in use, or not ours
            if path.is_symlink():
                path.unlink()  # the link, not what it leads to
                continue
            handle = open_regular(path)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink()
            finally:
                os.close(handle)
