"""What a plan expects a run to take."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.work import shared_work
from tests.work.shared_work import TABLES, plan_of, run
from vdmbench.models import costs
from vdmbench.study.config import expand, load_study
from vdmbench.study.files import SHIPPED
from vdmbench.study.registry import Size
from vdmbench.work.estimate import _PROCESS_BYTES, _law
from vdmbench.work.explain import summary
from vdmbench.work.plan import make_plan

cache, meshes = shared_work.cache, shared_work.meshes  # the fixtures


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
    assert line in searched["needed"]
    assert line not in own["needed"]


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
    assert 45.0 / 3.0 < law.setup + 3 * law.step < 45.0 * 3.0


def test_the_coarse_elements_take_the_time_of_their_own_mesh_too() -> None:
    size, coarse = Size(400.0, 8000.0), Size(100.0, 1000.0)
    own, elements = costs.coarse(size, "", 10), costs.linear(coarse, "", 10)
    assert own.setup - elements.setup == pytest.approx(0.3 + 2e-4 * 1000.0, rel=1e-12)
    assert (own.step, own.bytes) == (elements.step, elements.bytes)
