"""Meshes, quadrature, loads and supports of the volumetric reference."""

from __future__ import annotations

from math import factorial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from fem_reference.loads import gather_to_vertices, held_nodes, nodal_forces, prescribed_nodes
from fem_reference.mesh import TetMesh, triangle_p2
from fem_reference.solution import SolverError
from solver_common.quadrature import facet_quadrature
from tests.unit.fem_shapes import Body, ball, body, cube


def test_facet_quadrature_is_exact_to_degree_four() -> None:
    points, weights = facet_quadrature()
    assert points.shape == (6, 3)
    for i in range(5):
        for j in range(5 - i):
            exact = 2.0 * factorial(i) * factorial(j) / factorial(i + j + 2)
            assert_allclose(weights @ (points[:, 0] ** i * points[:, 1] ** j), exact, rtol=1e-14, atol=0)
    sixth = 2.0 * factorial(5) / factorial(7)
    assert abs(weights @ points[:, 0] ** 5 - sixth) > 1e-5, "degree five is beyond the rule"


def test_triangle_functions_are_one_at_their_own_node() -> None:
    nodes = np.vstack([np.eye(3), [[0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]]])
    assert_allclose(triangle_p2(nodes), np.eye(6), rtol=0, atol=1e-15)


def test_nodes_of_p2_lie_on_vertices_and_edge_middles() -> None:
    b = cube(2, distort=0.2)
    mesh = TetMesh(*b.arrays)
    corners = b.points[b.tetrahedra]
    for node, (i, j) in enumerate(((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)), start=4):
        middle = 0.5 * (corners[:, i] + corners[:, j])
        assert_allclose(mesh.node_points[mesh.element_nodes[:, node]], middle, rtol=1e-15, atol=1e-15)
    for edge, (i, j) in enumerate(((0, 1), (1, 2), (2, 0))):
        middle = 0.5 * (b.surface[b.triangles[:, i]] + b.surface[b.triangles[:, j]])
        assert_allclose(mesh.node_points[mesh.facet_nodes[:, 3 + edge]], middle, rtol=1e-15, atol=1e-15)
    assert_allclose(
        mesh.node_points[mesh.surface_edge_nodes],
        b.surface[mesh.surface_edges].mean(axis=1),
        rtol=1e-15,
        atol=1e-15,
    )
    assert len(mesh.surface_edge_nodes) == 3 * len(b.triangles) // 2, "a closed surface has 3 F / 2 edges"


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


def test_p2_load_of_a_uniform_pressure_sits_on_the_edges() -> None:
    b = body(np.vstack([np.zeros(3), np.eye(3)]), [[0, 1, 2, 3]])
    mesh = TetMesh(*b.arrays)
    bottom = b.facets_where(lambda x: x[:, 2] < 1e-12)
    force = nodal_forces(mesh, [b.load(3.0 * bottom)], density=0.0)[0]
    expected = np.where(mesh.node_points[:, 2] < 1e-12, 3.0 * 0.5 / 3.0, 0.0)
    expected[: mesh.n_vertices] = 0.0
    assert_allclose(force, np.outer(expected, [0.0, 0.0, 1.0]), rtol=0, atol=1e-15)


def test_edges_of_held_facets_are_held_and_no_others() -> None:
    b = cube(2)
    mesh = TetMesh(*b.arrays)
    held = b.surface[:, 2] < 1e-12
    lone = np.flatnonzero(np.all(b.surface == 1.0, axis=1))[0]
    held[lone] = True
    nodes = held_nodes(mesh, held)
    below = mesh.node_points[:, 2] < 1e-12
    vertex = np.zeros(mesh.n_nodes, dtype=bool)
    vertex[b.surface_nodes[lone]] = True
    assert_array_equal(nodes, np.repeat((below | vertex)[:, None], 3, axis=1))


def test_single_components_can_be_held() -> None:
    b = cube(2)
    mesh = TetMesh(*b.arrays)
    rollers = b.surface < 1e-12
    nodes = held_nodes(mesh, rollers)
    assert_array_equal(nodes, mesh.node_points < 1e-12)


def test_prescribed_edges_take_the_mean_of_their_ends() -> None:
    b = cube(2)
    mesh = TetMesh(*b.arrays)
    values = np.random.default_rng(0).standard_normal((len(b.surface_nodes), 3))
    given = prescribed_nodes(mesh, [b.load(prescribed=values)])[0]
    assert_allclose(given[b.surface_nodes], values, rtol=0, atol=0)
    ends = mesh.surface_edges
    mean = 0.5 * (values[ends[:, 0]] + values[ends[:, 1]])
    assert_allclose(given[mesh.surface_edge_nodes], mean, rtol=1e-15, atol=1e-15)


