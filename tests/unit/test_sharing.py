"""Least work: what is shared or known changes no number, and is counted as the plan says."""

from __future__ import annotations

import copy
import dataclasses
import math
import re
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from numpy.testing import assert_allclose

import fem_reference.condensed
import fem_reference.linear
import vdm.model
from fem_reference.loads import Load, independent_loads, multiple_of
from studies import metrics, worker
from studies import work as counted
from studies.case import CaseResult, StepStatus
from studies.cli_study import SHIPPED
from studies.estimate import _PROCESS_BYTES, FACTOR_MEASURED, Size, _law
from studies.explain import summary
from studies.meshing.geometry import build_mesh
from studies.meshing.geometry_spec import Geometry
from studies.meshing.mesh_cache import mesh_from_cache
from studies.model_name import REFINED
from studies.plan import Plan, make_plan, task_of
from studies.proportional import Answer
from studies.reference import own_error, refined_levels
from studies.run import Options, run_plan
from studies.store import read_case, write_case
from studies.study_file.config import expand, load_study
from studies.study_file.problems import StudyError
from studies.study_file.schema import Study
from studies.worker import run_case, share

TABLES: dict[str, Any] = {
    "study": {"name": "test", "models": ["vdm-vector", "fem-linear"], "reference": "fem-linear"},
    "geometry": {"shape": "sphere", "radius": 0.05, "mesh_size": 0.022},
    "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.49},
    "regions": {
        "base": {"below": {"axis": "z", "fraction": 0.25}},
        "finger": {"cap": {"direction": [0.3, 0.0, 1.0], "angle": 0.6}},
    },
    "constraints": [
        {"kind": "fixed", "region": "base"},
        {"name": "finger", "kind": "contact", "region": "finger", "force": 0.1, "profile": "hertz"},
    ],
    "load": {"factors": [0.5, 1.0]},
    "sweep": {"constraints.finger.force": [0.1, 0.3], "regions.finger.cap.direction.0": [0.0, 0.4]},
    "uncertainty": {"levels": 2},
}


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Holds the mesh once it is made."""
    return tmp_path_factory.mktemp("cache")


def plan_of(directory: Path, cache: Path, **changes: Any) -> Plan:
    study = Study.model_validate(copy.deepcopy(TABLES) | changes)
    return make_plan(study, expand(study), directory, cache)


def run(plan: Plan, *, fresh: bool = False, jobs: int = 1) -> list[CaseResult]:
    """What a worker does with each group, here."""
    for group in plan.groups(plan.cases_to_run(fresh=fresh), jobs):
        tasks = [task_of(case, plan, fresh=fresh) for case in group]
        with share(tasks):
            for task in tasks:
                run_case(task)
    return [read_case(plan.case_file(case)) for case in plan.cases]


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Counts set-ups and right-hand sides."""
    counts: Counter[str] = Counter()

    def counting(name: str, function: Callable[..., Any], size: Callable[..., int]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            counts[name] += size(*arguments)
            return function(*arguments, **options)

        return call

    linear = fem_reference.linear.LinearProblem
    for cls, name in ((linear, "fem set-ups"), (vdm.model.Model, "vdm set-ups")):
        monkeypatch.setattr(cls, "__init__", counting(name, cls.__init__, lambda *_: 1))
    monkeypatch.setattr(
        linear, "solve_nodal", counting("fem solves", linear.solve_nodal, lambda _, forces, __: len(forces))
    )
    surface = vdm.model.Model
    monkeypatch.setattr(surface, "solve", counting("vdm solves", surface.solve, lambda _, loads: len(loads)))
    return counts


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
        alone_plan = plan_of(tmp_path / "alone", cache)
        task = task_of(planned, alone_plan, fresh=True)
        run_case(task)
        alone = read_case(Path(task["path"]))
        for name, result in case.models.items():
            for field in ("displacement", "reaction_force", "energy", "fluid_pressure", "volume"):
                a, b = getattr(result, field), getattr(alone.models[name], field)
                assert_allclose(a, b, rtol=0, atol=1e-12 * np.abs(b).max(), err_msg=f"{name} {field}")
            assert result.key == alone.models[name].key
        assert case.models["fem-linear refined"].parameters["setup_shared"] == "yes"
        assert "setup_shared" not in alone.models["vdm-vector"].parameters
        for name, series in alone.metrics.items():
            for metric, entry in series.items():
                values = case.metrics[name][metric].values
                assert_allclose(values, entry.values, rtol=1e-9, atol=1e-13, err_msg=f"{name} {metric}")


HISTORY = {"load": {"factors": [0.25, 0.5, 1.0]}, "sweep": {}, "uncertainty": None}
TISSUES = {"sweep": {"tissue.poisson_ratio": [0.45, 0.49], "constraints.finger.force": [0.1, 0.3]}}
PARAMETERS = {"sweep": {"vdm.surface_tension": [20.0, 30.0, 40.0]}, "vdm": {"surface_tension": 20.0}}
WEIGHT = {"gravity": {"acceleration": [0.0, 0.0, -9.81]}}
SUPPORTS = {"sweep": {"regions.base.below.fraction": [0.2, 0.3], "constraints.finger.force": [0.1, 0.3]}}


PENALTY = {"vdm": {"penalty": 1e6}}
MOVED = {
    "regions": TABLES["regions"] | {"side": {"cap": {"direction": [1.0, 0.0, 0.1], "angle": 0.4}}},
    "constraints": [
        *TABLES["constraints"],
        {"name": "tool", "kind": "constrained", "region": "side", "displacement": [-0.001, 0.0, 0.0]},
    ],
    # twice both is a multiple, twice one is none
    "sweep": {"constraints.tool.displacement.0": [-0.001, -0.002], "constraints.finger.force": [0.1, 0.2]},
}


LEVELS = {"sweep": {"uncertainty.levels": [2, 3], "constraints.finger.force": [0.1, 0.3]}}
ALONE = {"study": {"name": "test", "models": ["vdm-vector", "fem-linear"]}, "uncertainty": None}
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


@pytest.mark.parametrize("changes", [ALONE, BESIDE, ALONE | WEIGHT, ALONE | MOVED, LEVELS])
def test_elements_of_any_place_have_the_numbers_of_each_case_alone(
    tmp_path: Path, cache: Path, changes: dict[str, Any]
) -> None:
    plan = plan_of(tmp_path / "together", cache, **changes)
    for case, planned in zip(run(plan), plan.cases, strict=True):
        task = task_of(planned, plan_of(tmp_path / "alone", cache, **changes), fresh=True)
        run_case(task)
        alone = read_case(Path(task["path"]))
        assert case.reference_error.get("levels") == alone.reference_error.get("levels")
        for name, result in case.models.items():
            # iterations from a random start end at their own residual
            tolerance = 1e-10 if result.parameters.get("solver") == "iterative" else 1e-12
            for field in ("displacement", "reaction_force", "energy", "volume"):
                a, b = getattr(result, field), getattr(alone.models[name], field)
                assert_allclose(a, b, rtol=0, atol=tolerance * np.abs(b).max(), err_msg=f"{name} {field}")


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
        task = task_of(planned, plan_of(tmp_path / "alone", tmp_path, **changes), fresh=True)
        run_case(task)
        alone = read_case(Path(task["path"]))
        for name, result in alone.models.items():
            assert name == "vdm-vector" or result.parameters["solver"] == solver
            for field in ("displacement", "reaction_force", "energy", "fluid_pressure", "volume"):
                a, b = getattr(case.models[name], field), getattr(result, field)
                assert_allclose(a, b, rtol=0, atol=of_results * np.abs(b).max(), err_msg=f"{name} {field}")
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
    alone = run(plan_of(tmp_path / "c", cache, **edited), fresh=True)
    assert made["fem solves"] > 0
    for case, other in zip(found, alone, strict=True):
        for name in case.models:
            for field in ("displacement", "reaction_force", "energy", "fluid_pressure", "volume"):
                a, b = getattr(case.models[name], field), getattr(other.models[name], field)
                assert_allclose(a, b, rtol=0, atol=1e-12 * np.abs(b).max(), err_msg=f"{name} {field}")
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
    (alone,) = run(plan_of(tmp_path / "b", cache, sweep={"constraints.finger.force": [0.1]}), fresh=True)
    for name, result in alone.models.items():
        assert_allclose(case.models[name].energy, result.energy, rtol=1e-12, atol=0, err_msg=name)
    plan = plan_of(tmp_path, tmp_path / "none", sweep={"constraints.finger.force": [1e-170, 200.0]})
    assert all(part.solves for part in counted.work_of(plan, plan.cases))


def test_a_motion_back_is_a_multiple(tmp_path: Path, cache: Path) -> None:
    plan = plan_of(
        tmp_path, cache, **(MOVED | {"sweep": {"constraints.tool.displacement.2": [0.001, -0.001]}})
    )
    assert len({case.load for case in plan.cases}) == 2, "the finger's force stays"
    constraints = [c for c in MOVED["constraints"] if c.get("name") != "finger"]
    alone = MOVED | {
        "constraints": constraints,
        "sweep": {"constraints.tool.displacement.2": [0.001, -0.001]},
    }
    alone["constraints"] = [
        c | {"displacement": [0.0, 0.0, 0.0]} if c.get("name") == "tool" else c for c in constraints
    ]
    assert len({case.load for case in plan_of(tmp_path, cache, **alone).cases}) == 1


def test_a_stored_reference_answers_its_multiples_only(cache: Path, tmp_path: Path) -> None:
    plan = plan_of(tmp_path, cache)
    task = task_of(plan.cases[0], plan)
    study, scene = worker._built(task)
    result = worker.models.run_model(scene, "fem-linear")
    loads = worker.loads_of(study)
    stored = Answer([result], loads, scene.load_factors)
    (same,) = stored.under(loads, scene) or [None]
    assert same is result
    (twice,) = stored.under({unit: 2 * value for unit, value in loads.items()}, scene) or [None]
    assert twice is not None
    assert_allclose(twice.displacement, 2 * result.displacement, rtol=1e-14, atol=0)
    assert "steps_scaled" in twice.parameters
    two = {"a": 1.0, "b": 2.0}
    stored = Answer([result], two, scene.load_factors)
    assert stored.under({"a": 3.0, "b": 6.0}, scene) is not None
    for other in ({"a": 3.0, "b": 6.0 * (1 + 1e-13)}, {"a": 3.0}, {"a": 3.0, "c": 6.0}, {"a": 0.0, "b": 6.0}):
        assert stored.under(other, scene) is None, other
    assert Answer([result], {"a": 0.0}, scene.load_factors).under({"a": 1.0}, scene) is None


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
    again = run(plan_of(tmp_path, cache), fresh=True)
    assert made == {"fem set-ups": 2, "vdm set-ups": 1, "fem solves": 4, "vdm solves": 4}
    assert all(
        "measured_earlier" not in result.parameters for case in again for result in case.models.values()
    )


def test_a_damaged_reference_is_made_again(tmp_path: Path, cache: Path, made: Counter[str]) -> None:
    plan = plan_of(tmp_path / "a", cache)
    before = run(plan, fresh=True)
    files = sorted((cache / "references").iterdir())
    for path in files:
        path.write_bytes(path.read_bytes()[:-100])
    made.clear()
    planned = plan_of(tmp_path / "b", cache)
    assert not any(planned.reference_cached(case) for case in planned.cases), "what has to be made is counted"
    with share([task_of(case, planned) for case in planned.cases]):
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


def test_groups_are_split_among_workers_and_shards_keep_them_whole(tmp_path: Path, cache: Path) -> None:
    sweep = {
        "tissue.poisson_ratio": [0.45, 0.49],
        "constraints.finger.force": {"start": 0.1, "stop": 1.0, "num": 6},
    }
    plan = plan_of(tmp_path, cache, sweep=sweep)
    assert [len(group) for group in plan.groups(plan.in_order, 1)] == [6, 6]
    assert [len(group) for group in plan.groups(plan.in_order, 4)] == [3, 3, 3, 3]
    shards = [plan.cases_to_run((k, 2)) for k in (1, 2)]
    assert [len({case.setup for case in shard}) for shard in shards] == [1, 1]
    assert sorted(case.hash for shard in shards for case in shard) == sorted(case.hash for case in plan.cases)


def test_independent_loads_span_the_others() -> None:
    rng = np.random.default_rng(3)
    a, b = (Load(rng.normal(size=(5, 4)), rng.normal(size=(3, 3)), np.zeros(3)) for _ in range(2))

    def mix(x: float, y: float) -> Load:
        return Load(
            x * a.facet_pressure + y * b.facet_pressure, x * a.prescribed + y * b.prescribed, np.zeros(3)
        )

    pairs = [(1.0, 0.0), (2.0, 0.0), (0.0, 1e-6), (0.0, 0.0), (-3.0, 1.0)]
    loads = [mix(x, y) for x, y in pairs]
    chosen, coefficients = independent_loads(loads)
    assert len(chosen) == 2
    for step, load in enumerate(loads):
        for name in ("facet_pressure", "prescribed"):
            total = sum(
                c * getattr(loads[k], name) for c, k in zip(coefficients[:, step], chosen, strict=True)
            )
            assert_allclose(total, getattr(load, name), rtol=0, atol=1e-12 * np.abs(a.facet_pressure).max())
    # nearly the same load twice: their small difference is not made a load by large coefficients
    chosen, coefficients = independent_loads([a, mix(1.0, 1e-7), mix(0.0, 1.0)])
    assert len(chosen) == 2
    assert np.abs(coefficients).max() < 2
    assert len(independent_loads([mix(0.0, 0.0)])[0]) == 0


def test_runs_of_multiples_are_one_load_each() -> None:
    rng = np.random.default_rng(4)
    a, b = (Load(rng.normal(size=(5, 4)), rng.normal(size=(3, 3)), np.zeros(3)) for _ in range(2))

    def times(factor: float, load: Load, gravity: float = 0.0) -> Load:
        weight = np.array([0.0, 0.0, gravity])
        return Load(factor * load.facet_pressure, factor * load.prescribed, weight)

    factors = [0.3, 0.0, 1e-150, -7.0, 1.5]
    chosen, coefficients = independent_loads([times(f, a) for f in factors])
    assert chosen.tolist() == [0]
    assert_allclose(coefficients[0], np.array(factors) / 0.3, rtol=1e-15, atol=0)
    loads = [times(f, load) for load in (a, b) for f in (0.0, *factors)] + [
        times(3.0, a, -9.81),
        times(2.0, b),
    ]
    chosen, coefficients = independent_loads(loads)
    assert len(chosen) == 3, "two loads and the weight"
    for name in ("facet_pressure", "prescribed", "gravity"):
        there = np.array([getattr(load, name) for load in loads])
        made = np.tensordot(coefficients, there[chosen], axes=(0, 0))
        assert_allclose(made, there, rtol=0, atol=1e-14 * np.abs(there).max())
    # a hair off is another load
    off = times(2.0, a)
    off.prescribed[0, 0] *= 1 + 1e-10
    assert len(independent_loads([a, times(2.0, a)])[0]) == 1
    assert len(independent_loads([a, off])[0]) == 2
    assert multiple_of([np.array([1e-300])], [np.array([1e100])]) is None
    pair = [np.array([1.0, 1e-20, 0.0]), np.zeros(1)]
    assert multiple_of(pair, [np.array([2.0, 2e-20, 0.0]), np.zeros(1)]) == 2.0
    assert multiple_of(pair, [np.array([2.0, 0.0, 5.0]), np.zeros(1)]) is None
    assert multiple_of(pair, [np.array([2.0, 2e-20, 0.0]), np.ones(1)]) is None
    assert multiple_of(pair, [np.zeros(3), np.zeros(1)]) == 0.0
    assert multiple_of([np.zeros(3), np.zeros(1)], pair) is None


def test_what_a_plan_expects_grows_with_the_work(tmp_path: Path) -> None:
    """Seconds depend on the machine: only memory and disk are held to what is measured, generously."""
    cache = tmp_path / "cache"
    plan = plan_of(tmp_path / "a", cache)
    expected = summary(plan)["estimate"]
    finer = plan_of(tmp_path / "a", cache, geometry=TABLES["geometry"] | {"mesh_size": 0.011})
    more = plan_of(tmp_path / "a", cache, load={"factors": [0.25, 0.5, 0.75, 1.0]})
    for larger in (finer, more):
        for kind in ("seconds", "memory", "disk"):
            assert summary(larger)["estimate"][kind] >= expected[kind], kind
    assert summary(finer)["estimate"]["memory"] > expected["memory"]
    assert expected["factor"] == 5
    cases = run(plan)
    files = [path for part in (tmp_path / "a", cache) for path in part.rglob("*") if path.is_file()]
    assert 1 / 5 < expected["disk"] / sum(path.stat().st_size for path in files) < 5
    added = sum(result.peak_bytes for result in cases[0].models.values())
    assert added / 5 < expected["memory"] < 5 * (added + 3e8)
    again = plan_of(tmp_path / "a", cache, load={"factors": [0.5, 1.0, 2.0]})
    assert summary(plan_of(tmp_path / "a", cache))["estimate"]["seconds"] == 0
    assert summary(again)["estimate"]["seconds"] > 0


def test_a_plan_knows_the_speed_of_the_machine_from_cases_that_are_done(tmp_path: Path, cache: Path) -> None:
    """Seconds in the case files that are so many times as long are expected of the other cases too."""

    def expected() -> Mapping[str, float]:
        sweep = {"constraints.finger.force": [0.1, 0.3], "regions.finger.cap.direction.0": [0.0, 0.4, 0.8]}
        plan = plan_of(tmp_path, cache, sweep=sweep)
        assert Counter(plan.state.values()) == {"done": 4, "missing": 2}
        return summary(plan)["estimate"]

    plan = plan_of(tmp_path, cache)
    cases = run(plan)
    seconds = [expected()["seconds"]]
    for times in (100.0, 300.0):
        for planned, case in zip(plan.cases, cases, strict=True):
            slow = {
                name: dataclasses.replace(
                    result,
                    seconds_setup=times * result.seconds_setup,
                    seconds_per_step=times * result.seconds_per_step,
                )
                for name, result in case.models.items()
            }
            write_case(plan.case_file(planned), dataclasses.replace(case, models=slow))
        seconds.append(expected()["seconds"])
    assert expected()["factor"] == 3
    assert seconds[1] > seconds[0]
    assert_allclose((seconds[2] - seconds[0]) / (seconds[1] - seconds[0]), 299 / 99, rtol=1e-6, atol=0)


@pytest.mark.parametrize(
    ("refined", "mesh_size", "least", "most", "factor"),
    [
        (1.0, 0.02, 1.0, 1.5, 3),  # what small solves take beyond the laws says little of larger ones
        (1.0, 0.006, 1.0, 1.5, 5),
        (30.0, 0.02, 3.0, 30.0, 3),  # a slow machine
        (30.0, 0.006, 1.3, 3.0, 5),  # is one as far as it is known, and what is known is told
    ],
)
def test_measured_seconds_tell_of_work_of_their_own_size(
    tmp_path: Path, cache: Path, refined: float, mesh_size: float, least: float, most: float, factor: float
) -> None:
    """All on the case's mesh takes 30 times what the laws say, what is on the refined one so many times."""

    def expected(directory: Path, *sizes: float) -> Mapping[str, float]:
        return summary(plan_of(directory, tmp_path, sweep={"geometry.mesh_size": list(sizes)}))["estimate"]

    plan = plan_of(tmp_path / "a", cache, sweep={"geometry.mesh_size": [0.022]})
    (planned,), (case,) = plan.cases, run(plan)
    size = Size(len(case.points), case.mesh_quality["tetrahedra"])
    models = {}
    for name, result in case.models.items():
        model, times = name.removesuffix(REFINED), refined if name.endswith(REFINED) else 30.0
        law = _law(model, size if name == model else size.refined(1), 1)
        steps = np.full(len(result.seconds_per_step), times * law.step)
        models[name] = dataclasses.replace(result, seconds_setup=times * law.setup, seconds_per_step=steps)
    write_case(plan.case_file(planned), dataclasses.replace(case, models=models))
    known, unknown = expected(tmp_path / "a", 0.022, mesh_size), expected(tmp_path / "b", mesh_size)
    assert (known["factor"], unknown["factor"]) == (factor, 5)
    assert least < known["seconds"] / unknown["seconds"] < most


@pytest.mark.parametrize(
    ("share", "known", "told"),
    [
        (0.7, False, "about 75 surface nodes"),
        (0.8, False, None),
        (0.95, True, "{} surface nodes"),
        (1.0, True, None),
    ],
)
def test_a_model_that_will_refuse_a_mesh_is_named(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch, share: float, known: bool, told: str | None
) -> None:
    """An expected number of nodes may be a quarter off, one of a mesh that is there is counted."""
    study = TABLES["study"] | {"models": ["mass-spring", "fem-linear"]}
    plan = plan_of(tmp_path, cache if known else tmp_path, study=study)
    (mesh,) = plan.meshes.values()
    nodes = mesh.expected.nodes
    if known:
        nodes = len(mesh_from_cache(mesh.geometry, cache).surface_nodes)
    monkeypatch.setattr("vdm.formulations.mass_spring.MAX_NODES", math.ceil(share * nodes))
    lines = summary(plan)["refused"]
    assert len(lines) == (told is not None)
    for line in lines:
        assert line.startswith(f"mass-spring on a mesh of {told.format(nodes)}, more than its ")
    assert summary(plan_of(tmp_path, cache))["refused"] == []


@pytest.mark.parametrize(
    ("finger", "told"),
    [
        ({"above": {"axis": "z", "value": 60.0}}, True),  # mm for m
        ({"ball": {"center": [0.0, 0.0, 0.2], "radius": 0.05}}, True),
        ({"box": {"min": [-1.0, -1.0, -0.2], "max": [1.0, 1.0, -0.1]}}, True),
        ({"above": {"axis": "z", "value": 0.051}}, False),  # a distorted mesh may reach so far
        ({"cap": {"direction": [0, 0, 1], "angle": 0.5}}, False),
    ],
)
def test_a_region_off_the_body_is_named_before_it_is_meshed(
    tmp_path: Path, finger: dict[str, Any], told: bool
) -> None:
    regions = TABLES["regions"] | {"finger": finger}
    pressed = TABLES["constraints"][1] | {"profile": "uniform"}
    constraints = [TABLES["constraints"][0], pressed]
    plan = plan_of(tmp_path, tmp_path / "cache", regions=regions, constraints=constraints, sweep={})
    line = (
        "region 'finger' lies off the body: the body has x from -0.05 to 0.05, y from -0.05 to 0.05, "
        "z from -0.05 to 0.05 m; a mixed-up unit? A bare number is in metres"
    )
    assert summary(plan)["refused"] == [line] * told


@pytest.mark.parametrize("suffix", [".stl", ".vtu"])
@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize(("height", "told"), [(0.1, True), (0.055, False)])  # an edge beyond is no matter
def test_a_region_off_the_body_of_a_file_is_named_before_it_is_meshed(
    tmp_path: Path, suffix: str, known: bool, height: float, told: bool
) -> None:
    file, shape = tmp_path / f"ball{suffix}", Geometry("sphere", 0.022, {"radius": 0.05})
    ball = build_mesh(shape)
    cells = {
        ".stl": (ball.surface_points, ("triangle", ball.triangles)),
        ".vtu": (ball.points, ("tetra", ball.tetrahedra)),
    }
    meshio.write_points_cells(
        file, cells[suffix][0] + 7.0, [cells[suffix][1]]
    )  # its place is no matter either
    geometry = {"shape": "file", "path": str(file), "mesh_size": 0.022}
    regions = TABLES["regions"] | {"finger": {"above": {"axis": "z", "value": height}}}
    pressed = TABLES["constraints"][1] | {"profile": "uniform"}
    constraints = [TABLES["constraints"][0], pressed]
    plan = plan_of(tmp_path, tmp_path, geometry=geometry, regions=regions, constraints=constraints, sweep={})
    if known:
        mesh_from_cache(next(iter(plan.meshes.values())).geometry, tmp_path)
        file.unlink()  # which is slower to read
    lines = summary(plan)["refused"]
    assert len(lines) == told
    for line in lines:
        high = float(line.partition("z from ")[2].split()[2])
        assert line.startswith("region 'finger' lies off the body: the body has x from -0.0")
        assert_allclose(high, 0.05, rtol=0.05, atol=0)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (None, "the body is 0.1 m across: if that is wrong correct its lengths, else use a larger mesh_size"),
        ({"scale": 1.0}, "m across: if that is wrong correct scale, else use a larger mesh_size"),
        ({}, "m across: if the file is not in metres give scale or size, else use a larger mesh_size"),
    ],
)
def test_what_the_machine_has_no_memory_for_is_named_and_not_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: dict[str, float] | None, words: str
) -> None:
    file, ball = tmp_path / "ball.stl", build_mesh(Geometry("sphere", 0.022, {"radius": 0.05}), volume=False)
    meshio.write_points_cells(file, ball.surface_points, [("triangle", ball.triangles)])
    geometry = {} if given is None else {"shape": "file", "path": str(file), "mesh_size": 0.022} | given
    plan = plan_of(tmp_path / "run", tmp_path / "cache", geometry=geometry or TABLES["geometry"])
    assert summary(plan)["refused"] == []
    monkeypatch.setattr("studies.explain.machine_memory", lambda: 1_000_000)
    monkeypatch.setattr("studies.run.start_server", lambda: None)
    (line,) = summary(plan)["refused"]
    assert line.startswith("fem-linear refined on a mesh of ")
    assert line.endswith(words)
    with pytest.raises(StudyError) as raised:
        run_plan(plan, "", Options(jobs=1), lambda _: None)
    (problem,) = raised.value.problems
    assert (problem.key, problem.message) == ("geometry.mesh_size", line)
    assert not (tmp_path / "run" / "plan.json").exists()
    without = {"study": TABLES["study"] | {"models": ["vdm-vector"], "reference": None}, "uncertainty": None}
    assert summary(plan_of(tmp_path / "other", tmp_path / "cache", **without))["refused"] == []


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


