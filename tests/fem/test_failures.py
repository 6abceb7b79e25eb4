"""What a failure of the finite-strain solver tells: what was found, where, and what to do."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fem_reference.surface_stretch import BIOT, most_compressed
from tests.fem.shapes import Array, mapped_box

HEAVY = {"poisson_ratio": 0.4999, "density": 1.0}


def test_a_rim_that_creases_is_named_and_ends_the_way_soon() -> None:
    body = mapped_box((2, 2, 2), lambda x: x)
    # what solvers remember moves the end of the way: each begins anew
    problem, other = (body.finite(body.bottom, **HEAVY) for _ in range(2))
    load = body.load(1.0 * body.top)
    attempts = [attempt for _, attempt in problem.substeps([load])]
    last = [attempt for attempt in attempts if attempt.converged][-1]
    worst = most_compressed(problem.mesh, last.state.displacement * problem.mesh.mean_edge)
    assert worst.plane < BIOT
    assert attempts[-1].load_factor - last.load_factor >= 2.0**-5, "no shorter steps beyond Biot's stretch"
    solution = other.solve([load])
    (status,) = solution.status
    x, y, z = 1e3 * worst.place
    assert f"at ({x:.1f}, {y:.1f}, {z:.1f}) mm is compressed to {worst.least:.3f}" in status.message
    assert "creasing" in status.message
    assert "`elastic`" in status.remedy
    assert solution.scalars["load_factor"][0] == last.load_factor, "the state up to there is kept"


@pytest.mark.parametrize(("sides", "at_the_rim"), [((2, 2, 2), False), ((4, 2, 2), True)])
def test_what_creases_at_the_rim_of_what_is_held_is_said_to_be_there(
    sides: tuple[int, int, int], at_the_rim: bool
) -> None:
    body = mapped_box(sides, lambda x: x)
    problem = body.finite(body.bottom, **HEAVY)
    (status,) = problem.solve([body.load(gravity=(0.0, 0.0, -4.0))]).status
    assert "creasing" in status.message
    assert ("at the rim of what is held" in status.message) == at_the_rim


def test_a_limit_point_is_named() -> None:
    """A shallow arch under its weight, just before it snaps through."""

    def arch(x: Array) -> Array:
        return np.c_[x[:, 0], 0.2 * x[:, 1], 0.8 * x[:, 0] * (1.0 - x[:, 0]) + 0.05 * (x[:, 2] - 0.5)]

    body = mapped_box((10, 2, 1), arch)
    x = body.surface[:, 0]
    problem = body.finite((x < 1e-9) | (x > 1.0 - 1e-9), **HEAVY)
    (status,) = problem.solve([body.load(gravity=(0.0, 0.0, -0.1))]).status
    assert not status.ok
    assert "a limit point" in status.message
    assert "displacement in place of the load" in status.remedy
    small = [a for _, a in problem.substeps([body.load(gravity=(0.0, 0.0, -1e-4))])][-1]
    assert_allclose(problem.softest(small), 1.0, rtol=0.05, atol=0)
