"""Models of other packages: what is wrong in them costs them alone, by name, and changes nothing of others."""

import dataclasses
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from solver_common.solution import CONVERGED, Solution
from tests.command import SMALL_STUDY, vdmbench_process
from vdmbench import machine, models
from vdmbench.body.geometry import build_mesh
from vdmbench.models.frames import frame_times
from vdmbench.scene.scene import Scene, build_scene
from vdmbench.study.config import expand, load_study
from vdmbench.study.registry import MODELS

Change = Callable[[Scene, dict[str, Any]], object]


def _plugin(change: Change) -> models.Model:
    """A model `theirs` that answers nothing moved, after `change` of the scene and of its answer."""

    def prepare(scene: Scene, solver: str, name: str, n_loads: int) -> models.SetUp:  # noqa: ARG001
        def solve(loads: Any) -> Solution:
            n, vectors = len(loads), np.zeros((len(loads), len(scene.fixed), 3))
            answer: dict[str, Any] = {
                **dict.fromkeys(("displacement", "reaction_force"), vectors),
                **dict.fromkeys(("fluid_pressure", "energy", "iterations", "seconds_per_step"), np.zeros(n)),
                "status": (CONVERGED,) * n,
                "seconds_setup": 0.0,
            }
            change(scene, answer)
            return Solution(**answer)

        return models.SetUp(solve)

    about = models.find("vdm-paper")[0]
    own = {
        "name": "theirs",
        "prepare": prepare,
        "solvers": ("linear",),
        "takes": {},
        "of_solvers": {},
    }
    return dataclasses.replace(about, **own)  # type: ignore[return-value]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    path = tmp_path_factory.mktemp("study") / "small.toml"
    path.write_text(SMALL_STUDY)
    study = expand(load_study(path))[0].study
    return build_scene(study, build_mesh(study.geometry))


@pytest.fixture(autouse=True)
def _forgotten() -> Iterator[None]:
    yield
    MODELS.pop("theirs", None)


def _set(name: str, value: Any) -> Change:
    return lambda _, answer: answer.__setitem__(name, value(answer[name]))


def _raise(error: BaseException) -> Change:
    def change(*_: Any) -> None:
        raise error

    return change


WRITES: dict[str, Change] = {
    "mesh": lambda scene, _: scene.mesh.points.__imul__(1.05),
    "surface": lambda scene, _: scene.mesh.surface_points.__imul__(1.05),
    "region": lambda scene, _: scene.regions["finger"].fill(True),
    "held": lambda scene, _: scene.fixed.fill(False),
    "pressure": lambda scene, _: scene.loads[0].facet_pressure.fill(0.0),
    "force": lambda scene, _: scene.contact_force.fill(0.0),
    "gravity": lambda scene, _: scene.loads[0].gravity.fill(1.0),
}


@pytest.mark.parametrize("name", WRITES)
def test_what_models_share_cannot_be_written(scene: Scene, name: str) -> None:
    before = models.run_model(scene, "vdm-paper").displacement
    models.register(_plugin(WRITES[name]))
    found = models.run_model(scene, "theirs")
    assert {status.code for status in found.status} == {"broken-model"}
    assert "theirs" in found.status[0].message
    assert "read-only" in found.status[0].message
    np.testing.assert_array_equal(models.run_model(scene, "vdm-paper").displacement, before)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (_set("displacement", lambda u: u[:, :-1]), "displacement of shape"),
        (_set("displacement", lambda u: np.concatenate([u, u])), "displacement of shape"),
        (_set("energy", lambda _: 0.0), "energy of shape"),
        (_set("energy", lambda e: e.astype(complex)), "no real numbers"),
        (_set("status", lambda s: s[:-1]), "one Status for each"),
        (_set("status", lambda s: ("converged",) * len(s)), "one Status for each"),
        (_set("displacement", lambda u: u * np.nan), "not finite"),
        (_set("reaction_force", lambda u: u + np.inf), "not finite"),
        (_raise(RuntimeError("no licence")), "RuntimeError: no licence (test_plugins.py:"),
        (_raise(SystemExit(0)), "SystemExit"),
        (_raise(ValueError("too soft; take another")), "too soft; take another"),
    ],
)
def test_an_answer_is_checked_and_its_model_named(scene: Scene, change: Change, told: str) -> None:
    models.register(_plugin(change))
    found = models.run_model(scene, "theirs")
    assert found.displacement.shape == (2, len(scene.fixed), 3)
    assert np.isnan(found.displacement).all()
    for status in found.status:
        assert not status.ok
        assert told in status.message
        assert "theirs" in status.message or status.code == models.REFUSED


