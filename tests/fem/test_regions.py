"""Moduli per tetrahedron: bodies of two materials against closed forms, and one material told in two ways."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from fem_reference.exact import LayeredSphere, ThickSphere
from fem_reference.exact_finite_strain import InflatedThickSphere
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


# ---------------------------------------------------------------- spheres of two layers


@a_sphere
@pytest.mark.parametrize("poisson_ratio", [0.3, 0.4999, 0.5])
def test_layered_sphere_formula(poisson_ratio: float, verified: Verified) -> None:
    """Of equal layers it is Lame's sphere; a layer without stiffness leaves the other alone."""
    radii = np.array([1.0, 1.3, 1.5, 2.0])
    same = LayeredSphere((1.0, 1.5, 2.0), (3.0, 3.0), (poisson_ratio, poisson_ratio), 0.7)
    one = ThickSphere(1.0, 2.0, 3.0, poisson_ratio, 0.7)
    difference = same.radial_displacement(radii) / one.radial_displacement(radii) - 1.0
    verified.at_most(f"formula: equal layers, nu = {poisson_ratio}", difference, 1e-12)
    soft = LayeredSphere((1.0, 1.5, 2.0), (3.0, 3e-12), (poisson_ratio, 0.2), 0.7)
    inner = ThickSphere(1.0, 1.5, 3.0, poisson_ratio, 0.7)
    assert_allclose(soft.radial_displacement(radii[:3]), inner.radial_displacement(radii[:3]), rtol=1e-9)


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
