"""Times that decide: measured anew in each run, all models in turns."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_common.solution import CONVERGED, Status
from tests.in_process import HerePool, do_cases
from vdmbench.models import frames
from vdmbench.scene.scene import Scene
from vdmbench.store.cases import read_case, write_case
from vdmbench.store.run_directory import TIMES, read_times
from vdmbench.verdict.acceptance import BEYOND, time_state
from vdmbench.work import times
from vdmbench.work.run import Options, _decides, _time_frames
from vdmbench.work.times import to_time

from .shared_work import ONE_LOAD, TABLES, cache, meshes, plan_of

__all__ = ["cache", "meshes"]  # fixtures
LIMITED = {"acceptance": {"frame_time": 1e-3}}


def timed(plan: object, cases: object, **options: bool) -> None:
    _time_frames(plan, cases, Options(jobs=1, **options), lambda _: None, HerePool())  # type: ignore[arg-type]


def test_a_run_with_nothing_to_do_measures_a_time_that_decides_and_no_other(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    real = frames.one_round

    def seen(scene: Scene, name: str, *, everywhere: bool) -> tuple[float, ...]:
        asked.append(name)
        return real(scene, name, everywhere=everywhere)

    monkeypatch.setattr(frames, "one_round", seen)
    plan = plan_of(tmp_path / "run", cache, **LIMITED)
    do_cases(plan)
    timed(plan, plan.cases)
    assert asked == list(plan.study.study.models) * 5, "models take turns"
    first = (plan.directory / TIMES).read_bytes()
    again = plan_of(tmp_path / "run", cache, **LIMITED)
    assert again.cases_to_run() == []
    timed(again, [])
    assert (plan.directory / TIMES).read_bytes() != first, "measured anew, whatever the cache has"
    ((mesh, found),) = read_times(plan.directory).items()
    assert mesh == plan.cases[0].mesh
    assert set(found) == set(plan.study.study.models)
    for model in found.values():
        assert model.case == plan.cases[0].label
        assert model.contact.shape == model.everywhere.shape == (5,)
        assert np.isfinite([model.setup, model.contact, model.everywhere]).all()

    other = plan_of(tmp_path / "other", cache, tables=TABLES)
    assert not _decides(other)
    timed(other, [])
    assert not (other.directory / TIMES).exists()


def test_a_round_far_beyond_the_limit_is_the_last_and_the_verdict_is_that_of_the_long_way(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A Newton's method takes a hundred times the limit or more, on any machine and however busy."""
    asked: list[str] = []
    real = frames.one_round
    monkeypatch.setattr(frames, "one_round", lambda *a, **b: asked.append(a[1]) or real(*a, **b))
    study = ONE_LOAD["study"] | {"models": ["vdm-vector", "vdm-vector:nonlinear", "fem-linear"]}
    plan = plan_of(
        tmp_path / "run",
        cache,
        tables=ONE_LOAD,
        study=study,
        acceptance={"frame_time": 1e-6},
    )
    do_cases(plan)
    mesh = plan.cases[0].mesh
    states = {}
    for way in ("short", "long"):
        asked.clear()
        timed(plan, plan.cases, times=way == "long")
        assert asked.count("vdm-vector:nonlinear") == (1 if way == "short" else 5)
        found = read_times(plan.directory)[mesh]
        case = read_case(plan.case_file(plan.cases[0]), frames=found)
        states[way] = time_state(case.models["vdm-vector:nonlinear"], 1e-6)
    assert states["short"] == states["long"] == BEYOND


def test_where_the_load_is_not_reached_or_a_model_fails_nothing_is_timed(tmp_path: Path, cache: Path) -> None:
    plan = plan_of(tmp_path / "run", cache, **LIMITED)
    do_cases(plan)

    def failed(place: int, name: str) -> None:
        path = plan.case_file(plan.cases[place])
        case = read_case(path)
        lost = replace(case.models[name], status=(CONVERGED, Status("diverged")))
        write_case(path, replace(case, models={**case.models, name: lost}))

    def chosen() -> list[tuple[str, list[str]]]:
        return [(one.case.label, one.names) for one in to_time(plan, plan.cases, every=True)]

    labels = [case.label for case in plan.cases]
    assert chosen() == [(labels[0], ["vdm-vector", "fem-linear"])]
    failed(0, "fem-linear refined")
    failed(1, "vdm-vector")
    later = [(labels[1], ["fem-linear"]), (labels[2], ["vdm-vector"])]
    assert chosen() == later, "a model is timed where it answers: a Newton's method that fails takes longer"
    timed(plan, plan.cases)
    ((_, found),) = read_times(plan.directory).items()
    assert {name: found[name].case for name in found} == {"fem-linear": labels[1], "vdm-vector": labels[2]}
    (plan.directory / TIMES).unlink()
    for place in (2, 3):
        failed(place, "vdm-vector")
    assert chosen() == [(labels[1], ["fem-linear"])]
    for place in (1, 2, 3):
        failed(place, "fem-linear refined")
    assert chosen() == []
    timed(plan, plan.cases)
    assert not (plan.directory / TIMES).exists()


def test_a_slow_model_is_neither_timed_nor_looked_for_in_further_cases(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = plan_of(tmp_path / "run", cache, **LIMITED)
    do_cases(plan)
    read: list[Path] = []
    monkeypatch.setattr(times, "read_case", lambda path, *a: read.append(path) or read_case(path, *a))
    monkeypatch.setattr(times, "SLOW", 0.0)
    assert to_time(plan, plan.cases, every=False) == []
    assert len(read) == len({case.mesh for case in plan.cases}) < len(plan.cases)
