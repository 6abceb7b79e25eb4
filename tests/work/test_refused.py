"""What a plan says will be refused, before anything is meshed or solved."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import meshio
import pytest
from numpy.testing import assert_allclose

from tests.bodies import shaped
from tests.work import shared_work
from tests.work.shared_work import TABLES, plan_of
from vdmbench import models
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh_cache import mesh_from_cache
from vdmbench.study.registry import Size
from vdmbench.work.explain import summary

pytestmark = pytest.mark.usefixtures("read_here")

cache, meshes = shared_work.cache, shared_work.meshes  # the fixtures


@pytest.mark.parametrize(
    ("share", "known", "told"),
    [
        (0.7, False, "about 40 surface nodes"),
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
    nodes = mesh.expected.size.nodes
    if known:
        nodes = len(mesh_from_cache(mesh.geometry, cache).surface_nodes)
    found = models.all_models()["mass-spring"]
    most = dataclasses.replace(found, most_nodes=math.ceil(share * nodes))
    monkeypatch.setitem(models.all_models(), "mass-spring", most)
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
        "region 'finger' lies off the body: the body has x from -0.05 to 0.05, "
        "y from -0.05 to 0.05, z from -0.05 to 0.05 m; a mixed-up unit? A bare number is in metres"
    )
    assert summary(plan)["refused"] == [line] * told


@pytest.mark.parametrize(("suffix", "known"), [(".stl", False), (".vtu", True)])
@pytest.mark.parametrize(("height", "told"), [(0.1, True), (0.055, False)])  # an edge beyond is no matter
def test_a_region_off_the_body_of_a_file_is_named_before_it_is_meshed(
    tmp_path: Path, suffix: str, known: bool, height: float, told: bool
) -> None:
    file, shape = tmp_path / f"ball{suffix}", shaped("sphere", 0.022, {"radius": 0.05})
    ball = build_mesh(shape)
    cells = {
        ".stl": (ball.surface_points, ("triangle", ball.triangles)),
        ".vtu": (ball.points, ("tetra", ball.tetrahedra)),
    }
    meshio.write_points_cells(file, cells[suffix][0], [cells[suffix][1]])
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
    ("tetrahedra", "measured"), [(1032, 220), (4292, 305), (8256, 472), (17520, 808), (34336, 1304)]
)
def test_finite_strain_declares_the_memory_that_it_takes(tetrahedra: float, measured: float) -> None:
    """Peak in MB of a process, of 130 MB without work, that solves one load of the shipped slab."""
    law = models.find("fem")[0].memory
    assert law is not None
    assert 130e6 + law(Size(0.0, tetrahedra), "linear") == pytest.approx(1e6 * measured, rel=0.25, abs=0)
