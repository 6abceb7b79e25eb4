"""What the report says, against numbers known from how the runs were made."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.report.runs import make_case, make_run, sweep_run
from vdmbench.verdict.digest import VECTOR, Digest, spread_of

RTOL, ATOL = 1e-9, 1e-12  # the runs are exact but for rounding


@pytest.fixture(scope="module")
def digest() -> Digest:
    return Digest(sweep_run())


def test_spread_takes_medians_the_largest_size_and_its_own_bar() -> None:
    spread = spread_of(np.array([0.1, -0.5, 0.3, math.nan]), np.array([0.02, 0.01, math.nan, 0.1]))
    assert (spread.value, spread.worst, spread.worst_bar) == (0.1, -0.5, 0.01)
    assert_allclose(spread.bar, 0.015, rtol=RTOL, atol=ATOL)
    assert spread.cases == 3
    assert spread_of(np.array([math.nan]), np.array([0.1])) is None


def test_the_first_familys_model_is_looked_at_and_its_cases_ranked(digest: Digest) -> None:
    assert digest.focus == "vdm-paper"
    ranked = [(role, case.swept) for role, case in digest.key_cases]
    assert ranked[0] == ("worst", {"tissue.poisson_ratio": 0.4999, "constraints.finger.pressure": 800.0})
    assert ranked[1] == ("median", {"tissue.poisson_ratio": 0.45, "constraints.finger.pressure": 200.0})
    assert ranked[2] == ("best", {"tissue.poisson_ratio": 0.3, "constraints.finger.pressure": 200.0})


def test_a_failed_case_is_no_key_case() -> None:
    cases = [
        make_case(
            {"m": e}, label=str(e), swept={"k": e}, stopped={"m": 1} if e == 0.9 else None, subdivisions=0
        )
        for e in (0.1, 0.9, 0.4, 0.2)
    ]
    digest = Digest(make_run(cases))
    assert [(role, case.label) for role, case in digest.key_cases] == [
        ("worst", "0.4"),
        ("median", "0.2"),
        ("best", "0.1"),
    ]
    vector = digest.spread("m", VECTOR)
    assert digest.stopped("m") == 1
    assert vector.cases == 3