def test_a_plan_expects_the_search_for_limits_to_cost_many_loads(tmp_path: Path) -> None:
    """Counted as 30 loads of every model; one of the reference is worth two of the study's."""
    tables = {
        "study": TABLES["study"] | {"models": ["vdm-vector", "fem-linear", "fem"], "reference": "fem"},
        "uncertainty": None,
    }
    limits = {"limits": {"along": "constraints.finger.force"}}
    own, searched, with_bars = (
        summary(plan_of(tmp_path / "a", tmp_path / "cache", **tables | more))
        for more in ({}, limits, limits | {"uncertainty": {"levels": 2}})
    )
    assert searched["estimate"]["seconds"] > 3 * own["estimate"]["seconds"]
    assert with_bars["estimate"]["seconds"] > 1.5 * searched["estimate"]["seconds"]
    line = "small-strain limits: a load that is tried serves all models and thresholds"
    assert line in searched["shared"]
    assert line not in own["shared"]


@pytest.mark.parametrize(
    ("tetrahedra", "loads", "measured"),
    [
        (1032, 1, 220),
        (4292, 1, 305),
        (4292, 3, 451),
        (8256, 1, 472),
        (17520, 1, 808),
        (17520, 20, 1232),
        (34336, 1, 1304),
    ],
)
def test_finite_strain_is_expected_to_take_the_memory_it_takes(
    tetrahedra: float, loads: int, measured: float
) -> None:
    """Peak in MB of a process that solves the shipped slab, on its mesh or refined, with factors or without."""
    expected = _PROCESS_BYTES + _law("fem", Size(0.0, tetrahedra), loads).bytes
    assert expected == pytest.approx(1e6 * measured, rel=0.25, abs=0)


def test_the_shipped_search_for_limits_is_expected_to_take_what_it_takes(cache: Path, tmp_path: Path) -> None:
    """It took 138 s of a core: 14 limits on the refined mesh, the reference going on from each to the next."""
    study = load_study(SHIPPED / "small-strain.toml")
    plan = make_plan(study, expand(study), tmp_path / "run", cache)
    assert 138.0 / 2 < summary(plan)["estimate"]["seconds"] < 138.0 * 2


def test_finite_strain_on_a_refined_mesh_is_expected_to_take_its_cheaper_path() -> None:
    """Three load steps of the shipped thigh, refined once, took some 45 s of a core; with factors, 290 and more."""
    law = _law("fem", Size(2540.0, 31944.0), 3)
    assert 45.0 / FACTOR_MEASURED < law.setup + 3 * law.step < 45.0 * FACTOR_MEASURED
