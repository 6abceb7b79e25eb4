"""Numbers as text."""

import math

import pytest

from vdmbench.verdict.formatting import (
    measure,
    number,
    parameter_name,
    percent,
    quantity,
    short_percent,
)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (1.0, "1.00"),
        (-2.5, "−2.50"),
        (0.09996, "0.100"),
        (999.6, "1000"),
        (123456.0, "123000"),
        (1e6, "10⁶"),
        (2.34e-7, "2.34×10⁻⁷"),
        (0.0001234, "0.000123"),
        (math.inf, "∞"),
        (math.nan, "–"),
    ],
)
def test_number(value: float, text: str) -> None:
    assert number(value) == text


def test_percent_is_the_ratio_times_a_hundred() -> None:
    assert percent(0.2134) == "21.3 %"
    assert percent(0.0) == "0 %"
    assert percent(0.00062, signed=True) == "+0.062 %"
    assert percent(-0.00062, signed=True) == "−0.062 %"
    assert percent(1.1e-14) == "1.1×10⁻¹² %"
    assert percent(math.nan) == "–"
    assert short_percent(0.2134) == "21.3 %"
    assert short_percent(0.1) == "10 %"
    assert short_percent(1.234) == "123 %"


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0004, "s", "400 µs"),
        (0.0123, "s", "12.3 ms"),
        (2.5, "s", "2.50 s"),
        (12e6, "B", "12.0 MB"),
        (0.0, "B", "0 B"),
        (0.002, "m", "2.00 mm"),
        (0.19, "m", "190 mm"),
        (2e-6, "m", "2.00 µm"),
        (1.2, "m", "1.20 m"),
        (5000.0, "Pa", "5.00 kPa"),
        (0.5, "N", "500 mN"),
        (3.0, "kg", "3.00 kg"),
    ],
)
def test_quantity_takes_the_prefix_that_fits(value: float, unit: str, text: str) -> None:
    assert quantity(value, unit) == text


def test_a_bar_of_nothing_is_not_told() -> None:
    """A frame that the machine did not make longer read `5.56 µs ± 0 s`."""
    assert measure(5.56e-6, "s", 0.0) == "5.56 µs"
    assert measure(5.56e-6, "s", 2e-7) == "5.56 µs ± 0.200 µs"
    assert measure(0.397, bar=0.02) == "39.7 % ± 2 %"


def test_components_of_vectors_have_names() -> None:
    assert parameter_name("gravity.acceleration.2") == "acceleration z"
    assert parameter_name("regions.finger.cap.direction.0") == "direction x of cap"
    assert parameter_name("tissue.poisson_ratio") == "Poisson ratio"
    assert parameter_name("constraints.finger.pressure") == "pressure of finger"
