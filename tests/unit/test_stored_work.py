"""What is stored is not solved again, and changes no number; nothing stored is used where that is asked for."""

from __future__ import annotations

import dataclasses
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from studies import metrics, worker
from studies import work as counted
from studies.case import StepStatus
from studies.explain import summary
from studies.plan import task_of
from studies.store import read_case
from studies.worker import share

from . import shared_work
from .shared_work import TABLES, assert_same_results, plan_of, run

cache, made = shared_work.cache, shared_work.made  # the fixtures


def test_a_further_model_costs_that_model(tmp_path: Path, cache: Path, made: Counter[str]) -> None:
    before = run(plan_of(tmp_path, cache))
    made.clear()
    study = TABLES["study"] | {"models": ["vdm-vector", "vdm-paper", "fem-linear"]}
    plan = plan_of(tmp_path, cache, study=study)
    assert {part.name for part in counted.work_of(plan, plan.cases)} == {"vdm-paper"}
    after = run(plan)
    assert made == {"vdm set-ups": 1, "vdm solves": 4}
    for a, b in zip(after, before, strict=True):
        assert set(a.models) == {*b.models, "vdm-paper"}
        assert set(a.metrics) == set(a.models)
        for name, result in b.models.items():
            np.testing.assert_array_equal(a.models[name].displacement, result.displacement)
            assert a.models[name].parameters["measured_earlier"] == "yes"
        assert "measured_earlier" not in a.models["vdm-paper"].parameters
        assert a.reference_error == b.reference_error


def test_another_study_uses_the_same_reference(tmp_path: Path, cache: Path, made: Counter[str]) -> None:
    run(plan_of(tmp_path / "a", cache))
    made.clear()
    regions = {"bed": TABLES["regions"]["base"], "tip": TABLES["regions"]["finger"]}
    constraints = [
        {"kind": "fixed", "region": "bed"},
        {"name": "finger", "kind": "contact", "region": "tip", "force": 0.3, "profile": "hertz"},
    ]
    changes = {"regions": regions, "constraints": constraints, "vdm": {"surface_tension": 20.0}}
    sweep = {"regions.tip.cap.direction.0": [0.0, 0.4], "vdm.surface_tension": [20.0, 30.0]}
    plan = plan_of(tmp_path / "b", cache, **changes, sweep=sweep)
    assert all(plan.reference_cached(case) for case in plan.cases)
    run(plan)
    assert made == {"vdm set-ups": 2, "vdm solves": 8}, (
        "names do not matter, and VDM's parameters not to the reference"
    )


@pytest.mark.parametrize("factors", [[0.5, 1.0], [0.2, -3.0]])
@pytest.mark.parametrize("levels", [1, 2])
def test_a_load_that_is_a_multiple_of_a_stored_one_is_not_solved(
    tmp_path: Path, cache: Path, made: Counter[str], factors: list[float], levels: int
) -> None:
    bar = {"uncertainty": {"levels": levels} if levels > 1 else None}
    run(plan_of(tmp_path / "a", tmp_path / "cache", sweep={}, **bar))
    made.clear()
    edited = {"sweep": {"constraints.finger.force": [0.07, 11.0]}, "load": {"factors": factors}} | bar
    plan = plan_of(tmp_path / "b", tmp_path / "cache", **edited)
    assert any("the reference of 2 cases: already in the cache" in line for line in summary(plan)["skipped"])
    assert not [part for part in counted.work_of(plan, plan.cases) if part.name == "fem-linear"]
    found = run(plan)
    assert made["fem solves"] == made["fem set-ups"] == 0
    alone = run(plan_of(tmp_path / "c", cache, fresh=True, **edited))
    assert made["fem solves"] > 0
    for case, other in zip(found, alone, strict=True):
        assert_same_results(case, other, 1e-12, 1e-12)
        assert "measured_earlier" in case.models["fem-linear"].parameters
        assert case.reference_error.keys() == other.reference_error.keys()
        for name, value in other.reference_error.items():
            assert_allclose(case.reference_error[name], value, rtol=1e-8, atol=1e-12, err_msg=name)


