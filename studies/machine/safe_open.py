"""Opening stored files: regular files under their own name, never through a link; new ones as the umask says."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

MAX_TEXT_BYTES = 256 << 20  # of a stored text; a plan of 100,000 cases has 40 MB
MAX_CASE_BYTES = 2 << 30  # of the results of a case


class UnfitFileError(OSError):
    """Something else than a regular file of a fit size is in a file's place."""


def open_regular(path: Path, flags: int = os.O_RDONLY) -> int:
    """A descriptor of the regular file at `path`; with O_CREAT a new one gets 0666 less the umask.

    A file that is opened for writing has one name only: a second one may be another's.

    Raises
    ------
    UnfitFileError
        a link, FIFO, socket or device, or for writing a file with several names.
    OSError
        no such file, a directory, no permission; it names `path`.
    """
    try:
        _require_regular(path, os.lstat(path), flags)  # opening a device may already do something
    except FileNotFoundError:
        if not flags & os.O_CREAT:
            raise
    handle = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    try:
        _require_regular(path, os.fstat(handle), flags)  # it may have been exchanged meanwhile
    except BaseException:
        os.close(handle)
        raise
    return handle


def read_regular(path: Path, most: int = MAX_TEXT_BYTES) -> bytes:
    """All bytes of the regular file at `path`. Raises as `open_regular`, and for more than `most` bytes."""
    with os.fdopen(open_regular(path), "rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            said = f"has {size} bytes, more than the {most} that such a file can have; delete it"
            raise UnfitFileError(errno.EFBIG, said, str(path))
        return file.read(size + 1)  # not `most`, which Python would set aside


def require_replaceable(path: Path) -> None:
    """Let `path` be replaced where nothing, a regular file or a link to one is there.

    Raises
    ------
    OSError
        a directory, FIFO, socket or device, or a link to one.
    """
    for look in (os.lstat, os.stat):
        try:
            found = look(path)
        except OSError as error:
            if error.errno in (errno.ENOENT, errno.ENOTDIR, errno.ELOOP):
                return  # a link that leads nowhere is replaced too
            raise
        if not stat.S_ISLNK(found.st_mode):
            _require_regular(path, found)


def _require_regular(path: Path, found: os.stat_result, flags: int = os.O_RDONLY) -> None:
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, "a directory is in a file's place; remove it", str(path))
    if not stat.S_ISREG(found.st_mode):
        what = "a link, a device or the like is in a file's place; remove it"
        raise UnfitFileError(errno.EINVAL, what, str(path))
    if flags & (os.O_RDWR | os.O_WRONLY) and found.st_nlink > 1:
        raise UnfitFileError(errno.EINVAL, "has a second name (a hard link); remove it", str(path))
