"""The linear problem with fibres: exact tension, scikit-fem's form, the finite-strain law's small limit."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fem_reference.finite_strain import FiniteStrainProblem
from fem_reference.linear import LinearProblem
from tests.fem.shapes import Body, cube

TILT = (1.0, -2.0, 0.5)


@pytest.fixture(scope="module")
def block() -> Body:
    return cube(3, distort=0.2)


def _bottom(b: Body) -> np.ndarray:
    return b.surface[:, 2] < 1e-12


def _tension(b: Body, contrast: float, axis: int, **options: object) -> tuple[np.ndarray, float]:
    """Strain along x, y, z and mean pressure per unit tension along `axis`, fibres along x, on rollers."""
    problem = b.problem(b.surface < 1e-12, fibre_direction=(3.0, 0.0, 0.0), contrast=contrast, **options)
    end = b.facets_where(lambda x: x[:, axis] > 1.0 - 1e-12)
    solution = problem.solve([b.load(-1.0 * end)])
    assert solution.status[0].ok
    far = np.argmax(b.surface.sum(axis=1))
    return solution.displacement[0, far], solution.fluid_pressure[0]


@pytest.mark.parametrize("solver", ["direct", "iterative"])
@pytest.mark.parametrize("contrast", [1.0, 20.0])
@pytest.mark.parametrize(("element", "nu"), [("P2-P1", 0.5), ("P2-P1", 0.3), ("P2", 0.3), ("P1", 0.3)])
def test_tension_along_and_across_is_exact(
    block: Body, solver: str, contrast: float, element: str, nu: float
) -> None:
    """Young's modulus along the fibres is c E; across, by inverting Hooke's law with the fibres' term."""
    shear, fibre = 0.5 / (1.0 + nu), contrast - 1.0
    compliance = (1.0 + nu) * np.eye(3) - nu * np.ones((3, 3))  # of the isotropic part, E = 1
    # Sherman-Morrison of the compliance for stress += fibre e_x along x; finite at nu = 1/2 too
    first = compliance[:, 0]
    compliance = compliance - fibre * np.outer(first, first) / (1.0 + fibre * first[0])
    assert_allclose(1.0 / compliance[0, 0], contrast, rtol=1e-14, atol=0)
    if nu == 0.5:
        m = 1.0 + fibre / (2.0 * shear)
        assert_allclose(1.0 / compliance[2, 2], 2.0 * shear * (1.0 + 2.0 * m) / (1.0 + m), rtol=1e-12, atol=0)
    for axis in range(3):
        strain, pressure = _tension(block, contrast, axis, element=element, poisson_ratio=nu, solver=solver)
        assert_allclose(strain, compliance[:, axis], rtol=0, atol=2e-7)
        assert_allclose(pressure, -1.0 / 3.0, rtol=0, atol=2e-7)


def test_small_loads_of_the_finite_strain_law_are_linear(block: Body) -> None:
    fibres = {"fibre_direction": TILT, "contrast": 5.0}
    common = {"youngs_modulus": 1.0, "poisson_ratio": 0.4999, "held": _bottom(block)}
    load = block.load(1e-6 * block.facets_where(lambda x: x[:, 2] > 1.0 - 1e-12))
    linear = LinearProblem(*block.arrays, **common, **fibres).solve([load])
    finite = FiniteStrainProblem(*block.arrays, **common, material="transversely-isotropic", **fibres)
    finite = finite.solve([load])
    isotropic = LinearProblem(*block.arrays, **common).solve([load])
    size = np.abs(linear.displacement).max()
    assert np.abs(linear.displacement - isotropic.displacement).max() > 0.2 * size
    assert_allclose(finite.displacement, linear.displacement, rtol=0, atol=1e-5 * size)
    assert_allclose(finite.fluid_pressure, linear.fluid_pressure, rtol=1e-4, atol=0)
    assert_allclose(finite.energy, linear.energy, rtol=1e-4, atol=0)
