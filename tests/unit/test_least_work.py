"""A run sets up and solves what its plan counts, each thing once, with the numbers of each case alone."""

from __future__ import annotations

import shutil
import weakref
from collections import Counter
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import fem_reference.condensed
import fem_reference.finite_strain
import vdm.model
from fem_reference.linear import LinearProblem
from studies import worker
from studies.case import CaseResult
from studies.execute import AGAIN
from studies.explain import summary
from studies.plan import Plan, task_groups, task_of
from studies.store import read_case
from studies.work import work_of
from studies.worker import run_case, share

from . import shared_work
from .shared_work import BASE, FINGER, ONE_LOAD, assert_same_results, run, run_alone

VDM = ("vdm-paper", "vdm-vector", "vdm-boundary")
THUMB = {"name": "thumb", "kind": "contact", "region": "back", "pressure": 50.0}
TOOL = {"name": "tool", "kind": "constrained", "region": "back", "displacement": [-0.001, 0.0, 0.0]}
TABLES: dict[str, Any] = ONE_LOAD | {
    "regions": {
        **ONE_LOAD["regions"],
        "front": {"cap": {"direction": [1.0, 0.0, 0.2], "angle": 0.5}},
        "back": {"cap": {"direction": [-1.0, 0.0, 0.1], "angle": 0.5}},
    },
}
plan_of = partial(shared_work.plan_of, tables=TABLES)
cache = shared_work.cache  # the fixture


def models(*names: str) -> dict[str, Any]:
    return {"study": {"name": "test", "models": [*names, "fem-linear"], "reference": "fem-linear"}}


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
        # iterations from a random start end at their own residual
        assert_same_results(case, run_alone(own, plan, directory / "alone"), 1e-12, 1e-10)


def setups(counts: Mapping[tuple[str, str], int]) -> dict[str, int]:
    return {name: count for (name, kind), count in counts.items() if kind == "setups"}


