"""Moduli per tetrahedron and elastic supports against closed forms; springs towards both limits: tests/scene."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from scipy.optimize import brentq

from fem_reference.condensed import CondensedProblem
from fem_reference.exact import LayeredSphere
from fem_reference.exact_finite_strain import InflatedThickSphere
from fem_reference.springs import ElasticSupport
from tests.fem.convergence import Convergence, inner_error, radial_error
from tests.fem.shapes import Body, cube, pressed_shell
from tests.verification.records import Verified

a_bar = pytest.mark.anchor(
    "bar of two materials in series", "uniaxial stress, Poisson ratios in the ratio of Young's moduli"
)
a_sphere = pytest.mark.anchor(
    "two-layer sphere under pressure", "Lame; Timoshenko and Goodier, art. 136, one solution in each layer"
)
a_large_sphere = pytest.mark.anchor(
    "two-layer sphere, finite strain", "Ogden 1984, Non-Linear Elastic Deformations, section 5.3.2"
)


def _upper(b: Body) -> NDArray[np.bool_]:
    return b.points[b.tetrahedra][:, :, 2].mean(axis=1) > 0.5


@a_bar
@pytest.mark.parametrize("solver", ["direct", "iterative"])
def test_bar_of_two_materials(solver: str, verified: Verified) -> None:
    """Both halves widen alike, so the stress is uniaxial and the answer exact on any mesh with a plane at 1/2."""
    b = cube(4)
    upper = _upper(b)
    young, nu = np.where(upper, 1.8, 1.0), np.where(upper, 0.45, 0.25)
    problem = b.problem(
        b.surface < 1e-12, youngs_modulus=young, poisson_ratio=nu, parts=upper.astype(int), solver=solver
    )
    end = b.facets_where(lambda x: x[:, 2] > 1.0 - 1e-9)
    s = problem.solve([b.load(0.2 * end)])
    x = b.surface
    lower, above = np.minimum(x[:, 2], 0.5), np.maximum(x[:, 2] - 0.5, 0.0)
    exact = 0.2 * np.column_stack([0.25 * x[:, 0], 0.25 * x[:, 1], -lower - above / 1.8])
    limit = 1e-11 if solver == "direct" else 1e-7
    verified.at_most(f"{solver}: displacement", s.displacement[0] - exact, limit)
    verified.equal(f"{solver}: mean pressure", s.fluid_pressure[0], 0.2 / 3.0, rtol=10.0 * limit)
    verified.equal(
        f"{solver}: energy", s.energy[0], 0.5 * 0.2**2 * 0.5 * (1.0 + 1.0 / 1.8), rtol=10.0 * limit
    )


def test_displacement_elements_of_two_stiffnesses_in_a_rigid_tube() -> None:
    """No pressure stands for lambda, which is each half's own; exact as above."""
    b = cube(2)
    held = b.surface < 1e-12
    held[:, :2] |= b.surface[:, :2] > 1.0 - 1e-12
    problem = b.problem(
        held, youngs_modulus=np.where(_upper(b), 4.0, 1.0), poisson_ratio=0.3, element="P2", solver="direct"
    )
    s = problem.solve([b.load(0.2 * b.facets_where(lambda x: x[:, 2] > 1.0 - 1e-9))])
    modulus = 0.7 / (1.3 * 0.4)
    z = b.surface[:, 2]
    exact = -0.2 / modulus * (np.minimum(z, 0.5) + np.maximum(z - 0.5, 0.0) / 4.0)
    assert np.abs(s.displacement[0] - np.stack([0.0 * z, 0.0 * z, exact], axis=1)).max() < 1e-11


# ---------------------------------------------------------------- spheres of two layers


LAYERS = [(1.0, 0.3, 5.0, 0.45), (5.0, 0.4999, 1.0, 0.3), (1.0, 0.5, 10.0, 0.5)]


