"""The small-strain limits of a real scene, held against runs of the models at the loads that were found."""

from __future__ import annotations

from pathlib import Path

import pytest
from numpy.testing import assert_allclose

from studies import models
from studies.case import SmallStrainLimits
from studies.meshing.mesh_cache import mesh_from_cache
from studies.meshing.refine import inherit, refine
from studies.scene import Scene, build_scene
from studies.setups import sharing
from studies.small_strain import small_strain_limits
from studies.study_file.config import geometry_of, load_study, raised, value_and_unit
from studies.study_file.schema import Study
from studies.surface_measures import Surface, relative_l2

STUDY = """
[study]
name = "limits"
models = ["vdm-vector", "fem-linear", "fem"]
reference = "fem"
[geometry]
shape = "box"
size = ["60 mm", "60 mm", "30 mm"]
mesh_size = "15 mm"
[tissue]
youngs_modulus = "5 kPa"
poisson_ratio = 0.49
[regions]
bottom.below = { axis = "z", value = "-15 mm" }
top.above = { axis = "z", value = "15 mm" }
tool = { all = ["top", { ball = { center = [0, 0, "15 mm"], radius = "20 mm" } }] }
[[constraints]]
kind = "fixed"
region = "bottom"
[[constraints]]
name = "tool"
kind = "contact"
region = "tool"
pressure = "300 Pa"
[limits]
along = "constraints.tool.pressure"
thresholds = [0.02, 0.05]
[uncertainty]
levels = 2
"""

Found = tuple[Study, Scene, SmallStrainLimits]


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Found:
    directory = tmp_path_factory.mktemp("limits")
    path: Path = directory / "study.toml"
    path.write_text(STUDY)
    study = load_study(path)
    scene = build_scene(study, mesh_from_cache(geometry_of(study), directory / "cache", volume=True))
    with sharing():
        return study, scene, small_strain_limits(study, scene)


def test_the_error_has_grown_by_the_threshold_at_the_load_that_was_found(found: Found) -> None:
    """On the refined mesh, where models are run anew; also on the case's own where no bars are asked for."""
    study, scene, limits = found
    assert limits.along == "constraints.tool.pressure"
    assert limits.unit == "Pa"
    linear = study.study.model_copy(update={"models": ("fem-linear", "fem")})
    with sharing():
        own = small_strain_limits(study.model_copy(update={"study": linear, "uncertainty": None}), scene)
    mesh, parents = refine(scene.mesh)
    regions = {name: inherit(mask, scene.mesh, parents) for name, mask in scene.regions.items()}
    surface = Surface(scene.mesh.surface_points, scene.mesh.triangles)
    checked = 0
    for found_limits, inside, masks, close in (
        (own, scene.mesh, scene.regions, 1e-6),
        (limits, mesh, regions, 0.02),
    ):
        for name, entry in found_limits.models.items():
            for limit in entry.limits:
                if limit.state != "found":
                    continue
                higher = raised(study, limits.along, limit.load)
                reference = models.run_model(build_scene(higher, inside, masks), "fem")
                on = inside if name == "fem-linear" else scene.mesh
                scene_of_model = build_scene(higher, on, masks if name == "fem-linear" else scene.regions)
                answer = models.run_model(scene_of_model, name)
                n_nodes = len(surface.points)
                error = relative_l2(
                    answer.displacement[-1, :n_nodes], reference.displacement[-1, :n_nodes], surface.areas
                )
                assert_allclose(error - entry.structural_error, limit.threshold, rtol=0.021, atol=0)
                assert_allclose(
                    limit.strain, reference.scalars["max_principal_strain"][-1], rtol=close, atol=0
                )
                # what leads from the case's mesh to the refined one, the bar covers, and not much more
                if found_limits is limits and name in own.models:
                    before = next(old for old in own.models[name].limits if old.threshold == limit.threshold)
                    moved = abs(limit.load - before.load) / limit.load
                    assert moved - 0.02 <= limit.bar <= moved + 0.02
                    assert limit.strain_bar >= abs(limit.strain - before.strain) / limit.strain - 0.02
                checked += 1
    assert checked >= 4


def test_linear_elements_have_no_structural_error_and_the_vector_form_has(found: Found) -> None:
    _, _, limits = found
    assert limits.models["fem-linear"].structural_error < 1e-3  # what is left is the small load's own square
    assert limits.models["vdm-vector"].structural_error > 0.1
    small, large = limits.models["fem-linear"].limits
    assert small.state == large.state == "found"
    assert small.load < large.load
    assert small.indentation < large.indentation
    assert small.strain < large.strain


def test_the_reference_gives_the_limits_their_bars(found: Found) -> None:
    _, _, limits = found
    for limit in limits.models["fem-linear"].limits:
        assert 0 < limit.bar < 1
        assert 0 < limit.indentation_bar < 1
        # the rim's strain rises as it is refined, and is the least known
        assert limit.indentation_bar < limit.strain_bar < 1


def test_a_raised_study_has_one_load_step_at_the_new_value(found: Found) -> None:
    study, _, _ = found
    higher = raised(study, "constraints.tool.pressure", 777.0)
    assert value_and_unit(higher, "constraints.tool.pressure") == (777.0, "Pa")
    assert higher.load.factors == (1.0,)
    assert value_and_unit(study, "constraints.tool.pressure") == (300.0, "Pa")
