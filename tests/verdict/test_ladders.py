"""Ladders: where on them each solver breaks down, on runs whose breakdowns are known."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from tests.report.runs import make_case, make_run
from vdmbench.body.surface_measures import Surface
from vdmbench.measures.case import CaseResult, MetricSeries
from vdmbench.measures.metrics import History, evaluate
from vdmbench.verdict.digest import Digest
from vdmbench.verdict.ladders import Ladder, ladders, reading, trusted

DIRECT, LU, NONLINEAR = "vdm-paper", "vdm-paper:lu", "vdm-paper:nonlinear"
SLIVERS, NU = "geometry.slivers", "tissue.poisson_ratio"


def case(
    swept: Mapping[str, float],
    *,
    lu: float = 0.0,
    residuals: Sequence[float] = (1e-15, 1e-14, 2e-14, 1e-14),
    stopped: Mapping[str, int] | None = None,
    steps: Sequence[float] = (0.25, 0.5, 0.75, 1.0),
) -> CaseResult:
    """A case in which LU is off by a ratio from the direct solver, which reports residuals and a condition."""
    made = make_case(
        {DIRECT: 0.0, LU: lu, NONLINEAR: 0.3},
        label=str(swept) or "base",
        swept=swept,
        steps=steps,
        reference=None,
        stopped=stopped,
        subdivisions=0,
    )
    scalars = {"relative_residual": np.array(residuals), "condition_estimate": np.full(len(steps), 1e5)}
    direct = dataclasses.replace(made.models[DIRECT], scalars=scalars)
    return dataclasses.replace(made, models={**made.models, DIRECT: direct})


def star() -> list[CaseResult]:
    """A base and two ladders: slivers stop the nonlinear solver at the second step, then make LU wrong."""
    return [
        case({NU: 0.45}),
        case({NU: 0.45, SLIVERS: 1e2}),
        case({NU: 0.45, SLIVERS: 1e4}, stopped={NONLINEAR: 1}),
        case({NU: 0.45, SLIVERS: 1e6}, lu=0.01, stopped={NONLINEAR: 0}),
        case({NU: 0.3}, residuals=(1e-15, 1e-5, 1e-15, 1e-15)),
        case({NU: 0.499}),
        case({NU: 0.5}, stopped={DIRECT: 0}),
    ]


@pytest.fixture(scope="module")
def found() -> dict[str, Ladder]:
    return {ladder.key: ladder for ladder in ladders(Digest(make_run(star())))}


def test_ladders_hold_the_cases_that_differ_in_one_value(found: dict[str, Ladder]) -> None:
    assert found[SLIVERS].values == (1e2, 1e4, 1e6), "the base has none"
    assert found[SLIVERS].base is None
    assert found[NU].values == (0.3, 0.45, 0.499, 0.5)
    assert found[NU].base == 0.45
    assert set(found[NU].readings) == {DIRECT, LU, NONLINEAR}


def test_a_breakdown_is_beside_the_range_that_is_right(found: dict[str, Ladder]) -> None:
    ladder = found[SLIVERS]
    assert ladder.sound_range(DIRECT) == (0, 2)
    assert ladder.breakdowns(DIRECT) == []
    [(value, stopped)] = ladder.breakdowns(NONLINEAR)
    assert (value, stopped.code) == (1e4, "diverged")
    assert stopped.message == "the volume could not be held at load factor 0.5"
    assert not stopped.silent
    [(value, wrong)] = ladder.breakdowns(LU)
    assert (value, wrong.code, wrong.silent) == (1e6, "wrong", True)
    assert wrong.message == "called converged and 1.0e-02 away from vdm-paper"
    # on both sides of the base
    assert found[NU].sound_range(DIRECT) == (1, 2)
    assert [(value, r.code) for value, r in found[NU].breakdowns(DIRECT)] == [
        (0.3, "wrong"),
        (0.5, "diverged"),
    ]
    assert "residual of 1.0e-05" in found[NU].breakdowns(DIRECT)[0][1].message


@pytest.mark.parametrize(("residual", "silent"), [(9e-4, False), (1.1e-3, True)])
def test_single_precision_may_leave_a_larger_residual(residual: float, silent: bool) -> None:
    one = case({}, residuals=(residual,) * 4)
    single = dataclasses.replace(one, models={"vdm-paper:single": one.models[DIRECT]})
    for made, name, expected in ((single, "vdm-paper:single", silent), (one, DIRECT, True)):
        read = reading(made, name)
        assert read is not None
        assert read.silent == expected


@pytest.mark.parametrize("scale", [0.0, 1e-5, 0.01])
def test_what_is_left_without_load_counts(scale: float) -> None:
    there_and_back = case({}, steps=(0.5, 1.0, 0.0), residuals=(0, 0, 0))
    result = there_and_back.models[NONLINEAR]
    u = result.displacement.copy()
    u[-1] = scale * u[1]
    models = {NONLINEAR: dataclasses.replace(result, displacement=u)}
    read = reading(dataclasses.replace(there_and_back, models=models), NONLINEAR)
    assert read is not None
    assert read.silent == (scale > 1e-3)


def test_the_refined_solver_is_trusted_before_the_direct_one() -> None:
    one = case({})
    assert trusted(one, LU) == DIRECT
    assert trusted(one, DIRECT) is None
    assert trusted(one, NONLINEAR) is None, "another problem"
    refined = dataclasses.replace(one, models={**one.models, "vdm-paper:refined": one.models[LU]})
    assert trusted(refined, LU) == trusted(refined, DIRECT) == "vdm-paper:refined"


def test_a_quasi_linear_step_that_is_too_long_is_told_from_a_wrong_number() -> None:
    there_and_back = case({}, steps=(1.0, 0.0), residuals=(0, 0))
    result = there_and_back.models[NONLINEAR]
    u = result.displacement.copy()
    u[-1] = 0.01 * u[0]
    quasi = "vdm-paper:quasi-linear"
    one = dataclasses.replace(there_and_back, models={quasi: dataclasses.replace(result, displacement=u)})
    read = reading(dataclasses.replace(one, metrics={}), quasi)
    assert read is not None
    assert (read.code, read.silent) == ("step-too-long", False)
    assert "1.0e-02 of the displacement stays" in read.message


@pytest.mark.parametrize("grown", [0.04, 0.2])
def test_a_linear_answer_to_a_load_that_is_too_large_is_told(grown: float) -> None:
    """A ball that grows by g all over: volume (1 + g)^3, 3 g of it in first order; nonlinear, it is right."""
    sound = case({})
    u = grown * sound.points[None]
    results = {name: dataclasses.replace(sound.models[name], displacement=u) for name in (DIRECT, NONLINEAR)}
    measured = evaluate(
        Surface(sound.points, sound.triangles), History(u, np.zeros_like(u), np.ones(1)), None
    )
    metrics = {name: MetricSeries(values, "1", "", 1) for name, values in measured.items()}
    grew = dataclasses.replace(sound, models=results, metrics=dict.fromkeys(results, metrics))
    direct, nonlinear = (reading(grew, name) for name in (DIRECT, NONLINEAR))
    assert direct is not None
    assert nonlinear is not None
    assert nonlinear.ok
    if grown < 0.1:  # 0.5 %
        assert direct.ok
    else:  # 12.8 %
        assert (direct.code, direct.silent) == ("beyond-linear", False)
        assert "second order is 13 % of the volume" in direct.message
        scalars = {"relative_residual": np.full(1, 1e-3)}
        unsolved = dataclasses.replace(results[DIRECT], scalars=scalars)
        read = reading(dataclasses.replace(grew, models={DIRECT: unsolved}), DIRECT)
        assert read is not None
        assert read.code == "wrong", "a load that is too large excuses no residual"