@a_sphere
@pytest.mark.parametrize("layers", LAYERS, ids=str)
def test_two_layer_sphere(layers: tuple[float, float, float, float], verified: Verified) -> None:
    """An octant on rollers, the layers meet at r = 1.5; also without its geometry error, see the anchors."""
    inner_young, inner_nu, outer_young, outer_nu = layers
    exact = LayeredSphere((1.0, 1.5, 2.0), (inner_young, outer_young), (inner_nu, outer_nu), 1.0)
    record = Convergence(f"E, nu = {layers}: u on flat facets", 2.0, 0.014, 0.3)
    for n in (4, 8):
        b, pressed = pressed_shell(n)
        inside = _inside(b)
        problem = b.problem(
            b.surface == 0.0,
            youngs_modulus=np.where(inside, inner_young, outer_young),
            poisson_ratio=np.where(inside, inner_nu, outer_nu),
            parts=inside.astype(int),
        )
        s = problem.solve([b.load(1.0 * pressed)])
        assert s.status[0].ok
        record.add(1.0 / n, radial_error(b, s.displacement[0], exact.radial_displacement))
    record.check(verified)


@a_large_sphere
def test_two_layer_sphere_at_finite_strain(verified: Verified) -> None:
    """Incompressible neo-Hookean layers, the outer three times as stiff; 25 % hoop stretch at the inner surface."""
    core = InflatedThickSphere(1.0, 1.5, 1.0 / 3.0, 1.25)
    shell = InflatedThickSphere(1.5, 2.0, 1.0, float(core.stretch(1.5)))
    pressure = core.pressure + shell.pressure
    record = Convergence("u(a) on flat facets, l_a = 1.25", 2.0, 0.015, 0.35)
    for n in (4, 6):
        b, pressed = pressed_shell(n)
        inside = _inside(b)
        problem = b.finite(
            b.surface == 0.0,
            youngs_modulus=np.where(inside, 1.0, 3.0),
            poisson_ratio=0.5,
            parts=inside.astype(int),
        )
        s = problem.solve([b.load(pressure * pressed)])
        assert s.status[0].ok
        record.add(1.0 / n, inner_error(b, s.displacement[0], 0.25))
    record.check(verified)
    verified.equal("energy, l_a = 1.25", 8.0 * s.energy[0], core.energy + shell.energy, rtol=0.02)


def _inside(b: Body) -> NDArray[np.bool_]:
    return np.linalg.norm(b.points[b.tetrahedra].mean(axis=1), axis=1) < 1.5 * 0.985


Array = NDArray[np.float64]

on_springs = pytest.mark.anchor(
    "bar on springs", "uniaxial stress: the springs give way by pressure over their constant"
)
in_a_bed = pytest.mark.anchor(
    "thick sphere in an elastic bed", "Lame; Timoshenko and Goodier, art. 136, radial stress -k u outside"
)


def _bottom(b: Body) -> Array:
    return b.facets_where(lambda x: np.abs(x[:, 2]) < 1e-12)


def _rollers(b: Body) -> Array:
    """Planes x = 0 and y = 0 slide."""
    return (b.surface < 1e-12) & [True, True, False]


@on_springs
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


@on_springs
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


@on_springs
def test_bar_on_springs_at_finite_strain(verified: Verified) -> None:
    """Dead pressure on an incompressible bar: P = G (l - l^-2); the springs give way by P / k. It tips at 0.49."""
    b = cube(2, distort=0.25)
    problem = b.finite(
        _rollers(b),
        youngs_modulus=3.0,
        poisson_ratio=0.5,
        pressure="dead",
        elastic_supports=[ElasticSupport(_bottom(b), 2.0)],
    )
    s = problem.solve([b.load(0.4 * b.top)])
    assert s.status[0].ok
    stretch = brentq(lambda length: length - length**-2 + 0.4, 0.3, 1.0, xtol=1e-15)
    exact = b.surface * [stretch**-0.5 - 1.0, stretch**-0.5 - 1.0, stretch - 1.0]
    exact[:, 2] -= 0.2
    verified.at_most("finite strain: displacement at a stretch of 0.88", s.displacement[0] - exact, 1e-8)
    verified.equal("finite strain: force of the springs", s.reaction_force[0, :, 2].sum(), 0.4, atol=1e-8)
    energy = 0.5 * (stretch**2 + 2.0 / stretch - 3.0)
    verified.equal("finite strain: energy of the body alone", s.energy[0], energy, atol=1e-8)


@in_a_bed
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
