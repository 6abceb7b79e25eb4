"""Fixtures that more than one test file uses."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import vdmbench

ROOT = Path(__file__).parents[1]
if Path(vdmbench.__file__).resolve().parent != ROOT / "studies":
    raise ImportError(
        f"vdmbench is imported from {vdmbench.__file__}, not from this checkout: run `make setup` in it"
    )

pytest_plugins = ["tests.verification.records"]


@pytest.fixture(autouse=True)
def _own_signals() -> Iterator[None]:
    """The command, where a test calls it in this process, leaves its own answers to signals."""
    numbers = (signal.SIGINT, signal.SIGHUP, signal.SIGTERM, signal.SIGALRM)
    before = {number: signal.getsignal(number) for number in numbers}
    hook = sys.unraisablehook
    yield
    sys.unraisablehook = hook
    for number, answer in before.items():
        signal.signal(number, answer)


@pytest.fixture(scope="session")
def liver() -> Path:
    """A real liver surface, named by VDMBENCH_LIVER; tests that need it are skipped without."""
    name = os.environ.get("VDMBENCH_LIVER", "")
    if not name:
        pytest.skip("VDMBENCH_LIVER does not name a liver surface")
    path = Path(name)
    if not path.is_file():
        pytest.fail(f"VDMBENCH_LIVER names {path}, which is not a file")
    return path
