"""The linear problem with fibres: exact tension; the limit of small loads is in `test_finite_strain`."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.fem.shapes import Body, cube


@pytest.fixture(scope="module")
def block() -> Body:
    return cube(3, distort=0.2)


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