MODULES = {
    "boom": "raise RuntimeError('no licence')",
    "leaves": "import sys\nsys.exit(0)",
    "taken": "from vdmbench.models import find, register\nregister(find('vdm-paper')[0])",
    "absent": None,
}


def test_a_package_that_does_not_load_costs_its_own_models_alone(tmp_path: Path) -> None:
    for name, text in MODULES.items():
        about = tmp_path / f"{name}-1.0.dist-info"
        about.mkdir()
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (about / "entry_points.txt").write_text(f"[vdmbench.models]\n{name} = {name}_model\n")
        if text is not None:
            (tmp_path / f"{name}_model.py").write_text(text)
    (tmp_path / "sound.toml").write_text(SMALL_STUDY)
    (tmp_path / "theirs.toml").write_text(SMALL_STUDY.replace('"vdm-paper"', '"leaves"'))
    sound = vdmbench_process("check", "sound.toml", cwd=tmp_path, PYTHONPATH=str(tmp_path))
    assert sound.returncode == 0, sound.stderr
    assert "ok" in sound.stdout
    theirs = vdmbench_process("check", "theirs.toml", cwd=tmp_path, PYTHONPATH=str(tmp_path))
    assert theirs.returncode == 2
    assert "theirs.toml:5" in theirs.stderr
    listed = vdmbench_process("list", "--models", "--json", cwd=tmp_path, PYTHONPATH=str(tmp_path))
    told = json.loads(listed.stdout)
    for name, why in {"boom": "no licence", "leaves": "SystemExit: 0", "taken": "already"}.items():
        assert why in told[name]
        assert why in theirs.stderr
    assert "absent_model" in told["absent"]


def test_a_model_with_no_time_left_has_the_rounds_that_decide(scene: Scene) -> None:
    models.register(_plugin(_set("seconds_per_step", lambda seconds: seconds + 0.03)))
    for least in (1, 3):
        found = frame_times(scene, ["theirs"], 5, 0.0, least=least)["theirs"]
        assert np.isfinite(found.contact).tolist() == [True] * least


@pytest.mark.parametrize(("limit", "rounds"), [(5e-3, 1), (6e-3, 3)])
def test_a_frame_is_timed_with_the_part_that_the_processor_works(
    scene: Scene, monkeypatch: pytest.MonkeyPatch, limit: float, rounds: int
) -> None:
    """Of each step of 40 ms it works 16 ms, which one round shows to be clearly beyond 5 ms."""
    at = {"wall": 0.0, "work": 0.0}

    def busy(seconds: np.ndarray) -> np.ndarray:
        at["wall"] += 0.04 * len(seconds)
        at["work"] += 0.016 * len(seconds)
        return seconds + 0.04

    clocks = SimpleNamespace(perf_counter=lambda: at["wall"], process_time=lambda: at["work"])
    monkeypatch.setattr(machine, "time", clocks)
    models.register(_plugin(_set("seconds_per_step", busy)))
    said: list[str] = []
    found = frame_times(scene, ["theirs"], 3, 0.0, least=3, limit=limit, begun=said.append)["theirs"]
    assert found.contact == pytest.approx(np.full(rounds, 0.04))
    assert found.contact_worked == pytest.approx(np.full(rounds, 0.016))
    assert said == [f"theirs, round {k + 1} of at most 3" for k in range(rounds)]


@pytest.mark.parametrize(("told", "known"), [(0.0, False), (1e-9, True)])
def test_frames_of_a_model_that_says_it_takes_no_time_have_an_end(
    scene: Scene, told: float, known: bool
) -> None:
    """Millions of its steps would make up a sample, with checks of each that take a thousand times as long."""
    models.register(_plugin(_set("seconds_per_step", lambda seconds: seconds + told)))
    start = time.perf_counter()
    found = frame_times(scene, ["theirs"], 1, 10.0)["theirs"]
    assert time.perf_counter() - start < 20.0
    assert np.isfinite(found.contact).all() == np.isfinite(found.everywhere).all() == known
