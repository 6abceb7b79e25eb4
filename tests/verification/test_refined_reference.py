"""The reference on refined meshes: its error estimate holds against a level that the estimate has not seen."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from studies import models
from studies.config import geometry_of
from studies.geometry import build_mesh
from studies.metrics import Surface, relative_l2
from studies.reference import refined_reference
from studies.scene import Scene, build_scene
from studies.schema import Study

STUDY = Study.model_validate(
    {
        "study": {"name": "test", "models": ["fem-linear"]},
        "geometry": {"shape": "sphere", "radius": 0.05, "mesh_size": 0.02},
        "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.4999},
        "regions": {
            "base": {"below": {"axis": "z", "fraction": 0.3}},
            "finger": {"cap": {"direction": [0.2, 0.0, 1.0], "angle": 0.6}},
        },
        "constraints": [
            {"kind": "fixed", "region": "base"},
            {"kind": "contact", "region": "finger", "force": 0.2, "profile": "hertz"},
        ],
        "load": {"factors": [0.5, 1.0]},
    }
)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene(STUDY, build_mesh(geometry_of(STUDY)))


def test_three_levels(scene: Scene) -> None:
    coarse = models.run_model(scene, "fem-linear")
    middle, two = refined_reference(STUDY, scene, "fem-linear", coarse, 2)
    fine, three = refined_reference(STUDY, scene, "fem-linear", coarse, 3)
    areas = Surface(scene.mesh.surface_points, scene.mesh.triangles).areas
    u0, u1, u2 = (result.displacement[-1] for result in (coarse, middle, fine))
    seen, unseen = relative_l2(u0, u1, areas), relative_l2(u1, u2, areas)
    assert unseen < 0.6 * seen, "levels come closer"
    # the bar of two levels holds the difference to the third, and is not wildly wide
    assert unseen <= two["gci"] <= 6 * unseen
    assert np.isnan(two["observed_order"])
    assert 0.8 < three["observed_order"] < 3.2, "a support's edge takes P2 elements below their order of 3"
    assert three["gci"] < two["gci"]
    assert three["levels"] == 3


def test_a_restricted_level_keeps_its_forces_and_steps(scene: Scene) -> None:
    coarse = models.run_model(scene, "fem-linear")
    finest, _ = refined_reference(STUDY, scene, "fem-linear", coarse, 2)
    assert finest.displacement.shape == coarse.displacement.shape == (2, len(scene.fixed), 3)
    assert_allclose(finest.displacement[:, scene.fixed], 0.0, rtol=0, atol=0)
    assert_allclose(finest.displacement[0], 0.5 * finest.displacement[1], rtol=1e-6, atol=1e-12)
    # the load is 0.2 N on every level, evaluated anew
    total = finest.reaction_force.sum(axis=1)
    assert_allclose(np.linalg.norm(total, axis=1), [0.1, 0.2], rtol=1e-6, atol=0)
    assert_allclose(total[1], coarse.reaction_force[1].sum(axis=0), rtol=0, atol=2e-3)
    assert not finest.reaction_force[:, ~scene.held].any()
