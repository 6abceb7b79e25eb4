"""The reference solved again on refinements of the case's mesh: a better reference, and its own error."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from solver_common.arrays import Array

from ..body.refine import Hierarchy
from ..body.surface_measures import Surface, deformations, enclosed_volumes, weighted_norm
from ..scene.inclusions import place_inclusions
from ..scene.regions import select
from ..scene.result import ModelResult
from ..scene.scene import Scene, build_scene
from ..study.schema import Study
from .metrics import METRICS, History, evaluate, full_load_step
from .uncertainty import estimate_error, estimate_limit


def own_error(surface: Surface, levels: Sequence[ModelResult], load_factors: Array) -> dict[str, float]:
    """The error of the finest of several S-step results on one surface, at the largest load that all reached.

    Empty if they reached none.

    Parameters
    ----------
    levels : the finest first, each refined once from the next

    Returns
    -------
    dict
        `difference_01` and so on: area-weighted L2 differences of neighbouring levels over the norm of the
        finest, with signs as in `vdmbench.measures.uncertainty`, which estimates the error from them;
        `relative_l2`, the estimated error of the displacement; `observed_order`; `levels`; and `gci:<metric>` for
        every metric that compares. That GCI is the metric between the two finest levels, times the displacement's
        GCI over its difference. The deformation has an estimate of its own. From three levels on,
        `own_gci:<metric>` of the finest level's own figures, such as its volume drift, from all levels.
    """
    answered = np.all([np.isfinite(level.displacement).all(axis=(1, 2)) for level in levels], axis=0)
    if not answered.any():
        return {}
    reached = np.flatnonzero(answered)
    step = int(reached[full_load_step(load_factors[reached])])
    fields = [level.displacement[step] for level in levels]
    differences = _differences(fields, surface.areas)
    deformed = list(deformations(surface.points, np.stack(fields), surface.areas))
    vector, deformation = estimate_error(differences), estimate_error(_differences(deformed, surface.areas))
    error = {f"difference_{k}{k + 1}": difference for k, difference in enumerate(differences)}
    error |= {
        "relative_l2": vector.error,
        "observed_order": vector.observed_order,
        "levels": float(len(levels)),
    }
    margin = vector.gci / differences[0] if differences[0] else 0.0
    # a body with a weight is not at rest without load: its displacement then is part of its stiffness
    steps = [*(np.flatnonzero(load_factors == 0.0)[:1] if surface.sags else []), step]
    histories = [
        History(
            level.displacement[steps],
            level.reaction_force[steps],
            load_factors[steps],
            volume=level.volume[steps],
        )
        for level in levels
    ]
    finest, second = histories[:2]
    error |= {
        f"gci:{metric}": margin * abs(float(value[-1]))
        for metric, value in evaluate(surface, second, finest).items()
        if METRICS[metric].needs_reference
    }
    error["gci:relative_l2_deformation_error"] = deformation.gci
    return error | (_own_figures(surface, histories) if len(levels) > 2 else {})


def _own_figures(surface: Surface, histories: Sequence[History]) -> dict[str, float]:
    """`own_gci:<metric>` of the last step's metrics without comparison; `histories` are the finest level first."""
    figures = [evaluate(surface, history, None) for history in histories]
    levels = {metric: [float(values[metric][-1]) for values in figures] for metric in figures[0]}
    return {
        f"own_gci:{metric}": estimate_limit(values)[1].gci
        for metric, values in levels.items()
        if np.isfinite(values).all()
    }


def _differences(fields: Sequence[Array], areas: Array) -> list[float]:
    """Relative norms of u1 - u0, u2 - u1, ..., signed by their products with the first."""
    size = weighted_norm(fields[0], areas)
    if size == 0.0:
        return [0.0] * (len(fields) - 1)
    gaps = [coarse - fine for fine, coarse in itertools.pairwise(fields)]
    along = [np.einsum("i,ij,ij->", areas, gap, gaps[0]) for gap in gaps]
    return [
        float(np.copysign(weighted_norm(gap, areas) / size, product))
        for gap, product in zip(gaps, along, strict=True)
    ]


def level_scene(study: Study, hierarchy: Hierarchy) -> Scene:
    """A study's scene on the finest mesh of a hierarchy, with the regions of the coarsest.

    Body, supports and loads do not change; a smooth profile is evaluated again.
    """
    coarsest = hierarchy.meshes[0]
    lines = {part.region for part in study.constraints if part.kind == "line"}
    regions = {name: select(region, coarsest) for name, region in study.regions.items()}
    masks = {
        name: hierarchy.inherit_line(mask) if name in lines else hierarchy.inherit(mask)
        for name, mask in regions.items()
    }
    inside = {
        part.declared.name: hierarchy.inherit_inside(part.inside)
        for part in place_inclusions(study, coarsest)
    }
    return build_scene(study, hierarchy.finest, masks, inside)


def restricted(result: ModelResult, hierarchy: Hierarchy) -> ModelResult:
    """A result on the finest mesh at the coarsest's surface nodes; an edge middle's force goes half to each end."""
    mesh = hierarchy.meshes[0]
    n, part = len(mesh.surface_nodes), result.part_of_node
    displacement = result.displacement[:, :n]
    return dataclasses.replace(
        result,
        displacement=displacement,
        reaction_force=hierarchy.restrict(result.reaction_force),
        volume=enclosed_volumes(mesh.surface_points + displacement, mesh.triangles),
        part_of_node=None if part is None else part[:n],
    )
