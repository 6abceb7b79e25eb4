"""A study as a graph: what has one key is done once, what is there is not done, and no number hangs on sharing."""

import dataclasses
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.in_process import HerePool
from vdmbench import models
from vdmbench.measures import metrics
from vdmbench.store.cases import read_case
from vdmbench.store.run_directory import write_plan
from vdmbench.work.explain import require_own, summary
from vdmbench.work.pool import local_pool, run_tasks
from vdmbench.work.run import Event, Options, _run_missing
from vdmbench.work.tasks import tasks_of

from . import shared_work
from .shared_work import (
    ALONE,
    BASE,
    FINGER,
    MOVED,
    TABLES,
    assert_same_results,
    plan_of,
    planned_work,
    run,
    run_alone,
)

cache, made, meshes = shared_work.cache, shared_work.made, shared_work.meshes  # the fixtures

LINEAR = ("fem-linear", "fem-p1", "fem-p2")
HISTORY = {"load": {"factors": [0.25, 0.5, 1.0]}, "sweep": {}, "uncertainty": None}
TISSUES = {"sweep": {"tissue.poisson_ratio": [0.45, 0.49], "constraints.finger.force": [0.1, 0.3]}}
ZIPPED = {
    "sweep": {
        "mode": "zip",
        "tissue.poisson_ratio": [0.45, 0.49, 0.45, 0.4],
        "constraints.finger.force": [0.1, 0.3, -0.2, 0.4],
        "regions.finger.cap.direction.0": [0.0, 0.4, 0.4, 0.4],
    }
}
WEIGHT = {"gravity": {"acceleration": [0.0, 0.0, -9.81]}, "tissue": TABLES["tissue"] | {"density": 1000.0}}
PENALTY = {"vdm": {"penalty": 1e6}}
FINITE = {
    "study": {"name": "test", "models": ["vdm-vector", "fem-linear", "fem"], "reference": "fem"},
    "uncertainty": None,
    "sweep": {"constraints.finger.force": [0.1, 0.3]},
}


@pytest.mark.parametrize("changes", [ZIPPED, WEIGHT, PENALTY, MOVED, FINITE])
def test_what_is_planned_is_what_is_done(
    tmp_path: Path, cache: Path, made: Counter[str], changes: dict[str, Any]
) -> None:
    plan = plan_of(tmp_path, cache, **changes)
    of_fem, of_vdm = planned_work(plan, *LINEAR), planned_work(plan, "vdm-vector")
    run(plan)
    assert made["fem set-ups"] == of_fem["set-ups"]
    assert made["fem solves"] <= of_fem["solves"], "sums of others are not solved"
    assert (made["vdm set-ups"], made["vdm solves"]) == (of_vdm["set-ups"], of_vdm["solves"])
    made.clear()
    run(plan_of(tmp_path, cache, **changes))
    assert not made, "what is done is not done again"


def test_two_places_and_two_forces_are_two_loads_on_one_body(
    tmp_path: Path, cache: Path, made: Counter[str]
) -> None:
    run(plan_of(tmp_path, cache))
    assert made == {"fem set-ups": 2, "fem solves": 4, "vdm set-ups": 1, "vdm solves": 2}


@pytest.mark.parametrize("changes", [ZIPPED, ALONE | MOVED])
def test_shared_numbers_are_those_of_each_case_alone(
    tmp_path: Path, cache: Path, changes: dict[str, Any]
) -> None:
    plan = plan_of(tmp_path / "together", cache, **changes)
    for case, planned in zip(run(plan), plan.cases, strict=True):
        alone = run_alone(planned, plan, tmp_path / "alone")
        # iterations end at their own residual
        assert_same_results(case, alone, 1e-12, 1e-10)
        assert case.reference_error.keys() == alone.reference_error.keys()
        for name, series in alone.metrics.items():
            for metric, entry in series.items():
                values = case.metrics[name][metric]
                assert_allclose(values, entry, rtol=1e-8, atol=1e-12, err_msg=f"{name} {metric}")


