"""A frame of a resting contact: the model's own answer, to single precision, whatever model the columns are of."""

from __future__ import annotations

import dataclasses
from types import MethodType

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fem_reference.condensed import CondensedProblem
from fem_reference.linear import LinearProblem
from fem_reference.loads import Load
from solver_common.quadrature import facet_quadrature
from vdm.solvers.columns import ContactColumns
from vdmbench import models
from vdmbench.body.geometry import build_mesh
from vdmbench.body.surface_measures import facet_area_vectors
from vdmbench.models.frames import contact_frame
from vdmbench.scene.scene import Scene, build_scene
from vdmbench.study.schema import Study

STUDY = {
    "study": {"name": "test", "models": ["vdm-paper"]},
    "geometry": {"shape": "ellipsoid", "semi_axes": [0.06, 0.04, 0.05], "mesh_size": 0.013},
    "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.49},
    "regions": {
        "base": {"below": {"axis": "z", "fraction": 0.2}},
        "finger": {"cap": {"direction": [0.3, 0.0, 1.0], "angle": 0.5}},
    },
    "constraints": [
        {"kind": "fixed", "region": "base"},
        {"kind": "contact", "region": "finger", "force": 0.1, "profile": "hertz"},
    ],
}


@pytest.fixture(scope="module")
def scene() -> Scene:
    study = Study.model_validate(STUDY)
    return build_scene(study, build_mesh(study.geometry))


def problem_of(scene: Scene, name: str) -> models.PressureProblem | None:
    """What answers contact pressures linearly, set up."""
    set_up = models.Prepared(scene, name).set_up
    assert set_up is not None
    return set_up.problem if models.superposes(name) else None


@pytest.mark.parametrize("name", ["vdm-paper", "vdm-vector", "bem", "fem-linear", "fem-condensed"])
def test_a_frame_is_the_answer_of_the_model(scene: Scene, name: str) -> None:
    result = models.run_model(scene, name)
    problem = problem_of(scene, name)
    assert problem is not None
    frame = contact_frame(problem, scene)
    pressure = scene.contact_pressure[scene.contact]
    largest = np.abs(result.displacement[-1]).max()
    for factor in (1.0, 1.0, -0.5):  # the second frame may shorten the columns
        displacement, fluid_pressure = frame(factor * pressure)
        assert displacement.shape == (len(scene.fixed), 3)
        assert displacement.dtype == (np.float64 if name == "vdm-paper" else np.float32)
        assert_allclose(displacement, factor * result.displacement[-1], rtol=0, atol=1e-6 * largest)
        assert_allclose(fluid_pressure, factor * result.fluid_pressure[-1], rtol=1e-6, atol=0)


@pytest.mark.parametrize("name", ["fem-linear", "fem-condensed"])
def test_a_node_has_its_share_of_the_contact(scene: Scene, name: str) -> None:
    """100 Pa at one node: the contact's pressure times the node's share of each point, 100 Pa A_i in all."""
    points, triangles = scene.mesh.surface_points, scene.mesh.triangles
    problem = problem_of(scene, name)
    assert isinstance(problem, LinearProblem | CondensedProblem)
    node = int(np.argmax(scene.contact_pressure))
    pressure = np.where(np.flatnonzero(scene.contact) == node, 100.0, 0.0)
    displacement, fluid_pressure = contact_frame(problem, scene)(pressure)
    corners, weights = facet_quadrature()
    part = np.zeros_like(scene.facet_pressure)
    for facet, corner in zip(*np.nonzero(triangles == node), strict=True):
        part[facet] = scene.facet_pressure[facet] * corners[:, corner]
    part *= 100.0 / scene.contact_pressure[node]
    areas = np.linalg.norm(facet_area_vectors(points, triangles), axis=1)
    around = areas[(triangles == node).any(axis=1)].sum() / 3.0
    assert_allclose(areas @ part @ weights, 100.0 * around, rtol=1e-12, atol=0)
    solved = problem.solve([Load(part, np.zeros_like(scene.prescribed), np.zeros(3))])
    size = np.abs(solved.displacement).max()
    assert_allclose(displacement, solved.displacement[0], rtol=0, atol=1e-6 * size)
    assert_allclose(fluid_pressure, solved.fluid_pressure[0], rtol=1e-6, atol=0)


@pytest.mark.parametrize("name", ["fem-linear", "fem-condensed"])
def test_columns_of_elements_are_shortened(name: str) -> None:
    """A finger at the end of a long body, most of which is far from it: few directions span what happens there."""
    study = Study.model_validate(
        STUDY
        | {
            "geometry": {"shape": "ellipsoid", "semi_axes": [0.02, 0.02, 0.12], "mesh_size": 0.008},
            "regions": STUDY["regions"] | {"finger": {"ball": {"center": [0.0, 0.0, 0.12], "radius": 0.03}}},
        }
    )
    scene = build_scene(study, build_mesh(study.geometry))
    problem = problem_of(scene, name)
    assert problem is not None
    frame = contact_frame(problem, scene)
    # from one side: what a long body does under it is not small beside the parts that it is summed from
    pressure = np.where(scene.mesh.surface_points[:, 0] > 0.0, scene.contact_pressure, 0.0)[scene.contact]
    assert isinstance(frame, MethodType)
    columns = frame.__self__
    assert isinstance(columns, ContactColumns)
    (whole, first), read = frame(pressure), columns.nbytes
    (short, second), read_then = frame(pressure), columns.nbytes
    assert read == columns.columns.nbytes
    assert read_then < 0.75 * read
    assert_allclose(short, whole, rtol=0, atol=1e-6 * np.abs(whole).max())
    assert_allclose(second, first, rtol=1e-6, atol=0)


@pytest.mark.parametrize("name", ["fem", "vdm-vector:nonlinear", "vdm-paper:bicg"])
def test_other_models_have_no_columns(scene: Scene, name: str) -> None:
    assert problem_of(scene, name) is None


def test_a_penalty_has_no_columns(scene: Scene) -> None:
    penalised = dataclasses.replace(scene, parameters={"penalty": 1e8})
    assert problem_of(penalised, "vdm-paper") is None
