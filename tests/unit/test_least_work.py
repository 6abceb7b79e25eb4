"""A run sets up and solves what its plan counts, each thing once, with the numbers of each case alone."""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import fem_reference.condensed
import fem_reference.finite_strain
import vdm.model
from studies import worker
from studies.case import CaseResult
from studies.explain import summary
from studies.plan import Plan, make_plan, task_of
from studies.store import read_case
from studies.study_file.config import expand
from studies.study_file.schema import Study
from studies.work import work_of
from studies.worker import run_case, share

VDM = ("vdm-paper", "vdm-vector", "vdm-boundary")
BASE = {"kind": "fixed", "region": "base"}
FINGER = {"name": "finger", "kind": "contact", "region": "top", "force": 0.1, "profile": "hertz"}
THUMB = {"name": "thumb", "kind": "contact", "region": "back", "pressure": 50.0}
TOOL = {"name": "tool", "kind": "constrained", "region": "back", "displacement": [-0.001, 0.0, 0.0]}
TABLES: dict[str, Any] = {
    "study": {"name": "test", "models": ["vdm-vector", "fem-linear"], "reference": "fem-linear"},
    "geometry": {"shape": "sphere", "radius": 0.05, "mesh_size": 0.022},
    "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.49},
    "regions": {
        "base": {"below": {"axis": "z", "fraction": 0.25}},
        "top": {"cap": {"direction": [0.3, 0.0, 1.0], "angle": 0.6}},
        "front": {"cap": {"direction": [1.0, 0.0, 0.2], "angle": 0.5}},
        "back": {"cap": {"direction": [-1.0, 0.0, 0.1], "angle": 0.5}},
    },
    "constraints": [BASE, FINGER],
}


def models(*names: str) -> dict[str, Any]:
    return {"study": {"name": "test", "models": [*names, "fem-linear"], "reference": "fem-linear"}}


def plan_of(directory: Path, cache: Path, **changes: Any) -> Plan:
    study = Study.model_validate(copy.deepcopy(TABLES) | changes)
    return make_plan(study, expand(study), directory, cache)


def run(plan: Plan) -> list[CaseResult]:
    """What one worker does, here."""
    for group in plan.groups(plan.cases_to_run(), 1):
        tasks = [task_of(case, plan) for case in group]
        with share(tasks):
            for task in tasks:
                run_case(task)
    return [read_case(plan.case_file(case)) for case in plan.cases]


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Holds the mesh once it is made."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Counter[tuple[str, str]]:
    """Counts set-ups and solved load steps by model, of linear elements nothing."""
    counts: Counter[tuple[str, str]] = Counter()

    def count(cls: Any, name: str) -> None:
        start, solve = cls.__init__, cls.solve

        def counted_start(self: Any, *arguments: Any, **options: Any) -> None:
            counts[name or f"vdm-{options['formulation']}", "setups"] += 1
            start(self, *arguments, **options)

        def counted_solve(self: Any, loads: Any, *arguments: Any, **options: Any) -> Any:
            counts[name or f"vdm-{self.formulation.name}", "solves"] += len(loads)
            return solve(self, loads, *arguments, **options)

        monkeypatch.setattr(cls, "__init__", counted_start)
        monkeypatch.setattr(cls, "solve", counted_solve)

    count(vdm.model.Model, "")
    count(fem_reference.condensed.CondensedProblem, "fem-condensed")
    count(fem_reference.finite_strain.FiniteStrainProblem, "fem")
    return counts


def planned(plan: Plan, jobs: int = 1) -> dict[tuple[str, str], int]:
    """The same from the plan."""
    counts: Counter[tuple[str, str]] = Counter()
    for part in work_of(plan, plan.cases_to_run(), jobs):
        if part.name != "fem-linear":
            counts += Counter({(part.name, kind): getattr(part, kind) for kind in ("setups", "solves")})
    return counts


def assert_as_alone(cases: list[CaseResult], plan: Plan, directory: Path) -> None:
    for case, own in zip(cases, plan.cases, strict=True):
        task = {**task_of(own, plan, fresh=True), "path": str(directory / f"{own.hash}.vtkhdf")}
        run_case(task)
        alone = read_case(Path(task["path"]))
        for name, result in alone.models.items():
            # iterations from a random start end at their own residual
            tolerance = 1e-10 if result.parameters.get("solver") == "iterative" else 1e-12
            for field in ("displacement", "reaction_force", "energy", "fluid_pressure", "volume"):
                a, b = getattr(case.models[name], field), getattr(result, field)
                scale = np.abs(b).max()
                assert_allclose(a, b, rtol=0, atol=tolerance * scale, err_msg=f"{own.label} {name} {field}")
            assert case.models[name].key == result.key


def setups(counts: Mapping[tuple[str, str], int]) -> dict[str, int]:
    return {name: count for (name, kind), count in counts.items() if kind == "setups"}


