"""Given forces: resultant and moment on every mesh level, and closed forms of shear, bending and torsion."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from fem_reference.condensed import CondensedProblem
from fem_reference.forces import line_forces, region_forces, traction_forces
from fem_reference.loads import independent_loads
from fem_reference.mesh import TetMesh
from fem_reference.solution import SolverError
from tests.fem.shapes import Body, ball, cube, mapped_box
from tests.verification.records import Verified

Array = NDArray[np.float64]

FORCE = (0.3, -0.7, 0.4)


def _wrench(mesh: TetMesh, forces: Array) -> tuple[Array, Array]:
    return forces.sum(axis=0), np.cross(mesh.node_points, forces).sum(axis=0)


def _meridian(b: Body) -> Array:
    """Edges of the ball in the plane x = 0 with z > 0."""
    edges = np.unique(
        np.sort(np.stack([b.triangles, np.roll(b.triangles, -1, axis=1)], axis=2).reshape(-1, 2), axis=1),
        axis=0,
    )
    x = b.surface[edges]
    return edges[(np.abs(x[:, :, 0]) < 1e-12).all(axis=1) & (x[:, :, 2].mean(axis=1) > 0.0)]


@pytest.mark.anchor("given forces on a ball", "their own resultant and moment, on three mesh levels")
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("refinements", [1, 2, 3])
def test_resultant_and_moment_on_every_level(refinements: int, order: int, verified: Verified) -> None:
    b = ball(refinements)
    mesh = TetMesh(*b.arrays, order=order)
    cap = b.facets_where(lambda x: x[:, 2] > 0.3)
    title = f"P{order}, level {refinements}"
    area = np.linalg.norm(b.area_vectors, axis=1)
    centroid = (area * cap) @ b.surface[b.triangles].mean(axis=1) / area[cap].sum()
    found = _wrench(mesh, region_forces(mesh, cap, FORCE))
    verified.at_most(f"{title}: region", np.subtract(found, (FORCE, np.cross(centroid, FORCE))), 1e-13)
    edges = _meridian(b)
    ends = b.surface[edges]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    middle = length @ ends.mean(axis=1) / length.sum()
    found = _wrench(mesh, line_forces(mesh, edges, FORCE))
    verified.at_most(f"{title}: line", np.subtract(found, (FORCE, np.cross(middle, FORCE))), 1e-13)
    # a traction that is linear in space, against its integrals over each flat facet
    g = np.random.default_rng(5).uniform(-1.0, 1.0, (3, 3))
    traction = b.quadrature_points @ g.T
    x = b.surface[b.triangles]
    total = area @ x.mean(axis=1) @ g.T
    # the mean of x_i x_j over a triangle: (sum of vertices' + 9 of the centroid's) / 12
    squares = (np.einsum("fai,faj->fij", x, x) + 9.0 * np.einsum("fi,fj->fij", *2 * [x.mean(axis=1)])) / 12.0
    second = np.einsum("f,fij->ij", area, squares) @ g.T
    twist = np.array([second[1, 2] - second[2, 1], second[2, 0] - second[0, 2], second[0, 1] - second[1, 0]])
    found = _wrench(mesh, traction_forces(mesh, traction))
    verified.at_most(f"{title}: linear traction", np.subtract(found, (total, twist)), 1e-12)


def _with(b: Body, forces: Array | None, **others: object):
    load = b.load(**others)
    return type(load)(load.facet_pressure, load.prescribed, load.gravity, forces)


@pytest.mark.anchor("simple shear by tractions", "homogeneous stress: displacement linear in space")
@pytest.mark.parametrize("poisson_ratio", [0.3, 0.5])
def test_simple_shear(poisson_ratio: float, verified: Verified) -> None:
    """Shear tractions t on four faces; three nodes hold the rigid motion: u_x = t z / G."""
    b = cube(3, distort=0.3)
    held = b.held_at(((0, 0, 0), (0, 1, 2)), ((1, 0, 0), (1, 2)), ((0, 1, 0), (2,)))
    problem = b.problem(held, poisson_ratio=poisson_ratio)
    stress = np.zeros((3, 3))
    stress[0, 2] = stress[2, 0] = 0.1
    normal = b.area_vectors / np.linalg.norm(b.area_vectors, axis=1)[:, None]
    forces = traction_forces(problem.mesh, (normal @ stress)[:, None])
    s = problem.solve([_with(b, forces)])
    shear = 0.5 / (1.0 + poisson_ratio)
    exact = np.outer(b.surface[:, 2], [0.1 / shear, 0.0, 0.0])
    verified.at_most(f"nu = {poisson_ratio}: displacement", s.displacement[0] - exact, 1e-11)
    assert_allclose(s.reaction_force, 0.0, rtol=0, atol=1e-12)


@pytest.mark.anchor(
    "bar under a moment and under a twist", "Timoshenko and Goodier, Theory of Elasticity, art. 102 and 109"
)
def test_pure_bending_is_exact(verified: Verified) -> None:
    """A moment through the linear traction of bending: quadratic displacements, which P2 has."""
    b = mapped_box((6, 2, 2), lambda x: (x - [0.0, 0.5, 0.5]) * [4.0, 1.0, 1.0])
    held = b.held_at(((0, 0, 0), (1, 2)), ((0, 0, 0.5), (1,)))
    held[b.surface[:, 0] == 0.0, 0] = True
    problem = b.problem(held, poisson_ratio=0.3)
    end = b.facets_where(lambda x: x[:, 0] > 4.0 - 1e-9)
    # sigma_x = M z / I
    traction = np.zeros_like(b.quadrature_points)
    traction[end, :, 0] = 0.01 * 12.0 * b.quadrature_points[end, :, 2]
    s = problem.solve([_with(b, traction_forces(problem.mesh, traction))])
    # u = k (x z, -nu y z, -(x^2 + nu (z^2 - y^2))/2), k = M / (E I), I = 1/12
    x, y, z = b.surface.T
    k = 0.01 * 12.0
    exact = k * np.column_stack([x * z, -0.3 * y * z, -0.5 * (x**2 + 0.3 * (z**2 - y**2))])
    verified.at_most(
        "moment of a square bar: displacement over the largest",
        (s.displacement[0] - exact) / np.abs(exact).max(),
        1e-10,
    )


@pytest.mark.anchor(
    "bar under a moment and under a twist", "Timoshenko and Goodier, Theory of Elasticity, art. 102 and 109"
)
def test_twist_of_a_square_bar(verified: Verified) -> None:
    """The angle between two sections away from the ends is M L / (0.140577 G a^4)."""
    b = mapped_box((18, 5, 5), lambda x: (x - [0.0, 0.5, 0.5]) * [6.0, 1.0, 1.0])
    problem = b.problem(b.surface[:, 0] == 0.0, poisson_ratio=0.3)
    end = b.facets_where(lambda x: x[:, 0] > 6.0 - 1e-9)
    # a traction across the radius, over the polar moment 1/6
    turn = np.cross([0.01 * 6.0, 0.0, 0.0], b.quadrature_points)
    s = problem.solve([_with(b, traction_forces(problem.mesh, turn * end[:, None, None]))])
    assert_allclose(np.cross(b.surface, s.reaction_force[0]).sum(axis=0), [-0.01, 0, 0], rtol=0, atol=1e-8)

    def angle(at: float) -> float:
        ring = np.abs(b.surface[:, 0] - at) < 1e-9
        y, z = b.surface[ring, 1:].T
        u = s.displacement[0][ring]
        return float(np.sum(y * u[:, 2] - z * u[:, 1]) / np.sum(y**2 + z**2))

    shear = 0.5 / 1.3
    verified.equal(
        "twist of a square bar, 5 cells across",
        angle(4.0) - angle(2.0),
        0.01 * 2.0 / (0.140577 * shear),
        rtol=0.01,
    )


def test_combinations_and_finite_strain_take_given_forces() -> None:
    b = cube(2, distort=0.25)
    problem = b.problem(b.bottom)
    top = b.top
    shear = region_forces(problem.mesh, top, (1e-6, 2e-6, 0.0))
    loads = [_with(b, None, pressure=1e-6 * top), _with(b, shear), _with(b, 2.0 * shear, pressure=3e-6 * top)]
    assert len(independent_loads(loads)[0]) == 2
    s = problem.solve(loads)
    assert_allclose(s.displacement[2], 3.0 * s.displacement[0] + 2.0 * s.displacement[1], rtol=0, atol=1e-18)
    finite = b.finite(b.bottom).solve(loads[1:2])
    assert_allclose(
        finite.displacement[0], s.displacement[1], rtol=0, atol=1e-4 * np.abs(s.displacement).max()
    )
    assert_allclose(finite.reaction_force[0].sum(axis=0), [-1e-6, -2e-6, 0.0], rtol=0, atol=1e-14)
    with pytest.raises(SolverError, match="load step 1 has given forces; use LinearProblem"):
        CondensedProblem(problem, b.surface[:, 2] == 1.0).solve(loads[1:2])
