"""Engines of others as models: against ours where they solve the same problem, and what happens without them."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.command import SMALL_STUDY, vdmbench, wait_for
from vdmbench import models
from vdmbench.body.geometry import build_mesh
from vdmbench.models import peers
from vdmbench.models.tetrahedra import Law, saint_venant, stable_neo_hookean, state
from vdmbench.scene.result import ModelResult
from vdmbench.scene.scene import Scene, build_scene
from vdmbench.study import registry
from vdmbench.study.config import expand, geometry_of
from vdmbench.study.schema import Study
from vdmbench.work.explain import refused
from vdmbench.work.plan import make_plan

STUDY: dict[str, Any] = {
    "study": {"name": "test", "models": ["fem-linear"]},
    "geometry": {"shape": "box", "size": [0.06, 0.03, 0.03], "mesh_size": 0.012},
    "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.4, "density": 1000.0},
    "regions": {
        "clamp": {"below": {"axis": "x", "fraction": 0.001}},
        "tool": {"above": {"axis": "x", "fraction": 0.999}},
        "edge": {"box": {"min": [-0.001, -0.02, 0.0149], "max": [0.001, 0.02, 0.0151]}},
        "top": {"above": {"axis": "z", "fraction": 0.999}},
    },
    "constraints": [{"kind": "fixed", "region": "clamp"}],
    "gravity": {"acceleration": [0.0, 0.0, -2.0]},
}
TOOL = {"kind": "constrained", "region": "tool", "displacement": [0.0, 0.002, -0.001]}


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A bar that is clamped, moved at its other end, and weighs; half and whole."""
    wanted = STUDY | {"constraints": [*STUDY["constraints"], TOOL], "load": {"factors": [0.5, 1.0]}}
    study = Study.model_validate(wanted)
    return build_scene(study, build_mesh(geometry_of(study)))


def needs(wheel: str) -> None:
    pytest.importorskip(
        wheel, reason=f"needs {wheel}: pip install '.[{'newton' if wheel == 'newton' else 'peers'}]'"
    )


def assert_same(ours: ModelResult, theirs: ModelResult, tolerance: float) -> None:
    assert all(status.ok for status in theirs.status), theirs.status
    for field in ("displacement", "reaction_force", "energy"):
        a, b = getattr(ours, field), getattr(theirs, field)
        if field == "reaction_force":  # elements give an edge's force to its ends in ways of their own
            a, b = a.sum(axis=1), b.sum(axis=1)
        assert_allclose(b, a, rtol=0, atol=tolerance * np.abs(a).max(), err_msg=field)


@pytest.mark.parametrize("nu", [0.3, 0.5])
def test_ngsolve_is_a_second_reference(scene: Scene, nu: float) -> None:
    needs("ngsolve")
    scene = dataclasses.replace(scene, tissue=scene.tissue.model_copy(update={"poisson_ratio": nu}))
    ours, theirs = (models.run_model(scene, name) for name in ("fem-linear", "ngsolve-p2p1"))
    assert_same(ours, theirs, 1e-8)  # both are direct solves of one system
    assert_allclose(theirs.fluid_pressure, ours.fluid_pressure, rtol=1e-7)


def test_ngsolve_in_finite_strain_is_the_reference(scene: Scene) -> None:
    """Without contact pressure, which there does not turn with the surface."""
    needs("ngsolve")
    ours, theirs = (models.run_model(scene, name) for name in ("fem", "ngsolve-p2p1:nonlinear"))
    assert_same(ours, theirs, 1e-6)
    linear = models.run_model(scene, "fem-linear")
    assert np.abs(linear.displacement - theirs.displacement).max() > 1e-3 * np.abs(theirs.displacement).max()


def test_mujoco_rests_where_the_forces_of_its_law_balance(scene: Scene) -> None:
    needs("mujoco")
    result = models.run_model(scene, "mujoco-flex")
    assert all(status.ok for status in result.status), result.status
    assert (result.scalars["relative_residual"] < 1e-4).all()
    held = scene.held
    assert_allclose(result.displacement[-1][held], scene.prescribed[held], atol=1e-12)


