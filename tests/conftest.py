"""Fixtures that more than one test file uses."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

pytest_plugins = ["tests.verification.records"]


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
