"""The processors of this machine: how many this process may use, and what they are called."""

from __future__ import annotations

import os
import platform
from pathlib import Path

_DESCRIPTION = Path("/proc/cpuinfo")


def usable_processors() -> int:
    """How many this process may use: a batch system or `taskset` may leave it fewer than the machine has."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def processor_name() -> str:
    """What the machine says that its processors are; "unknown" where it says nothing."""
    try:
        lines = _DESCRIPTION.read_text().splitlines()
    except OSError:
        return platform.processor() or "unknown"
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown")
