"""Which loads are multiples or sums of others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose

from fem_reference.loads import Load, independent_loads, multiple_of
from studies import worker
from studies.plan import task_of
from studies.proportional import Answer

from . import shared_work
from .shared_work import MOVED, plan_of

cache = shared_work.cache  # the fixture


def test_a_motion_back_is_a_multiple(tmp_path: Path, cache: Path) -> None:
    plan = plan_of(
        tmp_path, cache, **(MOVED | {"sweep": {"constraints.tool.displacement.2": [0.001, -0.001]}})
    )
    assert len({case.load for case in plan.cases}) == 2, "the finger's force stays"
    constraints = [c for c in MOVED["constraints"] if c.get("name") != "finger"]
    alone = MOVED | {
        "constraints": constraints,
        "sweep": {"constraints.tool.displacement.2": [0.001, -0.001]},
    }
    alone["constraints"] = [
        c | {"displacement": [0.0, 0.0, 0.0]} if c.get("name") == "tool" else c for c in constraints
    ]
    assert len({case.load for case in plan_of(tmp_path, cache, **alone).cases}) == 1


def test_a_stored_reference_answers_its_multiples_only(cache: Path, tmp_path: Path) -> None:
    plan = plan_of(tmp_path, cache)
    task = task_of(plan.cases[0], plan)
    study, scene = worker._built(task)
    result = worker.models.run_model(scene, "fem-linear")
    loads = worker.loads_of(study)
    stored = Answer([result], loads, scene.load_factors)
    (same,) = stored.under(loads, scene) or [None]
    assert same is result
    (twice,) = stored.under({unit: 2 * value for unit, value in loads.items()}, scene) or [None]
    assert twice is not None
    assert_allclose(twice.displacement, 2 * result.displacement, rtol=1e-14, atol=0)
    assert "steps_scaled" in twice.parameters
    two = {"a": 1.0, "b": 2.0}
    stored = Answer([result], two, scene.load_factors)
    assert stored.under({"a": 3.0, "b": 6.0}, scene) is not None
    for other in ({"a": 3.0, "b": 6.0 * (1 + 1e-13)}, {"a": 3.0}, {"a": 3.0, "c": 6.0}, {"a": 0.0, "b": 6.0}):
        assert stored.under(other, scene) is None, other
    assert Answer([result], {"a": 0.0}, scene.load_factors).under({"a": 1.0}, scene) is None


def test_independent_loads_span_the_others() -> None:
    rng = np.random.default_rng(3)
    a, b = (Load(rng.normal(size=(5, 4)), rng.normal(size=(3, 3)), np.zeros(3)) for _ in range(2))

    def mix(x: float, y: float) -> Load:
        return Load(
            x * a.facet_pressure + y * b.facet_pressure, x * a.prescribed + y * b.prescribed, np.zeros(3)
        )

    pairs = [(1.0, 0.0), (2.0, 0.0), (0.0, 1e-6), (0.0, 0.0), (-3.0, 1.0)]
    loads = [mix(x, y) for x, y in pairs]
    chosen, coefficients = independent_loads(loads)
    assert len(chosen) == 2
    for step, load in enumerate(loads):
        for name in ("facet_pressure", "prescribed"):
            total = sum(
                c * getattr(loads[k], name) for c, k in zip(coefficients[:, step], chosen, strict=True)
            )
            assert_allclose(total, getattr(load, name), rtol=0, atol=1e-12 * np.abs(a.facet_pressure).max())
    # nearly the same load twice: their small difference is not made a load by large coefficients
    chosen, coefficients = independent_loads([a, mix(1.0, 1e-7), mix(0.0, 1.0)])
    assert len(chosen) == 2
    assert np.abs(coefficients).max() < 2
    assert len(independent_loads([mix(0.0, 0.0)])[0]) == 0


def test_runs_of_multiples_are_one_load_each() -> None:
    rng = np.random.default_rng(4)
    a, b = (Load(rng.normal(size=(5, 4)), rng.normal(size=(3, 3)), np.zeros(3)) for _ in range(2))

    def times(factor: float, load: Load, gravity: float = 0.0) -> Load:
        weight = np.array([0.0, 0.0, gravity])
        return Load(factor * load.facet_pressure, factor * load.prescribed, weight)

    factors = [0.3, 0.0, 1e-150, -7.0, 1.5]
    chosen, coefficients = independent_loads([times(f, a) for f in factors])
    assert chosen.tolist() == [0]
    assert_allclose(coefficients[0], np.array(factors) / 0.3, rtol=1e-15, atol=0)
    loads = [times(f, load) for load in (a, b) for f in (0.0, *factors)] + [
        times(3.0, a, -9.81),
        times(2.0, b),
    ]
    chosen, coefficients = independent_loads(loads)
    assert len(chosen) == 3, "two loads and the weight"
    for name in ("facet_pressure", "prescribed", "gravity"):
        there = np.array([getattr(load, name) for load in loads])
        made = np.tensordot(coefficients, there[chosen], axes=(0, 0))
        assert_allclose(made, there, rtol=0, atol=1e-14 * np.abs(there).max())
    # a hair off is another load
    off = times(2.0, a)
    off.prescribed[0, 0] *= 1 + 1e-10
    assert len(independent_loads([a, times(2.0, a)])[0]) == 1
    assert len(independent_loads([a, off])[0]) == 2
    assert multiple_of([np.array([1e-300])], [np.array([1e100])]) is None
    pair = [np.array([1.0, 1e-20, 0.0]), np.zeros(1)]
    assert multiple_of(pair, [np.array([2.0, 2e-20, 0.0]), np.zeros(1)]) == 2.0
    assert multiple_of(pair, [np.array([2.0, 0.0, 5.0]), np.zeros(1)]) is None
    assert multiple_of(pair, [np.array([2.0, 2e-20, 0.0]), np.ones(1)]) is None
    assert multiple_of(pair, [np.zeros(3), np.zeros(1)]) == 0.0
    assert multiple_of([np.zeros(3), np.zeros(1)], pair) is None
