"""Standard streams that never fail: what nobody can read is dropped, and the program goes on."""

from __future__ import annotations

import errno
import io
import os
import select
import sys
from contextlib import suppress
from typing import TextIO

_NAMES = {1: "standard output", 2: "standard error"}
_NOBODY_READS = (errno.EPIPE, errno.EIO, errno.EBADF)  # a pipe's reader, a terminal or the file is gone


# what steers a terminal or turns the direction of text; a tab and a line's end stay
_STEERING = {
    code: f"\\x{code:02x}" if code < 256 else f"\\u{code:04x}"
    for code in (*range(32), *range(127, 160), *range(0x202A, 0x202F), *range(0x2066, 0x206A))
    if chr(code) not in "\t\n"
}


def harmless(text: str) -> str:
    """The text with its control characters written as escapes: results from elsewhere steer no terminal."""
    return text.translate(_STEERING)


class _Harmless(io.TextIOWrapper):
    """A stream that no text can steer."""

    def write(self, text: str) -> int:
        return super().write(harmless(text))


class _Patient(io.FileIO):
    """A descriptor of which every write succeeds: after the first failure, which it keeps, all is dropped."""

    failure: OSError | None = None

    def write(self, data: object) -> int:
        size = memoryview(data).nbytes  # type: ignore[arg-type]  # typeshed has no name for what it takes
        if self.failure is None:
            try:
                return self._written(data)
            except OSError as error:
                self.failure = error
        return size

    def _written(self, data: object) -> int:
        while (count := super().write(data)) is None:  # type: ignore[arg-type]
            select.select([], [self], [])  # a pipe that does not block, and is full
        return count


def make_patient() -> None:
    """Make `sys.stdout` and `sys.stderr` streams that never fail, whatever happens to their reader.

    Characters that their encoding lacks are written as escapes. Of streams that the caller closed, the null device
    takes the place, lest the next file that is opened become one. A stream that a program has exchanged stays.
    """
    for number in range(3):
        with suppress(OSError):
            os.fstat(number)
            continue
        os.open(os.devnull, os.O_RDWR)  # becomes the lowest number that is free: this one
    if sys.stdout is sys.__stdout__:
        sys.stdout = _patient(1, sys.stdout)
    if sys.stderr is sys.__stderr__:
        sys.stderr = _patient(2, sys.stderr)


def _patient(number: int, stream: TextIO | None) -> TextIO:
    raw = _Patient(number, "w", closefd=False)
    steered = number == 2 and raw.isatty()  # by the progress bar
    return (io.TextIOWrapper if steered else _Harmless)(
        io.BufferedWriter(raw),
        getattr(stream, "encoding", None),
        errors="backslashreplace",
        line_buffering=number == 2 or raw.isatty(),
        write_through=getattr(stream, "write_through", False),
    )


def lost_output() -> list[str]:
    """A sentence for each stream that took not all, as on a full disk; none where only nobody reads any more."""
    found = []
    for number, stream in ((1, sys.stdout), (2, sys.stderr)):
        stream.flush()
        raw = getattr(getattr(stream, "buffer", None), "raw", None)
        failure = getattr(raw, "failure", None)
        if failure is not None and failure.errno not in _NOBODY_READS:
            found.append(f"{_NAMES[number]}: {failure.strerror}; what was to be shown there is incomplete")
    return found
