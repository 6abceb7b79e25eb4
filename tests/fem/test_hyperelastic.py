"""The laws of the distortion in whole bodies: a thick sphere blown up, and the linear limit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from fem_reference.exact_finite_strain import InflatedThickSphere
from fem_reference.materials import MATERIALS
from tests.fem.convergence import Convergence, inner_error
from tests.fem.shapes import pressed_shell
from tests.fem.test_materials import SHAPES, _curves
from tests.verification.records import Verified

a_sphere = pytest.mark.anchor(
    "hyperelastic thick sphere", "Ogden 1984, Non-Linear Elastic Deformations, section 5.3.2"
)
_INNER_STRETCH = 1.3


def _pressure(name: str) -> float:
    """P = integral from l_b to l_a of W'(l)/(l^3 - 1), W' twice the equibiaxial stress at stretch l; G = 1/3."""
    outer = float(InflatedThickSphere(1.0, 2.0, 1.0, _INNER_STRETCH).stretch(2.0))

    def slope(stretch: float) -> float:
        equibiaxial = float(_curves(name, np.array([stretch]))[1][0]) / 6.0
        return 2.0 * equibiaxial / (stretch**3 - 1.0)

    return float(quad(slope, outer, _INNER_STRETCH, epsabs=1e-13)[0])


def test_the_shapes_are_those_of_every_law() -> None:
    assert set(SHAPES) | {"neo-hookean", "transversely-isotropic"} == set(MATERIALS)


@a_sphere
@pytest.mark.parametrize(("name", "share"), [("neo-hookean", 0.0), ("mooney-rivlin", 0.3)])
def test_pressure_by_quadrature_and_in_closed_form(name: str, share: float, verified: Verified) -> None:
    exact = InflatedThickSphere(1.0, 2.0, 1.0 / 3.0, _INNER_STRETCH, share)
    verified.equal(f"formula, {name}: P at l_a = 1.3", _pressure(name), exact.pressure, rtol=1e-12)


@a_sphere
@pytest.mark.parametrize(
    "name",  # by invariants, and by principal stretches; the others beside them are of one form with these
    [
        name if name in ("mooney-rivlin", "ogden") else pytest.param(name, marks=pytest.mark.slow)
        for name in SHAPES
    ],
)
def test_inflated_sphere(name: str, verified: Verified) -> None:
    """An octant on rollers under follower pressure, incompressible."""
    exact = InflatedThickSphere(1.0, 2.0, 1.0 / 3.0, _INNER_STRETCH)
    record = Convergence(f"{name}: u(a) on flat facets, l_a = 1.3", 2.0, 0.016, 0.3)
    for n in (4, 6):
        b, inner = pressed_shell(n)
        law = {"material": name, "material_parameters": SHAPES[name]}
        s = b.finite(b.surface == 0.0, poisson_ratio=0.5, **law).solve([b.load(_pressure(name) * inner)])
        assert s.status[0].ok, s.status
        record.add(1.0 / n, inner_error(b, s.displacement[0], float(exact.radial_displacement(1.0))))
    record.check(verified)
