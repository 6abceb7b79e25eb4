"""Memory from Linux's own accounting: what a stretch of work took at its peak, and how much a process may take."""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
from pathlib import Path

_STATUS = Path("/proc/self/status")
_CLEAR = Path("/proc/self/clear_refs")
_CONTAINER = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")  # versions 2 and 1


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
    import numpy as np
    from scipy.linalg import lu_factor
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)
    np.linalg.solve(np.eye(2), np.eye(2))
    lu_factor(np.eye(2))


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
