"""Times that decide: measured anew in each run, all models in turns."""

from pathlib import Path

import numpy as np
import pytest

from tests.in_process import HerePool, do_cases
from vdmbench.models import frames
from vdmbench.scene.scene import Scene
from vdmbench.store.run_directory import TIMES, read_times
from vdmbench.work.run import Options, _decides, _time_frames

from .shared_work import TABLES, cache, meshes, plan_of

__all__ = ["cache", "meshes"]  # fixtures
LIMITED = {"acceptance": {"frame_time": 1e-3}}


def timed(plan: object, cases: object) -> None:
    _time_frames(plan, cases, Options(jobs=1), lambda _: None, HerePool())  # type: ignore[arg-type]


def test_a_run_with_nothing_to_do_measures_a_time_that_decides_and_no_other(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    real = frames.one_round

    def seen(scene: Scene, name: str, *, everywhere: bool) -> tuple[float, float, float]:
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
