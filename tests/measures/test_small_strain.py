"""The small-strain limits of a real scene, held against runs of the models at the loads that were found."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from vdmbench import models
from vdmbench.body.mesh_cache import mesh_from_cache
from vdmbench.body.refine import inherit, refine
from vdmbench.body.surface_measures import Surface, relative_l2
from vdmbench.measures.case import ModelLimits
from vdmbench.scene.scene import Scene, build_scene
from vdmbench.study.checks import only_load
from vdmbench.study.config import load_study
from vdmbench.study.files import merged
from vdmbench.study.schema import Study
from vdmbench.work.small_strain import small_strain_limits

STUDY = """
[study]
name = "limits"
models = ["bem", "fem-linear", "fem"]
reference = "fem"
[geometry]
shape = "box"
size = ["40 mm", "40 mm", "30 mm"]
mesh_size = "15 mm"
[tissue]
youngs_modulus = "5 kPa"
poisson_ratio = 0.49
[regions]
bottom.below = { axis = "z", value = "-15 mm" }
tool = { above = { axis = "z", value = "15 mm" }, ball = { center = [0, 0, "15 mm"], radius = "20 mm" } }
[[constraints]]
kind = "fixed"
region = "bottom"
[[constraints]]
name = "tool"
kind = "contact"
region = "tool"
pressure = "300 Pa"
[limits]
thresholds = [0.05]
[uncertainty]
levels = 2
"""

Found = tuple[Study, Scene, dict[str, ModelLimits]]
PRESSURE = 300.0  # Pa, of the study


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Found:
    directory = tmp_path_factory.mktemp("limits")
    path: Path = directory / "study.toml"
    path.write_text(STUDY)
    study = load_study(path)
    scene = build_scene(study, mesh_from_cache(study.geometry, directory / "cache", volume=True))
    return study, scene, small_strain_limits(study, scene.mesh)


def grown(
    study: Study,
    scene: Scene,
    name: str,
    factor: float,
    *,
    refined: bool,
    together: bool = False,
) -> tuple[float, float]:
    """(error of a model against the reference, the reference's strain) at a factor of the load, both run anew.

    `together`: of all that acts, else of the pressure alone.
    """
    mesh, masks = scene.mesh, scene.regions
    if refined:
        mesh, parents = refine(scene.mesh)
        masks = {region: inherit(mask, scene.mesh, parents) for region, mask in scene.regions.items()}
    changes: dict[str, Any] = {"constraints": {"tool": {"pressure": factor * PRESSURE}}, "limits": None}
    if together:
        weight = [0.0, 0.0, -4.0 * factor]
        changes = {"load": {"factors": [factor]}, "gravity": {"acceleration": weight}, "limits": None}
    higher = Study.model_validate(merged(study.model_dump(mode="json"), changes))
    own, inside = build_scene(higher, scene.mesh, scene.regions), build_scene(higher, mesh, masks)
    surface = Surface(scene.mesh.surface_points, scene.mesh.triangles)
    reference = models.run_model(inside, "fem")
    answer = models.run_model(inside if name == "fem-linear" else own, name)
    n_nodes = len(surface.points)
    error = relative_l2(
        answer.displacement[-1, :n_nodes], reference.displacement[-1, :n_nodes], surface.areas
    )
    return error, float(reference.scalars["p95_principal_strain"][-1])


def test_the_error_has_grown_by_the_threshold_at_the_load_that_was_found(found: Found) -> None:
    study, scene, _ = found
    own = small_strain_limits(study.model_copy(update={"uncertainty": None}), scene.mesh)
    assert only_load(study) == ("constraints.tool.pressure", PRESSURE, "Pa")
    for name, entry in own.items():
        (limit,) = entry.limits  # `test_limits` has several thresholds, by closed forms
        assert limit.state == "found"
        error, strain = grown(study, scene, name, limit.load, refined=False)
        assert_allclose(error - entry.structural_error, limit.threshold, rtol=0.021, atol=0)
        assert_allclose(limit.strain, strain, rtol=1e-6, atol=0)
        assert np.isnan(limit.bar)


@pytest.mark.slow
def test_the_limit_of_the_refined_mesh_lies_inside_the_bar(found: Found) -> None:
    """The error has not grown by the threshold at the bar's lower end, and has at its upper one."""
    study, scene, limits = found
    for name, entry in limits.items():
        (limit,) = entry.limits
        low, _ = grown(study, scene, name, limit.load * (1.0 - limit.bar), refined=True)
        high, _ = grown(study, scene, name, limit.load * (1.0 + limit.bar), refined=True)
        assert low - entry.structural_error < limit.threshold < high - entry.structural_error


def test_the_limit_of_a_departure_by_a_power_law_is_that_of_the_refined_mesh(found: Found) -> None:
    study, scene, limits = found
    linear = limits["fem-linear"]
    (limit,) = linear.limits
    error, strain = grown(study, scene, "fem-linear", limit.load, refined=True)
    assert_allclose(error - linear.structural_error, limit.threshold, rtol=0.005, atol=0)
    assert_allclose(limit.strain, strain, rtol=0.02, atol=0)


SIDE = """
[regions.side]
box = { min = ["20 mm", -1, 0], max = [1, 1, 1] }
[gravity]
acceleration = [0, 0, -4]
[[constraints]]
kind = "constrained"
region = "side"
displacement = ["-1 mm", 0, "0.5 mm"]
"""


def test_loads_are_raised_together(tmp_path: Path) -> None:
    """A contact, a movement and a weight: small loads are small, and the limit is a multiple of all of them."""
    head, limits = STUDY.split("[uncertainty]")[0].split("[limits]")
    path = tmp_path / "study.toml"
    head = head.replace("[regions]", "density = 1000\n[regions]")
    path.write_text(f"{head}{SIDE}[limits]{limits}")
    study = load_study(path)
    assert only_load(study) is None
    scene = build_scene(study, mesh_from_cache(study.geometry, tmp_path / "cache", volume=True))
    found = small_strain_limits(study, scene.mesh)
    assert found["fem-linear"].structural_error < 1e-3
    for name, entry in found.items():
        (limit,) = entry.limits
        assert limit.state == "found"
        error, strain = grown(study, scene, name, limit.load, refined=False, together=True)
        assert_allclose(error - entry.structural_error, limit.threshold, rtol=0.021, atol=0)
        assert_allclose(limit.strain, strain, rtol=1e-6, atol=0)
