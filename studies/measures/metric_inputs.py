"""How far an answer may be off because the inputs are not known better, at full load."""

from __future__ import annotations

import numpy as np

from solver_common.arrays import Array

from ..body.surface_measures import Surface
from .metrics import History, full_load_step, metric


def _at_full_load(model: History, value: float) -> Array:
    out = np.full(len(model.load_factors), np.nan)
    out[full_load_step(model.load_factors)] = value
    return out


@metric(
    "1",
    "area-weighted norm of the standard deviation of the displacement that comes of not knowing the inputs, over "
    "that of the displacement",
    degree=None,
    needs_reference=False,
    needs_inputs=True,
    sense="descriptive",
)
def input_uncertainty(surface: Surface, model: History) -> Array:  # noqa: ARG001
    assert model.inputs is not None
    return _at_full_load(model, model.inputs[0])


@metric(
    "1",
    "as the input uncertainty, the best-fit rigid motion removed",
    degree=None,
    needs_reference=False,
    needs_inputs=True,
    sense="descriptive",
)
def input_uncertainty_deformation(surface: Surface, model: History) -> Array:  # noqa: ARG001
    assert model.inputs is not None
    return _at_full_load(model, model.inputs[1])
