"""Young's modulus fitted to a measurement: found where the answer is known, and tried on what was held out."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from vdmbench.calibrate import FACTOR, modulus_of, training
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
    found = modulus_of(lambda modulus: answers(modulus, shift=1e-4), GIVEN, "m")
    assert_allclose(found.modulus, TRUE, rtol=2e-3)  # to a thousandth of itself
    assert_allclose(found.held_out, 1e-4, rtol=0.1)
    assert found.trained < 1e-5
    assert_allclose(found.as_given, 4e-3 * (TRUE / GIVEN - 1) - 1e-4, rtol=1e-9)
    assert_allclose(found.size, 4.1e-3)
    # d S / d log E = -S: the uncertainty is that of a weighted mean of the two
    assert_allclose(found.uncertainty, TRUE * 1e-5 / np.hypot(1e-3, 2e-3), rtol=0.05)


def test_a_modulus_out_of_reach_and_a_model_without_an_answer_are_no_number() -> None:
    found = modulus_of(lambda modulus: answers(modulus * 100), GIVEN, "m")
    assert np.isnan(found.modulus), f"more than {FACTOR} times off"
    assert np.isfinite(found.as_given)
    assert np.isnan(modulus_of(lambda _: answers(np.nan), GIVEN, "m").modulus)


def test_one_load_alone_is_fitted_and_tried_on_nothing() -> None:
    assert training(answers(TRUE)).tolist() == [True, True, False]
    found = modulus_of(lambda modulus: answers(modulus, steps=(0, 0, 0)), GIVEN, "m")
    assert_allclose(found.modulus, TRUE, rtol=2e-3)  # to a thousandth of itself
    assert np.isnan([found.held_out, found.size]).all()
    assert_allclose(found.as_given, (TRUE / GIVEN - 1) * np.sqrt(7.0) * 1e-3, rtol=1e-9)  # of 1, 2 and 4 mm


def test_what_moves_alone_tells_no_modulus() -> None:
    found = modulus_of(lambda _: answers(TRUE), GIVEN, "m")
    assert np.isnan(found.modulus)
    assert found.as_given == 0.0


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

    found = modulus_of(pressed, GIVEN, "m")
    assert found.unit == "N"
    assert_allclose(found.modulus, TRUE, rtol=2e-3)
    assert_allclose(found.held_out, 0.1, rtol=0.1)
    assert_allclose(found.size, np.sqrt((2.1**2 + 4.1**2) / 2), rtol=1e-9)