def test_a_combination_is_what_a_model_answers_to_the_load_itself(tmp_path: Path, cache: Path) -> None:
    """The long way: every model set up and solved for the very scene of the case."""
    plan = plan_of(tmp_path, cache, **(HISTORY | {"environment": {"pressure": 100.0}}))
    (case,) = run(plan)
    scene = shared_work.scene_of(plan, plan.cases[0])
    for name in ("vdm-vector", "fem-linear"):
        long = models.run_model(scene, name)
        for field in ("displacement", "reaction_force", "energy", "fluid_pressure", "volume"):
            a, b = getattr(case.models[name], field), getattr(long, field)
            assert_allclose(a, b, rtol=0, atol=1e-12 * np.abs(b).max(), err_msg=f"{name} {field}")


def test_a_further_model_costs_that_model(tmp_path: Path, cache: Path, made: Counter[str]) -> None:
    before = run(plan_of(tmp_path, cache))
    made.clear()
    study = TABLES["study"] | {"models": ["vdm-vector", "vdm-paper", "fem-linear"]}
    plan = plan_of(tmp_path, cache, study=study)
    found = tasks_of(plan, plan.cases)
    assert [task.payload["name"] for task in found if task.kind == "answers"] == ["vdm-paper"]
    after = run(plan)
    assert made == {"vdm set-ups": 1, "vdm solves": 2}
    for a, b in zip(after, before, strict=True):
        for name, result in b.models.items():
            np.testing.assert_array_equal(a.models[name].displacement, result.displacement)
        assert a.reference_error == b.reference_error


def test_another_study_uses_the_same_answers(tmp_path: Path, cache: Path, made: Counter[str]) -> None:
    run(plan_of(tmp_path / "a", cache))
    made.clear()
    regions = {"bed": TABLES["regions"]["base"], "tip": TABLES["regions"]["finger"]}
    constraints = [BASE | {"region": "bed"}, FINGER | {"region": "tip", "force": 0.3}]
    changes = {"regions": regions, "constraints": constraints, "vdm": {"surface_tension": 20.0}}
    sweep = {"regions.tip.cap.direction.0": [0.0, 0.4], "vdm.surface_tension": [20.0, 30.0]}
    run(plan_of(tmp_path / "b", cache, **changes, sweep=sweep))
    assert made == {"vdm set-ups": 2, "vdm solves": 4}, (
        "names do not matter, nor VDM's parameters to the reference"
    )


def test_more_levels_serve_fewer(tmp_path: Path, cache: Path, made: Counter[str]) -> None:
    run(plan_of(tmp_path / "a", cache, sweep={}, uncertainty={"levels": 3}))
    made.clear()
    (case,) = run(plan_of(tmp_path / "b", cache, sweep={}, uncertainty={"levels": 2}))
    assert not made
    assert case.reference_error["levels"] == 2


def test_what_nobody_asks_for_has_no_node(tmp_path: Path) -> None:
    plan = plan_of(
        tmp_path, tmp_path / "none", study={"name": "test", "models": ["vdm-vector"]}, uncertainty=None
    )
    found = tasks_of(plan, plan.cases)
    assert Counter(task.kind for task in found) == {"mesh": 1, "answers": 1, "case": 4}
    assert not any(task.payload["volume"] for task in found), "no tetrahedra"


def test_an_answer_that_is_gone_meanwhile_is_told(tmp_path: Path, cache: Path) -> None:
    plan = plan_of(tmp_path, cache)
    cases = [task for task in tasks_of(plan, plan.cases) if task.kind == "case"]
    said = [one for _, one in run_tasks(cases, HerePool(), tmp_path / "failed")]
    assert all("is gone" in one.message and one.remedy for one in said)