def test_mujoco_at_small_loads_is_linear_elasticity_on_its_tetrahedra(scene: Scene) -> None:
    needs("mujoco")
    small = dataclasses.replace(
        scene, prescribed=1e-3 * scene.prescribed, gravity=1e-3 * scene.gravity, load_factors=np.ones(1)
    )
    ours, theirs = (models.run_model(small, name) for name in ("fem-p1", "mujoco-flex"))
    assert_same(ours, theirs, 1e-3)  # its strain is quadratic: micrometres on 60 mm are linear to as much


def test_newton_rests_where_the_forces_of_its_law_balance(scene: Scene) -> None:
    """Its positions have 32 bits, of which the forces have four digits left."""
    needs("newton")
    scene = dataclasses.replace(scene, load_factors=np.ones(1))
    ours, theirs = (models.run_model(scene, name) for name in ("fem-p1", "newton-vbd"))
    assert all(status.ok for status in theirs.status), theirs.status
    assert (theirs.scalars["relative_residual"] < 1e-3).all()
    assert_allclose(theirs.displacement[-1][scene.held], scene.prescribed[scene.held], atol=1e-8)
    difference = np.abs(theirs.displacement - ours.displacement).max()
    assert difference < 0.05 * np.abs(ours.displacement).max(), "linear elements of the same tetrahedra"


def test_a_body_that_is_crushed_is_told(scene: Scene) -> None:
    needs("mujoco")
    torn = dataclasses.replace(scene, gravity=np.array([0.0, 0.0, -1e5]))
    result = models.run_model(torn, "mujoco-flex")
    assert not any(status.ok for status in result.status)
    assert {status.code for status in result.status} <= {"no-rest", "no-balance", "inside-out"}
    assert np.isnan(result.displacement).all()


@pytest.mark.parametrize("law", [saint_venant, stable_neo_hookean])
def test_forces_of_the_law_are_the_slope_of_its_energy(scene: Scene, law: Law) -> None:
    mesh, rng = scene.mesh, np.random.default_rng(5)
    u = 1e-3 * rng.normal(size=mesh.points.shape)
    way = rng.normal(size=mesh.points.shape)
    force = state(mesh, u, 5000.0, 0.4, law).force
    step = 1e-8
    energies = [state(mesh, u + side * step * way, 5000.0, 0.4, law).energy for side in (-1.0, 1.0)]
    assert np.vdot(force, way) == pytest.approx((energies[1] - energies[0]) / (2.0 * step), rel=1e-6)
    assert_allclose(force.sum(axis=0), 0.0, atol=1e-12 * np.abs(force).max())
    # all around pressed together by 0.1 %: p = -K tr(strain), to the square of it
    bulk = 5000.0 / (3.0 * (1.0 - 0.8))
    pressed = state(mesh, -1e-3 * mesh.points, 5000.0, 0.4, law)
    assert pressed.pressure == pytest.approx(3e-3 * bulk, rel=3e-3)
    assert pressed.least_volume == pytest.approx(0.999**3, rel=1e-9)
    assert state(mesh, -2.0 * mesh.points * [1.0, 0.0, 0.0], 5000.0, 0.4, law).least_volume == pytest.approx(
        -1.0
    )
    assert state(mesh, np.zeros_like(u), 5000.0, 0.4, law).energy == pytest.approx(
        0.0, abs=1e-16
    )  # rounding of 5 kPa over 54 cm3


