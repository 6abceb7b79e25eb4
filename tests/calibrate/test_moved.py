"""Fits where regions are moved: what a common factor of the moduli changes is found, what it does not is told."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.testing import assert_allclose

from vdmbench.calibrate import CalibrationError, Sample, Trial, least_error, least_squares_of_moduli

from . import test_calibrate
from .test_calibrate import answered

four_loads = test_calibrate.samples  # the fixture
DEPTH = 0.002  # of the movement [m]


def moved(samples: Sequence[Sample], *, force: float = 5.0) -> list[Sample]:
    """The loads with a region beside them moved in, and so many times their force."""
    out = []
    for sample in samples:
        scene = sample.scene
        points = scene.mesh.surface_points
        side = (np.linalg.norm(points - points[points[:, 1].argmax()], axis=1) < 0.012) & ~scene.fixed
        side &= ~scene.contact
        assert side.sum() >= 3, "a region of its own"
        prescribed = np.where(side[:, None], [0.0, -DEPTH, 0.0], 0.0)
        pressure = force * scene.facet_pressure
        scene = dataclasses.replace(scene, constrained=side, prescribed=prescribed, facet_pressure=pressure)
        out.append(dataclasses.replace(sample, scene=scene))
    return out


def loss(trial: Trial, multiples: np.ndarray) -> float:
    """Mean squared relative error, by hand."""
    return float(
        np.mean(
            [
                (s.surface.areas @ ((u - s.reference) ** 2).sum(axis=1))
                / (s.surface.areas @ (s.reference**2).sum(axis=1))
                for s, u in zip(trial.samples, trial.answers(multiples), strict=True)
            ]
        )
    )


@pytest.mark.parametrize(
    ("model", "asked", "multiples", "movement"),
    [
        ("bem", ["shear_modulus"], [0.4], False),
        ("vdm-paper", ["bulk_modulus", "connectivity_modulus"], [0.3, 2.5], False),
        ("vdm-paper", ["bulk_modulus", "connectivity_modulus"], [0.3, 2.5], True),
        ("vdm-vector", ["foundation", "surface_tension"], [0.5, 1.2], False),
        ("vdm-vector", ["surface_tension"], [20.0], True),
        ("vdm-vector:nonlinear", ["surface_tension"], [1.7], True),
    ],
)
def test_the_parameters_behind_an_answer_are_found(
    four_loads: list[Sample], model: str, asked: list[str], multiples: list[float], movement: bool
) -> None:
    loads = moved(four_loads[:2]) if movement else four_loads[:2]
    if "foundation" in asked:
        loads = with_foundation(loads)
    found = least_error(Trial(model, answered(loads, model, multiples, asked), asked))
    assert_allclose(found, multiples, rtol=1e-5, atol=0)


def with_foundation(samples: Sequence[Sample]) -> list[Sample]:
    """The loads on a foundation of 5e4 Pa/m that the study sets."""
    scenes = [dataclasses.replace(s.scene, parameters={"foundation": 5e4}) for s in samples]
    return [dataclasses.replace(s, scene=scene) for s, scene in zip(samples, scenes, strict=True)]


@pytest.mark.parametrize(("model", "movement"), [("vdm-vector", True), ("vdm-vector:nonlinear", False)])
def test_no_multiple_beside_the_fit_has_a_smaller_error(
    four_loads: list[Sample], model: str, movement: bool
) -> None:
    """Whatever the answer is of the modulus: also nonlinear, or beside one that the study sets."""
    loads = with_foundation(moved(four_loads[:2]) if movement else four_loads[:2])
    known = answered(loads, "bem", [1.0], ["shear_modulus"])  # which the vector form cannot match
    trial = Trial(model, known, ["surface_tension"])
    best = least_error(trial)
    assert loss(trial, best) < min(loss(trial, best * 1.003), loss(trial, best / 1.003))
    assert loss(trial, best) <= loss(trial, np.ones(1))


@pytest.mark.parametrize("model", ["vdm-vector", "bem"])
def test_a_modulus_stays_at_its_rule_where_all_loads_are_movements(
    four_loads: list[Sample], model: str
) -> None:
    known = answered(moved(four_loads, force=0.0), "vdm-paper", [1.0], ["bulk_modulus"])
    assert_allclose(least_error(Trial(model, known)), 1.0, rtol=1e-5, atol=0)


def test_a_modulus_that_would_grow_without_end_is_no_fit(four_loads: list[Sample]) -> None:
    """The reference is what the movement alone does: no finite stiffness leaves nothing of the force."""
    alone = answered(moved(four_loads[:2], force=0.0), "vdm-vector", [1.0], ["surface_tension"])
    known = [
        dataclasses.replace(s, reference=u.reference)
        for s, u in zip(moved(four_loads[:2]), alone, strict=True)
    ]
    with pytest.raises(CalibrationError, match="falls as long as its moduli grow"):
        least_error(Trial("vdm-vector", known, ["surface_tension"]))


def test_the_best_factor_on_two_parts_is_that_of_least_squares() -> None:
    """Movements (1, 0), forces (0, 3) / c, wanted (1.5, 1): c = 3, whatever the movements leave."""
    found = least_squares_of_moduli(lambda m: np.array([1.0, 3.0 / m[0]]), np.array([1.5, 1.0]), 1)
    assert_allclose(found, 3.0, rtol=1e-5, atol=0)
