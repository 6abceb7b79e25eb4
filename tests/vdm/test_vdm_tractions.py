"""Facets that share a traction: which do, the operators of the long way, and what it costs in accuracy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from tests.vdm.vdm_shapes import box, icosphere
from vdm import Load, Model, Parameters, SurfaceMesh
from vdm.boundary import operators
from vdm.boundary.operators import Facets, assembled
from vdm.boundary.tractions import shared

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def rough(level: int = 2) -> tuple[Array, Index]:
    """An ellipsoid whose facets are all unlike."""
    points, triangles = icosphere(level, (0.05, 0.04, 0.03))
    return points + 1e-3 * np.random.default_rng(0).standard_normal(points.shape), triangles


def members(numbers: Index) -> list[Index]:
    return [np.flatnonzero(numbers == number) for number in range(numbers.max() + 1)]


@pytest.mark.parametrize("shape", [rough(), box(8, (0.04, 0.04, 0.04))], ids=["rough", "box"])
def test_neighbours_share_a_traction_but_at_the_rim(shape: tuple[Array, Index]) -> None:
    points, triangles = shape
    surface, held = SurfaceMesh(points, triangles), points[:, 2] < np.median(points[:, 2]) - 0.01
    numbers = shared(surface, held)
    i, j = surface.edges.T
    rim = surface.edges[held[i] != held[j]]
    at_rim = np.isin(triangles, rim[held[rim]]).any(axis=1)
    alone = 0
    for facets in members(numbers):
        if len(facets) == 1:
            alone += not at_rim[facets[0]]
        else:
            first, second = facets
            assert len(set(triangles[first]) & set(triangles[second])) == 2
            assert not at_rim[facets].any()
    assert at_rim.any()
    assert alone < 0.16 * (~at_rim).sum()


def test_facets_at_a_right_angle_or_more_share_none() -> None:
    """A box has no pair over an edge; at the rim of a double cone, sharper than that, two would have no normal."""
    around = 2.0 * np.pi * np.arange(12) / 12
    rim = np.stack([np.cos(around), np.sin(around), np.zeros(12)], axis=1)
    cone = np.vstack([rim, [[0.0, 0.0, 0.2], [0.0, 0.0, -0.2]]])
    i, j = np.arange(12), np.roll(np.arange(12), -1)
    sides = np.vstack([np.stack([i, j, np.full(12, 12)], axis=1), np.stack([j, i, np.full(12, 13)], axis=1)])
    for points, triangles in (box(8, (0.04, 0.04, 0.04)), (cone, sides)):
        surface = SurfaceMesh(points, triangles)
        normals = Facets.of(points, triangles).normals
        pairs = [two for two in members(shared(surface, np.zeros(len(points), np.bool_))) if len(two) == 2]
        assert len(pairs) > 0.4 * len(triangles)
        assert min(normals[first] @ normals[second] for first, second in pairs) > 0.8


@pytest.mark.parametrize("nu", [0.3, 0.4999, 0.5])
def test_the_operators_are_those_of_all_tractions_summed_up(nu: float) -> None:
    points, triangles = rough(1)
    numbers = shared(SurfaceMesh(points, triangles), points[:, 0] < -0.03)
    own, few = Facets.of(points, triangles), Facets.of(points, triangles, numbers)
    spread = np.zeros((len(triangles), 3, few.n_tractions, 3))
    for f, number in enumerate(numbers):
        mean = (own.areas[:, None] * own.normals)[numbers == number].sum(axis=0)
        mean /= np.linalg.norm(mean)
        spread[f, :, number] = np.eye(3) + np.outer(own.normals[f] - mean, mean)
    spread = spread.reshape(3 * len(triangles), -1)
    whole, parts = assembled(own, nu), assembled(few, nu)
    for found, expected in (
        (parts.single, spread.T @ whole.single @ spread),
        (parts.jump, spread.T @ whole.jump),
        (parts.hypersingular, whole.hypersingular),
    ):
        assert_allclose(found, expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())


def test_sharing_costs_an_answer_less_than_its_mesh_does(monkeypatch: pytest.MonkeyPatch) -> None:
    nu = 0.5

    def solved(level: int) -> Array:
        points, triangles = icosphere(level, (0.05, 0.05, 0.05))
        parameters = Parameters(shear_modulus=1e3, poisson_ratio=nu)
        model = Model(points, triangles, parameters, formulation="bem", fixed=points[:, 2] < -0.03)
        pressure = 10.0 * np.clip(points[:, 2] / 0.05, 0.0, 1.0)
        return np.asarray(model.solve([Load(pressure)]).displacement[0][:42])

    each = solved(1)
    monkeypatch.setattr(operators, "DOUBLE_NODES", 1000)
    assert_allclose(solved(1), each, rtol=0.0, atol=0.0)  # few nodes: each facet has its own
    finer = solved(2)
    monkeypatch.setattr(operators, "DOUBLE_NODES", 0)
    shared_by_two = solved(1)
    assert 0.0 < np.linalg.norm(shared_by_two - each) < 0.3 * np.linalg.norm(each - finer)


def test_a_solid_next_to_incompressible_keeps_its_volume(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a uniform pressure among the shared tractions it loses its bulk modulus."""
    monkeypatch.setattr(operators, "DOUBLE_NODES", 0)
    points, triangles = rough()
    load = Load(np.where(points[:, 2] > 0.02, 10.0, 0.0))
    answers = []
    for nu in (0.4997, 0.5):
        parameters = Parameters(shear_modulus=1e3, poisson_ratio=nu)
        model = Model(points, triangles, parameters, formulation="bem", fixed=points[:, 2] < -0.02)
        answers.append(model.solve([load]).displacement[0])
    assert np.linalg.norm(answers[0] - answers[1]) < 3e-3 * np.linalg.norm(answers[1])
