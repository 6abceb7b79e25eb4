"""Each operator against the energy or the equation it stands for, summed edge by edge or spring by spring."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.vdm.vdm_shapes import box, icosphere
from vdm import Load, Model, Parameters, SurfaceMesh
from vdm.deformed import DeformableSurface
from vdm.formulations.consistent import ConsistentFormulation
from vdm.formulations.paper import PaperFormulation
from vdm.formulations.vector import VectorFormulation
from vdm.material import EDGE_MODULI, NODE_MODULI
from vdm.peers.mass_spring import make_springs

BODY = SurfaceMesh(*icosphere(1, (0.05, 0.06, 0.045)))


def rotation_of(surface: SurfaceMesh, weights: np.ndarray, u: np.ndarray, edges: list[int]) -> np.ndarray:
    """The omega that minimises sum w |u_i - u_j - omega x (x_i - x_j)|^2, by least squares."""
    rows, right = [], []
    for e in edges:
        i, j = surface.edges[e]
        d = surface.points[i] - surface.points[j]
        root = np.sqrt(weights[e])
        rows.append(root * np.array([[0, d[2], -d[1]], [-d[2], 0, d[0]], [d[1], -d[0], 0]]))
        right.append(root * (u[i] - u[j]))
    return np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]


def tension_energy(surface: SurfaceMesh, tension: float, u: np.ndarray, rotation: str) -> float:
    """1/2 T min_omega sum w |u_i - u_j - omega x d|^2 of both settings, by the definition."""
    weights = surface.cotangent_weights
    every = list(range(len(surface.edges)))
    energy = 0.0
    omega = np.zeros(3) if rotation == "none" else rotation_of(surface, weights, u, every)
    for e in every:
        i, j = surface.edges[e]
        gap = u[i] - u[j] - np.cross(omega, surface.points[i] - surface.points[j])
        energy += 0.5 * tension * weights[e] * gap @ gap
    return energy


@pytest.mark.parametrize("rotation", ["none", "global"])
def test_vector_operator_is_the_stated_energy(rotation):
    k, tension, stretch = 3e4, 50.0, 20.0
    form = VectorFormulation(
        BODY, Parameters(foundation=k, surface_tension=tension, stretch_stiffness=stretch, rotation=rotation)
    )
    u = np.random.default_rng(1).standard_normal(BODY.points.shape)
    expected = tension_energy(BODY, tension, u, rotation)
    for node in range(BODY.n_nodes):
        expected += 0.5 * k * BODY.vector_areas[node] * (u[node] @ BODY.normals[node]) ** 2
    for e, (i, j) in enumerate(BODY.edges):
        along = (BODY.points[i] - BODY.points[j]) / np.linalg.norm(BODY.points[i] - BODY.points[j])
        expected += 0.5 * stretch * BODY.cotangent_weights[e] * ((u[i] - u[j]) @ along) ** 2
    border = np.zeros(form.columns.count)
    if rotation == "global":
        border[1:] = np.linalg.solve(
            -form.corner[1:, 1:], form.rows.dense()[:, :, 1:].reshape(-1, 3).T @ u.reshape(-1)
        )
    # rtol: sums of some hundred terms in another order
    assert_allclose(0.5 * np.vdot(u, form.internal_force(u, border)), expected, rtol=1e-11, atol=0.0)
    assert_allclose(form.apply(u).reshape(-1), form.stiffness() @ u.reshape(-1), rtol=0.0, atol=1e-9)


def test_paper_operator_is_equation_27():
    rng = np.random.default_rng(2)
    bulk, links = rng.uniform(5.0, 20.0, BODY.n_nodes), rng.uniform(1e3, 5e3, len(BODY.edges))
    form = PaperFormulation(BODY, Parameters(bulk_modulus=bulk, connectivity_modulus=links))
    length, pressure = rng.standard_normal(BODY.n_nodes), 1.7
    area, volume = BODY.nodal_areas, BODY.nodal_volumes
    expected = bulk / volume * area * length - pressure
    for e, (i, j) in enumerate(BODY.edges):
        gap = links[e] * (area[i] * length[i] - area[j] * length[j])
        expected[i] += gap / volume[i]
        expected[j] -= gap / volume[j]
    state = form.state_matrix() @ np.append(length, pressure)
    assert_allclose(state[:-1], expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    assert_allclose(state[-1], area @ length, rtol=1e-12, atol=0.0)
    # (16): volumic pressure and tension (6)-(8) are the two terms of the same row
    rows = form.volumic_pressure(length) + form.volumic_tension(length) - pressure
    assert_allclose(rows, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


def test_nodal_stress_as_printed_gives_one_minus_valence_for_a_uniform_change():
    form = PaperFormulation(BODY, Parameters(bulk_modulus=10.0, connectivity_modulus=100.0))
    uniform = 1e-3 / BODY.nodal_areas
    valence = np.bincount(BODY.edges.ravel())
    expected = (1 - valence) * form.volumic_pressure(uniform)
    assert_allclose(form.nodal_stress(uniform), expected, rtol=1e-12, atol=0.0)
    # the corrected tension of the same state is zero
    assert_allclose(form.volumic_tension(uniform), 0.0, rtol=0.0, atol=1e-9 * np.abs(expected).max())


def test_consistent_operator_is_its_equation():
    k, tension = 2e4, 40.0
    form = ConsistentFormulation(BODY, Parameters(foundation=k, surface_tension=tension))
    length = np.random.default_rng(3).standard_normal(BODY.n_nodes)
    expected = k * BODY.vector_areas * length
    for e, (i, j) in enumerate(BODY.edges):
        gap = tension * BODY.cotangent_weights[e] * (length[i] - length[j])
        expected[i] += gap
        expected[j] -= gap
    assert_allclose(form.apply(length[:, None])[:, 0], expected, rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("name", [*NODE_MODULI, *EDGE_MODULI])
def test_every_modulus_follows_the_fibre(name):
    along = BODY.normals[:, 1]
    if name in EDGE_MODULI:
        edges = np.diff(BODY.points[BODY.edges], axis=1)[:, 0]
        along = edges[:, 1] / np.linalg.norm(edges, axis=1)
    changed = getattr(Parameters(**{name: 7.0}).anisotropic(BODY, (0.0, 3.0, 0.0), 0.2), name)
    assert_allclose(changed, 7.0 * (1.0 - 0.8 * along**2), rtol=1e-12, atol=0.0)


@pytest.mark.parametrize("gamma", [0.0, 40.0])
def test_paper_tension_at_a_large_displacement_is_equation_8_with_its_stiffening(gamma):
    bulk, links = 20.0, 300.0
    form = PaperFormulation(
        BODY, Parameters(bulk_modulus=bulk, connectivity_modulus=links, tension_stiffening=gamma)
    )
    normal = 0.01 * np.random.default_rng(2).standard_normal(BODY.n_nodes)
    x = (BODY.nodal_areas * normal)[:, None]
    state = DeformableSurface(BODY).at(normal[:, None] * BODY.normals)
    areas = state.nodal_areas
    change, height = areas * normal, BODY.volume / areas.sum()  # V_i = A_i height of the areas as they are
    expected = bulk * change / height
    for i, j in BODY.edges:
        gap = change[i] - change[j]
        strain = gap / (0.5 * (BODY.nodal_volumes[i] + BODY.nodal_volumes[j]))
        pull = links * (1.0 + gamma * strain**2) * gap / height
        expected[i] += pull
        expected[j] -= pull
    found = form.deformed_internal_force(x, state)[:, 0]
    assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


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
