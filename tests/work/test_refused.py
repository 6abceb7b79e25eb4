"""What a plan says will be refused, before anything is meshed or solved."""

import dataclasses
from pathlib import Path

import pytest

from tests.work import shared_work
from tests.work.shared_work import TABLES, plan_of
from vdmbench import models
from vdmbench.body.mesh_cache import mesh_from_cache
from vdmbench.study.registry import Size
from vdmbench.work.explain import scene_problems, summary

pytestmark = pytest.mark.usefixtures("read_here")

cache, meshes = shared_work.cache, shared_work.meshes  # the fixtures


@pytest.mark.parametrize("known", [False, True])
def test_a_model_that_will_refuse_a_mesh_is_named(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch, known: bool
) -> None:
    """An expected number of nodes is near, one of a mesh that is there is counted."""
    study = TABLES["study"] | {"models": ["mass-spring", "fem-linear"]}
    plan = plan_of(tmp_path, cache if known else tmp_path, study=study)
    (mesh,) = plan.meshes.values()
    counted = len(mesh_from_cache(mesh.geometry, cache).surface_nodes)
    nodes = round(mesh.size.nodes)
    assert nodes == counted if known else nodes == pytest.approx(counted, rel=0.25)
    for most, told in ((nodes - 1, True), (nodes + 1, False)):
        model = dataclasses.replace(models.all_models()["mass-spring"], most_nodes={"linear": most})
        monkeypatch.setitem(models.all_models(), "mass-spring", model)
        lines = summary(plan)["refused"]
        assert [line.partition(";")[0] for line in lines] == [
            f"mass-spring on a mesh of about {nodes} surface nodes, more than its {most}"
        ] * told


def test_what_cuts_a_body_into_parts_is_not_held_to_the_nodes_of_one(tmp_path: Path) -> None:
    """`bem:nonlinear` answers beyond the nodes of one dense matrix, `bem` does not."""
    study = {"name": "test", "models": ["bem", "bem:nonlinear"]}
    geometry = TABLES["geometry"] | {"mesh_size": 0.001}
    lines = summary(plan_of(tmp_path, tmp_path, study=study, geometry=geometry, uncertainty=None))["refused"]
    assert [line.split()[0] for line in lines] == ["bem"]
    assert lines[0].endswith("; use a larger mesh_size or bem-sparse, or leave the model out")


def test_a_check_tells_who_will_refuse_inclusions_that_touch(tmp_path: Path) -> None:
    """Of the models that know inclusions those of surfaces; apart they are nothing to tell."""
    study = {"name": "test", "models": ["bem", "bem:nonlinear", "fem-linear"]}
    changes = {"geometry": TABLES["geometry"] | {"mesh_size": 0.01}, "sweep": {}, "uncertainty": None}
    for way, told in (
        (0.0, ["bem will refuse: inclusions touch each other ('left' and 'right')"]),
        (0.01, []),
    ):
        lumps = [
            {"name": name, "ball": {"center": [x, 0, 0], "radius": 0.016}, "youngs_modulus": 1e4}
            for name, x in (("left", -0.014 - way), ("right", 0.014 + way))
        ]
        plan = plan_of(tmp_path, tmp_path, study=study, inclusions=lumps, **changes)
        found = [problem.message for problem in scene_problems(plan)]
        assert [text.partition(",")[0] for text in found] == told


@pytest.mark.parametrize(
    ("tetrahedra", "measured"), [(1032, 220), (4292, 305), (8256, 472), (17520, 808), (34336, 1304)]
)
def test_finite_strain_declares_the_memory_that_it_takes(tetrahedra: float, measured: float) -> None:
    """Peak in MB of a process, of 130 MB without work, that solves one load of the shipped slab."""
    law = models.find("fem")[0].memory
    assert law is not None
    assert 130e6 + law(Size(0.0, tetrahedra), "linear") == pytest.approx(1e6 * measured, rel=0.25, abs=0)
