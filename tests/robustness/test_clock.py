"""A clock that is wrong, or jumps, changes no result and no decision."""

from __future__ import annotations

import datetime
import os
import re
import shutil
import time
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from vdmbench.store import cases as store

from .processes import CACHE, RUN
from .test_damage import _displacements, _plan, _run

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("year", [1971, 2100])
def test_the_age_of_files_decides_nothing(undisturbed: tuple[Path, float], tmp_path: Path, year: int) -> None:
    copy = Path(shutil.copytree(undisturbed[0], tmp_path / "copy"))
    stamp = datetime.datetime(year, 1, 1, tzinfo=datetime.UTC).timestamp()
    for path in copy.rglob("*"):
        os.utime(path, (stamp, stamp))
    assert set(_plan(copy).state.values()) == {"done"}
    assert _run(copy) == 0
    lost = sorted((copy / RUN / "cases").iterdir())[0]
    lost.unlink()
    assert _run(copy) == 1
    assert lost.stat().st_mtime != stamp
    others = [path for path in (copy / CACHE).rglob("*.npz") if path.stat().st_mtime != stamp]
    assert others == [], "mesh and references were taken as they are"


def test_a_clock_that_runs_backwards_changes_no_result(
    undisturbed: tuple[Path, float], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each look at it finds it an hour earlier. Durations come from clocks that only go forwards."""
    shutil.copy(undisturbed[0] / "small.toml", tmp_path)
    looks = count()
    monkeypatch.setattr(time, "time", lambda: 1e9 - 3600 * next(looks))
    monkeypatch.setattr(time, "time_ns", lambda: int(1e18) - 3600 * 10**9 * next(looks))
    assert _run(tmp_path) == 6
    ours, theirs = _displacements(tmp_path), _displacements(undisturbed[0])
    for key, displacement in theirs.items():
        atol = 1e-12 * float(np.abs(displacement).max())
        assert_allclose(ours[key], displacement, rtol=0, atol=atol, err_msg=str(key))
    for case in _plan(tmp_path).cases:
        for model in store.read_case(store.case_path(tmp_path / RUN, case.hash)).models.values():
            assert 0 < model.seconds_setup < 600
            assert (model.seconds_per_step > 0).all()


def test_only_dates_that_are_shown_come_from_the_clock() -> None:
    """No module asks a clock that can jump, nor the age of a file, but for the date of a result or a baseline."""
    asks = re.compile(r"\btime\.(time|ctime|localtime|gmtime)(_ns)?\(|st_[mca]time|getmtime|\.now\(|today\(")
    found = {
        str(path.relative_to(ROOT)): asks.findall(path.read_text())
        for package in ("studies", "vdm", "fem_reference", "solver_common")
        for path in (ROOT / package).rglob("*.py")
        if asks.search(path.read_text())
    }
    assert {name: len(hits) for name, hits in found.items()} == {
        "studies/work/provenance.py": 1,
        "studies/gate.py": 1,
    }
