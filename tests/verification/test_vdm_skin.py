"""The boundary formulation of many nodes: coarsening, interpolation, and the skin on the coarse body."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from scipy.special import eval_legendre

from tests.unit.vdm_shapes import box, icosphere, torus
from vdm import Load, Model, Parameters, SolverError, SurfaceMesh
from vdm.formulations.boundary import (
    MAX_NODES,
    BoundaryFormulation,
    Dense,
    DenseFactor,
    rigid_basis,
    surface_stiffness,
)
from vdm.formulations.coarse_surface import coarsened
from vdm.formulations.interpolation import interpolation
from vdm.formulations.skin import LARGEST_RATIO, Skin
from vdm.material import ParameterError, ball_compliance
from vdmbench.body.surface_measures import rigid_motion_removed

ELLIPSOID = SurfaceMesh(*icosphere(3, (1.0, 0.8, 0.6)))
FREE = ELLIPSOID.points[:, 2] > -0.5


@pytest.fixture(scope="module")
def skin() -> Skin:
    return Skin(ELLIPSOID, 120, surface_stiffness)


@pytest.mark.parametrize("shape", [icosphere(3), torus(n=40, m=20), box(8, (1.0, 0.8, 0.5))])
def test_coarse_surface_is_closed_of_the_same_genus_and_volume(shape):
    fine = SurfaceMesh(*shape)
    coarse = coarsened(fine, 200)  # SurfaceMesh checks that it is closed, manifold and turned outward
    assert coarse.surface.n_nodes == 200
    assert_allclose(coarse.shares.sum(axis=1), 1.0, rtol=0.0, atol=1e-15)
    on_facets = np.einsum("na,nac->nc", coarse.shares, fine.points[coarse.corners])
    assert_allclose(coarse.surface.points, on_facets, rtol=0.0, atol=1e-15)
    facets = {frozenset(facet) for facet in fine.triangles.tolist()}
    edges = {frozenset(edge) for edge in fine.edges.tolist()}
    for corners, shares in zip(coarse.corners, coarse.shares, strict=True):
        under = frozenset(corners[shares > 0.0].tolist())
        assert len(under) == 1 or under in edges or under in facets
    assert coarse.surface.genus == fine.genus
    assert_allclose(coarse.surface.volume, fine.volume, rtol=0.06, atol=0.0)


def test_a_box_keeps_its_corners():
    fine = SurfaceMesh(*box(8, (1.0, 0.8, 0.5)))
    assert_allclose(coarsened(fine, 100).surface.volume, 0.4, rtol=0.01, atol=0.0)


def test_coarsening_ends_where_no_collapse_is_left():
    assert coarsened(SurfaceMesh(*icosphere(1)), 1).surface.n_nodes == 4


@pytest.mark.parametrize("shape", [icosphere(3), torus(n=40, m=20), box(8, (1.0, 0.8, 0.5))])
def test_interpolation_keeps_nodes_and_linear_fields_and_gets_smooth_ones(shape):
    fine = SurfaceMesh(*shape)
    coarse = coarsened(fine, 200)
    weights = interpolation(fine, coarse).weights
    assert_allclose((weights @ coarse.surface.points), fine.points, rtol=0.0, atol=1e-10)
    assert_allclose(weights.sum(axis=1), 1.0, rtol=0.0, atol=1e-10)
    on_node = np.flatnonzero(coarse.shares.max(axis=1) == 1.0)
    assert len(on_node) > 10
    own = coarse.corners[on_node, coarse.shares[on_node].argmax(axis=1)]
    assert_allclose(weights[own].toarray(), np.eye(200)[on_node], rtol=0.0, atol=1e-9)
    scale = np.ptp(fine.points, axis=0).max()
    fields = [
        np.sin(3.0 * s.points[:, 0] / scale) * np.cos(3.0 * s.points[:, 2] / scale)
        for s in (fine, coarse.surface)
    ]
    assert np.abs(weights @ fields[1] - fields[0]).max() < 0.02


def test_a_dimple_in_a_flat_face_is_reached_by_a_larger_stencil():
    points, triangles = box(12, (1.0, 1.0, 1.0))
    plain = SurfaceMesh(points, triangles)
    coarse = coarsened(plain, 150)
    inner = (points[:, 2] == 1.0) & (np.abs(points[:, :2] - 0.5).max(axis=1) < 0.4)
    dent = np.setdiff1d(np.flatnonzero(inner), coarse.corners)[0]
    points[dent, 2] -= 0.01
    weights = interpolation(SurfaceMesh(points, triangles), coarse).weights
    assert_allclose(weights @ coarse.surface.points, points, rtol=0.0, atol=1e-10)


def test_skin_is_symmetric_semi_definite_and_rigid_basis_cost_nothing(skin):
    n = ELLIPSOID.n_nodes
    matrix = np.stack([skin.apply(e.reshape(n, 3)).reshape(-1) for e in np.eye(3 * n)])
    assert_allclose(matrix, matrix.T, rtol=0.0, atol=1e-12 * np.abs(matrix).max())
    assert_allclose(matrix @ rigid_basis(ELLIPSOID), 0.0, rtol=0.0, atol=1e-12 * np.abs(matrix).max())
    values = np.linalg.eigvalsh(matrix)
    assert values[6] > 1e-4 * values[-1]
    dofs = np.repeat(FREE, 3)
    force = np.random.default_rng(0).standard_normal((int(dofs.sum()), 2))
    direct = DenseFactor(matrix[np.ix_(dofs, dofs)]).solve(force)
    factor = skin.factor(FREE, 1.0)
    for found in (factor.solve(force), np.stack([factor.solve(f) for f in force.T], axis=1)):
        assert_allclose(found, direct, rtol=0.0, atol=1e-10 * np.abs(direct).max())


def test_what_the_coarse_nodes_can_follow_answers_as_the_coarse_body():
    coarse = coarsened(ELLIPSOID, 120)
    weights = interpolation(ELLIPSOID, coarse).weights
    stiffness = surface_stiffness(coarse.surface, weights.T @ ELLIPSOID.area_vectors)
    body = Skin(ELLIPSOID, 120, surface_stiffness)
    z = np.random.default_rng(1).standard_normal((120, 3))
    u = weights @ z
    assert_allclose(
        np.vdot(u, body.apply(u)), z.reshape(-1) @ stiffness @ z.reshape(-1), rtol=1e-10, atol=0.0
    )
    # the springs are as soft as the coarse body allows
    gathered = np.kron((weights.T * body.springs) @ weights.toarray(), np.eye(3))
    largest = np.abs(np.linalg.eigvals(np.linalg.solve(gathered, stiffness))).max()
    assert_allclose(largest, LARGEST_RATIO, rtol=0.05, atol=0.0)


def test_force_at_held_nodes_from_the_factor_is_that_of_the_operator(skin):
    rng = np.random.default_rng(2)
    x = rng.standard_normal((ELLIPSOID.n_nodes, 3))
    x[~FREE] = 0.0
    loads = np.stack(
        [2.0 * skin.apply(s * x) for s in (1.0, -3.0)], axis=2
    )  # (N, 3, 2) of twice the operator
    size = np.abs(loads).max()
    factor = skin.factor(FREE, 2.0)
    both = factor.solve_with_inside(loads[FREE].reshape(-1, 2))
    for k in range(2):
        one = factor.solve_with_inside(loads[FREE][:, :, k].reshape(-1))
        for answer, inside in (one, (both[0][:, k], both[1][:, k])):
            assert_allclose(factor.held_force(inside), loads[~FREE][:, :, k], rtol=0.0, atol=1e-10 * size)
            assert_allclose(answer.reshape(-1, 3), (1.0, -3.0)[k] * x[FREE], rtol=0.0, atol=1e-10)


def test_reactions_of_a_skin_with_a_tool_that_moves_are_those_of_the_operator(monkeypatch):
    monkeypatch.setattr("vdm.formulations.boundary.MAX_NODES", 100)
    monkeypatch.setattr("vdm.formulations.boundary.COARSE_NODES", 120)
    points = ELLIPSOID.points
    tool = points[:, 0] > 0.8
    load = Load(np.where(points[:, 1] > 0.6, 0.1, 0.0), None, np.where(tool[:, None], [0.01, 0.0, 0.02], 0.0))
    options = {"formulation": "boundary", "fixed": ~FREE, "constrained": tool}
    model = Model(points, ELLIPSOID.triangles, Parameters(shear_modulus=2.0), **options)
    assert isinstance(model.formulation.body, Skin)
    solution = model.solve([load])
    u, pressure = solution.displacement[0], solution.fluid_pressure[0]
    lacking = (
        model.formulation.apply(u) - (pressure - load.contact_pressure)[:, None] * ELLIPSOID.area_vectors
    )
    size = np.abs(solution.reaction_force).max()
    assert_allclose(lacking, solution.reaction_force[0], rtol=0.0, atol=1e-10 * size)
    assert_allclose(np.vdot(ELLIPSOID.area_vectors, u), 0.0, rtol=0.0, atol=1e-16)
    assert_allclose(solution.energy[0], 0.5 * np.vdot(u, model.formulation.apply(u)), rtol=1e-10, atol=0.0)


def test_the_coarse_body_may_be_smaller():
    few = Parameters(shear_modulus=2.0, coarse_nodes=200)
    form = BoundaryFormulation(ELLIPSOID, few)
    assert isinstance(form.body, Skin)
    assert form.body.inner.shape == (600, 600)
    assert few.record()["coarse_nodes"] == 200.0
    # a surface that has no more is taken as it is
    small = SurfaceMesh(*icosphere(2, (1.0, 0.8, 0.6)))
    assert isinstance(BoundaryFormulation(small, few).body, Dense)
    with pytest.raises(SolverError, match="no matrix where it is a skin"):
        form.stiffness()
    for count in (199, 1001, 300.5, "300", True):
        with pytest.raises(ParameterError, match="coarse_nodes must be a whole number from 200 to 1,000"):
            Parameters(shear_modulus=2.0, coarse_nodes=count)
    # a smooth push is answered as by all 642 nodes, but for what the coarse body's facets lack
    push = [Load(np.exp(-4.0 * ((ELLIPSOID.points - [0.0, 0.5, 0.4]) ** 2).sum(axis=1)))]
    options = {"formulation": "boundary", "fixed": ~FREE}
    whole, coarse = (
        Model(ELLIPSOID.points, ELLIPSOID.triangles, parameters, **options).solve(push).displacement[0]
        for parameters in (Parameters(shear_modulus=2.0), few)
    )
    gap = np.linalg.norm(coarse - whole) / np.linalg.norm(whole)
    assert 1e-3 < gap < 0.08, gap


def test_a_skin_held_at_too_few_nodes_is_singular(skin):
    free = np.ones(ELLIPSOID.n_nodes, dtype=bool)
    for held in ([], [3], [3, 4]):
        free[held] = False
        with pytest.raises(SolverError, match="hold at least three nodes"):
            skin.factor(free, 1.0)


def sphere_of_many() -> SurfaceMesh:
    surface = SurfaceMesh(*icosphere(4))
    assert surface.n_nodes > MAX_NODES
    return surface


@pytest.mark.slow
def test_a_model_of_many_nodes():
    """The ball's exact answers, volume, balance, reciprocity, and the refusal of a matrix."""
    surface = sphere_of_many()
    form = BoundaryFormulation(surface, Parameters(shear_modulus=2.0))
    assert isinstance(form.body, Skin)
    with pytest.raises(SolverError, match="no matrix"):
        form.stiffness()
    fixed = surface.points[:, 2] < -0.9
    model = Model(
        surface.points, surface.triangles, Parameters(shear_modulus=2.0), formulation="boundary", fixed=fixed
    )
    pushes = [Load(np.where(surface.points[:, axis] > 0.9, 0.1, 0.0)) for axis in (0, 2)]
    solution = model.solve(pushes)
    g = surface.area_vectors
    drift = np.einsum("ic,sic->s", g, solution.displacement)
    assert_allclose(drift, 0.0, rtol=0.0, atol=1e-14)
    applied = [-load.contact_pressure[:, None] * g for load in pushes]
    for force, reaction in zip(applied, solution.reaction_force, strict=True):
        assert_allclose(reaction.sum(axis=0), -force.sum(axis=0), rtol=0.0, atol=1e-12)
    works = [np.vdot(applied[a], solution.displacement[b]) for a, b in ((0, 1), (1, 0))]
    assert_allclose(works[0], works[1], rtol=1e-10, atol=0.0)
    for degree in (2, 3, 4):
        harmonic = eval_legendre(degree, surface.points[:, 2])
        # no resultant, so that holding three nodes moves the body rigidly at most
        few = np.zeros(surface.n_nodes, dtype=bool)
        few[[0, 1, 2]] = True
        free = Model(
            surface.points,
            surface.triangles,
            Parameters(shear_modulus=1.0),
            formulation="boundary",
            fixed=few,
        )
        u = free.solve([Load(-harmonic)]).displacement[0]
        u = rigid_motion_removed(surface.points, u, surface.vector_areas)
        exact = ball_compliance(degree) * (surface.vector_areas @ harmonic**2)
        radial = np.einsum("ic,ic->i", u, surface.normals)
        assert_allclose(
            (surface.vector_areas * harmonic) @ radial, exact, rtol=0.015 * (degree - 1), atol=0.0
        )


