"""A surface model's result for a multiple of a load is the multiple of its result."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from studies import models
from studies.meshing.geometry import build_mesh
from studies.meshing.mesh import Mesh
from studies.metrics import METRICS, History, Metric, evaluate_all
from studies.proportional import Comparisons
from studies.scene import Scene, build_scene
from studies.setups import sharing
from studies.study_file.config import geometry_of
from studies.study_file.schema import Study
from studies.surface_measures import Surface

NAMES = ["vdm-paper", "vdm-consistent", "vdm-vector", "vdm-boundary", "mass-spring"]
BASE = {"kind": "fixed", "region": "base"}
PUSH = {"kind": "contact", "region": "finger", "profile": "hertz", "pressure": 40.0}
PULL = {"kind": "constrained", "region": "side", "displacement": [0.0003, 0.0, -0.0002]}
TABLES: dict[str, Any] = {
    "study": {"name": "test", "models": NAMES},
    "geometry": {"shape": "sphere", "radius": 0.05, "mesh_size": 0.018},
    "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.45, "density": 1000.0},
    "regions": {
        "base": {"below": {"axis": "z", "fraction": 0.2}},
        "side": {"cap": {"direction": [1.0, 0.0, 0.1], "angle": 0.5}},
        "finger": {"cap": {"direction": [0.0, 0.0, 1.0], "angle": 0.6}},
    },
    "constraints": [BASE, PUSH, PULL],
    "environment": {"pressure": 1000.0},
    "load": {"factors": [0.25, 0.5]},
}


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    return build_mesh(geometry_of(Study.model_validate(TABLES)))


def scene_of(mesh: Mesh, push: float = 1.0, pull: float = 1.0, **changes: Any) -> Scene:
    """The scene with `push` times the pressure and `pull` times the displacement."""
    constraints = [
        BASE,
        PUSH | {"pressure": 40.0 * push},
        PULL | {"displacement": [pull * x for x in PULL["displacement"]]},
    ]
    return build_scene(Study.model_validate(TABLES | {"constraints": constraints} | changes), mesh)


def is_scaled(result: models.ModelResult) -> bool:
    return "steps_scaled" in result.parameters


@pytest.mark.parametrize("name", NAMES)
def test_a_multiple_has_the_numbers_of_its_own_solve(mesh: Mesh, name: str) -> None:
    other = scene_of(mesh, 1.7, 1.7, load={"factors": [0.1, 1.0, 0.0, -3.0]})
    alone = models.run_model(other, name)
    with sharing():
        first = models.run_model(scene_of(mesh), name)
        follows = models.run_model(other, name)
    assert [is_scaled(result) for result in (alone, first, follows)] == [False, False, True]
    assert "setup_shared" in follows.parameters
    for field in ("displacement", "reaction_force", "energy", "fluid_pressure", "volume"):
        a, b = getattr(follows, field), getattr(alone, field)
        assert_allclose(a, b, rtol=0, atol=1e-12 * np.abs(b).max(), err_msg=field)
    assert [s.code for s in follows.status] == [s.code for s in alone.status] == ["converged"] * 4
    assert follows.scalars.keys() == alone.scalars.keys()
    assert (follows.seconds_per_step == np.median(first.seconds_per_step)).all()
    assert follows.iterations.tolist() == alone.iterations.tolist()
    assert follows.peak_bytes == first.peak_bytes


@pytest.mark.parametrize(
    "changes",
    [
        {"push": 2.0},
        {"push": 1.0 + 1e-12},
        {"pull": 0.0},
        {"push": 2.0, "pull": 2.0, "gravity": {"acceleration": [0.0, 0.0, -9.81]}},
        {"push": 2.0, "pull": 2.0, "environment": {"pressure": 0.0}},
        {"push": 2.0, "pull": 2.0, "vdm": {"penalty": 1e6}},
    ],
)
def test_another_load_body_or_datum_is_solved(mesh: Mesh, changes: dict[str, Any]) -> None:
    fixed = {k: v for k, v in changes.items() if k in ("gravity", "vdm")}
    with sharing():
        models.run_model(scene_of(mesh, **fixed), "vdm-vector")
        follows = models.run_model(scene_of(mesh, **changes), "vdm-vector")
    assert not is_scaled(follows)
    alone = models.run_model(scene_of(mesh, **changes), "vdm-vector")
    assert_allclose(
        follows.displacement, alone.displacement, rtol=0, atol=1e-12 * np.abs(alone.displacement).max()
    )


def test_only_a_linear_solver_scales(mesh: Mesh) -> None:
    with sharing():
        for push in (1.0, 2.0):
            for name in ("vdm-vector:nonlinear", "vdm-vector:single", "fem-linear"):
                assert not is_scaled(models.run_model(scene_of(mesh, push, push), name))


def test_nothing_is_scaled_from_no_load_or_from_a_failure(mesh: Mesh) -> None:
    with sharing():
        models.run_model(scene_of(mesh, 0.0, 0.0), "vdm-vector")
        assert not is_scaled(models.run_model(scene_of(mesh), "vdm-vector"))
        # no load is a multiple of any
        assert is_scaled(models.run_model(scene_of(mesh, 0.0, 0.0), "vdm-vector"))


def test_a_condition_is_not_left_out_for_a_multiple(mesh: Mesh) -> None:
    asking = {"study": TABLES["study"] | {"condition": True}}
    with sharing():
        models.run_model(scene_of(mesh), "vdm-vector")
        asked, again = (models.run_model(scene_of(mesh, k, k, **asking), "vdm-vector") for k in (2.0, 3.0))
    assert [is_scaled(result) for result in (asked, again)] == [False, True]
    assert again.scalars["condition_estimate"][0] == asked.scalars["condition_estimate"][0] > 1.0


def histories_of(scene: Scene, names: list[str]) -> dict[str, History]:
    results = {name: models.run_model(scene, name) for name in names}
    return {
        name: History(result.displacement, result.reaction_force, scene.load_factors)
        for name, result in results.items()
    }


def under(comparisons: Comparisons, scene: Scene) -> Surface:
    return comparisons.surface.under(scene.contact, scene.contact_force)


def measured(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The metrics that are measured from now on."""
    seen: list[str] = []

    def watched(metric: Metric) -> Metric:
        def function(*arguments: Any) -> Any:
            seen.append(metric.name)
            return metric.function(*arguments)

        return dataclasses.replace(metric, function=function)

    for name, metric in METRICS.items():
        monkeypatch.setitem(METRICS, name, watched(metric))
    return seen


