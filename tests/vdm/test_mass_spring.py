"""The mass-spring surface: its answer by one dense system, its rule, its struts."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.vdm.vdm_shapes import box, icosphere
from vdm import Load, Model, Parameters, SurfaceMesh
from vdm.peers.mass_spring import make_springs, through_springs

MU = 1700.0


def _setting(shape) -> tuple[SurfaceMesh, np.ndarray, Load]:
    points, triangles = shape
    surface = SurfaceMesh(points, triangles)
    points = surface.points - surface.points.mean(axis=0)
    height = points[:, 2] / np.abs(points[:, 2]).max()
    pressure = np.where((height > 0.5) & (points[:, 0] > 0.0), 150.0, 0.0)
    return surface, height < -0.8, Load(pressure)


@pytest.mark.parametrize("shape", [icosphere(2, (0.05, 0.06, 0.045)), box(5, (0.1, 0.08, 0.05))])
def test_equal_to_one_dense_system_assembled_spring_by_spring(shape) -> None:
    surface, fixed, load = _setting(shape)
    n = surface.n_nodes
    springs, constants = make_springs(surface, MU)
    matrix = np.zeros((3 * n + 1, 3 * n + 1))
    for (i, j), k in zip(springs, constants, strict=True):
        e = surface.points[i] - surface.points[j]
        block = k * np.outer(e, e) / (e @ e)
        a, b = slice(3 * i, 3 * i + 3), slice(3 * j, 3 * j + 3)
        matrix[a, a] += block
        matrix[b, b] += block
        matrix[a, b] -= block
        matrix[b, a] -= block
    gradient = surface.area_vectors.reshape(-1)
    matrix[:-1, -1] = matrix[-1, :-1] = -gradient
    force = np.append(-(surface.area_vectors * load.contact_pressure[:, None]).reshape(-1), 0.0)
    kept = np.append(np.repeat(~fixed, 3), True)
    expected = np.zeros(3 * n + 1)
    expected[kept] = np.linalg.solve(matrix[np.ix_(kept, kept)], force[kept])

    model = Model(
        surface.points,
        surface.triangles,
        Parameters(shear_modulus=MU),
        formulation="mass-spring",
        fixed=fixed,
    )
    solution = model.solve([load])
    u = solution.displacement[0].reshape(-1)
    assert_allclose(u, expected[:-1], rtol=0, atol=1e-9 * np.abs(u).max())
    assert_allclose(solution.fluid_pressure[0], expected[-1], rtol=1e-9, atol=0)
    assert_allclose(gradient @ u, 0.0, rtol=0, atol=1e-12 * (np.abs(gradient) @ np.abs(u)))
    balance = (matrix @ expected - force)[:-1].reshape(-1, 3)
    assert_allclose(solution.reaction_force[0], balance, rtol=0, atol=1e-9 * np.abs(balance).max())
    assert_allclose(solution.energy[0], 0.5 * force @ expected, rtol=1e-9, atol=0)


def test_the_rods_hold_what_the_rule_says() -> None:
    """sum k L^2 is 33 mu V, 0.3 of it in the skin, where an edge has the share of its two facets."""
    surface, _, _ = _setting(icosphere(2, (0.05, 0.06, 0.045)))
    springs, constants = make_springs(surface, MU)
    lengths = np.linalg.norm(surface.points[springs[:, 0]] - surface.points[springs[:, 1]], axis=1)
    held = constants * lengths**2
    n_edges = len(surface.edges)
    assert_allclose(held.sum(), 33.0 * MU * surface.volume, rtol=1e-12, atol=0)
    assert_allclose(held[:n_edges].sum(), 0.3 * held.sum(), rtol=1e-12, atol=0)
    touching = [surface.facet_areas[(surface.facet_edges == e).any(axis=1)].sum() for e in range(n_edges)]
    assert_allclose(held[:n_edges] / held[0], np.array(touching) / touching[0], rtol=1e-12, atol=0)


def test_struts_cross_the_body_and_stand_for_the_whole_surface() -> None:
    surface, _, _ = _setting(icosphere(2, (0.05, 0.05, 0.05)))
    struts, areas = through_springs(surface)
    assert_allclose(areas.sum(), surface.area, rtol=1e-12, atol=0)
    assert (struts[:, 0] < struts[:, 1]).all()
    first, second = surface.points[struts[:, 0]], surface.points[struts[:, 1]]
    direction = (second - first) / np.linalg.norm(second - first, axis=1)[:, None]
    assert (np.einsum("ic,ic->i", direction, surface.normals[struts[:, 0]]) < 0.0).all(), "inward at one end"
    assert (np.einsum("ic,ic->i", direction, surface.normals[struts[:, 1]]) > 0.0).all(), (
        "outward at the other"
    )
    # struts of a ball are chords at 0 or 45 degrees from the normal, within 20
    lengths = np.linalg.norm(second - first, axis=1)
    assert lengths.min() > 2.0 * 0.05 * np.cos(np.radians(65.1))