def uneven(shape: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The shape with its nodes a little off their places, so that the mesh has no symmetry."""
    points, triangles = shape
    return points * (1.0 + 0.01 * np.random.default_rng(5).standard_normal(points.shape)), triangles


def force_of(points: np.ndarray, triangles: np.ndarray, x: np.ndarray) -> np.ndarray:
    return Skin(SurfaceMesh(points, triangles), 200, surface_stiffness).apply(x)


@pytest.mark.parametrize("shape", [uneven(icosphere(3, (1.0, 0.8, 0.6))), box(8, (1.0, 0.8, 0.5))])
def test_the_numbers_of_the_nodes_decide_nothing(shape):
    points, triangles = shape
    x = np.random.default_rng(3).standard_normal(points.shape)
    order = np.random.default_rng(4).permutation(len(points))
    corners = np.roll(np.argsort(order)[triangles[::-1]], 1, axis=1)
    first, again = force_of(points, triangles, x), force_of(points[order], corners, x[order])
    # rounding alone; beside a body coarsened in another order 0.3
    assert_allclose(again, first[order], rtol=0.0, atol=1e-10 * np.abs(first).max())


def test_the_pose_of_the_body_decides_nothing():
    """Nor its size, nor the side: of a mesh without symmetry, whose nodes are told apart by their places."""
    points, triangles = uneven(icosphere(3, (1.0, 0.8, 0.6)))
    x = np.random.default_rng(3).standard_normal(points.shape)
    first = force_of(points, triangles, x)
    for degrees in ([1.0, 2.0, 3.0], [37.0, -61.0, 113.0]):
        turn = Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
        turned = force_of(points @ turn.T + 0.3, triangles, x @ turn.T)
        assert_allclose(turned, first @ turn.T, rtol=0.0, atol=1e-8 * np.abs(first).max())
    mirror = np.diag([1.0, -1.0, 1.0])
    mirrored = force_of(points @ mirror, triangles[:, ::-1], x @ mirror)
    assert_allclose(mirrored, first @ mirror, rtol=0.0, atol=1e-8 * np.abs(first).max())
    # a stiffness is modulus times length
    small = force_of(0.01 * points, triangles, x)
    assert_allclose(small, 0.01 * first, rtol=0.0, atol=1e-10 * np.abs(first).max())


@pytest.mark.parametrize("shape", [icosphere(3), box(8, (1.0, 0.8, 0.5))])
def test_coarse_nodes_are_evenly_spaced_and_lie_on_fine_nodes_of_their_own(shape):
    coarse = coarsened(SurfaceMesh(*shape), 200)
    i, j = coarse.surface.edges.T
    length = np.linalg.norm(coarse.surface.points[i] - coarse.surface.points[j], axis=1)
    # 0.25 without the even spacing, 0.1 by a mesh generator
    assert length.std() < 0.18 * length.mean()
    own = coarse.corners[np.arange(200), coarse.shares.argmax(axis=1)]
    assert len(np.unique(own)) == 200
