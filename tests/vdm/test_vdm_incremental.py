"""The incremental reading of the paper's time step: one step is linear, many are each on the surface as it is."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from tests.vdm.vdm_shapes import BASE, BODY, POINTS, TRIANGLES, model
from vdm import Load, Model, Parameters
from vdm.incremental import IncrementalModel

MATERIAL = Parameters.from_tissue(5000.0, BODY, "paper")
PUSH = Load(np.where(POINTS[:, 2] > 0.03, 800.0, 0.0))


def incremental(steps: int, load: Load = PUSH, **options) -> np.ndarray:
    stepping = IncrementalModel(POINTS, TRIANGLES, MATERIAL, fixed=BASE, **options)
    solution = stepping.solve([load.scaled(k / steps) for k in range(1, steps + 1)])
    assert all(status.ok for status in solution.status)
    return solution.displacement[-1]


def test_one_step_is_the_linear_answer_and_many_small_loads_are_too() -> None:
    linear = model("paper").solve([PUSH])
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
    first = model("paper").solve([half]).displacement[0]
    second = Model(POINTS + first, TRIANGLES, MATERIAL, fixed=BASE).solve([half]).displacement[0]
    assert_allclose(incremental(2), first + second, rtol=0, atol=1e-15)
    linear = 2.0 * first
    assert np.abs(incremental(2) - linear).max() > 1e-3 * np.abs(linear).max(), "steps change the answer"


def test_a_surface_that_folds_ends_the_history_and_says_so() -> None:
    stepping = IncrementalModel(POINTS, TRIANGLES, MATERIAL, fixed=BASE)
    solution = stepping.solve([PUSH.scaled(100.0 * k) for k in range(1, 6)])
    assert solution.status[0].ok
    assert solution.status[-1].code == "diverged"
    assert "smaller load" in solution.status[-1].remedy
    assert np.isnan(solution.displacement[-1]).all()


def test_a_tolerance_is_what_the_iterative_solver_reaches() -> None:
    right = model("paper").solve([PUSH]).displacement[0]
    iterations, errors = [], []
    for tolerance in (1e-2, 1e-3, 1e-6, 1e-9):
        solution = model("paper", solver="bicg", tolerance=tolerance).solve([PUSH])
        assert solution.status[0].ok, "asked for, and so no failure"
        iterations.append(int(solution.iterations[0]))
        errors.append(np.abs(solution.displacement[0] - right).max() / np.abs(right).max())
    assert iterations == sorted(iterations)
    assert iterations[1] < 0.7 * iterations[3]
    assert errors[0] > errors[1] > 10.0 * errors[2] > 100.0 * errors[3]
