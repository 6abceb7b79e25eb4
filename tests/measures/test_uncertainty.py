"""Error estimates from mesh levels, on sequences whose error is known."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from vdmbench.measures.uncertainty import (
    INDENTATION_FORCE,
    STRAINS,
    estimate_error,
    estimate_limit,
    is_resolved,
    least_bar,
)


def power_law(order: float, ratio: float, levels: int, size: float, h: float = 0.1) -> list[float]:
    """7 + size h^order on the finest mesh and on each coarser one."""
    return [7.0 + size * (h * ratio**level) ** order for level in range(levels)]


@pytest.mark.parametrize("order", [0.6, 1.0, 2.0, 3.9])
@pytest.mark.parametrize(("ratio", "levels"), [(1.4, 3), (2.0, 3), (2.0, 4)])
@pytest.mark.parametrize("size", [3.0, -3.0])
def test_a_pure_power_law_is_recovered(order: float, ratio: float, levels: int, size: float) -> None:
    limit, estimate = estimate_limit(power_law(order, ratio, levels, size), ratio)
    assert estimate.behaviour == "converging"
    assert estimate.reasonable
    # differences of numbers around 7 carry 1e-15 of round-off each, the smallest of them is 1e-4
    assert_allclose(estimate.observed_order, order, rtol=1e-8, atol=0)
    assert_allclose(estimate.error, 3.0 * 0.1**order, rtol=1e-8, atol=0)
    assert_allclose(estimate.gci, 1.25 * 3.0 * 0.1**order, rtol=1e-8, atol=0)
    assert_allclose(limit, 7.0, rtol=1e-10, atol=0)


def test_two_levels_assume_the_first_order() -> None:
    limit, estimate = estimate_limit([1.0, 1.03])
    assert estimate.behaviour == "two levels"
    assert np.isnan(estimate.observed_order)
    assert not estimate.reasonable
    assert_allclose([estimate.error, estimate.gci], [0.03, 0.0375], rtol=1e-12, atol=0)
    assert limit == 1.0


# behaviour, differences from the finest, expected error; the GCI is three times that
ANOMALIES = [
    ("too fast", [0.03, 30.0], 0.01),
    ("too fast", [0.0, 30.0], 0.0),
    ("too slow", [0.03, 0.035], 0.065),
    ("oscillating", [0.03, -0.05], 0.05),
    ("oscillating", [-0.03, 0.05], 0.05),
    ("diverging", [0.03, 0.03], 0.06),
    ("diverging", [0.05, 0.03], 0.08),
    ("diverging", [0.05, -0.03], 0.05),
    ("diverging", [0.05, 0.0], 0.05),
    ("unsteady", [0.01, 0.02, 0.2], 0.01),
    ("unsteady", [0.01, 0.08, 0.1], 0.01 / 3.0),
]


@pytest.mark.parametrize(("behaviour", "differences", "error"), ANOMALIES)
def test_an_unreasonable_order_is_named_and_not_used(
    behaviour: str, differences: list[float], error: float
) -> None:
    estimate = estimate_error(differences)
    assert estimate.behaviour == behaviour
    assert not estimate.reasonable
    assert_allclose([estimate.error, estimate.gci], [error, 3.0 * error], rtol=1e-12, atol=0)
    values = list(np.cumsum([2.0, *differences]))
    assert estimate_limit(values)[0] == 2.0, "no extrapolation from levels that do not converge"


@pytest.mark.parametrize(("differences", "ratio"), [([], 2.0), ([0.1], 1.0), ([0.1], 0.5)])
def test_too_little_to_estimate_from(differences: list[float], ratio: float) -> None:
    with pytest.raises(ValueError, match="two mesh levels"):
        estimate_error(differences, ratio)


def test_a_level_without_a_result_is_told() -> None:
    with pytest.raises(ValueError, match="finite differences"):
        estimate_error([0.1, math.nan])


def test_a_discrepancy_is_resolved_by_a_bar_a_tenth_of_it() -> None:
    assert is_resolved(0.5, 0.05)
    assert is_resolved(-0.5, 0.05)
    assert not is_resolved(0.5, 0.0501)
    assert not any(is_resolved(*pair) for pair in ((0.5, math.nan), (math.nan, 0.0), (0.5, math.inf)))


def test_a_signed_figure_is_known_no_better_than_the_displacement() -> None:
    """Displaced 2 % of a volume, which drifts by 0.1 % of that, known to 3 %."""
    figures = {"volume_drift": -2e-5, "volume_drift_of_displaced": -1e-3, "contact_work": -0.5}
    figures |= {"mean_strain_x": 1e-4, "mean_strain_y": -4e-4, "mean_strain_z": 0.0}
    least = {name: least_bar(name, figures, 0.03) for name in figures}
    assert_allclose(least["volume_drift"], 0.03 * 0.02, rtol=1e-12, atol=0)
    assert_allclose(least["volume_drift_of_displaced"], 0.03, rtol=1e-12, atol=0)
    assert_allclose(least["contact_work"], 0.03 * 0.5, rtol=1e-12, atol=0)
    assert_allclose([least[name] for name in STRAINS], 0.03 * 4e-4, rtol=1e-12, atol=0)
    for value, factor in ((-0.25, 0.75), (2.0, 3.0)):  # forces over the reference's
        assert_allclose(
            least_bar(INDENTATION_FORCE, {INDENTATION_FORCE: value}, 0.03), 0.03 * factor, rtol=1e-12
        )
    assert math.isnan(
        least_bar("relative_l2_displacement_error", {"relative_l2_displacement_error": 0.2}, 0.03)
    )
    assert math.isnan(
        least_bar("volume_drift", {"volume_drift": 0.0, "volume_drift_of_displaced": 0.0}, 0.03)
    )
    assert math.isnan(least_bar("contact_work", {}, 0.03))


def test_a_worked_example_of_the_grid_convergence_index() -> None:
    """The tutorial "Examining Spatial (Grid) Convergence" of NASA Glenn: three grids, ratio 2, factor 1.25."""
    limit, estimate = estimate_limit([0.97050, 0.96854, 0.96178])
    assert_allclose(estimate.observed_order, 1.786170, rtol=0, atol=5e-7)
    assert_allclose(limit, 0.97130, rtol=0, atol=5e-6)
    assert_allclose(100.0 * estimate.gci / 0.97050, 0.103083, rtol=0, atol=5e-7)
    # the middle grid's, by the same order
    assert_allclose(100.0 * 1.25 * abs(limit - 0.96854) / 0.96854, 0.356249, rtol=0, atol=5e-7)