TENSIONS = {"vdm.surface_tension": [20.0, 30.0, 40.0]}
FORCES = {"constraints.finger.force": [0.1, 0.3]}
PRESSURES = {"constraints.thumb.pressure": [50.0, -20.0, 70.0]}
PLACES = {"constraints.finger.region": ["top", "front"]}
RATIOS = {"tissue.poisson_ratio": [0.4, 0.45, 0.49]}
MOTIONS = {"constraints.tool.displacement.0": [-0.001, 0.0005, 0.0]}
DATUMS = {"environment.pressure": [0.0, 50.0]}
CONDENSED = models("vdm-paper", "vdm-vector", "fem-condensed")


@pytest.mark.parametrize(
    ("changes", "few"),
    [
        pytest.param(
            models("vdm-paper", "vdm-vector", "fem") | {"sweep": TENSIONS | FORCES},
            {"vdm-paper": 1, "vdm-vector": 3, "fem": 2},
            id="a parameter, then a load",
        ),
        pytest.param(
            models("vdm-paper", "vdm-vector", "fem") | {"sweep": FORCES | TENSIONS},
            {"vdm-paper": 1, "vdm-vector": 3, "fem": 2},
            id="a load, then a parameter",
        ),
        pytest.param(
            CONDENSED | {"constraints": [BASE, FINGER, THUMB], "sweep": PRESSURES | PLACES},
            {"vdm-paper": 1, "vdm-vector": 1, "fem-condensed": 2},
            id="a load, then a place",
        ),
        pytest.param(
            CONDENSED | {"constraints": [BASE, FINGER, THUMB], "sweep": PLACES | PRESSURES},
            {"vdm-paper": 1, "vdm-vector": 1, "fem-condensed": 2},
            id="a place, then a load",
        ),
        pytest.param(
            CONDENSED | {"constraints": [BASE, FINGER, THUMB], "sweep": PRESSURES | PLACES | TENSIONS},
            {"vdm-paper": 1, "vdm-vector": 3, "fem-condensed": 2},
            id="a load, a place and a parameter",
        ),
        pytest.param(
            CONDENSED
            | {
                "constraints": [BASE, FINGER, TOOL],
                "sweep": MOTIONS | FORCES | DATUMS,
                "environment": {"pressure": 0.0},
            },
            {"vdm-paper": 2, "vdm-vector": 2, "fem-condensed": 2},
            id="a motion, a load and a datum",
        ),
        pytest.param(
            models(*VDM)
            | {
                "vdm": {"shear_modulus": 1500.0},
                "sweep": TENSIONS | {"vdm.shear_modulus": [1500.0, 1700.0]} | FORCES,
            },
            {"vdm-paper": 1, "vdm-vector": 3, "vdm-boundary": 2},
            id="two parameters, each of one model",
        ),
        pytest.param(
            models(*VDM) | {"sweep": RATIOS | FORCES},
            {"vdm-paper": 1, "vdm-vector": 1, "vdm-boundary": 1},
            id="Poisson's ratio, then a load",
        ),
    ],
)
def test_a_run_does_what_is_planned_and_no_more_than_needed(
    tmp_path: Path, cache: Path, made: Counter[tuple[str, str]], changes: dict[str, Any], few: dict[str, int]
) -> None:
    plan = plan_of(tmp_path / "run", cache, **changes)
    expected = planned(plan)
    cases = run(plan)
    assert made == expected
    assert setups(made) == few
    assert_as_alone(cases, plan, tmp_path)


def test_what_is_solved_once_has_one_time(tmp_path: Path, cache: Path) -> None:
    plan = plan_of(tmp_path, cache, **models("vdm-vector", "fem"), sweep=TENSIONS | FORCES)
    cases = run(plan)
    assert len({tuple(case.models["fem"].seconds_per_step) for case in cases}) == 2
    line = "fem: 2 results for 6 cases; it does not read what else differs"
    assert (
        line
        in summary(plan_of(tmp_path / "b", cache, **models("vdm-vector", "fem"), sweep=TENSIONS | FORCES))[
            "shared"
        ]
    )


