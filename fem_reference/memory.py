"""The memory that a solver may take."""

from __future__ import annotations

import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager

from solver_common.solution import solver_error


def available_memory() -> float:
    """Bytes that this process can still take: what the machine has left, or less under a limit [B]."""
    page = os.sysconf("SC_PAGE_SIZE")
    available = float(os.sysconf("SC_PHYS_PAGES") * page)
    try:
        with open("/proc/meminfo", encoding="ascii") as lines:
            for line in lines:
                if line.startswith("MemAvailable:"):
                    available = min(available, 1024.0 * float(line.split()[1]))
        with open("/proc/self/statm", encoding="ascii") as statm:
            used = float(statm.read().split()[0]) * page
    except OSError:  # not Linux: the physical memory is the only known bound
        return available
    for kind, taken in ((resource.RLIMIT_AS, used), (resource.RLIMIT_DATA, _data_bytes())):
        limit, _ = resource.getrlimit(kind)
        if limit != resource.RLIM_INFINITY:
            available = min(available, limit - taken)
    return available


@contextmanager
def reserved_not_counted() -> Iterator[None]:
    """Memory reserved inside the block does not count against the process's data limit (RLIMIT_DATA)."""
    limit, hard = resource.getrlimit(resource.RLIMIT_DATA)
    if limit == hard:
        yield
        return
    resource.setrlimit(resource.RLIMIT_DATA, (hard, hard))
    before = _data_bytes()
    try:
        yield
    finally:
        wanted = limit + max(0, _data_bytes() - before)
        if hard != resource.RLIM_INFINITY:
            wanted = min(wanted, hard)
        resource.setrlimit(resource.RLIMIT_DATA, (wanted, hard))


def _data_bytes() -> int:
    """Private data of this process, touched or not (VmData); Linux limits it by RLIMIT_DATA."""
    try:
        with open("/proc/self/status", encoding="ascii") as lines:
            return sum(1024 * int(line.split()[1]) for line in lines if line.startswith("VmData:"))
    except OSError:  # not Linux
        return 0


def allowed_memory(limit: float | None) -> float:
    """The limit, or without one what is available now [B]."""
    return available_memory() if limit is None else limit


def check_memory(needed: float, limit: float | None, path: str) -> None:
    """Raise a `SolverError` if `needed` bytes exceed `limit` (None: what is available now)."""
    allowed = allowed_memory(limit)
    if needed > allowed:
        or_else = 'solver="iterative"' if path == "direct" else "a machine with more memory"
        raise solver_error(
            "memory",
            f"the {path} solver needs about {needed / 1e6:.0f} MB but {allowed / 1e6:.0f} MB are available",
            f"use a larger mesh_size or {or_else}",
        )
