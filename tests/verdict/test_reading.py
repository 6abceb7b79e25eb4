"""What a solver made of a case: breakdowns told, and what is called converged and is not right."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from solver_common.solution import CONVERGED
from tests.report.runs import make_case, of_model
from vdmbench.body.surface_measures import Surface
from vdmbench.measures.case import CaseResult
from vdmbench.measures.metrics import History, evaluate
from vdmbench.verdict.reading import WRONG, reading, trusted

DIRECT, LU, NONLINEAR = "vdm-paper", "vdm-paper:lu", "vdm-paper:nonlinear"


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
    return of_model(made, DIRECT, scalars=scalars)


def test_the_first_step_that_failed_says_why() -> None:
    read = reading(case({}, stopped={NONLINEAR: 1}), NONLINEAR)
    assert (read.code, read.message) == ("diverged", "the volume could not be held at load factor 0.5")


def test_what_is_called_converged_and_is_not_right_is_told() -> None:
    off, unsolved = case({}, lu=0.01), case({}, residuals=(1e-15, 1e-5, 1e-15, 1e-15))
    for made, name, told in (
        (off, LU, "1.0e-02 away from vdm-paper"),
        (unsolved, DIRECT, "residual of 1.0e-05"),
    ):
        read = reading(made, name)
        assert read.code == WRONG
        assert told in read.message
    assert reading(off, DIRECT) == CONVERGED


@pytest.mark.parametrize(("residual", "silent"), [(9e-4, False), (1.1e-3, True)])
def test_single_precision_may_leave_a_larger_residual(residual: float, silent: bool) -> None:
    one = case({}, residuals=(residual,) * 4)
    single = dataclasses.replace(one, models={"vdm-paper:single": one.models[DIRECT]})
    for made, name, expected in ((single, "vdm-paper:single", silent), (one, DIRECT, True)):
        read = reading(made, name)
        assert (read.code == WRONG) == expected


@pytest.mark.parametrize("scale", [0.0, 1e-5, 0.01])
def test_what_is_left_without_load_counts(scale: float) -> None:
    there_and_back = case({}, steps=(0.5, 1.0, 0.0), residuals=(0, 0, 0))
    result = there_and_back.models[NONLINEAR]
    u = result.displacement.copy()
    u[-1] = scale * u[1]
    read = reading(of_model(there_and_back, NONLINEAR, displacement=u), NONLINEAR)
    assert (read.code == WRONG) == (scale > 1e-3)


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
    assert read.code == "step-too-long"
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
    grew = dataclasses.replace(sound, models=results, metrics=dict.fromkeys(results, measured))
    direct, nonlinear = (reading(grew, name) for name in (DIRECT, NONLINEAR))
    assert nonlinear.ok
    if grown < 0.1:  # 0.5 %
        assert direct.ok
    else:  # 12.8 %
        assert direct.code == "beyond-linear"
        assert "second order is 12.8 % of the volume" in direct.message
        scalars = {"relative_residual": np.full(1, 1e-3)}
        unsolved = dataclasses.replace(results[DIRECT], scalars=scalars)
        read = reading(dataclasses.replace(grew, models={DIRECT: unsolved}), DIRECT)
        assert read.code == "wrong", "a load that is too large excuses no residual"
