"""The coarse peer: transfer that keeps linear fields and resultants, supports of the right area, errors."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fem_reference.linear import LinearProblem
from vdmbench import models
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh import Mesh
from vdmbench.body.surface_measures import Surface, enclosed_volume, relative_l2
from vdmbench.models.coarse import (
    COARSENING,
    CoarseProblem,
    coarse_mesh,
    coarse_support,
    surface_interpolation,
)
from vdmbench.scene.scene import Scene, build_scene
from vdmbench.study.schema import Study

STUDY = {
    "study": {"name": "test", "models": ["fem-coarse"]},
    "geometry": {"shape": "box", "size": [0.1, 0.08, 0.06], "mesh_size": 0.012},
    "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.49, "density": 1000.0},
    "regions": {
        "base": {"below": {"axis": "z", "value": -0.03}},
        "finger": {"ball": {"center": [0.0, 0.0, 0.03], "radius": 0.03}},
    },
    "constraints": [
        {"kind": "fixed", "region": "base"},
        {"kind": "contact", "region": "finger", "force": 0.2, "profile": "hertz"},
    ],
    "load": {"factors": [0.5, 1.0]},
}


def _scene(**changes: object) -> Scene:
    study = Study.model_validate({**STUDY, **changes})
    return build_scene(study, build_mesh(study.geometry))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return _scene()


@pytest.fixture(scope="module")
def coarse(scene: Scene) -> Mesh:
    return coarse_mesh(scene.mesh)


def test_the_mesh_is_of_the_same_body_and_as_coarse_as_said(scene: Scene, coarse: Mesh) -> None:
    def edge(mesh: Mesh) -> float:
        corners = mesh.surface_points[mesh.triangles]
        return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean())

    assert_allclose(edge(coarse) / edge(scene.mesh), COARSENING, rtol=0.15, atol=0)
    assert_allclose(np.ptp(coarse.surface_points, axis=0), [0.1, 0.08, 0.06], rtol=0.15, atol=0)


def test_displacement_and_force_are_transferred_by_one_matrix(scene: Scene, coarse: Mesh) -> None:
    """Constants are kept, so is the resultant; a linear field is off by the distance of the surfaces at most."""
    problem = LinearProblem(
        coarse.points,
        coarse.tetrahedra,
        coarse.surface_nodes,
        coarse.triangles,
        youngs_modulus=1.0,
        poisson_ratio=0.3,
        held=np.ones(len(coarse.surface_nodes), dtype=bool),
    )
    points = scene.mesh.surface_points
    matrix = surface_interpolation(problem.mesh, points)
    assert_allclose(matrix.sum(axis=1), 1.0, rtol=1e-12, atol=0)
    assert_allclose(
        (matrix.T @ scene.contact_force).sum(axis=0), scene.contact_force.sum(axis=0), rtol=1e-12, atol=1e-15
    )
    # the corners of the box are cut by half an edge of 24 mm, nothing else is
    assert np.linalg.norm(matrix @ problem.mesh.node_points - points, axis=1).max() < 0.012
    # at the coarse nodes themselves, middles of edges included, it is the identity
    nodes = np.unique(problem.mesh.facet_nodes)
    own = surface_interpolation(problem.mesh, problem.mesh.node_points[nodes])
    assert_allclose(own.toarray()[:, nodes], np.eye(len(nodes)), rtol=0, atol=1e-9)


def test_the_support_keeps_its_area(scene: Scene, coarse: Mesh) -> None:
    held, nearest = coarse_support(scene, coarse)
    assert scene.held[nearest].all()
    corners = coarse.surface_points[coarse.triangles[held[coarse.triangles].all(axis=1)]]
    area = (
        0.5
        * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    )
    assert_allclose(area, 0.1 * 0.08, rtol=0.1, atol=0)
    assert coarse.surface_points[held, 2].max() < -0.03 + COARSENING * 0.012, "none further than an edge"


def test_near_the_linear_answer_and_in_balance(scene: Scene) -> None:
    fine, coarse = (models.run_model(scene, name) for name in ("fem-linear", "fem-coarse"))
    areas = Surface(scene.mesh.surface_points, scene.mesh.triangles).areas
    assert 1e-3 < relative_l2(coarse.displacement[-1], fine.displacement[-1], areas) < 0.2
    assert_allclose(coarse.displacement[0], 0.5 * coarse.displacement[1], rtol=0, atol=1e-9)
    total = scene.contact_force.sum(axis=0)
    assert_allclose(coarse.reaction_force[-1].sum(axis=0), -total, rtol=0, atol=1e-8 * np.linalg.norm(total))
    assert not coarse.reaction_force[:, ~scene.held].any()
    assert_allclose(coarse.energy[-1], fine.energy[-1], rtol=0.2, atol=0)
    assert float(coarse.parameters["dofs"]) < 0.4 * float(fine.parameters["dofs"])


def test_weight_and_a_moved_tool() -> None:
    tool = {"kind": "constrained", "region": "finger", "displacement": [0.0, 0.0, -0.002]}
    pulled = _scene(
        constraints=[STUDY["constraints"][0], tool],  # type: ignore[index]
        gravity={"acceleration": [0.0, 0.0, -9.81]},
    )
    result = CoarseProblem(pulled, 2).solve(pulled.loads)
    assert_allclose(result.displacement[1][pulled.held], pulled.prescribed[pulled.held], rtol=0, atol=0)
    weight = 1000.0 * 9.81 * enclosed_volume(pulled.mesh.surface_points, pulled.mesh.triangles)
    assert_allclose(result.reaction_force[:, :, 2].sum(axis=1), weight, rtol=1e-8, atol=0)
    mesh = coarse_mesh(pulled.mesh)
    volume = enclosed_volume(mesh.surface_points, mesh.triangles)
    assert_allclose(9.81 * volume * result.parameters["coarse_density"], weight, rtol=1e-12, atol=0)


@pytest.mark.parametrize("count", [2, 3])
def test_a_support_smaller_than_its_facets_is_refused(scene: Scene, count: int) -> None:
    """One node or two let a body turn, and the facet that the coarse mesh would hold in their place does not."""
    nodes = scene.mesh.triangles[scene.fixed[scene.mesh.triangles].all(axis=1)][0][:count]
    fixed = np.zeros_like(scene.fixed)
    fixed[nodes] = True
    result = models.run_model(dataclasses.replace(scene, fixed=fixed), "fem-coarse")
    assert {status.code for status in result.status} == {models.REFUSED}
    assert "too small for the coarse mesh" in result.status[0].message
    assert "hold a wider region" in result.status[0].remedy
