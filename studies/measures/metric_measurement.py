"""How far a model is from what was measured at points of the body: root mean squares over all components."""

from __future__ import annotations

import numpy as np

from solver_common.arrays import Array

from ..body.surface_measures import Surface, ratio
from .metrics import History, metric


@metric(
    "m",
    "root mean square of S - D over the measured components of the step",
    degree=None,
    needs_reference=False,
    needs_measurement=True,
)
def measurement_error(surface: Surface, model: History) -> Array:  # noqa: ARG001
    assert model.measurement is not None
    return model.measurement[0]


@metric(
    "1",
    "the same over the root mean square of D",
    degree=None,
    needs_reference=False,
    needs_measurement=True,
)
def measurement_error_relative(surface: Surface, model: History) -> Array:  # noqa: ARG001
    assert model.measurement is not None
    errors, sizes = model.measurement
    return np.asarray(ratio(errors, sizes))
