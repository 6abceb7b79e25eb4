"""Meshes, quadrature, loads and supports of the volumetric reference."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from fem_reference.loads import nodal_forces
from fem_reference.mesh import TetMesh
from fem_reference.solution import SolverError
from solver_common.quadrature import facet_quadrature
from tests.fem.shapes import ball, cube


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
