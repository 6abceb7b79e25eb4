"""Metrics of an answer itself: how rigid, how much in the surface, how far off by inputs and from a measurement."""

from __future__ import annotations

from functools import partial

import numpy as np

from solver_common.arrays import Array

from ..body.surface_measures import Surface, ratio, rigid_parts, weighted_norms
from .metrics import History, along, full_load_step, metric

_of_inputs = partial(metric, "1", degree=None, needs_reference=False, needs_inputs=True, sense="descriptive")
_of_measurement = partial(metric, degree=None, needs_reference=False, needs_measurement=True)


def _at_full_load(model: History, value: float) -> Array:
    out = np.full(len(model.load_factors), np.nan)
    out[full_load_step(model.load_factors)] = value
    return out


@_of_inputs(
    "area-weighted norm of the standard deviation of the displacement that comes of not knowing the inputs, over "
    "that of the displacement"
)
def input_uncertainty(surface: Surface, model: History) -> Array:  # noqa: ARG001
    assert model.inputs is not None
    return _at_full_load(model, model.inputs[0])


@_of_inputs("as the input uncertainty, the best-fit rigid motion removed")
def input_uncertainty_deformation(surface: Surface, model: History) -> Array:  # noqa: ARG001
    assert model.inputs is not None
    return _at_full_load(model, model.inputs[1])


@_of_measurement("m", "root mean square of S - D over the measured components of the step")
def measurement_error(surface: Surface, model: History) -> Array:  # noqa: ARG001
    assert model.measurement is not None
    return model.measurement[0]


@_of_measurement("1", "the same over the root mean square of D")
def measurement_error_relative(surface: Surface, model: History) -> Array:  # noqa: ARG001
    assert model.measurement is not None
    errors, sizes = model.measurement
    return np.asarray(ratio(errors, sizes))


@metric(
    "1",
    "area-weighted ||w|| / ||u|| of the best-fit rigid motion w, of a finite rotation, of the answer itself",
    degree=None,
    relative=True,
    version=2,
    needs_reference=False,
    sense="descriptive",
)
def rigid_share(surface: Surface, model: History) -> Array:
    u = model.displacement
    out = np.full(len(u), np.nan)
    solved = np.isfinite(u).all(axis=(1, 2))
    rigid = rigid_parts(surface.points, u[solved], surface.areas)
    out[solved] = ratio(weighted_norms(rigid, surface.areas), weighted_norms(u[solved], surface.areas))
    return out


@metric(
    "1",
    "area-weighted ||t|| / ||u|| of the component t of the answer itself in the undeformed surface: of the exact "
    "answer, the least displacement error of a model that moves nodes along normals",
    degree=0,
    needs_reference=False,
    sense="descriptive",
)
def tangential_share(surface: Surface, model: History) -> Array:
    u = model.displacement
    inside = u - along(u, surface.normals) * surface.normals
    return np.asarray(ratio(weighted_norms(inside, surface.areas), weighted_norms(u, surface.areas)))
