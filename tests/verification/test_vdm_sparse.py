"""`bem-sparse`: its coarse surface, interpolation and operator, and what it is right about."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from tests.vdm.vdm_shapes import box, icosphere, torus
from vdm import Load, Model, Parameters, SolverError, SurfaceMesh
from vdm.boundary.coarsening import coarsened
from vdm.boundary.interpolation import interpolation
from vdm.peers.bem import DenseFactor
from vdm.peers.bem_sparse import SparseFormulation
from vdm.solvers.single import SingleFactor
from vdm.surface import rigid_basis

Array = NDArray[np.float64]
SHAPES = [icosphere(3), torus(n=40, m=20), box(8, (1.0, 0.8, 0.5))]
ELLIPSOID = SurfaceMesh(*icosphere(3, (1.0, 0.8, 0.6)))
FREE = ELLIPSOID.points[:, 2] > -0.5


def sparse_form(surface: SurfaceMesh, coarse_nodes: int, nu: float = 0.5) -> SparseFormulation:
    return SparseFormulation(
        surface, Parameters(shear_modulus=2.0, coarse_nodes=coarse_nodes, poisson_ratio=nu)
    )


@pytest.fixture(scope="module")
def form() -> SparseFormulation:
    return sparse_form(ELLIPSOID, 200)


def graded(level: int, ratio: float) -> SurfaceMesh:
    """An ellipsoid whose mesh is `ratio` times as fine at the bottom as in the middle, facets as good as before."""
    x = icosphere(level)[0]
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    half = 0.5 * np.arccos(np.clip(x[:, 2], -1.0, 1.0))
    around = np.arctan2(x[:, 1], x[:, 0])
    # a dilation of the plane on which the ball is projected
    polar = 2.0 * np.arctan2(ratio * np.sin(half), np.cos(half))
    sides = np.sin(polar)
    x = np.stack([sides * np.cos(around), sides * np.sin(around), np.cos(polar)], axis=1)
    return SurfaceMesh(x * [0.08, 0.06, 0.05], icosphere(level)[1])


@pytest.mark.parametrize("shape", SHAPES)
def test_coarse_surface_is_closed_of_the_same_genus_and_volume(shape):
    fine = SurfaceMesh(*shape)
    coarse = coarsened(fine, 200)  # SurfaceMesh checks that it is closed, manifold and turned outward
    assert coarse.surface.n_nodes == 200
    on_facets = np.einsum("na,nac->nc", coarse.shares, fine.points[coarse.corners])
    assert_allclose(coarse.surface.points, on_facets, rtol=0.0, atol=1e-15)
    assert coarse.surface.genus == fine.genus
    assert_allclose(coarse.surface.volume, fine.volume, rtol=0.08, atol=0.0)


def test_a_coarse_surface_is_fine_where_the_fine_one_is():
    fine = graded(3, 2.5)
    low = fine.points[:, 2] < -0.03
    for count in (500, 300):
        coarse = coarsened(fine, count).surface
        there = coarse.points[:, 2] < -0.03
        assert_allclose(there.mean(), low.mean(), rtol=0.15, atol=0.0)
    # an even mesh of as many nodes has a fifth of them there
    even = SurfaceMesh(*icosphere(3, (0.08, 0.06, 0.05)))
    assert (even.points[:, 2] < -0.03).mean() < 0.5 * low.mean()


def test_a_small_cavity_is_left_as_a_tetrahedron():
    """It has no more neighbours for wider stencils, and the facets of fewer nodes would bound nothing."""
    (x, outer), (y, inner) = icosphere(3, (0.06, 0.03, 0.03)), icosphere(0, (0.004, 0.004, 0.004))
    points = np.vstack([x, y + np.array([0.02, 0.0, 0.0])])
    fine = SurfaceMesh(points, np.vstack([outer, inner[:, ::-1] + len(x)]))
    coarse = coarsened(fine, 60)
    assert coarse.surface.n_nodes == 60
    assert np.bincount(coarse.surface.shells)[1] == 4  # facets
    weights = interpolation(fine, coarse).weights
    assert_allclose(weights @ coarse.surface.points, fine.points, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_interpolation_keeps_linear_fields_and_gets_smooth_ones(shape):
    fine = SurfaceMesh(*shape)
    coarse = coarsened(fine, 200)
    weights = interpolation(fine, coarse).weights
    assert_allclose(weights @ coarse.surface.points, fine.points, rtol=0.0, atol=1e-10)
    assert_allclose(weights.sum(axis=1), 1.0, rtol=0.0, atol=1e-10)
    scale = np.ptp(fine.points, axis=0).max()
    fields = [
        np.sin(3.0 * s.points[:, 0] / scale) * np.cos(3.0 * s.points[:, 2] / scale)
        for s in (fine, coarse.surface)
    ]
    assert np.abs(weights @ fields[1] - fields[0]).max() < 0.02


def dense(form: SparseFormulation) -> Array:
    n = form.surface.n_nodes
    return np.stack([form.apply(e.reshape(n, 3)).reshape(-1) for e in np.eye(3 * n)])


def test_the_operator_is_symmetric_semi_definite_and_inverted_exactly(form):
    matrix = dense(form)
    size = np.abs(matrix).max()
    assert_allclose(matrix, matrix.T, rtol=0.0, atol=1e-12 * size)
    assert_allclose(form.diagonal(), np.diagonal(matrix), rtol=0.0, atol=1e-12 * size)
    # what rounding and the quadrature of the coarse body leave
    assert_allclose(matrix @ rigid_basis(ELLIPSOID), 0.0, rtol=0.0, atol=1e-4 * size)
    values = np.linalg.eigvalsh(matrix)
    assert values[0] > -1e-5 * values[-1]
    assert values[6] > 1e-4 * values[-1]
    dofs = np.repeat(FREE, 3)
    force = np.random.default_rng(0).standard_normal((int(dofs.sum()), 2))
    direct = DenseFactor(matrix[np.ix_(dofs, dofs)]).solve(force)
    factor = form.factor(FREE)
    for found in (factor.solve(force), np.stack([factor.solve(f) for f in force.T], axis=1)):
        assert_allclose(found, direct, rtol=0.0, atol=1e-10 * np.abs(direct).max())
    # seven digits less those of the condition
    single = form.factor(FREE, SingleFactor).solve(force)
    assert 1e-9 < np.abs(single - direct).max() / np.abs(direct).max() < 1e-4


def test_reactions_come_from_the_factor_and_are_those_of_the_operator(form):
    rng = np.random.default_rng(2)
    x = rng.standard_normal((ELLIPSOID.n_nodes, 3))
    x[~FREE] = 0.0
    force = form.apply(x)
    factor = form.factor(FREE)
    answer, inside = factor.solve_with_inside(force[FREE].reshape(-1))
    assert_allclose(answer.reshape(-1, 3), x[FREE], rtol=0.0, atol=1e-9)
    assert_allclose(factor.held_force(inside), force[~FREE], rtol=0.0, atol=1e-9 * np.abs(force).max())


@pytest.mark.parametrize("nu", [0.5, 0.3])
def test_with_all_nodes_in_the_coarse_body_it_is_the_boundary_form(nu):
    points, triangles = icosphere(2, (0.08, 0.06, 0.05))
    load = Load(np.where(points[:, 2] > 0.03, 100.0, 0.0))
    parameters = Parameters(shear_modulus=1667.0, poisson_ratio=nu)
    whole, boundary = (
        Model(points, triangles, parameters, formulation=name, fixed=points[:, 2] < -0.03).solve([load])
        for name in ("bem-sparse", "bem")
    )
    for field in ("displacement", "reaction_force", "fluid_pressure", "energy"):
        right = getattr(boundary, field)
        assert_allclose(getattr(whole, field), right, rtol=0.0, atol=1e-9 * np.abs(right).max())
    assert whole.parameters["scheme"] == "whole"


def test_what_it_cannot_do_is_refused_with_a_remedy(form):
    with pytest.raises(SolverError, match="no matrix"):
        form.stiffness()
    with pytest.raises(SolverError, match="not positive definite"):
        form.factor(np.ones(ELLIPSOID.n_nodes, dtype=np.bool_))
