"""The estimate of the discretisation error on fields with known recovered strain."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fem_reference import recovery
from fem_reference.mesh import TetMesh
from fem_reference.recovery import StrainRecovery, displacement_gradient
from tests.fem.shapes import Body, cube


def _field(x: np.ndarray) -> np.ndarray:
    return np.column_stack([np.sin(2.0 * x[:, 1]), x[:, 0] * x[:, 2], np.cos(x[:, 0] + x[:, 1])])


@pytest.mark.parametrize("order", [1, 2])
def test_fields_of_the_element_have_no_error(order: int) -> None:
    mesh = TetMesh(*cube(3, distort=0.2).arrays, order=order)
    x = mesh.node_points
    u = x @ np.array([[1.0, 0.2, 0.3], [0.0, -1.0, 0.5], [0.3, 0.0, 2.0]])
    if order == 2:
        u = u + np.column_stack([x[:, 0] * x[:, 1], x[:, 2] ** 2, x[:, 0] ** 2])
    assert StrainRecovery(mesh).relative_error(u) < 1e-12
    assert StrainRecovery(mesh).relative_error(np.zeros_like(u)) == 0.0


def test_p1_estimate_by_hand() -> None:
    """u_x = x^2 on a uniform row of cells: strain jumps by 2 h, the estimate tends to the exact error."""
    for n, low, high in ((4, 0.8, 1.2), (12, 0.95, 1.05)):
        mesh = TetMesh(*cube(n).arrays, order=1)
        x = mesh.points[:, 0]
        u = np.column_stack([x**2, 0.0 * x, 0.0 * x])
        # eps_h is 2 x at each cell's middle: error 2 (x - middle), L2 norm h / sqrt(3); norm(2 x) = 2 / sqrt(3).
        exact = (1.0 / n / np.sqrt(3.0)) / (2.0 / np.sqrt(3.0))
        assert low < StrainRecovery(mesh).relative_error(u) / exact < high


@pytest.mark.parametrize("order", [1, 2])
def test_turning_the_body_changes_nothing(order: int) -> None:
    b = cube(3, distort=0.2)
    turn, _ = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    turned = Body(b.points @ turn.T, b.tetrahedra, b.surface_nodes, b.triangles)
    one, other = (TetMesh(*body.arrays, order=order) for body in (b, turned))
    u = _field(one.node_points)
    first = StrainRecovery(one).relative_error(u)
    assert first > 1e-3
    assert_allclose(StrainRecovery(other).relative_error(u @ turn.T), first, rtol=1e-9, atol=0)


def test_passes_over_parts_of_the_mesh_add_up(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = TetMesh(*cube(3, distort=0.2).arrays)
    u = _field(mesh.node_points)
    whole = StrainRecovery(mesh).relative_error(u)
    monkeypatch.setattr(recovery, "_CHUNK", 50)
    assert_allclose(StrainRecovery(mesh).relative_error(u), whole, rtol=1e-12, atol=0)


def test_a_mesh_too_small_for_any_fit_still_has_an_estimate() -> None:
    mesh = TetMesh(*cube(1).arrays)
    assert 0.0 < StrainRecovery(mesh).relative_error(_field(mesh.node_points)) < 1.0


def test_a_turn_of_the_body_is_no_finite_strain() -> None:
    mesh = TetMesh(*cube(3, distort=0.2).arrays)
    turn, _ = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    u = 0.1 * _field(mesh.node_points)
    turned = (mesh.node_points + u) @ turn.T - mesh.node_points
    recovery = StrainRecovery(mesh, finite=True)
    error = recovery.relative_error(u)
    assert error > 1e-3
    assert_allclose(recovery.relative_error(turned), error, rtol=1e-9, atol=0)
    assert StrainRecovery(mesh).relative_error(turned) < 0.5 * error


def test_a_node_takes_the_fit_about_its_own_vertex() -> None:
    """A node moved beyond a vertex's own tetrahedra changes fits about its neighbours, but no strain there."""
    mesh = TetMesh(*cube(4).arrays, order=1)
    middle = int(np.argmin(np.linalg.norm(mesh.points - 0.5, axis=1)))
    patch = np.unique(mesh.tetrahedra[(mesh.tetrahedra == middle).any(axis=1)])
    (beyond,) = np.flatnonzero(np.linalg.norm(mesh.points - [1.0, 0.5, 0.5], axis=1) < 1e-9)
    assert beyond not in patch
    still = _field(mesh.points)
    moved = still.copy()
    moved[beyond] += 0.1
    recovery = StrainRecovery(mesh)
    first, other = (
        recovery._recover(u, recovery._strain(displacement_gradient(mesh, u, np.eye(4))))
        for u in (still, moved)
    )
    changes = np.abs(other - first).max(axis=1)
    assert changes[patch].max() > 1e-2, "about a neighbour"
    assert changes[middle] < 1e-6
