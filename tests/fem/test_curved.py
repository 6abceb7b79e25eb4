"""Curved elements: the ball's harmonics and the thick sphere with their geometry, and what straight ones keep."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from fem_reference.condensed import CondensedProblem
from fem_reference.exact import IncompressibleBall, ThickSphere
from fem_reference.forces import region_forces
from fem_reference.loads import nodal_forces
from fem_reference.mesh import TetMesh
from fem_reference.solution import SolverError
from tests.fem.convergence import (
    THREE_POINTS,
    Convergence,
    inner_error,
    relative_without_motion,
)
from tests.fem.shapes import Body, assert_same, ball, cube, pressed_shell
from tests.verification.records import Verified

Array = NDArray[np.float64]

a_ball = pytest.mark.anchor(
    "incompressible ball under P_n, curved elements",
    "Love 1927, Mathematical Theory of Elasticity, art. 173; `fem_reference.exact.IncompressibleBall`",
)
a_sphere = pytest.mark.anchor(
    "thick sphere under pressure, curved elements",
    "Lame; Timoshenko and Goodier, Theory of Elasticity, art. 136",
)


DEGREES = (2, 3, 4)


def _onto_sphere(x: Array) -> Array:
    return x / np.linalg.norm(x, axis=1)[:, None]


def _onto_shell(x: Array) -> Array:
    """Middles of edges of the spheres of radius 1 and 2 go onto them; others stay."""
    r = np.linalg.norm(x, axis=1)[:, None]
    nearest = np.where(r < 1.0 + 1e-9, 1.0, np.where(r > 1.95, 2.0, r))
    return x * nearest / r


def _ball_errors(refinements: int) -> dict[int, float]:
    """Relative error at the surface for each degree."""
    b = ball(refinements)
    problem = b.problem(
        b.held_at(*THREE_POINTS), poisson_ratio=0.5, density=1.0, onto=_onto_sphere, expected_loads=3
    )
    points = problem.mesh.facet_points
    loads, exact = [], {}
    for degree in DEGREES:
        case = IncompressibleBall(radius=1.0, shear_modulus=1.0 / 3.0, degree=degree, traction=1.0)
        traction = case.surface_traction(points.reshape(-1, 3)).reshape(points.shape[:2])
        exact[degree] = case.displacement(b.surface)
        # what little resultant the mesh leaves would be a point force at a support: it is spread over the volume
        resultant = nodal_forces(problem.mesh, [b.load(-traction)], 0.0)[0].sum(axis=0)
        volume = problem.mesh.curved.shares().sum()
        loads.append(b.load(-traction, exact[degree], gravity=-resultant / volume))
    s = problem.solve(loads)
    # three points that hold the body leave its small rigid motion to the error there
    errors = {}
    for u, found, status, degree in zip(exact.values(), s.displacement, s.status, DEGREES, strict=True):
        assert status.ok
        errors[degree] = relative_without_motion(found, u, b.surface)
    return errors


def _check_ball(verified: Verified, levels: tuple[int, ...], caps: tuple[float, ...]) -> None:
    found = {level: _ball_errors(level) for level in levels}
    for degree, cap in zip(DEGREES, caps, strict=True):
        record = Convergence(f"n = {degree}: u at the surface", 3.0, cap, 0.4)
        for level in levels:
            record.add(2.0**-level, found[level][degree])
        record.check(verified)


@a_ball
@pytest.mark.slow
def test_ball_harmonics_with_their_geometry(verified: Verified) -> None:
    """Order 3, where flat facets have 2 and leave seven times the error for n = 2."""
    _check_ball(verified, (2, 3), (2.5e-3, 9.5e-3, 2.2e-2))


@a_ball
@pytest.mark.slow
def test_ball_harmonics_on_a_fine_mesh(verified: Verified) -> None:
    """32,768 tetrahedra. On this family of meshes the last orders are 2.7 for n = 2 and 2.3 for n = 3."""
    errors = _ball_errors(4)
    for degree, cap in zip(DEGREES, (5e-4, 2e-3, 6e-3), strict=True):
        verified.at_most(f"n = {degree}: u at the surface, error at h = 0.0625", errors[degree], cap)


@a_sphere
@pytest.mark.parametrize("poisson_ratio", [0.3, 0.5])
def test_thick_sphere_with_its_geometry(poisson_ratio: float, verified: Verified) -> None:
    exact = ThickSphere(1.0, 2.0, 1.0, poisson_ratio, 1.0)
    record = Convergence(f"nu = {poisson_ratio}: u(a) at the vertices, which gain an order", 4.0, 3.5e-3, 0.4)
    for n in (3, 6):
        b, inner = pressed_shell(n)
        problem = b.problem(b.surface == 0.0, poisson_ratio=poisson_ratio, onto=_onto_shell)
        s = problem.solve([b.load(1.0 * inner)])
        record.add(1.0 / n, inner_error(b, s.displacement[0], float(exact.radial_displacement(1.0))))
    record.check(verified)
    verified.equal(
        f"nu = {poisson_ratio}: mean pressure", s.fluid_pressure[0], exact.mean_pressure, rtol=1e-3
    )
    work = 0.5 * 4.0 * np.pi * float(exact.radial_displacement(1.0)) / 8.0
    verified.equal(f"nu = {poisson_ratio}: energy", s.energy[0], work, rtol=1e-3)


@pytest.mark.parametrize("solver", ["direct", "iterative"])
@pytest.mark.parametrize("poisson_ratio", [-0.3, 0.0, 0.3, 0.5])
def test_elements_that_are_moved_nowhere_are_straight(poisson_ratio: float, solver: str) -> None:
    b = cube(2, distort=0.25)
    held, top = b.surface[:, 2] == 0.0, b.facets_where(lambda x: x[:, 2] == 1.0)
    load = b.load(0.3 * top, gravity=(0.0, 1.0, -9.0))
    straight, curved = (
        b.problem(held, poisson_ratio=poisson_ratio, density=0.01, solver=solver, onto=onto).solve([load])
        for onto in (None, lambda x: x)
    )
    assert_same(curved, straight, 1e-11 if solver == "direct" else 1e-7)


def test_a_curved_body_keeps_its_balance() -> None:
    """Weight and a resultant over a cap against the reactions; the volume is the ball's."""
    b = ball(2)
    problem = b.problem(b.surface[:, 2] < -0.7, density=3.0, onto=_onto_sphere)
    mesh = problem.mesh
    assert isinstance(mesh, TetMesh)
    assert mesh.curved is not None
    assert_allclose(mesh.curved.shares().sum(), 4.0 / 3.0 * np.pi, rtol=2e-3)
    displacement, pressure = mesh.bases(intorder=6)
    assert_allclose(displacement.dx.sum(), mesh.curved.shares().sum(), rtol=1e-12)
    assert 3 * mesh.n_nodes == displacement.N
    assert mesh.n_pressures == pressure.N
    assert abs(mesh.volume - 4.0 / 3.0 * np.pi) > 0.05
    cap = b.facets_where(lambda x: x[:, 2] > 0.5)
    forces = region_forces(mesh, cap, (0.1, 0.2, -0.3), (0.02, -0.01, 0.05))
    assert_allclose(np.cross(mesh.node_points, forces).sum(axis=0), (0.02, -0.01, 0.05), rtol=0, atol=1e-13)
    load = b.load(gravity=(0.0, 0.0, -2.0))
    s = problem.solve([type(load)(load.facet_pressure, load.prescribed, load.gravity, forces)])
    weight = 3.0 * 2.0 * mesh.curved.shares().sum()
    assert_allclose(s.reaction_force[0].sum(axis=0), (-0.1, -0.2, 0.3 + weight), rtol=0, atol=1e-8)


def test_what_curved_elements_do_not_have_is_refused() -> None:
    b: Body = ball(1)
    held = b.surface[:, 2] < -0.5
    problem = b.problem(held, onto=_onto_sphere)
    for call, words in (
        (lambda: b.problem(held, onto=_onto_sphere, element="P1"), "curved elements are P2"),
        (lambda: b.problem(held, onto=lambda x: x[1:]), "onto gives an array of shape"),
        (lambda: b.problem(held, onto=lambda x: -x), "a tetrahedron turns inside out"),
        (lambda: b.problem(held, onto=lambda x: -0.9 * x), r"tetrahedron \d+ turns inside out"),
        (
            lambda: b.problem(held, onto=_onto_sphere, fibre_direction=(1, 0, 0), contrast=2.0),
            "there are no fibres of a body with curved elements; leave out onto",
        ),
        (
            lambda: problem.solve([b.load()], frozenset({"volume"})),
            "there is no volume of a body with curved",
        ),
        (lambda: CondensedProblem(problem, ~held), "there is no condensed form"),
    ):
        with pytest.raises(SolverError, match=words):
            call()
