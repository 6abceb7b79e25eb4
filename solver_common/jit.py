"""Loops compiled by numba, cached on disk where possible."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba.core import event

Function = TypeVar("Function", bound=Callable[..., Any])

_compiling = event.TimingListener()  # type: ignore[no-untyped-call]
event.register("numba:compile", _compiling)  # type: ignore[no-untyped-call]


def compiled(function: Function) -> Function:
    """The function in machine code, compiled at its first call and cached for later processes.

    numba caches beside the module, or below the user's cache directory where that is not writable. Several
    processes may write at once: each file is replaced as a whole. Without a writable place every process compiles
    anew.
    """
    options: dict[str, Any] = {"fastmath": True, "nogil": True, "error_model": "numpy"}
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no writable directory
        return numba.njit(**options)(function)


def clock() -> float:
    """`time.perf_counter` [s] without the time that numba compiles, which is spent once on a machine."""
    return time.perf_counter() - (_compiling.duration if _compiling.done else 0.0)
