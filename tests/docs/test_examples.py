"""Engines of others, through the door for plug-ins and by an export: held to ours on the same problem."""

import dataclasses
import importlib
import json
import os
import runpy
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.command import SMALL_STUDY, do, vdmbench_process
from vdmbench import models
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh_cache import mesh_from_cache
from vdmbench.cli.arguments import parse
from vdmbench.measures.foreign import read_foreign
from vdmbench.measures.metrics import VECTOR
from vdmbench.scene.result import ModelResult
from vdmbench.scene.scene import Scene, build_scene
from vdmbench.study.config import expand, load_study
from vdmbench.study.registry import MODELS, is_linear
from vdmbench.study.schema import Study

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
STUDY: dict[str, Any] = {
    "study": {"name": "test", "models": ["fem-linear"]},
    "geometry": {"shape": "box", "size": [0.06, 0.03, 0.03], "mesh_size": 0.012},
    "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.4, "density": 1000.0},
    "regions": {
        "clamp": {"below": {"axis": "x", "fraction": 0.001}},
        "tool": {"above": {"axis": "x", "fraction": 0.999}},
    },
    "constraints": [
        {"kind": "fixed", "region": "clamp"},
        {"kind": "constrained", "region": "tool", "displacement": [0.0, 0.002, -0.001]},
    ],
    "gravity": {"acceleration": [0.0, 0.0, -2.0]},
    "load": {"factors": [0.5, 1.0]},
}


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A bar that is clamped, moved at its other end, and weighs; half and whole."""
    study = Study.model_validate(STUDY)
    return build_scene(study, build_mesh(study.geometry))


def example(wheel: str, module: str) -> Iterator[Any]:
    """A file of the examples, which registers its model, for one test."""
    pytest.importorskip(wheel, reason=f"needs {wheel}: pip install ./docs/examples")
    known = dict(models.all_models())
    with mock.patch.object(sys, "path", [*sys.path, str(EXAMPLES)]), mock.patch.dict(MODELS, known):
        MODELS.pop(module.replace("_", "-"), None)  # where it is installed
        sys.modules.pop(module, None)
        yield importlib.import_module(module)


@pytest.fixture
def mujoco() -> Iterator[Any]:
    yield from example("mujoco", "mujoco_flex")


@pytest.fixture
def ngsolve() -> Iterator[Any]:
    yield from example("ngsolve", "ngsolve_p2p1")


def assert_same(ours: ModelResult, theirs: ModelResult, tolerance: float) -> None:
    assert all(status.ok for status in theirs.status), theirs.status
    for field in ("displacement", "reaction_force", "energy"):
        a, b = getattr(ours, field), getattr(theirs, field)
        if field == "reaction_force":  # elements give an edge's force to its ends in ways of their own
            a, b = a.sum(axis=1), b.sum(axis=1)
        assert_allclose(b, a, rtol=0, atol=tolerance * np.abs(a).max(), err_msg=field)


@pytest.mark.usefixtures("ngsolve")
@pytest.mark.parametrize("nu", [0.3, 0.5])
def test_ngsolve_is_a_second_reference(scene: Scene, nu: float) -> None:
    scene = dataclasses.replace(scene, tissue=scene.tissue.model_copy(update={"poisson_ratio": nu}))
    ours, theirs = (models.run_model(scene, name) for name in ("fem-linear", "ngsolve-p2p1"))
    assert_same(ours, theirs, 1e-8)  # both are direct solves of one system
    assert_allclose(theirs.fluid_pressure, ours.fluid_pressure, rtol=1e-7)


@pytest.mark.usefixtures("ngsolve")
def test_ngsolve_in_finite_strain_is_the_reference(scene: Scene) -> None:
    """Without contact pressure, which there does not turn with the surface."""
    ours, theirs = (models.run_model(scene, name) for name in ("fem", "ngsolve-p2p1:nonlinear"))
    assert_same(ours, theirs, 1e-6)
    linear = models.run_model(scene, "fem-linear")
    assert np.abs(linear.displacement - theirs.displacement).max() > 1e-3 * np.abs(theirs.displacement).max()


@pytest.mark.usefixtures("mujoco")
def test_mujoco_rests_where_the_forces_of_its_law_balance(scene: Scene) -> None:
    result = models.run_model(scene, "mujoco-flex")
    assert all(status.ok for status in result.status), result.status
    assert (result.scalars["relative_residual"] < 1e-4).all()
    assert_allclose(result.displacement[-1][scene.held], scene.prescribed[scene.held], atol=1e-12)
    small = dataclasses.replace(
        scene, prescribed=1e-3 * scene.prescribed, gravity=1e-3 * scene.gravity, load_factors=np.ones(1)
    )
    ours, theirs = (models.run_model(small, name) for name in ("fem-p1", "mujoco-flex"))
    assert_same(ours, theirs, 1e-3)  # its strain is quadratic: micrometres on 60 mm are linear to as much
    assert not is_linear("mujoco-flex")


def test_forces_of_mujocos_law_are_the_slope_of_its_energy(scene: Scene, mujoco: Any) -> None:
    mesh, rng, state = scene.mesh, np.random.default_rng(5), mujoco.state
    u = 1e-3 * rng.normal(size=mesh.points.shape)
    way = rng.normal(size=mesh.points.shape)
    force = state(mesh, u, 5000.0, 0.4).force
    step = 1e-8
    energies = [state(mesh, u + side * step * way, 5000.0, 0.4).energy for side in (-1.0, 1.0)]
    assert np.vdot(force, way) == pytest.approx((energies[1] - energies[0]) / (2.0 * step), rel=1e-6)
    # all around pressed together by 0.1 %: p = -K tr(strain), to the square of it
    pressed = state(mesh, -1e-3 * mesh.points, 5000.0, 0.4)
    assert pressed.pressure == pytest.approx(3e-3 * 5000.0 / (3.0 * (1.0 - 0.8)), rel=3e-3)
    assert pressed.least_volume == pytest.approx(0.999**3, rel=1e-9)
    turned_out = state(mesh, -2.0 * mesh.points * [1.0, 0.0, 0.0], 5000.0, 0.4)
    assert turned_out.least_volume == pytest.approx(-1.0)


def test_installed_they_are_models_of_every_command(tmp_path: Path) -> None:
    """With the entry points that `pip install ./docs/examples` writes."""
    for wheel in ("mujoco", "ngsolve"):
        pytest.importorskip(wheel, reason=f"needs {wheel}: pip install ./docs/examples")
    entries = tomllib.loads((EXAMPLES / "pyproject.toml").read_text())["project"]["entry-points"]
    about = tmp_path / "vdmbench_engines-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: vdmbench-engines\nVersion: 1.0\n")
    lines = [
        f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in own.items()) for group, own in entries.items()
    ]
    (about / "entry_points.txt").write_text("\n".join(lines))
    names = '["mujoco-flex", "ngsolve-p2p1", "fem-p1", "fem-linear"]'
    study = SMALL_STUDY.replace('["vdm-paper", "fem-linear"]', names).replace('"16 mm"', '"20 mm"')
    (tmp_path / "small.toml").write_text(study)
    search = f"{tmp_path}{os.pathsep}{EXAMPLES}"
    told = vdmbench_process("run", "small.toml", "--jobs", "1", "--json", cwd=tmp_path, PYTHONPATH=search)
    assert told.returncode == 0, told.stderr
    found = json.loads(told.stdout)
    error = {model: row[VECTOR]["value"] for model, row in found["metrics"].items() if VECTOR in row}
    assert error["ngsolve-p2p1"] < 1e-8, "both are direct solves of one system"
    assert 0.1 < error["fem-p1"] == pytest.approx(error["mujoco-flex"], rel=0.2), "they lock alike"
    assert "engines" in found["verdicts"]


ENGINE = Path(__file__).parents[2] / "docs" / "examples" / "twenty_lines.py"
TOOL = """
[[constraints]]
kind = "constrained"
region = "side"
displacement = ["0 mm", "1 mm", "0 mm"]
[regions.side]
above = { axis = "x", fraction = 0.9 }
[gravity]
acceleration = [0, 0, -9.81]
"""


def test_it_has_twenty_lines_and_says_what_ours_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    *_, solving = ENGINE.read_text().split("\n\n", 3)
    assert len(solving.splitlines()) <= 22, "twenty, and two that write"
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text(SMALL_STUDY + TOOL)
    assert do(parse(["export", "small.toml", "--to", "out", "--cache", "cache", "--json"])) == 0
    runpy.run_path(str(ENGINE))
    (case,) = expand(load_study(Path("small.toml")))
    mesh = mesh_from_cache(case.study.geometry, Path("cache"))
    theirs = read_foreign(Path("theirs.csv"), mesh)
    ours = models.run_model(build_scene(case.study, mesh), "fem-p1").displacement[-1]
    assert theirs.exact == 1.0
    # both are direct solves of the same system
    assert_allclose(theirs.displacement, ours, rtol=0, atol=1e-9 * np.abs(ours).max())
