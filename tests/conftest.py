"""Fixtures that more than one test file uses."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vdmbench
from tests.command import own_signals
from tests.command import vdmbench as command
from vdmbench.body import imported
from vdmbench.body.read_apart import read_clean
from vdmbench.machine import lock
from vdmbench.models import frames
from vdmbench.report import picture
from vdmbench.scene import placed

ROOT = Path(__file__).parents[1]
if Path(vdmbench.__file__).resolve().parent != ROOT / "studies":
    raise ImportError(
        f"vdmbench is imported from {vdmbench.__file__}, not from this checkout: run `make setup` in it"
    )

# what takes half a small run: frames are timed once, not for seconds, and pictures have hard outlines
frames.MOST, picture.FINER = 0.0, 1

pytest_plugins = ["tests.verification.records"]


def pytest_collection_finish() -> None:
    """Five thousand tests and what they load stay to the end: no look for garbage goes through them again."""
    gc.freeze()


@pytest.fixture(autouse=True)
def _own_signals() -> Iterator[None]:
    """Where a test calls the command in this process."""
    with own_signals():
        yield


STIFFNESSES: dict[tuple[object, ...], tuple[np.ndarray, np.ndarray | None]] = {}
MOST, MOST_NODES = 6, 800  # bodies that are kept, the last that were asked for: up to 46 MB each


@pytest.fixture(autouse=True)
def _integrated_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The integrals over a body's facets, which many tests ask for, are made once for each body."""
    operators = sys.modules.get("vdm.boundary.operators")  # a second of imports, which few need
    if operators is None:
        return
    made = operators.surface_stiffness

    def known(facets: Any, nu: float, dtype: Any = None, rims: Any = None) -> np.ndarray:
        if len(facets.points) > MOST_NODES:
            return made(facets, nu, dtype, rims)
        parts = [facets.points, facets.triangles, facets.numbers]
        parts += [rims.body.points, rims.body.triangles] if rims else []
        dtype = dtype or operators.precision(len(facets.points))
        key = (*(part.tobytes() for part in parts), nu, dtype)
        if key not in STIFFNESSES:
            whole = made(facets, nu, dtype, rims)
            STIFFNESSES[key] = whole, rims.follows.copy() if rims else None
        found, follows = STIFFNESSES[key] = STIFFNESSES.pop(key)
        if len(STIFFNESSES) > MOST:
            del STIFFNESSES[next(iter(STIFFNESSES))]
        if rims:
            rims.follows[:] = follows
        return found.copy()

    monkeypatch.setattr(operators, "surface_stiffness", known)


PRESSURES: dict[tuple[object, ...], np.ndarray] = {}


@pytest.fixture(autouse=True)
def _pressed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same of smooth pressures over its facets: most small studies press the same few balls."""
    made = placed.on_facets

    def known(profile: str, region: Any, mesh: Any, rule: Any) -> np.ndarray:
        key = (profile, repr(region), mesh.surface_points.tobytes(), mesh.triangles.tobytes())
        found = PRESSURES[key] = PRESSURES.pop(key) if key in PRESSURES else made(profile, region, mesh, rule)
        if len(PRESSURES) > 5 * MOST:
            del PRESSURES[next(iter(PRESSURES))]
        return found.copy()

    monkeypatch.setattr(placed, "on_facets", known)


@pytest.fixture
def read_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mesh files are read in this process; `test_mesh_reading` reads them apart."""
    monkeypatch.setattr(imported, "clean_of", read_clean)


@pytest.fixture(scope="session")
def quickstart(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory in which the quickstart was run, by the first worker of pytest that asks. Not to be changed."""
    base = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        base = base.parent
    directory = base / "quickstart"
    with lock(base / ".quickstart", wait=True):
        if not directory.exists():
            directory.mkdir()
            result = command("run", "quickstart", cwd=directory)
            assert result.returncode == 0, result.stderr
    return directory


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
