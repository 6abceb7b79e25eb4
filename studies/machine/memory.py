"""Memory from Linux's own accounting: what a stretch of work took at its peak, and how much a process may take."""

from __future__ import annotations

import contextlib
import ctypes
import mmap
import os
import re
import resource
from functools import cache
from pathlib import Path

_STATUS = Path("/proc/self/status")
_CLEAR = Path("/proc/self/clear_refs")
_CONTAINER = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")  # versions 2 and 1


# what C++, Rust, the system and its loader of libraries say where memory runs out
OUT_OF_MEMORY = re.compile(
    "bad_alloc|memory allocation of|cannot allocate memory|cannot map zero-fill|failed to map segment", re.I
)
_BUFFER = 64 << 20  # B that a library of dense algebra is left to work in; OpenBLAS's own takes 32 MB
_LIMITS = (("ulimit -v", resource.RLIMIT_AS), ("ulimit -d", resource.RLIMIT_DATA))


class MemoryLimitError(OSError):
    """This process may take too little memory to load what solves."""

    def __init__(self, why: str) -> None:
        super().__init__(f"too little memory to load the solvers: {why}; allow 3 GB or more, or no limit")


@cache
def memory_limits() -> str:
    """The limits that this process was started with, as "ulimit -v 400000"; "" where there are none."""
    found = ((words, resource.getrlimit(kind)[0]) for words, kind in _LIMITS)
    return " and ".join(f"{words} {size // 1024}" for words, size in found if size != resource.RLIM_INFINITY)


def is_lack_of_memory(error: BaseException) -> bool:
    """Whether an error, as that of a library that cannot be loaded, says that memory has run out."""
    return isinstance(error, MemoryError) or OUT_OF_MEMORY.search(str(error)) is not None


def heed_limits() -> None:
    """Call before numpy is loaded: under a limit, dense algebra has one thread.

    Each further one takes a buffer when it starts, and asks for it for ever where the system refuses.
    """
    if memory_limits():
        os.environ["OPENBLAS_NUM_THREADS"] = "1"


def require_room() -> None:
    """Under a limit, load dense algebra with what it works in. Raises MemoryLimitError where that finds no room."""
    if not (limits := memory_limits()):
        return
    try:
        _take_working_buffers()
    except (MemoryError, ImportError, OSError) as error:
        raise MemoryLimitError(limits) from error


def machine_memory() -> int:
    """Bytes of memory of this machine, or of this container where it may take less."""
    sizes = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    for name in _CONTAINER:
        with contextlib.suppress(OSError, ValueError):  # not there, or "max"
            sizes.append(int(Path(name).read_text()))
    return min(sizes)


def limit_memory(size: int) -> None:
    """Let this process take so many bytes more, for the rest of its life; then allocations fail.

    What counts is private data (RLIMIT_DATA), touched or not; on another system than Linux nothing is limited.
    From here on dense algebra has one thread.
    """
    if _STATUS.exists():
        memory_limits()  # which it was started with, kept: those of here are not its shell's
        _take_working_buffers()
        _, hard = resource.getrlimit(resource.RLIMIT_DATA)
        wanted = _read("VmData") + size
        limit = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))


def _take_working_buffers() -> None:
    """Have numpy's and scipy's OpenBLAS take the memory that they work in, which they keep.

    At its first product each maps 32 MB, and where the system refuses it asks again, for ever (blas_memory_alloc
    in OpenBLAS's driver/others/memory.c). A thread takes such a buffer for itself, too, when their number is set.
    """
    _require_buffer()
    import numpy as np
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)
    _require_buffer()
    np.linalg.solve(np.eye(2), np.eye(2))
    _require_buffer()
    from scipy.linalg import lu_factor

    threadpool_limits(1)
    _require_buffer()
    lu_factor(np.eye(2))


def _require_buffer() -> None:
    """Raises MemoryError where the system refuses what OpenBLAS would ask for again and again."""
    try:
        # private, as RLIMIT_DATA counts it
        mmap.mmap(-1, _BUFFER, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS).close()
    except OSError as error:
        raise MemoryError from error


def reset_peak() -> int:
    """Start a stretch: forget the peak so far; returns the resident bytes now, for `peak_bytes_since`.

    Memory that was freed but kept by the allocator goes back to the system first: taken again, it counts.
    """
    with contextlib.suppress(OSError, AttributeError):  # another C library than glibc
        ctypes.CDLL(None).malloc_trim(0)
    try:
        _CLEAR.write_text("5")  # resets VmHWM (proc(5))
    except OSError:
        return 0
    return _read("VmRSS")


def peak_bytes_since(baseline: int) -> int:
    """Bytes that the stretch added at its peak to the resident memory at its start.

    Where the peak cannot be reset (another system than Linux) it is the peak of the whole process.
    """
    peak = _read("VmHWM") if _STATUS.exists() else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return max(0, peak - baseline)


def _read(field: str) -> int:
    for line in _STATUS.read_text().splitlines():
        if line.startswith(field + ":"):
            return int(line.split()[1]) * 1024
    return 0
