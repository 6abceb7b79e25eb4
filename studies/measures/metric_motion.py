"""What kind of motion an answer is: how much of it is rigid, and how much lies in the surface."""

from __future__ import annotations

import numpy as np

from solver_common.arrays import Array

from ..body.surface_measures import Surface, ratio, weighted_norms, without_motions
from .metrics import History, along, metric


@metric(
    "1",
    "area-weighted ||w|| / ||u|| of the best-fit rigid motion w of the answer itself",
    degree=0,
    needs_reference=False,
    sense="descriptive",
)
def rigid_share(surface: Surface, model: History) -> Array:
    u = model.displacement
    rigid = u - without_motions(surface.rigid_motions, u, surface.areas)
    return np.asarray(ratio(weighted_norms(rigid, surface.areas), weighted_norms(u, surface.areas)))


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