TENSIONS = {"vdm.surface_tension": [20.0, 30.0, 40.0]}
FORCES = {"constraints.finger.force": [0.1, 0.3]}
PRESSURES = {"constraints.thumb.pressure": [50.0, -20.0, 70.0]}
PLACES = {"constraints.finger.region": ["finger", "front"]}
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
        pytest.param(
            models(*VDM, "fem-condensed")
            | {"sweep": {"mode": "zip"} | RATIOS | {"constraints.finger.force": [0.1, 0.3, -0.2]}},
            {"vdm-paper": 1, "vdm-vector": 1, "vdm-boundary": 1, "fem-condensed": 3},
            id="each load its own Poisson's ratio",
        ),
        pytest.param(
            models(*VDM)
            | {
                "vdm": {"surface_tension": 20.0},
                "constraints": [BASE, FINGER, THUMB],
                "sweep": {
                    "mode": "zip",
                    "tissue.poisson_ratio": [0.4, 0.45, 0.4, 0.49, 0.45],
                    "vdm.surface_tension": [20.0, 30.0, 20.0, 20.0, 30.0],
                    "constraints.thumb.pressure": [50.0, -20.0, 70.0, 30.0, 10.0],
                },
            },
            {"vdm-paper": 1, "vdm-vector": 2, "vdm-boundary": 1},
            id="loads on few tissues",
        ),
        pytest.param(
            models("vdm-paper", "vdm-vector")
            | {
                "sweep": {
                    "mode": "latin-hypercube",
                    "samples": 4,
                    "seed": 3,
                    "tissue.poisson_ratio": {"start": 0.4, "stop": 0.49},
                    "tissue.density": {"start": 900.0, "stop": 1100.0},
                    "constraints.finger.force": {"start": 0.1, "stop": 0.3},
                },
            },
            {"vdm-paper": 1, "vdm-vector": 1},
            id="a sample of tissues and loads",
        ),
        pytest.param(
            models("vdm-vector")
            | {
                "gravity": {"acceleration": [0.0, 0.0, -9.81]},
                "sweep": {"mode": "zip", "tissue.density": [900.0, 900.0, 950.0]} | RATIOS,
            },
            {"vdm-vector": 2},
            id="a weight with each Poisson's ratio",
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
    made.clear()
    again = plan_of(tmp_path / "run", cache, fresh=True, **changes)
    assert planned(again) == expected, "with nothing that is stored"
    run(again)
    assert made == expected


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
    (tasks,) = task_groups(plan, plan.cases_to_run(), 1)
    with share(tasks):
        for task in tasks:
            run_case(task)
            assert worker._group is not None
            kept.append(len(worker._group.results))
    # of each force vdm-paper's and the reference's
    assert kept == ([2, 4, 4, 4, 2, 0] if room else [0] * 6)
    assert made == expected


def test_workers_at_once_know_nothing_of_each_other(tmp_path: Path, cache: Path) -> None:
    """Three Poisson ratios: of two workers one has two of them, which share what does not read it."""
    plan = plan_of(tmp_path, cache, **models(*VDM), sweep=RATIOS | FORCES)
    for jobs, count in ((1, 1), (2, 2), (3, 3)):
        assert setups(planned(plan, jobs)) == dict.fromkeys(VDM, count), jobs


@pytest.mark.parametrize(
    ("sizes", "ratios", "jobs", "expected"),
    [
        ([0.022], 6, 1, [6]),
        ([0.022], 6, 2, [3, 3]),
        ([0.022], 7, 2, [4, 3]),
        ([0.022], 6, 4, [2, 2, 2]),
        ([0.022, 0.03], 3, 2, [3, 3]),
        ([0.022, 0.03], 3, 3, [2, 1, 2, 1]),
    ],
)
def test_bodies_are_divided_where_a_worker_would_have_more_than_its_share(
    tmp_path: Path, sizes: list[float], ratios: int, jobs: int, expected: list[int]
) -> None:
    sweep = {
        "geometry.mesh_size": sizes,
        "tissue.poisson_ratio": {"start": 0.3, "stop": 0.49, "num": ratios},
    }
    plan = plan_of(tmp_path, tmp_path, sweep=sweep)
    assert [len(group) for group in plan.groups(plan.in_order, jobs)] == expected
    without = {"study": {"name": "test", "models": ["fem-linear"]}}
    plan = plan_of(tmp_path, tmp_path, sweep=sweep, **without)
    assert [len(group) for group in plan.groups(plan.in_order, jobs)] == [1] * len(sizes) * ratios


def test_one_tissue_is_let_go_before_the_next_is_factored(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there: weakref.WeakSet[LinearProblem] = weakref.WeakSet()
    others = []
    start = LinearProblem.__init__

    def watched_start(self: LinearProblem, *arguments: Any, **options: Any) -> None:
        others.append(len(there))
        start(self, *arguments, **options)
        there.add(self)

    monkeypatch.setattr(LinearProblem, "__init__", watched_start)
    plan = plan_of(tmp_path, cache, fresh=True, **models("vdm-vector"), sweep=RATIOS | FORCES)
    run(plan)
    assert others == [0, 0, 0]
    (held,) = (part.held for part in work_of(plan, plan.cases) if part.name == "fem-linear")
    assert held == 1


def test_no_number_hangs_on_which_worker_is_faster(tmp_path: Path, made: Counter[tuple[str, str]]) -> None:
    """Two workers that share a reference and a surface model's results, one after the other in either order."""
    sweep = {"constraints.finger.force": [0.1, 0.3], "constraints.thumb.pressure": [50.0, 150.0]} | TENSIONS
    found: list[list[CaseResult]] = []
    for order in (1, -1):
        shutil.rmtree(tmp_path / "cache" / "references", ignore_errors=True)
        tables = {"constraints": [BASE, FINGER, THUMB], "sweep": sweep}
        names = models("vdm-paper", "vdm-vector")
        plan = plan_of(tmp_path / f"{order}", tmp_path / "cache", **names, **tables)
        groups = task_groups(plan, plan.cases_to_run(), 2)
        assert len(groups) == 2
        references = [{task["reference_key"] for task in group} for group in groups]
        assert references[0] & references[1], "which both solve"
        expected = planned(plan, 2)
        made.clear()
        for group in groups[::order]:
            with share(group):
                for task in group:
                    run_case(task)
        assert made == expected
        found.append([read_case(plan.case_file(case)) for case in plan.cases])
    for one, other in zip(*found, strict=True):
        for name, result in one.models.items():
            for field in ("displacement", "reaction_force", "energy", "fluid_pressure", "volume"):
                a, b = getattr(result, field), getattr(other.models[name], field)
                np.testing.assert_array_equal(a, b, err_msg=f"{name} {field}")


def test_a_worker_in_the_place_of_one_that_died_reads_what_that_had_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plans = [plan_of(tmp_path, tmp_path / "cache", fresh=fresh) for fresh in (False, True)]
    tasks = [task_of(plan.cases[0], plan) for plan in plans]
    solve, solved = LinearProblem.solve, []

    def counted_solve(self: LinearProblem, loads: Any, *arguments: Any) -> Any:
        solved.append(len(loads))
        return solve(self, loads, *arguments)

    monkeypatch.setattr(LinearProblem, "solve", counted_solve)
    for task, count in (
        (tasks[0], 1),
        ({**tasks[0], AGAIN: True}, 1),
        (tasks[0], 2),
        ({**tasks[1], AGAIN: True}, 3),
    ):
        run_case(task)
        assert len(solved) == count


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
