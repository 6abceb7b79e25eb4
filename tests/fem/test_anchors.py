"""Closed-form anchors: the formulas against published numbers, and the reference against the formulas.

Flat facets follow a curved surface with an error of order h^2, which hides the element's own order 3. It is shown
apart: given the exact displacement on the same flat-faceted boundary, the error inside falls with order 3.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fem_reference.exact import IncompressibleBall, ThickCylinder, ThickSphere
from solver_common.quadrature import facet_quadrature
from tests.fem.convergence import (
    THREE_POINTS,
    Convergence,
    inner_error,
    relative_l2,
    relative_without_motion,
)
from tests.fem.shapes import Body, ball, mapped_box, pressed_shell
from tests.verification.records import Verified

Array = np.ndarray

# Order 2 of flat facets, in the maximum norm and on two meshes only.
_GEOMETRY_SLACK = 0.3


LOVE = "Love 1927, Mathematical Theory of Elasticity, art. 173; `fem_reference.exact.IncompressibleBall`"
LAME = "Lame; Timoshenko and Goodier, Theory of Elasticity, art. 136"
MACNEAL = "MacNeal and Harder 1985, doi 10.1016/0168-874X(85)90003-4"
a_ball = pytest.mark.anchor("incompressible ball under P_n", LOVE)
a_sphere = pytest.mark.anchor("thick sphere under pressure", LAME)
a_cylinder = pytest.mark.anchor("thick cylinder, plane strain", MACNEAL)


# ---------------------------------------------------------------- formulas


@a_ball
@pytest.mark.parametrize(("degree", "coefficient"), [(2, 0.26316), (3, 0.15909), (4, 0.11765), (5, 0.09418)])
def test_ball_coefficients_as_published(degree: int, coefficient: float, verified: Verified) -> None:
    exact = IncompressibleBall(radius=0.05, shear_modulus=1700.0, degree=degree, traction=30.0)
    found = exact.surface_coefficient / (30.0 * 0.05 / 1700.0)
    verified.equal(f"formula: c_{degree} mu / (R t)", found, coefficient, atol=5e-6)


def test_ball_of_low_degree_is_refused() -> None:
    with pytest.raises(ValueError, match="degree is 1; give 2 or more"):
        IncompressibleBall(1.0, 1.0, 1, 1.0)


@a_sphere
@pytest.mark.parametrize(("poisson_ratio", "value"), [(0.5, 0.857143), (0.4999, 0.857114), (0.3, 0.8)])
def test_thick_sphere_as_published(poisson_ratio: float, value: float, verified: Verified) -> None:
    exact = ThickSphere(1.0, 2.0, 1.0, poisson_ratio, 1.0)
    found = float(exact.radial_displacement(1.0))
    verified.equal(f"formula: u(a), nu = {poisson_ratio}", found, value, atol=5e-7)


@a_cylinder
@pytest.mark.parametrize(
    ("poisson_ratio", "value"), [(0.49, 5.0399e-3), (0.499, 5.0602e-3), (0.4999, 5.0623e-3)]
)
def test_thick_cylinder_as_published(poisson_ratio: float, value: float, verified: Verified) -> None:
    exact = ThickCylinder(3.0, 9.0, 1000.0, poisson_ratio, 1.0)
    found = float(exact.radial_displacement(3.0))
    verified.equal(f"formula: u(ri), nu = {poisson_ratio}", found, value, atol=5e-8)


# ---------------------------------------------------------------- the reference


@a_sphere
@pytest.mark.parametrize(
    "poisson_ratio", [*(pytest.param(nu, marks=pytest.mark.slow) for nu in (0.3, 0.4999)), 0.5]
)
def test_thick_sphere(poisson_ratio: float, verified: Verified) -> None:
    """An octant on rollers; the pressure depends on the resultant alone and is exact on flat facets too."""
    exact = ThickSphere(1.0, 2.0, 1.0, poisson_ratio, 1.0)
    record = Convergence(f"u(a) on flat facets, nu = {poisson_ratio}", 2.0, 0.012, _GEOMETRY_SLACK)
    for n in (4, 8):
        b, inner = pressed_shell(n)
        s = b.problem(b.surface == 0.0, poisson_ratio=poisson_ratio).solve([b.load(1.0 * inner)])
        record.add(1.0 / n, inner_error(b, s.displacement[0], float(exact.radial_displacement(1.0))))
        assert_allclose(s.fluid_pressure, exact.mean_pressure, rtol=1e-10, atol=0)
    verified.equal(
        f"mean pressure, nu = {poisson_ratio}", s.fluid_pressure[0], exact.mean_pressure, rtol=1e-10
    )
    record.check(verified)


@a_sphere
@pytest.mark.parametrize("poisson_ratio", [pytest.param(0.3, marks=pytest.mark.slow), 0.4999])
def test_thick_sphere_without_its_geometry_error(poisson_ratio: float, verified: Verified) -> None:
    exact = ThickSphere(1.0, 2.0, 1.0, poisson_ratio, 1.0)
    record = Convergence(f"L2 of u without geometry error, nu = {poisson_ratio}", 3.0, 4e-4)

    def displacement(x: np.ndarray) -> np.ndarray:
        """(3, ...)"""
        r = np.linalg.norm(x, axis=0)
        return np.asarray(exact.radial_displacement(r) * x / r)

    for n in (4, 8):
        b, _ = pressed_shell(n)
        problem = b.problem(np.ones(len(b.surface_nodes), dtype=bool), poisson_ratio=poisson_ratio)
        given = displacement(problem.mesh.node_points.T).T
        fields = problem.solve_nodal(np.zeros((1, *given.shape)), given[None])
        # Integrated over the body: at the nodes alone a structured mesh is better than its element.
        basis, _ = problem.mesh.bases(intorder=4)
        record.add(1.0 / n, relative_l2(basis, fields.displacement[0].ravel(), displacement))
    record.check(verified)


def _quarter_cylinder(n: int) -> Body:
    def shape(p: np.ndarray) -> np.ndarray:
        r, angle = 3.0 + 6.0 * p[:, 0], 0.5 * np.pi * p[:, 1]
        x = np.column_stack([r * np.cos(angle), r * np.sin(angle), 6.0 / n * p[:, 2]])
        return np.where(np.abs(x) < 1e-12, 0.0, x)

    return mapped_box((n, n, 1), shape)


@a_cylinder
@pytest.mark.parametrize(
    "poisson_ratio", [*(pytest.param(nu, marks=pytest.mark.slow) for nu in (0.49, 0.499)), 0.4999, 0.5]
)
def test_thick_cylinder(poisson_ratio: float, verified: Verified) -> None:
    """MacNeal and Harder's: a quarter of one slice between rollers."""
    exact = ThickCylinder(3.0, 9.0, 1000.0, poisson_ratio, 1.0)
    record = Convergence(f"u(ri) on flat facets, nu = {poisson_ratio}", 2.0, 0.002, _GEOMETRY_SLACK)
    for n in (8, 16):
        b = _quarter_cylinder(n)
        held = b.surface == 0.0
        held[:, 2] = True  # every vertex lies on one of the two faces of the slice
        radius = np.linalg.norm(b.surface[:, :2], axis=1)
        inner = b.facets_where(lambda x: np.linalg.norm(x[:, :2], axis=1) < 3.0 + 1e-9)
        problem = b.problem(held, youngs_modulus=1000.0, poisson_ratio=poisson_ratio)
        s = problem.solve([b.load(1.0 * inner)])
        at = radius < 3.0 + 1e-9
        radial = np.einsum("ni,ni->n", s.displacement[0][at], b.surface[at]) / radius[at]
        record.add(1.0 / n, float(np.abs(radial / exact.radial_displacement(3.0) - 1.0).max()))
        assert_allclose(s.fluid_pressure, exact.mean_pressure, rtol=1e-10, atol=0)
    record.check(verified)


