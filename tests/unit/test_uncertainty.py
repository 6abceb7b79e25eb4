"""Error estimates from mesh levels, on sequences whose error is known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from studies.uncertainty import estimate_error


@pytest.mark.parametrize("order", [1.0, 2.0, 3.0])
@pytest.mark.parametrize("ratio", [1.4, 2.0])
def test_a_pure_power_law_is_recovered(order: float, ratio: float) -> None:
    h = 0.1
    values = [7.0 + 3.0 * (h * ratio**level) ** order for level in range(3)]
    estimate = estimate_error([abs(values[0] - values[1]), abs(values[1] - values[2])], ratio)
    assert estimate.reasonable
    # differences of numbers around 7 carry 1e-15 of round-off each, the smallest of them is 1e-4
    assert_allclose(estimate.observed_order, order, rtol=1e-8, atol=0)
    assert_allclose(estimate.error, 3.0 * h**order, rtol=1e-8, atol=0)
    assert_allclose(estimate.gci, 1.25 * 3.0 * h**order, rtol=1e-8, atol=0)


def test_two_levels_assume_an_order_and_a_wide_margin() -> None:
    estimate = estimate_error([0.03])
    assert np.isnan(estimate.observed_order)
    assert not estimate.reasonable
    assert_allclose([estimate.error, estimate.gci], [0.01, 0.03], rtol=1e-12, atol=0)


@pytest.mark.parametrize("differences", [[0.03, 0.035], [0.03, 0.03], [0.03, 30.0], [0.03, 0.001]])
def test_an_unreasonable_order_is_not_used(differences: list[float]) -> None:
    estimate = estimate_error(differences)
    assert not estimate.reasonable
    assert_allclose([estimate.error, estimate.gci], [0.01, 0.03], rtol=1e-12, atol=0)


def test_identical_levels_have_no_error() -> None:
    assert estimate_error([0.0, 0.0]).error == 0.0


@pytest.mark.parametrize(("differences", "ratio"), [([], 2.0), ([0.1], 1.0), ([0.1], 0.5)])
def test_too_little_to_estimate_from(differences: list[float], ratio: float) -> None:
    with pytest.raises(ValueError, match="two mesh levels"):
        estimate_error(differences, ratio)
