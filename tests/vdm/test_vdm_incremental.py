"""The incremental reading of the paper's time step: one step is linear, many are each on the surface as it is."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.vdm.vdm_shapes import BASE, BODY, POINTS, TRIANGLES
from vdm import ConstraintError, Load, Model, ParameterError, Parameters
from vdm.incremental import IncrementalModel

MATERIAL = Parameters.from_tissue(5000.0, BODY, "paper")
PUSH = Load(np.where(POINTS[:, 2] > 0.03, 800.0, 0.0))


def incremental(steps: int, load: Load = PUSH, **options) -> np.ndarray:
    model = IncrementalModel(POINTS, TRIANGLES, MATERIAL, fixed=BASE, **options)
    solution = model.solve([load.scaled(k / steps) for k in range(1, steps + 1)])
    assert all(status.ok for status in solution.status)
    return solution.displacement[-1]


def test_one_step_is_the_linear_answer_and_many_small_loads_are_too() -> None:
    linear = Model(POINTS, TRIANGLES, MATERIAL, fixed=BASE).solve([PUSH])
    one = IncrementalModel(POINTS, TRIANGLES, MATERIAL, fixed=BASE).solve([PUSH])
    for name in ("displacement", "reaction_force", "fluid_pressure"):
        assert_allclose(getattr(one, name), getattr(linear, name), rtol=1e-12, atol=1e-18)
    # work of the load on the way: that of a linear answer is its energy
    assert_allclose(one.energy, linear.energy, rtol=1e-9, atol=0)
    tiny, size = PUSH.scaled(1e-6), 1e-6 * np.abs(linear.displacement).max()
    assert_allclose(
        incremental(5, tiny),
        1e-6 * linear.displacement[0],
        rtol=0,
        atol=1e-5 * size,
    )


def test_each_step_is_a_model_of_the_surface_that_the_last_one_left() -> None:
    half = PUSH.scaled(0.5)
    first = Model(POINTS, TRIANGLES, MATERIAL, fixed=BASE).solve([half]).displacement[0]
    second = Model(POINTS + first, TRIANGLES, MATERIAL, fixed=BASE).solve([half]).displacement[0]
    assert_allclose(incremental(2), first + second, rtol=0, atol=1e-15)
    linear = 2.0 * first
    assert np.abs(incremental(2) - linear).max() > 1e-3 * np.abs(linear).max(), "steps change the answer"


def test_a_surface_that_folds_ends_the_history_and_says_so() -> None:
    model = IncrementalModel(POINTS, TRIANGLES, MATERIAL, fixed=BASE)
    solution = model.solve([PUSH.scaled(100.0 * k) for k in range(1, 6)])
    assert solution.status[0].ok
    assert solution.status[-1].code == "diverged"
    assert "smaller load" in solution.status[-1].remedy
    assert np.isnan(solution.displacement[-1]).all()


def test_weight_and_dead_forces_are_refused() -> None:
    with pytest.raises(ConstraintError, match="no weight"):
        IncrementalModel(POINTS, TRIANGLES, MATERIAL, fixed=BASE, density=1e3, gravity=(0.0, 0.0, -9.8))
    dead = Load(np.zeros(BODY.n_nodes), dead_force=np.ones((BODY.n_nodes, 3)))
    with pytest.raises(ConstraintError, match="along a line"):
        IncrementalModel(POINTS, TRIANGLES, MATERIAL, fixed=BASE).solve([dead])


def test_a_tolerance_is_what_the_iterative_solver_reaches() -> None:
    right = Model(POINTS, TRIANGLES, MATERIAL, fixed=BASE).solve([PUSH]).displacement[0]
    iterations, errors = [], []
    for tolerance in (1e-2, 1e-3, 1e-6, 1e-9):
        model = Model(POINTS, TRIANGLES, MATERIAL, fixed=BASE, solver="bicg", tolerance=tolerance)
        solution = model.solve([PUSH])
        assert solution.status[0].ok, "asked for, and so no failure"
        iterations.append(int(solution.iterations[0]))
        errors.append(np.abs(solution.displacement[0] - right).max() / np.abs(right).max())
    assert iterations == sorted(iterations)
    assert iterations[1] < 0.7 * iterations[3]
    assert errors[0] > errors[1] > 10.0 * errors[2] > 100.0 * errors[3]


@pytest.mark.parametrize("tolerance", [0.0, 1.0, np.nan])
def test_a_tolerance_that_is_none_is_refused(tolerance: float) -> None:
    with pytest.raises(ParameterError, match="tolerance must lie between 0 and 1"):
        Model(POINTS, TRIANGLES, MATERIAL, fixed=BASE, solver="bicg", tolerance=tolerance)
