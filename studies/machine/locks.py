"""Locks between processes: a lock goes with its process, and nobody waits for one in silence."""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from .safe_open import open_regular

_POLL = 0.1  # s


class LockedError(ValueError):
    """Another process holds the lock; the message is who, as "process 12"."""


@contextmanager
def lock(
    path: Path, kind: int, *, patience: float = 0.0, tell: Callable[[str], None] | None = None
) -> Iterator[None]:
    """Hold the lock of a file, `fcntl.LOCK_EX` or `LOCK_SH`, and say in the file who does.

    Parameters
    ----------
    patience : seconds to wait for one holder; a holder who is followed by another has done its work
    tell : told who is waited for

    Raises
    ------
    LockedError
        another process holds it, and has for longer than the patience.
    OSError
        the file cannot be opened for writing, or is no regular file.
    """
    with os.fdopen(open_regular(path, os.O_RDWR | os.O_CREAT), "r+", errors="replace") as file:
        holder, end = "", 0.0
        while not _taken(file, kind):
            if (found := _holder(file)) != holder:
                holder, end = found, time.monotonic() + patience
                if tell is not None:
                    tell(f"waiting for {holder}, which has locked {path}")
            if time.monotonic() >= end:
                raise LockedError(holder)
            time.sleep(_POLL)
        file.seek(0)
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
        yield


def _taken(file: TextIO, kind: int) -> bool:
    try:
        fcntl.flock(file, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _holder(file: TextIO) -> str:
    """Who has written its number there last; others may write anything."""
    file.seek(0)
    number = file.read(20).strip()
    return f"process {number}" if number.isascii() and number.isdigit() else "an unknown process"
