"""Meshes, quadrature, loads and supports of the volumetric reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from fem_reference.loads import held_nodes, nodal_forces
from fem_reference.mesh import TetMesh
from fem_reference.solution import SolverError
from solver_common.quadrature import facet_quadrature
from tests.fem.shapes import ball, body, cube


@pytest.mark.parametrize("order", [1, 2])
def test_forces_add_up_to_the_load(order: int) -> None:
    b = ball(1, radius=0.05)
    mesh = TetMesh(*b.arrays, order=order)
    rng = np.random.default_rng(3)
    pressure = rng.uniform(-100.0, 300.0, (len(b.triangles), 6))
    load = b.load(pressure, gravity=(1.0, -2.0, -9.81))
    force = nodal_forces(mesh, [load, b.load()], density=1060.0)
    area = b.area_vectors
    applied = -area.T @ (pressure @ facet_quadrature()[1])
    weight = 1060.0 * np.linalg.det(np.diff(b.points[b.tetrahedra], axis=1)).sum() / 6.0
    resultant = applied + weight * np.array([1.0, -2.0, -9.81])
    size = np.abs(force[0]).sum()
    assert_allclose(force[0].sum(axis=0), resultant, rtol=0, atol=1e-14 * size)
    # A linear pressure on flat facets: the moment is exact too, the rule integrates p times a P2 function.
    moment = -np.einsum("q,fq,fqi->fi", facet_quadrature()[1], pressure, b.quadrature_points)
    moment = np.cross(moment, area).sum(axis=0)
    surface_only = nodal_forces(mesh, [b.load(pressure)], density=1060.0)[0]
    arms = np.cross(mesh.node_points, surface_only).sum(axis=0)
    assert_allclose(arms, moment, rtol=0, atol=1e-14 * np.abs(surface_only).sum() * 0.05)
    assert_array_equal(force[1], 0.0)


def _with_flat_tetrahedron() -> dict[str, object]:
    corners = CUBE.tetrahedra[0, :3]
    points = np.vstack([CUBE.points, CUBE.points[corners].mean(axis=0)])
    return {"points": points, "tetrahedra": np.vstack([CUBE.tetrahedra, [[*corners, len(points) - 1]]])}


def _with_infinite_point() -> dict[str, object]:
    points = CUBE.points.copy()
    points[3, 1] = np.inf
    return {"points": points}


CUBE = cube(1)
ONE_TURNED = np.where(np.arange(6)[:, None] == 2, CUBE.tetrahedra[:, [1, 0, 2, 3]], CUBE.tetrahedra)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_with_flat_tetrahedron(), "1 of 7 tetrahedra have no volume .the first is number 6"),
        ({"tetrahedra": ONE_TURNED}, "1 of 6 tetrahedra are inverted .the first is number 2"),
        ({"triangles": CUBE.triangles[1:]}, "the triangles leave a hole"),
        ({"triangles": CUBE.triangles[:, ::-1]}, "the triangles enclose -1"),
        ({"points": np.vstack([CUBE.points, [[2.0, 2.0, 2.0]]])}, "1 of 9 points belong to no tetrahedron"),
        (_with_infinite_point(), "not finite"),
        ({"tetrahedra": CUBE.tetrahedra + 1}, "tetrahedra has an index outside 0..7"),
        ({"tetrahedra": CUBE.tetrahedra[:0]}, r"tetrahedra has shape \(0, 4\)"),
    ],
)
def test_unusable_meshes_are_told(change: dict[str, object], words: str) -> None:
    with pytest.raises(SolverError, match=words) as caught:
        TetMesh(*replace(CUBE, **change).arrays)
    assert caught.value.status.code == "bad-mesh"
    assert caught.value.status.remedy


def test_a_triangle_off_the_mesh_is_told() -> None:
    # Two cubes' worth of boundary vertices, but one diagonal turned: same volume, another edge.
    b = cube(1)
    triangles = b.triangles.copy()
    first = triangles[0]
    for k in range(1, len(triangles)):
        shared = np.intersect1d(first, triangles[k])
        normal_a, normal_b = np.sign(b.area_vectors[0]), np.sign(b.area_vectors[k])
        if len(shared) == 2 and np.array_equal(normal_a, normal_b):
            break
    apex_a = int(np.setdiff1d(first, shared)[0])
    apex_b = int(np.setdiff1d(triangles[k], shared)[0])
    turn = int(np.flatnonzero(first == apex_a)[0])
    after = int(first[(turn + 1) % 3])
    before = int(first[(turn + 2) % 3])
    triangles[0] = apex_a, after, apex_b
    triangles[k] = apex_a, apex_b, before
    with pytest.raises(SolverError, match="an edge that no tetrahedron has"):
        TetMesh(b.points, b.tetrahedra, b.surface_nodes, triangles)


@pytest.mark.parametrize(
    ("hold", "words"),
    [
        (lambda x: np.zeros(len(x), dtype=bool), "nothing is held"),
        (lambda x: np.all(x == 0.0, axis=1), "can still move or turn"),
        (lambda x: np.all(x[:, :2] == 0.0, axis=1), "can still move or turn"),
        (lambda x: np.column_stack([x[:, 0] == 0.0, np.zeros((len(x), 2), dtype=bool)]), "can still move"),
        (lambda x: np.ones(len(x) - 1, dtype=bool), "held has shape"),
    ],
)
def test_too_little_support_is_told(hold: object, words: str) -> None:
    b = cube(2)
    with pytest.raises(SolverError, match=words):
        held_nodes(TetMesh(*b.arrays), hold(b.surface))  # type: ignore[operator]


def test_every_separate_body_needs_support() -> None:
    one = cube(1)
    both = body(
        np.vstack([one.points, one.points + np.array([3.0, 0.0, 0.0])]),
        np.vstack([one.tetrahedra, one.tetrahedra + len(one.points)]),
    )
    with pytest.raises(SolverError, match="body 1 of 2 can still move"):
        held_nodes(TetMesh(*both.arrays), (both.surface[:, 2] == 0.0) & (both.surface[:, 0] < 2.0))
    held_nodes(TetMesh(*both.arrays), both.surface[:, 2] == 0.0)