def _exact_ball(degree: int) -> IncompressibleBall:
    return IncompressibleBall(radius=1.0, shear_modulus=1.0 / 3.0, degree=degree, traction=1.0)


def _ball_solution(b: Body, degree: int) -> tuple[Array, Array]:
    """Displacement of the surface and reactions of a polyhedron under the ball's traction."""
    exact = _exact_ball(degree)
    u = exact.displacement(b.surface)
    # The load balances itself: six components, the least that stops rigid motion, take no force.
    held = b.held_at(*THREE_POINTS)
    q = b.quadrature_points
    traction = exact.surface_traction(q.reshape(-1, 3)).reshape(q.shape[:2])
    # On flat facets an odd traction has a small resultant; as a point force at a support it would leave a dent,
    # so it is spread over the volume.
    volume = np.einsum("fi,fi->", b.area_vectors, b.surface[b.triangles].mean(axis=1)) / 3.0
    resultant = b.area_vectors.T @ (traction @ facet_quadrature()[1])
    load = b.load(-traction, u, gravity=-resultant / volume)
    s = b.problem(held, poisson_ratio=0.5, density=1.0).solve([load])
    return s.displacement[0], s.reaction_force[0]


def _check_ball(verified: Verified, degree: int, levels: tuple[int, ...], cap: float) -> None:
    record = Convergence(f"u at the surface on flat facets, n = {degree}", 2.0, cap, _GEOMETRY_SLACK)
    for refinements in levels:
        b = ball(refinements)
        found, reaction = _ball_solution(b, degree)
        record.add(
            2.0**-refinements,
            relative_without_motion(found, _exact_ball(degree).displacement(b.surface), b.surface),
        )
        # Facets are no exact sphere: what the odd loads leave unbalanced is of second order.
        assert np.abs(reaction).max() <= 0.5 * 4.0**-refinements
    record.check(verified)


@a_ball
def test_ball_under_a_legendre_traction(verified: Verified) -> None:
    """Normal and tangential displacement at the surface of the incompressible ball."""
    _check_ball(verified, 4, (2, 3), 0.04)


@a_ball
@pytest.mark.slow
@pytest.mark.parametrize(("degree", "cap"), [(2, 0.0045), (3, 0.006), (4, 0.0095), (5, 0.013)])
def test_ball_under_a_legendre_traction_on_fine_meshes(degree: int, cap: float, verified: Verified) -> None:
    _check_ball(verified, degree, (3, 4), cap)