def test_gathering_to_vertices_keeps_force_and_moment() -> None:
    b = cube(2)
    mesh = TetMesh(*b.arrays)
    nodal = np.zeros((2, mesh.n_nodes, 3))
    on_surface = np.concatenate([b.surface_nodes, mesh.surface_edge_nodes])
    nodal[:, on_surface] = np.random.default_rng(0).standard_normal((2, len(on_surface), 3))
    at_vertices = gather_to_vertices(mesh, nodal)
    assert_allclose(at_vertices.sum(axis=1), nodal.sum(axis=1), rtol=0, atol=1e-12)
    moment = np.cross(b.surface, at_vertices).sum(axis=1)
    assert_allclose(moment, np.cross(mesh.node_points, nodal).sum(axis=1), rtol=0, atol=1e-12)


def _with_flat_tetrahedron() -> Body:
    b = cube(1)
    points = np.vstack([b.points, b.points[b.tetrahedra[0, :3]].mean(axis=0)])
    extra = [*b.tetrahedra[0, :3], len(b.points)]
    return Body(points, np.vstack([b.tetrahedra, [extra]]), b.surface_nodes, b.triangles)


def _with_inverted_tetrahedron() -> Body:
    b = cube(1)
    t = b.tetrahedra.copy()
    t[2] = t[2][[1, 0, 2, 3]]
    return Body(b.points, t, b.surface_nodes, b.triangles)


def _with_a_hole() -> Body:
    b = cube(1)
    return Body(b.points, b.tetrahedra, b.surface_nodes, b.triangles[1:])


def _inward() -> Body:
    b = cube(1)
    return Body(b.points, b.tetrahedra, b.surface_nodes, b.triangles[:, ::-1])


def _with_unused_point() -> Body:
    b = cube(1)
    return Body(np.vstack([b.points, [[2.0, 2.0, 2.0]]]), b.tetrahedra, b.surface_nodes, b.triangles)


def _with_infinite_point() -> Body:
    b = cube(1)
    points = b.points.copy()
    points[3, 1] = np.inf
    return Body(points, b.tetrahedra, b.surface_nodes, b.triangles)


def _with_index_out_of_range() -> Body:
    b = cube(1)
    return Body(b.points, b.tetrahedra + 1, b.surface_nodes, b.triangles)


def _without_tetrahedra() -> Body:
    b = cube(1)
    return Body(b.points, b.tetrahedra[:0], b.surface_nodes, b.triangles)


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        (_with_flat_tetrahedron, "1 of 7 tetrahedra have no volume .the first is number 6"),
        (_with_inverted_tetrahedron, "1 of 6 tetrahedra are inverted .the first is number 2"),
        (_with_a_hole, "the triangles leave a hole"),
        (_inward, "the triangles enclose -1"),
        (_with_unused_point, "1 of 9 points belong to no tetrahedron"),
        (_with_infinite_point, "not finite"),
        (_with_index_out_of_range, "tetrahedra has an index outside 0..7"),
        (_without_tetrahedra, r"tetrahedra has shape \(0, 4\)"),
    ],
)
def test_unusable_meshes_are_told(broken: object, words: str) -> None:
    b = broken()  # type: ignore[operator]
    with pytest.raises(SolverError, match=words) as caught:
        TetMesh(*b.arrays)
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


def test_three_nodes_off_one_line_hold_a_body() -> None:
    b = cube(2)
    held = np.isin(b.surface @ [1, 10, 100], [0, 1, 10])
    assert held.sum() == 3
    held_nodes(TetMesh(*b.arrays), held)


def test_every_separate_body_needs_support() -> None:
    one = cube(1)
    both = body(
        np.vstack([one.points, one.points + np.array([3.0, 0.0, 0.0])]),
        np.vstack([one.tetrahedra, one.tetrahedra + len(one.points)]),
    )
    with pytest.raises(SolverError, match="body 1 of 2 can still move"):
        held_nodes(TetMesh(*both.arrays), (both.surface[:, 2] == 0.0) & (both.surface[:, 0] < 2.0))
    held_nodes(TetMesh(*both.arrays), both.surface[:, 2] == 0.0)
