"""Elastic supports against closed forms; towards fixed and free ones: tests/scene/test_elastic_support.py."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from scipy.optimize import brentq

from fem_reference.condensed import CondensedProblem
from fem_reference.exact import LayeredSphere
from fem_reference.springs import ElasticSupport
from tests.fem.convergence import Convergence, radial_error
from tests.fem.shapes import Body, cube, pressed_shell
from tests.verification.records import Verified

Array = NDArray[np.float64]

a_bar = pytest.mark.anchor(
    "bar on springs", "uniaxial stress: the springs give way by pressure over their constant"
)
a_sphere = pytest.mark.anchor(
    "thick sphere in an elastic bed", "Lame; Timoshenko and Goodier, art. 136, radial stress -k u outside"
)


def _bottom(b: Body) -> Array:
    return b.facets_where(lambda x: np.abs(x[:, 2]) < 1e-12)


def _rollers(b: Body) -> Array:
    """Planes x = 0 and y = 0 slide."""
    return (b.surface < 1e-12) & [True, True, False]


@a_bar
@pytest.mark.parametrize("solver", ["direct", "iterative"])
@pytest.mark.parametrize("poisson_ratio", [0.3, 0.5])
def test_bar_on_springs(poisson_ratio: float, solver: str, verified: Verified) -> None:
    b = cube(3, distort=0.3)
    problem = b.problem(
        _rollers(b),
        poisson_ratio=poisson_ratio,
        youngs_modulus=4.0,
        elastic_supports=[ElasticSupport(_bottom(b), 0.7)],
        solver=solver,
    )
    s = problem.solve([b.load(0.2 * b.top)])
    exact = 0.05 * b.surface * [poisson_ratio, poisson_ratio, -1.0]
    exact[:, 2] -= 0.2 / 0.7
    title = f"{solver}, nu = {poisson_ratio}"
    limit = 1e-11 if solver == "direct" else 1e-7
    verified.at_most(f"{title}: displacement", s.displacement[0] - exact, limit)
    verified.equal(f"{title}: force of the springs", s.reaction_force[0, :, 2].sum(), 0.2, atol=limit)
    verified.equal(f"{title}: energy of the body alone", s.energy[0], 0.5 * 0.2 * 0.05, atol=limit)


@a_bar
def test_springs_alone_carry_a_body(verified: Verified) -> None:
    """Full springs below, nothing held; with nu = 0 the stress is uniaxial. Condensed too."""
    b = cube(3, distort=0.3)
    problem = b.problem(
        np.zeros(len(b.surface), dtype=bool),
        poisson_ratio=0.0,
        elastic_supports=[ElasticSupport(_bottom(b), 0.5, "full")],
    )
    load = b.load(0.2 * b.top)
    s = problem.solve([load])
    exact = np.outer(-0.2 * b.surface[:, 2] - 0.4, [0.0, 0.0, 1.0])
    verified.at_most("full springs, nothing held: displacement", s.displacement[0] - exact, 1e-11)
    assert_allclose(s.reaction_force[0].sum(axis=0), [0.0, 0.0, 0.2], rtol=0, atol=1e-12)
    frame = CondensedProblem(problem, np.abs(b.surface[:, 2] - 1.0) < 1e-12).solve([load])
    assert_allclose(frame.displacement, s.displacement, rtol=0, atol=1e-11)
    assert_allclose(frame.reaction_force, s.reaction_force, rtol=0, atol=1e-12)
    assert_allclose(frame.energy, s.energy, rtol=1e-10, atol=0)


def test_energy_where_springs_meet_nodes_that_move() -> None:
    """Condensed and not: the body's energy is the work of the loads less that stored in springs."""
    b = cube(2, distort=0.25)
    side = b.facets_where(lambda x: np.abs(x[:, 0] - 1.0) < 1e-12)
    base = b.bottom
    motion = np.outer(base, [0.1, 0.0, -0.05])
    problem = b.problem(base, elastic_supports=[ElasticSupport(side, 3.0, "full")])
    load = b.load(0.2 * b.top, prescribed=motion)
    s = problem.solve([load])
    top = np.abs(b.surface[:, 2] - 1.0) < 1e-12
    frame = CondensedProblem(problem, top, motions=motion[None]).solve([load])
    assert_allclose(frame.energy, s.energy, rtol=1e-10, atol=0)
    assert_allclose(frame.reaction_force, s.reaction_force, rtol=0, atol=1e-11)
    small = b.finite(base, elastic_supports=[ElasticSupport(side, 3.0, "full")]).solve(
        [b.load(0.2e-6 * b.top, prescribed=1e-6 * motion)]
    )
    assert_allclose(small.energy, 1e-12 * s.energy, rtol=1e-5, atol=0)


@a_bar
def test_bar_on_springs_at_finite_strain(verified: Verified) -> None:
    """Dead pressure on an incompressible bar: P = G (l - l^-2), and the springs give way by P / k."""
    b = cube(2, distort=0.25)
    problem = b.finite(
        _rollers(b),
        youngs_modulus=3.0,
        poisson_ratio=0.5,
        pressure="dead",
        elastic_supports=[ElasticSupport(_bottom(b), 2.0)],
    )
    s = problem.solve([b.load(0.8 * b.top)])
    assert s.status[0].ok
    stretch = brentq(lambda length: length - length**-2 + 0.8, 0.3, 1.0, xtol=1e-15)
    exact = b.surface * [stretch**-0.5 - 1.0, stretch**-0.5 - 1.0, stretch - 1.0]
    exact[:, 2] -= 0.4
    verified.at_most("finite strain: displacement at a stretch of 0.75", s.displacement[0] - exact, 1e-8)
    verified.equal("finite strain: force of the springs", s.reaction_force[0, :, 2].sum(), 0.8, atol=1e-8)
    energy = 0.5 * (stretch**2 + 2.0 / stretch - 3.0)
    verified.equal("finite strain: energy of the body alone", s.energy[0], energy, atol=1e-8)


@a_sphere
@pytest.mark.parametrize("poisson_ratio", [0.3, 0.5])
def test_sphere_in_an_elastic_bed(poisson_ratio: float, verified: Verified) -> None:
    """A stiffness k is that of a shell around the sphere, here without a limit to its modulus."""
    bed = 0.8
    # A far thicker shell of Poisson ratio 0.3: k = 4 G / b where it reaches to infinity (Lame's cavity).
    shear = bed * 2.0 / 4.0
    exact = LayeredSphere((1.0, 2.0, 2e5), (1.0, 2.6 * shear), (poisson_ratio, 0.3), 0.5)
    record = Convergence(f"nu = {poisson_ratio}: u on flat facets", 2.0, 0.012, 0.3)
    for n in (4, 8):
        b, inner = pressed_shell(n)
        outer = b.facets_where(lambda x: np.linalg.norm(x, axis=1) > 2.0 - 1e-9)
        problem = b.problem(
            b.surface == 0.0, poisson_ratio=poisson_ratio, elastic_supports=[ElasticSupport(outer, bed)]
        )
        s = problem.solve([b.load(0.5 * inner)])
        record.add(1.0 / n, radial_error(b, s.displacement[0], exact.radial_displacement))
    record.check(verified)
