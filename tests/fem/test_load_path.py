"""A path along one rising load: the short way to each load ends where the long way from rest does."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fem_reference.finite_strain import FiniteStrainProblem
from fem_reference.load_path import LoadPath
from fem_reference.loads import Load
from fem_reference.solution import Solution
from tests.fem.shapes import Body, assert_same, cube

OUTPUTS = frozenset({"max_principal_strain", "volume"})
SHARES = (0.01, 0.5, 1.0, 0.25, 0.75, 0.6, 0.75)


@pytest.fixture(scope="module")
def block() -> Body:
    return cube(1)


def _at_rest(b: Body) -> FiniteStrainProblem:
    """One that has solved nothing yet."""
    return b.finite(b.bottom, poisson_ratio=0.45)


def _pulled(b: Body, pressure: float) -> Load:
    return b.load(-pressure * b.top)


def _assert_same(one: Solution, other: Solution) -> None:
    assert other.status[0].ok
    assert_same(one, other, 1e-8)
    for name in OUTPUTS:
        assert_allclose(one.scalars[name], other.scalars[name], rtol=1e-8, atol=0)


def test_each_load_gives_what_it_gives_from_rest_and_is_nearer(block: Body) -> None:
    problem, path = _at_rest(block), LoadPath()
    loads = [_pulled(block, 0.4 * share) for share in SHARES]
    short = [problem.solve([load], OUTPUTS, path) for load in loads]
    long = [_at_rest(block).solve([load], OUTPUTS) for load in loads]
    for one, other in zip(short, long, strict=True):
        _assert_same(one, other)
    steps = np.array(
        [[one.iterations[0], other.iterations[0]] for one, other in zip(short, long, strict=True)]
    )
    assert steps[3:, 0].sum() < steps[3:, 1].sum(), "between loads that are known"
    assert steps[-1, 0] == 0, "a load that is known"


def test_the_end_of_the_way_is_looked_for_once(block: Body) -> None:
    """Too small a load is no end."""
    problem, path = _at_rest(block), LoadPath()
    assert problem.solve([_pulled(block, 1e-17)], OUTPUTS, path).status[0].code == "too-small"
    stopped = problem.solve([_pulled(block, 20.0)], OUTPUTS, path)
    assert stopped.status[0].code in {"not-converged", "inverted"}
    end = 20.0 * stopped.scalars["load_factor"][0]
    again = problem.solve([_pulled(block, 1.5 * end)], OUTPUTS, path)
    assert again.status[0].code == stopped.status[0].code
    assert again.iterations[0] == 0
    assert_allclose(again.displacement, stopped.displacement, rtol=1e-14, atol=0)
    below = _pulled(block, 0.4 * end)  # nearer to the end the path branches
    _assert_same(problem.solve([below], OUTPUTS, path), _at_rest(block).solve([below], OUTPUTS))
