"""Young's modulus fitted to a measurement: found where the answer is known, and tried on what was held out."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.testing import assert_allclose

from vdmbench.evidence.modulus import FACTOR, fit, training
from vdmbench.measures.measurement import FORCE, Measurement, Quantity

TRUE, GIVEN = 8e3, 5e3  # Pa


def answers(modulus: float, shift: float = 0.0, steps: tuple[int, ...] = (0, 0, 1)) -> Measurement:
    """Displacements 1, 2 and 4 mm of a linear body of TRUE, the last at another load and off by `shift`."""
    sizes = np.array([1e-3, 2e-3, 4e-3])
    quantities = [
        Quantity("tips", f"{k}", "z", step, value, 1e-5, 0.0)
        for k, (step, value) in enumerate(zip(steps, sizes + np.array([0.0, 0.0, shift]), strict=True))
    ]
    return Measurement(quantities, {"m": sizes * TRUE / modulus}, {"m": np.full(3, np.nan)})


def test_the_modulus_is_found_and_the_other_load_is_not_fitted() -> None:
    found = fit(lambda modulus: answers(modulus, shift=1e-4), GIVEN, "m")
    assert_allclose(found.modulus, TRUE, rtol=2e-3)  # to a thousandth of itself
    assert_allclose(found.held_out, 1e-4, rtol=0.1)
    assert found.trained < 1e-5
    assert_allclose(found.as_given, 4e-3 * (TRUE / GIVEN - 1) - 1e-4, rtol=1e-9)
    assert_allclose(found.size, 4.1e-3)
    # d S / d log E = -S: the uncertainty is that of a weighted mean of the two
    assert_allclose(found.uncertainty, TRUE * 1e-5 / np.hypot(1e-3, 2e-3), rtol=0.05)


def test_a_modulus_out_of_reach_and_a_model_without_an_answer_are_no_number() -> None:
    found = fit(lambda modulus: answers(modulus * 100), GIVEN, "m")
    assert np.isnan(found.modulus), f"more than {FACTOR} times off"
    assert np.isfinite(found.as_given)
    assert np.isnan(fit(lambda _: answers(np.nan), GIVEN, "m").modulus)


def test_one_load_alone_is_fitted_and_tried_on_nothing() -> None:
    assert training(answers(TRUE)).tolist() == [True, True, False]
    found = fit(lambda modulus: answers(modulus, steps=(0, 0, 0)), GIVEN, "m")
    assert_allclose(found.modulus, TRUE, rtol=2e-3)  # to a thousandth of itself
    assert np.isnan([found.held_out, found.size]).all()
    assert_allclose(found.as_given, (TRUE / GIVEN - 1) * np.sqrt(7.0) * 1e-3, rtol=1e-9)  # of 1, 2 and 4 mm


def test_what_moves_alone_tells_no_modulus() -> None:
    found = fit(lambda _: answers(TRUE), GIVEN, "m")
    assert np.isnan(found.modulus)
    assert found.as_given == 0.0
    (told,) = found.untold
    assert "no fitted value changes with the modulus" in told


def test_a_ratio_that_acts_as_the_modulus_does_is_told() -> None:
    """A ratio that moves all by 3 % more acts as a modulus lower by 3 % (a difference over 2 %); no other does."""

    def beside(factors: list[float]) -> Callable[[float], Measurement]:
        def answer(modulus: float) -> Measurement:
            found = answers(modulus)
            return dataclasses.replace(found, simulated={"m": found.simulated["m"] * factors})

        return answer

    alike = fit(answers, GIVEN, "m", beside([1.03, 1.03, 1.0]))
    (told,) = alike.untold
    assert "one lower by 0.01 acts as a modulus that is 3.1 % lower" in told
    assert fit(answers, GIVEN, "m", beside([1.1, 0.97, 1.0])).untold == ()
    (told,) = fit(answers, GIVEN, "m", answers).untold
    assert "no fitted value changes with Poisson's ratio" in told


def test_noise_that_leaves_the_modulus_open_is_told() -> None:
    def noisy(modulus: float) -> Measurement:
        found = answers(modulus)
        rows = [dataclasses.replace(one, uncertainty=1e-3) for one in found.quantities]
        return dataclasses.replace(found, quantities=rows)

    (told,) = fit(noisy, GIVEN, "m").untold
    assert told == "u_D alone leaves it open by 46 %"


def test_forces_are_fitted_and_tried_in_newtons() -> None:
    """Of three depths the first trains; displacements beside them are of another unit, and are left out."""

    def pressed(modulus: float) -> Measurement:
        forces = np.array([1.0, 2.0, 4.0])
        rows = [
            Quantity("press", "finger", FORCE, 0, force, 0.01, 0.0, depth)
            for depth, force in zip(
                (1e-3, 2e-3, 3e-3), (forces + np.array([0.0, 0.1, 0.1])).tolist(), strict=True
            )
        ]
        rows.append(Quantity("tips", "tip", "z", 0, 5.0, 1e-5, 0.0))
        simulated = np.append(forces * modulus / TRUE, np.nan)
        return Measurement(rows, {"m": simulated}, {"m": np.full(4, np.nan)})

    found = fit(pressed, GIVEN, "m")
    assert found.unit == "N"
    assert_allclose(found.modulus, TRUE, rtol=2e-3)
    assert_allclose(found.held_out, 0.1, rtol=0.1)
    assert_allclose(found.size, np.sqrt((2.1**2 + 4.1**2) / 2), rtol=1e-9)
