"""Volumetric locking: what the displacement elements do wrong and the mixed element right."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from skfem import ElementTetP1, ElementTetP2, ElementVector, FacetBasis, LinearForm

from tests.unit.fem_shapes import Body, ball, mapped_box

NEARLY_INCOMPRESSIBLE = (0.45, 0.49, 0.499, 0.4999, 0.49999)


def _compliance(b: Body, element: str, poisson_ratio: float, solver: str = "direct") -> float:
    """Work of a pressed cap on a ball whose base is held [J]."""
    held = b.surface[:, 2] < -0.035
    cap = b.facets_where(lambda x: x[:, 2] > 0.035)
    problem = b.problem(held, youngs_modulus=5e3, poisson_ratio=poisson_ratio, element=element, solver=solver)
    s = problem.solve([b.load(200.0 * cap)], frozenset({"compliance"}))
    assert s.status[0].ok
    return float(s.scalars["compliance"][0])


def test_only_the_mixed_element_survives_incompressibility() -> None:
    """The compliance of a body at nu -> 1/2 is finite; P1 sends it to zero, P2 falls behind by a few per cent."""
    b = ball(2, radius=0.05)
    table = {
        element: np.array([_compliance(b, element, nu) for nu in NEARLY_INCOMPRESSIBLE])
        for element in ("P1", "P2", "P2-P1")
    }
    limit = _compliance(b, "P2-P1", 0.5)
    mixed = table["P2-P1"]
    assert_allclose(mixed[-3:], limit, rtol=2e-3, atol=0)
    assert_allclose(mixed[-1], limit, rtol=5e-5, atol=0)
    p1, p2 = table["P1"] / mixed, table["P2"] / mixed
    assert (np.diff(p1) < 0.0).all()
    assert (np.diff(p2) < 0.0).all()
    # One mesh: P1 is a fifth short at nu = 0.45 and has lost more than four fifths at 0.49999.
    assert_allclose(p1[[0, -1]], [0.81, 0.16], rtol=0, atol=0.02)
    assert_allclose(p2[[0, -1]], [0.98, 0.94], rtol=0, atol=0.01)
    # With Pi the projection on the pressure space, the mixed energy replaces (div u)^2 by (Pi div u)^2 <= it.
    assert (table["P2"] < mixed).all()


def test_refinement_helps_p1_only_slowly() -> None:
    coarse, fine = ball(2, radius=0.05), ball(3, radius=0.05)
    ratios = [_compliance(b, "P1", 0.4999) / _compliance(b, "P2-P1", 0.4999) for b in (coarse, fine)]
    assert ratios[0] < 0.4
    assert ratios[0] < ratios[1] < 0.55


def test_without_volume_coupling_the_mixed_element_is_p2() -> None:
    b = ball(2, radius=0.05)
    assert_allclose(_compliance(b, "P2-P1", 0.0), _compliance(b, "P2", 0.0), rtol=1e-11, atol=0)


def _cook(n: int, element: str, poisson_ratio: float) -> float:
    """Rise of the upper corner of Cook's membrane in plane strain: one slice between rollers, E = 250."""

    def shape(p: np.ndarray) -> np.ndarray:
        low = 44.0 * p[:, 0]
        height = 44.0 - 28.0 * p[:, 0]
        return np.column_stack([48.0 * p[:, 0], low + height * p[:, 1], 48.0 / n * p[:, 2]])

    b = mapped_box((n, n, 1), shape)
    held = np.zeros((len(b.surface_nodes), 3), dtype=bool)
    held[:, 2] = True
    held[b.surface[:, 0] < 1e-9] = True
    problem = b.problem(held, youngs_modulus=250.0, poisson_ratio=poisson_ratio, element=element)
    mesh = problem.mesh
    vector = ElementVector(ElementTetP2() if mesh.order == 2 else ElementTetP1())
    end = mesh.skfem_mesh.facets_satisfying(lambda x: x[0] > 48.0 - 1e-9)
    face = FacetBasis(mesh.skfem_mesh, vector, facets=end, intorder=2)
    shear = LinearForm(lambda v, _: 6.25 * v[1]).assemble(face).reshape(1, -1, 3)
    fields = problem.solve_nodal(shear, np.zeros_like(shear))
    corner = np.argmin(np.linalg.norm(mesh.node_points - np.array([48.0, 60.0, 0.0]), axis=1))
    return float(fields.displacement[0, corner, 1])


def _check_cook(levels: tuple[int, ...], change: float) -> None:
    limits = {}
    for poisson_ratio in (0.3, 0.4999, 0.49999, 0.5):
        rise = np.array([_cook(n, "P2-P1", poisson_ratio) for n in levels])
        steps = np.diff(rise)
        assert (steps > 0.0).all(), "the corner approaches from below"
        assert steps[-1] < change * rise[-1]
        rate = steps[-2] / steps[-1]
        assert 2.0 < rate < 4.0, "between orders 1 and 2: the held corner is singular"
        limits[poisson_ratio] = rise[-1] + steps[-1] / (rate - 1.0)
    assert_allclose(limits[0.49999], limits[0.5], rtol=1e-4, atol=0)
    assert_allclose(limits[0.4999], limits[0.5], rtol=2e-3, atol=0)
    # Where nothing locks, P2 is an independent second opinion on the limit.
    plain = np.array([_cook(n, "P2", 0.3) for n in levels])
    steps = np.diff(plain)
    extrapolated = plain[-1] + steps[-1] / (steps[-2] / steps[-1] - 1.0)
    assert_allclose(limits[0.3], extrapolated, rtol=3e-3, atol=0)
    locked = _cook(levels[-1], "P1", 0.49999)
    assert locked < 0.3 * limits[0.5]


def test_cooks_membrane() -> None:
    _check_cook((4, 8, 16), change=0.015)


@pytest.mark.slow
def test_cooks_membrane_on_fine_meshes() -> None:
    _check_cook((8, 16, 32), change=0.007)


@pytest.mark.slow
@pytest.mark.parametrize("poisson_ratio", [0.45, 0.4999, 0.5])
def test_the_two_paths_agree_on_a_large_body(poisson_ratio: float) -> None:
    b = ball(4, radius=0.05)
    direct, iterative = (_compliance(b, "P2-P1", poisson_ratio, solver) for solver in ("direct", "iterative"))
    assert_allclose(iterative, direct, rtol=1e-8, atol=0)
