"""Condition estimates of the finite elements against numpy's condition number of the dense matrix."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fem_reference.condensed import CondensedProblem
from fem_reference.condition import condition_estimate
from fem_reference.solution import SolverError
from fem_reference.system import LinearSystem
from tests.fem.shapes import Body, ball, cube

CUBE, BALL = cube(2), ball(1)
CONDITION = frozenset({"condition_estimate"})
BAND = (0.3, 1.0 + 1e-6)  # of a lower bound that is rarely more than three times too small


def base(body: Body) -> np.ndarray:
    return body.surface[:, 2] < body.surface[:, 2].min() + 0.4


def exact(system: LinearSystem) -> float:
    """|M|_1 |M^-1|_1 by numpy: displacements to a unit diagonal, pressures by theirs of the mass matrix."""
    matrix = system.apply(np.eye(system.size))
    n = system.n_displacements
    unit = np.ones(system.size)
    unit[:n] = 1.0 / np.sqrt(np.diag(matrix)[:n])
    if system.mass is not None:
        complement = abs(system.schur_factor) * system.mass.toarray().diagonal()
        unit[n:] = 1.0 / np.sqrt(complement)
    return float(np.linalg.cond(matrix * np.outer(unit, unit), 1))


@pytest.mark.parametrize("body", [CUBE, BALL], ids=["cube", "ball"])
@pytest.mark.parametrize(
    ("element", "ratios"),
    [("P2-P1", (-0.5, 0.0, 0.3, 0.4999, 0.5)), ("P2", (0.0, 0.4999)), ("P1", (0.3, 0.49999))],
)
def test_the_estimate_is_the_condition_number_of_the_scaled_system(
    body: Body, element: str, ratios: tuple[float, ...]
) -> None:
    for ratio in ratios:
        problem = body.problem(base(body), poisson_ratio=ratio, element=element)
        share = problem.condition / exact(problem.system)
        assert BAND[0] <= share <= BAND[1], (element, ratio, share)


def test_every_solver_reports_it_where_it_is_asked_for_and_not_otherwise() -> None:
    body, held = BALL, base(BALL)
    load = body.load(pressure=np.where(body.facets_where(lambda x: x[:, 2] > 0.5), 0.01, 0.0))
    linear = body.problem(held, poisson_ratio=0.49)
    assert "condition_estimate" not in linear.solve([load]).scalars
    contact = body.surface[:, 2] > 0.5
    condensed = CondensedProblem(body.problem(held, poisson_ratio=0.49, solver="direct"), contact)
    finite = body.finite(held, poisson_ratio=0.49)
    for problem in (linear, condensed):
        found = problem.solve([load, load], CONDITION).scalars["condition_estimate"]
        assert_allclose(found, linear.condition, rtol=1e-12, atol=0)
    with pytest.raises(SolverError, match="'stiffness' is unknown"):
        condensed.solve([load], frozenset({"stiffness"}))
    nothing, tiny = body.load(), body.load(pressure=1e-9 * load.facet_pressure)
    found = finite.solve([nothing, tiny], CONDITION).scalars["condition_estimate"]
    assert_allclose(found, linear.condition, rtol=1e-6, atol=0)
    assert "condition_estimate" not in finite.solve([nothing]).scalars


def test_the_tangents_condition_follows_the_load() -> None:
    body, held = BALL, base(BALL)
    facets = body.facets_where(lambda x: x[:, 2] > 0.5)
    loads = [body.load(pressure=np.where(facets, p, 0.0)) for p in (0.0, 0.1, 0.2, 100.0)]
    problem = body.finite(held, poisson_ratio=0.49)
    found = problem.solve(loads, CONDITION)
    estimate = found.scalars["condition_estimate"]
    assert [status.ok for status in found.status] == [True, True, True, False]
    assert np.abs(np.diff(estimate[:3]) / estimate[:2]).min() > 0.01
    # the step that failed has that of the last state in equilibrium
    assert np.isfinite(estimate[3])
    # and it is that of the tangent there, computed anew
    [*_, (_, last)] = [item for item in problem.substeps(loads[:3]) if item[1].converged]
    tangent = problem.tangent(last).symmetric()
    assert_allclose(condition_estimate(tangent), estimate[2], rtol=1e-6, atol=0)
    assert BAND[0] <= estimate[2] / exact(tangent) <= BAND[1]