def test_a_result_that_failed_is_no_reference(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    study = {"name": "test", "models": ["vdm-vector", "fem-linear"]}
    changes: dict[str, Any] = {"sweep": {}, "uncertainty": None}
    with monkeypatch.context() as patched:
        run_model = worker.models.run_model

        def failing(scene: Any, name: str) -> Any:
            result = run_model(scene, name)
            if name != "fem-linear":
                return result
            stopped = StepStatus("diverged", "it did not converge", "")
            return dataclasses.replace(
                result, status=(stopped,) * 2, displacement=np.full_like(result.displacement, np.nan)
            )

        patched.setattr(worker.models, "run_model", failing)
        run(plan_of(tmp_path, tmp_path / "cache", study=study, **changes))
    with pytest.raises(ValueError, match="it did not converge"):
        run(plan_of(tmp_path, tmp_path / "cache", study=study | {"reference": "fem-linear"}, **changes))


def test_loads_that_differ_beyond_measure_are_no_multiples(tmp_path: Path, cache: Path) -> None:
    for force in (1e-155, 0.1):
        (case,) = run(plan_of(tmp_path, tmp_path / "cache", sweep={"constraints.finger.force": [force]}))
        assert all(np.isfinite(result.energy).all() for result in case.models.values()), force
    (alone,) = run(plan_of(tmp_path / "b", cache, fresh=True, sweep={"constraints.finger.force": [0.1]}))
    for name, result in alone.models.items():
        assert_allclose(case.models[name].energy, result.energy, rtol=1e-12, atol=0, err_msg=name)
    plan = plan_of(tmp_path, tmp_path / "none", sweep={"constraints.finger.force": [1e-170, 200.0]})
    assert all(part.solves for part in counted.work_of(plan, plan.cases))


@pytest.mark.parametrize(
    "changes",
    [
        {"gravity": {"acceleration": [0.0, 0.0, -9.81]}, "tissue": TABLES["tissue"] | {"density": 1000.0}},
        {"study": {"name": "test", "models": ["vdm-vector", "fem"], "reference": "fem"}, "uncertainty": None},
    ],
)
def test_what_does_not_scale_has_a_reference_per_load(
    tmp_path: Path, cache: Path, changes: dict[str, Any]
) -> None:
    assert len({case.reference for case in plan_of(tmp_path, cache).cases}) == 2
    assert len({case.reference for case in plan_of(tmp_path, cache, **changes).cases}) == 4


def test_fresh_uses_nothing_that_is_stored(tmp_path: Path, cache: Path, made: Counter[str]) -> None:
    run(plan_of(tmp_path, cache))
    made.clear()
    again = run(plan_of(tmp_path, cache, fresh=True))
    assert made == {"fem set-ups": 2, "vdm set-ups": 1, "fem solves": 4, "vdm solves": 4}
    assert all(
        "measured_earlier" not in result.parameters for case in again for result in case.models.values()
    )


def test_a_damaged_reference_is_made_again(tmp_path: Path, cache: Path, made: Counter[str]) -> None:
    before = run(plan_of(tmp_path / "a", cache, fresh=True))
    files = sorted((cache / "references").iterdir())
    for path in files:
        path.write_bytes(path.read_bytes()[:-100])
    made.clear()
    planned = plan_of(tmp_path / "b", cache)
    assert not any(planned.reference_cached(case) for case in planned.cases), "what has to be made is counted"
    tasks = [task_of(case, planned) for case in planned.in_order]
    with share(tasks) as prepare:
        prepare(tasks[0])
        assert worker._group is not None
        assert len(worker._group.answers) == 2, "all at once"
    after = run(planned)
    assert made["fem solves"] > 0
    for a, b in zip(after, before, strict=True):
        u, v = (case.models["fem-linear refined"].displacement for case in (a, b))
        assert_allclose(u, v, rtol=0, atol=1e-12 * np.abs(v).max())
    made.clear()
    run(plan_of(tmp_path / "c", cache))
    assert made["fem solves"] == 0, "what was damaged has been replaced"


def test_another_metric_version_costs_no_solve(
    tmp_path: Path, cache: Path, made: Counter[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    run(plan_of(tmp_path, cache))
    assert set(plan_of(tmp_path, cache).state.values()) == {"done"}
    made.clear()
    name = "max_nodal_error"
    old = metrics.METRICS[name]
    changed = dataclasses.replace(old, version=99, function=lambda *a: 2 * old.function(*a))
    before = [read_case(plan_of(tmp_path, cache).case_file(c)) for c in plan_of(tmp_path, cache).cases]
    monkeypatch.setitem(metrics.METRICS, name, changed)
    plan = plan_of(tmp_path, cache)
    assert set(plan.state.values()) == {"stale"}
    assert any("only the metrics have changed" in line for line in summary(plan)["skipped"])
    after = run(plan)
    assert not made, "nothing is set up or solved"
    for a, b in zip(after, before, strict=True):
        series = a.metrics["vdm-vector"][name]
        assert series.version == 99
        assert_allclose(series.values, 2 * b.metrics["vdm-vector"][name].values, rtol=1e-12, atol=0)
    assert set(plan_of(tmp_path, cache).state.values()) == {"done"}