@pytest.mark.parametrize("room", [0, 1 << 28])
def test_results_are_kept_until_their_last_use(
    tmp_path: Path, cache: Path, made: Counter[tuple[str, str]], monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    """In memory, or where there is no room found again in the case's file."""
    monkeypatch.setattr(worker, "_MOST_BYTES", room)
    plan = plan_of(tmp_path, cache, **models("vdm-paper", "vdm-vector"), sweep=TENSIONS | FORCES)
    expected, kept = planned(plan), []
    (group,) = plan.groups(plan.cases_to_run(), 1)
    tasks = [task_of(case, plan) for case in group]
    with share(tasks):
        for task in tasks:
            run_case(task)
            assert worker._group is not None
            kept.append(len(worker._group.results))
    # of each force vdm-paper's and the reference's
    assert kept == ([2, 4, 4, 4, 2, 0] if room else [0] * 6)
    assert made == expected


def test_workers_at_once_know_nothing_of_each_other(tmp_path: Path, cache: Path) -> None:
    """Three Poisson ratios: two workers begin with one each, the third finds what the first has left."""
    plan = plan_of(tmp_path, cache, **models(*VDM), sweep=RATIOS | FORCES)
    for jobs, count in ((1, 1), (2, 2), (3, 3)):
        assert setups(planned(plan, jobs)) == dict.fromkeys(VDM, count), jobs


def test_memory_is_expected_for_what_waits(tmp_path: Path) -> None:
    """The dense set-ups stand together, those of a datum wait for each other across them."""
    tables = {"constraints": [BASE, FINGER, TOOL], "environment": {"pressure": 0.0}}
    plan = plan_of(tmp_path, tmp_path, **(CONDENSED | tables), sweep=MOTIONS | FORCES | DATUMS)
    held = {part.name: part.held for part in work_of(plan, plan.cases_to_run())}
    assert held == {"vdm-paper": 2, "vdm-vector": 2, "fem-condensed": 1, "fem-linear": 1}


def test_cases_that_are_done_serve_those_to_come(
    tmp_path: Path, cache: Path, made: Counter[tuple[str, str]]
) -> None:
    names = models("vdm-boundary", "vdm-vector", "fem")
    one = {"vdm.surface_tension": [30.0], "tissue.poisson_ratio": [0.45]}
    (first,) = run(plan_of(tmp_path, cache, **names, sweep=one))
    made.clear()
    plan = plan_of(tmp_path, cache, **names, sweep=one | {"vdm.surface_tension": [20.0, 30.0]})
    expected = planned(plan)
    new, old = run(plan)
    assert made == expected == {("vdm-vector", "setups"): 1, ("vdm-vector", "solves"): 1}
    assert old.hash == first.hash
    for name in ("vdm-boundary", "fem"):
        np.testing.assert_array_equal(new.models[name].displacement, first.models[name].displacement)
    made.clear()
    plan = plan_of(tmp_path, cache, **names, sweep=one | {"tissue.poisson_ratio": [0.4, 0.45]})
    expected = planned(plan)
    run(plan)
    assert made == expected == {("fem", "setups"): 1, ("fem", "solves"): 1}


def test_a_model_is_given_what_it_reads(tmp_path: Path, cache: Path) -> None:
    plan = plan_of(tmp_path, cache, **models(*VDM), vdm={"surface_tension": 30.0, "shear_modulus": 1500.0})
    (case,) = run(plan)
    found = {name: {"surface_tension", "shear_modulus"} & case.models[name].parameters.keys() for name in VDM}
    assert found == {
        "vdm-paper": set(),
        "vdm-vector": {"surface_tension"},
        "vdm-boundary": {"shear_modulus"},
    }
    without = plan_of(tmp_path, cache, **models("vdm-paper"))
    assert plan.cases[0].results["vdm-paper"] == without.cases[0].results["vdm-paper"]


def test_no_gravity_is_no_weight(tmp_path: Path) -> None:
    """What scales still does, and is found in the cache."""
    names = models("vdm-vector", "fem-condensed")
    none, zero, some = (
        plan_of(tmp_path, tmp_path, **names, **gravity, sweep=FORCES)
        for gravity in (
            {},
            {"gravity": {"acceleration": [0.0, 0.0, 0.0]}},
            {"gravity": {"acceleration": [0.0, 0.0, -9.81]}, "tissue": TABLES["tissue"] | {"density": 1e3}},
        )
    )
    for a, b, c in zip(none.cases, zero.cases, some.cases, strict=True):
        assert (a.setup, a.load, a.reference, a.results) == (b.setup, b.load, b.reference, b.results)
        assert a.load != c.load
    assert work_of(none, none.cases) == work_of(zero, zero.cases) != work_of(some, some.cases)


@pytest.mark.parametrize("levels", [1, 2])
def test_a_reference_on_more_levels_serves_fewer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, levels: int
) -> None:
    fine = {"geometry": TABLES["geometry"] | {"mesh_size": 0.03}}
    bar = {"uncertainty": {"levels": levels} if levels > 1 else None}
    (alone,) = run(plan_of(tmp_path / "alone", tmp_path / "other", **fine, **bar))
    (three,) = run(plan_of(tmp_path / "a", tmp_path / "cache", **fine, uncertainty={"levels": 3}))
    plan = plan_of(tmp_path / "b", tmp_path / "cache", **fine, **bar)
    assert {part.name for part in work_of(plan, plan.cases)} == {"vdm-vector"}

    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("solved again")

    monkeypatch.setattr("fem_reference.linear.LinearProblem.solve", refuse)
    (case,) = run(plan)
    assert case.reference == alone.reference
    assert case.reference_error == pytest.approx(alone.reference_error, rel=1e-9, nan_ok=True)
    for name, result in alone.models.items():
        b = result.displacement
        assert_allclose(case.models[name].displacement, b, rtol=0, atol=1e-12 * np.abs(b).max(), err_msg=name)
    assert three.reference_error.keys() != case.reference_error.keys()
    assert list((tmp_path / "cache" / "references").iterdir()) != [], "and is not written again"
    assert len(list((tmp_path / "cache" / "references").iterdir())) == 1
