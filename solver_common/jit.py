"""Loops compiled by numba and cached on disk."""

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

    numba caches beside the module, or below the user's cache directory. If neither is writable, every process
    compiles. Processes may write at the same time: each replaces a file as a whole.
    """
    options: dict[str, Any] = {"fastmath": True, "nogil": True, "error_model": "numpy"}
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no writable directory
        return numba.njit(**options)(function)


def clock() -> float:
    """`time.perf_counter` [s], less the time that numba spent compiling, which a machine pays once."""
    return time.perf_counter() - (_compiling.duration if _compiling.done else 0.0)
