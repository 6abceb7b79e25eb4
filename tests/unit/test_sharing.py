"""Cases that share work: shared numbers are those of each case alone, and counted as the plan says."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import fem_reference.condensed
import fem_reference.linear
from studies import work as counted
from studies import worker
from studies.explain import summary
from studies.plan import task_of
from studies.reference import own_error, refined_levels

from . import shared_work
from .shared_work import ALONE, MOVED, TABLES, assert_same_results, plan_of, run, run_alone

cache, made = shared_work.cache, shared_work.made  # the fixtures


def test_shared_numbers_are_those_of_each_case_alone(tmp_path: Path, cache: Path, made: Counter[str]) -> None:
    plan = plan_of(tmp_path / "together", cache)
    work = counted.work_of(plan, plan.cases)
    together = run(plan)
    # one set-up on each mesh level; two patches, all else are multiples; a surface model solves a history's steps
    assert made == {"fem set-ups": 2, "vdm set-ups": 1, "fem solves": 4, "vdm solves": 4}
    of_fem = [part for part in work if part.name == "fem-linear"]
    assert sum(part.setups for part in of_fem) == made["fem set-ups"]
    assert sum(part.solves for part in of_fem) == made["fem solves"]
    assert sum(part.setups for part in work if part.name == "vdm-vector") == made["vdm set-ups"]
    for case, planned in zip(together, plan.cases, strict=True):
        alone = run_alone(planned, plan, tmp_path / "alone")
        assert_same_results(case, alone, 1e-12, 1e-12)
        assert case.models["fem-linear refined"].parameters["setup_shared"] == "yes"
        assert "setup_shared" not in alone.models["vdm-vector"].parameters
        for name, series in alone.metrics.items():
            for metric, entry in series.items():
                values = case.metrics[name][metric].values
                assert_allclose(values, entry.values, rtol=1e-9, atol=1e-13, err_msg=f"{name} {metric}")


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
PARAMETERS = {"sweep": {"vdm.surface_tension": [20.0, 30.0, 40.0]}, "vdm": {"surface_tension": 20.0}}
WEIGHT = {"gravity": {"acceleration": [0.0, 0.0, -9.81]}}
SUPPORTS = {"sweep": {"regions.base.below.fraction": [0.2, 0.3], "constraints.finger.force": [0.1, 0.3]}}


PENALTY = {"vdm": {"penalty": 1e6}}


LEVELS = {"sweep": {"uncertainty.levels": [2, 3], "constraints.finger.force": [0.1, 0.3]}}
BESIDE = {
    "study": {
        "name": "test",
        "models": ["vdm-vector", "fem-p1", "fem-p2", "fem-linear"],
        "reference": "fem-linear",
    }
}
FINITE = {
    "study": {"name": "test", "models": ["vdm-vector", "fem-linear", "fem"], "reference": "fem"},
    "uncertainty": None,
    "geometry": TABLES["geometry"] | {"mesh_size": 0.03},
}


@pytest.mark.parametrize(
    "changes",
    [
        {},
        HISTORY,
        TISSUES,
        ZIPPED,
        PARAMETERS,
        WEIGHT,
        SUPPORTS,
        PENALTY,
        MOVED,
        ALONE,
        BESIDE,
        FINITE,
        ALONE | WEIGHT,
    ],
)
def test_what_is_planned_is_what_is_done(tmp_path: Path, made: Counter[str], changes: dict[str, Any]) -> None:
    plan = plan_of(tmp_path, tmp_path / "cache", **changes)
    work = counted.work_of(plan, plan.cases)
    run(plan)
    linear = ("fem-linear", "fem-p1", "fem-p2")
    of_fem, of_vdm = ([part for part in work if part.name in names] for names in (linear, ("vdm-vector",)))
    planned = {
        "fem set-ups": sum(part.setups for part in of_fem),
        "fem solves": sum(part.solves for part in of_fem),
        "vdm set-ups": sum(part.setups for part in of_vdm),
        "vdm solves": sum(part.solves for part in of_vdm),
    }
    assert made == planned


@pytest.mark.parametrize("changes", [ALONE, BESIDE, ZIPPED, ALONE | WEIGHT, ALONE | MOVED, LEVELS])
def test_elements_of_any_place_have_the_numbers_of_each_case_alone(
    tmp_path: Path, cache: Path, changes: dict[str, Any]
) -> None:
    plan = plan_of(tmp_path / "together", cache, **changes)
    for case, planned in zip(run(plan), plan.cases, strict=True):
        alone = run_alone(planned, plan, tmp_path / "alone")
        assert case.reference_error.get("levels") == alone.reference_error.get("levels")
        # iterations from a random start end at their own residual
        assert_same_results(case, alone, 1e-12, 1e-10)


def _sums_documented() -> dict[str, tuple[float, float]]:
    """Solver -> bounds of results and of metrics, from the table of results/FORMAT.md."""
    text = (Path(__file__).parents[2] / "results" / "FORMAT.md").read_text()
    rows = re.findall(
        r"^\| (direct|iterative) \| (\S+) \(\S+\) \| (\S+) \(\S+\) \|$", text, flags=re.MULTILINE
    )
    return {solver: (float(results), float(metrics)) for solver, results, metrics in rows}


@pytest.mark.parametrize(
    ("solver", "nu"), [("direct", 0.49), ("direct", 0.4999), ("iterative", 0.3), ("iterative", 0.4999)]
)
def test_sums_of_loads_agree_with_each_case_alone_as_documented(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, solver: str, nu: float
) -> None:
    choose = fem_reference.linear.choose_solver
    monkeypatch.setattr(
        fem_reference.linear, "choose_solver", lambda system, _, *more: choose(system, solver, *more)
    )
    models = ["vdm-vector", "fem-linear", *(["fem-p2"] if solver == "direct" else [])]
    study = {
        "study": TABLES["study"] | {"models": models},
        "tissue": TABLES["tissue"] | {"poisson_ratio": nu},
    }
    sweep = {"constraints.tool.displacement.0": [-0.001, 0.002], "constraints.finger.force": [0.1, -0.3]}
    changes = MOVED | study | {"sweep": sweep}
    plan = plan_of(tmp_path / "together", tmp_path, **changes)
    of_results, of_metrics = _sums_documented()[solver]
    refined = [part for part in counted.work_of(plan, plan.cases) if part.level]
    assert sum(part.solves for part in refined) < sum(part.steps for part in refined) / 2, "sums"
    for case, planned in zip(run(plan), plan.cases, strict=True):
        alone = run_alone(planned, plan, tmp_path / "alone")
        for name, result in alone.models.items():
            assert name == "vdm-vector" or result.parameters["solver"] == solver
        assert_same_results(case, alone, of_results, of_results)
        for name, series in alone.metrics.items():
            for metric, entry in series.items():
                values = case.metrics[name][metric].values
                apart = of_metrics * (1.0 if entry.unit == "1" else np.nanmax(np.abs(entry.values)))
                assert_allclose(values, entry.values, rtol=0, atol=apart, err_msg=f"{name} {metric}")


@pytest.mark.parametrize("displacements", [[-0.001, -0.002], [-0.001, 0.0]])
def test_condensed_elements_are_set_up_as_often_as_planned(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch, displacements: list[float]
) -> None:
    made: list[int] = []
    start = fem_reference.condensed.CondensedProblem.__init__

    def counted_start(self: Any, *arguments: Any, **options: Any) -> None:
        made.append(1)
        start(self, *arguments, **options)

    monkeypatch.setattr(fem_reference.condensed.CondensedProblem, "__init__", counted_start)
    sweep = {"constraints.tool.displacement.0": displacements, "constraints.finger.force": [0.1, 0.2]}
    study = {"study": {"name": "test", "models": ["fem-condensed"]}, "uncertainty": None}
    plan = plan_of(tmp_path, cache, **(MOVED | study | {"sweep": sweep}))
    (work,) = counted.work_of(plan, plan.cases)
    run(plan)
    assert len(made) == work.setups


def test_workers_that_divide_a_group_make_its_set_ups_each(tmp_path: Path, made: Counter[str]) -> None:
    plan = plan_of(tmp_path / "run", tmp_path / "cache")
    work = counted.work_of(plan, plan.cases_to_run(), 2)
    run(plan, jobs=2)
    for kind, name in (("fem", "fem-linear"), ("vdm", "vdm-vector")):
        parts = [part for part in work if part.name == name]
        assert made[f"{kind} set-ups"] == sum(part.setups for part in parts)
        assert made[f"{kind} solves"] == sum(part.solves for part in parts)

    plan = plan_of(tmp_path, tmp_path / "cache", uncertainty={"levels": 3})
    assert len(plan.groups(plan.in_order, 2)) == 2 > len(plan.groups(plan.in_order, 1))
    work = counted.work_of(plan, plan.cases_to_run(), 2)
    vector = [part for part in work if part.name == "vdm-vector"]
    assert [(part.worker, part.setups) for part in vector] == [(0, 1), (1, 1)]
    alone, divided = (summary(plan, jobs) for jobs in (1, 2))
    assert (alone["groups"], divided["groups"]) == (1, 2)
    assert divided["estimate"]["seconds"] > alone["estimate"]["seconds"]
    assert [line.split(": 1 set-up, ")[0] for line in alone["needed"]] == [
        f"fem-linear, refined {times} for its error bar" for times in ("1 time", "2 times")
    ]
    assert all(": 2 set-ups, " in line for line in divided["needed"])
    assert summary(plan_of(tmp_path, tmp_path / "cache", uncertainty=None))["needed"] == []


def test_groups_are_split_among_workers_and_shards_keep_them_whole(tmp_path: Path, cache: Path) -> None:
    sweep = {
        "tissue.poisson_ratio": [0.45, 0.49],
        "constraints.finger.force": {"start": 0.1, "stop": 1.0, "num": 6},
    }
    plan = plan_of(tmp_path, cache, sweep=sweep)
    assert [len(group) for group in plan.groups(plan.in_order, 1)] == [12]
    assert [len(group) for group in plan.groups(plan.in_order, 2)] == [6, 6]
    assert [len(group) for group in plan.groups(plan.in_order, 4)] == [3, 3, 3, 3]
    shards = [plan.cases_to_run((k, 2)) for k in (1, 2)]
    assert [len({case.setup for case in shard}) for shard in shards] == [1, 1]
    assert sorted(case.hash for shard in shards for case in shard) == sorted(case.hash for case in plan.cases)


@pytest.mark.parametrize("factors", [[0.5, 1.0], [1.0]])
def test_a_batch_and_one_case_give_one_reference(tmp_path: Path, cache: Path, factors: list[float]) -> None:
    """And one error of it: of a single load it comes from the metrics of the case."""
    plan = plan_of(tmp_path, cache, load={"factors": factors})
    case = run(plan)[0]
    study = plan.cases[0].study
    task = task_of(plan.cases[0], plan)
    scene = worker.build_scene(study, worker._mesh(study, task))
    finest = refined_levels([study], [scene], "fem-linear", [2])[0][0]
    stored = case.models["fem-linear refined"].displacement
    assert_allclose(finest.displacement, stored, rtol=0, atol=1e-12 * np.abs(stored).max())
    error = own_error(worker._surface(scene), [finest, case.models["fem-linear"]], scene.load_factors)
    assert error == pytest.approx(case.reference_error, rel=1e-9, abs=0, nan_ok=True)
