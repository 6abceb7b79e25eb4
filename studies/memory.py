"""Peak resident memory of a stretch of work, from Linux's own accounting."""

from __future__ import annotations

import contextlib
import ctypes
import resource
from pathlib import Path

_STATUS = Path("/proc/self/status")
_CLEAR = Path("/proc/self/clear_refs")


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