@pytest.mark.parametrize("name", ["mujoco-flex", "newton-vbd", "ngsolve-p2p1", "ngsolve-p2p1:nonlinear"])
def test_a_missing_wheel_is_a_named_refusal(
    scene: Scene, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(registry, "find_spec", lambda _: None)
    result = models.run_model(scene, name)
    assert {status.code for status in result.status} == {models.REFUSED}
    assert "which is not installed" in result.status[0].message
    extra = "newton" if name == "newton-vbd" else "peers"
    assert f"pip install 'vdmbench[{extra}]'" in result.status[0].remedy
    study = Study.model_validate(STUDY | {"study": {"name": "test", "models": ["fem-p1", name]}})
    plan = make_plan(study, expand(study), tmp_path / "run", tmp_path / "cache")
    (line,) = refused(plan, plan.cases, [])
    assert line.startswith(f"{name}: it runs ")


@pytest.mark.skipif(importlib.util.find_spec("mujoco") is not None, reason="the wheel is here")
def test_a_run_goes_on_without_a_wheel(tmp_path: Path) -> None:
    text = SMALL_STUDY.replace('["vdm-paper", "fem-linear"]', '["mujoco-flex", "fem-linear"]')
    (tmp_path / "study.toml").write_text(text)
    told = vdmbench("run", "study.toml", "--jobs", "1", cwd=tmp_path)
    assert told.returncode == 0, told.stderr
    assert "stopped: mujoco-flex" in told.stdout
    assert "pip install 'vdmbench[peers]'" in told.stdout
    assert "1 done, 0 failed" in told.stdout


def test_what_an_engine_prints_or_breaks_stays_in_its_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from solver_common.solution import SolverError

    shutil.copy(Path(peers.__file__).with_name("engine.py"), tmp_path)
    monkeypatch.setattr(peers, "_HERE", tmp_path)
    (tmp_path / "engine_loud.py").write_text(
        "def solve(given):\n    print('a banner')\n    return {'twice': 2 * given['x']}\n"
    )
    assert_allclose(peers.call("loud", {"x": np.arange(3.0)})["twice"], [0.0, 2.0, 4.0])
    (tmp_path / "engine_bad.py").write_text("def solve(given):\n    raise RuntimeError('no licence')\n")
    (tmp_path / "engine_gone.py").write_text("import os\ndef solve(given):\n    os.abort()\n")
    for name, told in (("bad", "bad ended: RuntimeError: no licence"), ("gone", "gone ended: ")):
        with pytest.raises(SolverError, match=told):
            peers.call(name, {"x": np.zeros(1)})
    monkeypatch.setattr(peers, "MOST_SECONDS", 0.5)
    (tmp_path / "engine_slow.py").write_text("import time\ndef solve(given):\n    time.sleep(60)\n")
    with pytest.raises(SolverError, match=r"takes more than .* s"):
        peers.call("slow", {"x": np.zeros(1)})


def test_a_benchmark_of_all_leaves_them_out() -> None:
    names = json.dumps(models.benched_names())
    assert "fem-linear" in names
    assert "mujoco" not in names
    assert "newton" not in names
    assert "ngsolve" not in names


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere an engine ends with its own work")
def test_an_engine_ends_with_the_process_that_started_it(tmp_path: Path) -> None:
    shutil.copy(Path(peers.__file__).with_name("engine.py"), tmp_path)
    said = tmp_path / "pid"
    (tmp_path / "engine_slow.py").write_text(
        "import os, pathlib, time\n"
        "def solve(given):\n"
        f"    part = pathlib.Path({str(tmp_path / 'part')!r})\n"
        f"    part.write_text(str(os.getpid()))\n    part.rename({str(said)!r})\n    time.sleep(60)\n"
    )
    starting = (
        "import pathlib\nfrom vdmbench.models import peers\n"
        f"peers._HERE = pathlib.Path({str(tmp_path)!r})\npeers.call('slow', {{}})\n"
    )
    with subprocess.Popen([sys.executable, "-c", starting], cwd=Path(__file__).parents[2]) as starter:
        try:
            wait_for(said.exists)
        finally:
            starter.kill()
    engine = Path("/proc") / said.read_text()
    wait_for(lambda: not engine.exists() or "Z" in (engine / "stat").read_text().rsplit(")", 1)[1].split()[0])
