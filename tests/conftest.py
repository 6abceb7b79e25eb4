"""Fixtures that more than one test file uses."""

import gc
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

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

# a busy machine fails no test that looks for what breaks
settings.register_profile(
    "unhurried", deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large]
)
settings.load_profile("unhurried")

pytest_plugins = ["tests.verification.records"]


def pytest_collection_finish() -> None:
    """Five thousand tests and what they load stay to the end: no look for garbage goes through them again."""
    gc.freeze()


@pytest.fixture(autouse=True)
def _own_signals() -> Iterator[None]:
    """Where a test calls the command in this process."""
    with own_signals():
        yield


class Kept:
    """What a pure function gave for what it was given, of the last `most` things that it was asked for."""

    def __init__(self, most: int) -> None:
        self.most, self.known = most, dict[Any, Any]()

    def __call__(self, asked: Any, make: Callable[[], Any]) -> Any:
        """The answer, made where it is not known."""
        found = self.known[asked] = self.known.pop(asked) if asked in self.known else make()
        if len(self.known) > self.most:
            del self.known[next(iter(self.known))]
        return found


STIFFNESSES, COARSE, PRESSURES = Kept(6), Kept(30), Kept(30)
MOST_NODES = 800  # of a body whose stiffness is kept: up to 46 MB each


@pytest.fixture(autouse=True)
def _made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """What many tests ask for of a few bodies: integrals over facets, coarse surfaces, smooth pressures."""
    on_facets = placed.on_facets

    def pressures(profile: str, region: Any, mesh: Any, rule: Any) -> np.ndarray:
        asked = (profile, repr(region), mesh.surface_points.tobytes(), mesh.triangles.tobytes())
        return PRESSURES(asked, lambda: on_facets(profile, region, mesh, rule)).copy()

    monkeypatch.setattr(placed, "on_facets", pressures)
    places = ("vdm.boundary.operators", "vdm.boundary.coarsening")  # a second of imports, which few need
    operators, coarsening = map(sys.modules.get, places)
    if operators is None or coarsening is None:
        return
    surface_stiffness, coarsened = operators.surface_stiffness, coarsening.coarsened

    def stiffnesses(facets: Any, nu: float, dtype: Any = None, rims: Any = None) -> np.ndarray:
        def make() -> tuple[np.ndarray, np.ndarray | None]:
            return surface_stiffness(facets, nu, dtype, rims), rims.follows.copy() if rims else None

        if len(facets.points) > MOST_NODES:
            return make()[0]
        parts = [facets.points, facets.triangles, facets.numbers]
        parts += [rims.body.points, rims.body.triangles] if rims else []
        dtype = dtype or operators.precision(len(facets.points))
        found, follows = STIFFNESSES((*(part.tobytes() for part in parts), nu, dtype), make)
        if rims:
            rims.follows[:] = follows
        return found.copy()

    def coarse(surface: Any, count: int, held: Any = None) -> Any:
        parts = [surface.points, surface.triangles, np.zeros(0) if held is None else held]
        asked = (count, *(part.tobytes() for part in parts))
        return COARSE(asked, lambda: coarsened(surface, count, held))

    monkeypatch.setattr(operators, "surface_stiffness", stiffnesses)
    monkeypatch.setattr(coarsening, "coarsened", coarse)


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