def test_another_metric_version_costs_no_solve(
    tmp_path: Path, cache: Path, made: Counter[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = run(plan_of(tmp_path, cache))
    made.clear()
    name = "max_nodal_error"
    old = metrics.METRICS[name]
    changed = dataclasses.replace(old, version=99, function=lambda *a: 2 * old.function(*a))
    monkeypatch.setitem(metrics.METRICS, name, changed)
    plan = plan_of(tmp_path, cache)
    assert set(plan.state.values()) == {"missing"}
    for a, b in zip(run(plan), before, strict=True):
        assert_allclose(a.metrics["vdm-vector"][name], 2 * b.metrics["vdm-vector"][name], rtol=1e-12, atol=0)
    assert not made, "nothing is set up or solved"


@pytest.mark.parametrize("displacements", [[-0.001, -0.002], [-0.001, 0.0]])
def test_condensed_elements_are_set_up_as_often_as_planned(
    tmp_path: Path, cache: Path, made: Counter[str], displacements: list[float]
) -> None:
    sweep = {"constraints.tool.displacement.0": displacements, "constraints.finger.force": [0.1, 0.2]}
    study = {"study": {"name": "test", "models": ["fem-condensed"]}, "uncertainty": None}
    plan = plan_of(tmp_path, cache, **(MOVED | study | {"sweep": sweep}))
    planned = planned_work(plan)
    run(plan)
    assert made["fem set-ups"] == planned["set-ups"]


def test_one_and_three_workers_give_the_same_numbers(tmp_path: Path) -> None:
    """Bit for bit, whichever worker is faster."""
    found = []
    for jobs in (1, 3):
        plan = plan_of(tmp_path / f"{jobs}", tmp_path / f"cache-{jobs}", **ALONE)
        with local_pool(jobs) as pool:
            outcomes = list(run_tasks(tasks_of(plan, plan.cases), pool, tmp_path / "logs"))
        assert all(said.ok for _, said in outcomes), outcomes
        found.append([read_case(plan.case_file(case)) for case in plan.cases])
    assert list((tmp_path / "logs").iterdir()) == []
    for first, *others in zip(*found, strict=True):
        for other in others:
            for name, result in first.models.items():
                for field in ("displacement", "reaction_force", "energy", "fluid_pressure", "volume"):
                    a, b = getattr(result, field), getattr(other.models[name], field)
                    np.testing.assert_array_equal(a, b, err_msg=f"{name} {field}")


def test_no_gravity_is_no_weight(tmp_path: Path) -> None:
    none, zero = (
        plan_of(tmp_path, tmp_path, **gravity)
        for gravity in ({}, {"gravity": {"acceleration": [0.0, 0.0, 0.0]}})
    )
    assert [case.wanted for case in none.cases] == [case.wanted for case in zero.cases]


def test_loads_that_differ_beyond_measure(tmp_path: Path, cache: Path) -> None:
    for force in (1e-155, 0.1):
        (case,) = run(plan_of(tmp_path, cache, sweep={"constraints.finger.force": [force]}))
        assert all(np.isfinite(result.energy).all() for result in case.models.values()), force
    (alone,) = run(plan_of(tmp_path / "b", cache, fresh=True, sweep={"constraints.finger.force": [0.1]}))
    for name, result in alone.models.items():
        assert_allclose(case.models[name].energy, result.energy, rtol=1e-12, atol=0, err_msg=name)


def test_shards_have_each_case_once(tmp_path: Path, cache: Path) -> None:
    plan = plan_of(tmp_path, cache, sweep=TISSUES["sweep"] | {"constraints.finger.force": [0.1, 0.2, 0.3]})
    shards = [plan.cases_to_run((k, 4)) for k in (1, 2, 3, 4)]
    assert sorted(case.hash for shard in shards for case in shard) == sorted(case.hash for case in plan.cases)


def test_a_run_says_before_it_begins_how_much_there_is_to_tell(tmp_path: Path, cache: Path) -> None:
    plan, events = plan_of(tmp_path, cache, **ALONE), list[Event]()
    _run_missing(plan, tasks_of(plan, plan.cases), Options(jobs=1), events.append, HerePool())
    assert [event.kind for event in events].index("begun") == 0
    assert events[0].count == sum(event.kind in ("done", "failed", "stopped") for event in events) > 4


def test_a_body_that_bench_brings_itself_does_not_ask_whose_surface_is_there(tmp_path: Path) -> None:
    plan = plan_of(tmp_path / "run", tmp_path / "cache")
    write_plan(plan.directory, summary(plan))
    require_own(dataclasses.replace(plan, command=("bench", "--surface", "ball.obj")))