@pytest.mark.parametrize("share", [1e-3, 1.7])
def test_a_multiple_has_the_metrics_of_its_own_case(
    mesh: Mesh, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    comparisons, scene, other = Comparisons(mesh), scene_of(mesh), scene_of(mesh, share, share)
    with sharing():
        first, results = (histories_of(each, ["vdm-paper", "vdm-vector"]) for each in (scene, other))
    comparisons.compare(under(comparisons, scene), first, "vdm-vector")
    plain = evaluate_all(under(comparisons, other), results, "vdm-vector")
    seen = measured(monkeypatch)
    found = comparisons.compare(under(comparisons, other), results, "vdm-vector")
    assert set(seen) == {name for name, metric in METRICS.items() if metric.degree is None}
    assert {model: set(metrics) for model, metrics in found.items()} == {m: set(v) for m, v in plain.items()}
    for model, metrics in plain.items():
        for name, values in metrics.items():
            assert_allclose(found[model][name], values, rtol=1e-12, atol=0, err_msg=f"{model} {name}")


def test_what_is_no_multiple_is_measured(mesh: Mesh) -> None:
    scene = scene_of(mesh)
    comparisons = Comparisons(mesh)
    first = histories_of(scene, ["vdm-paper", "vdm-vector"])
    comparisons.compare(under(comparisons, scene), first, "vdm-vector")
    twice = {
        name: dataclasses.replace(h, displacement=2 * h.displacement, reaction_force=2 * h.reaction_force)
        for name, h in first.items()
    }
    nudged = twice["vdm-paper"].displacement.copy()
    nudged[0, 0, 0] += 1e-12 * np.abs(nudged).max()
    gone = np.where(np.arange(len(nudged))[:, None, None] == 0, np.nan, nudged)
    more = scene_of(mesh, 2.0, 2.0)
    paper = twice["vdm-paper"]
    for surface, models_, reference in [
        (
            under(comparisons, more),
            twice | {"vdm-paper": dataclasses.replace(paper, displacement=nudged)},
            "vdm-vector",
        ),
        (
            under(comparisons, more),
            twice | {"vdm-paper": dataclasses.replace(paper, displacement=gone)},
            "vdm-vector",
        ),
        (under(comparisons, scene), twice, "vdm-vector"),
        (dataclasses.replace(under(comparisons, more), weighs=True), twice, "vdm-vector"),
        (under(comparisons, more), twice, "vdm-paper"),
        (under(comparisons, more), twice, None),
        (comparisons.surface.under(~scene.contact, 2 * scene.contact_force), twice, "vdm-vector"),
        (
            comparisons.surface.under(scene.contact, -scene.contact_force),
            {
                n: dataclasses.replace(h, displacement=-h.displacement, reaction_force=-h.reaction_force)
                for n, h in first.items()
            },
            "vdm-vector",
        ),
        (
            under(comparisons, more),
            {n: dataclasses.replace(h, load_factors=2 * h.load_factors) for n, h in twice.items()},
            "vdm-vector",
        ),
    ]:
        found = dataclasses.replace(comparisons).compare(surface, models_, reference)
        plain = evaluate_all(surface, models_, reference)
        assert found.keys() == plain.keys()
        for model, metrics in plain.items():
            assert metrics.keys() == found[model].keys()
            for name, values in metrics.items():
                assert np.array_equal(found[model][name], values, equal_nan=True), (model, name)
