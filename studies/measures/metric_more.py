"""Metrics of an answer itself: how far it is from a measurement, how rigid, how much of it is in the surface."""

from __future__ import annotations

import numpy as np

from solver_common.arrays import Array

from ..body.surface_measures import Surface, ratio, rigid_parts, weighted_norms
from .metrics import History, along, metric


@metric(
    "m",
    "root mean square of S - D over the measured components of the step",
    degree=None,
    needs_reference=False,
    needs_measurement=True,
)
def measurement_error(surface: Surface, model: History) -> Array:  # noqa: ARG001
    assert model.measurement is not None
    return model.measurement


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
