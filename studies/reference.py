"""The reference solved again on refinements of the case's mesh: a better reference, and its own error."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from . import models
from .case import ModelResult
from .execute import TaskError
from .mesh import Array, Index, InputError
from .metrics import Surface, relative_l2, rigid_motion_removed
from .refine import inherit, refine
from .scene import Scene, build_scene
from .schema import Study
from .uncertainty import estimate_error


def refined_reference(
    study: Study, scene: Scene, name: str, result: ModelResult, n_levels: int
) -> tuple[ModelResult, dict[str, float]]:
    """Solve the scene on `n_levels` - 1 refinements, each splitting every tetrahedron into eight.

    The body, its supports and its loads stay what they are; a smooth profile is evaluated anew on each level.
    All levels share the surface nodes of the case's mesh, where they are compared.

    Parameters
    ----------
    name : the reference model
    result : its result on the case's own mesh

    Returns
    -------
    finest : the finest level's result at the surface nodes of the case's mesh
    error : the finest level's own error at the last load step, relative to its displacement: an estimate and a
        GCI for the vector and for the deformation, and the observed order where there are three levels

    Raises
    ------
    TaskError
        a level that did not converge.
    """
    surface = Surface(scene.mesh.surface_points, scene.mesh.triangles)
    levels = [result]
    lineage: list[Index] = []
    for _ in range(n_levels - 1):
        mesh, parents = refine(scene.mesh)
        masks = {region: inherit(mask, scene.mesh, parents) for region, mask in scene.regions.items()}
        scene = build_scene(study, mesh, masks)
        lineage.append(parents)
        finer = models.run_model(scene, name)
        require_converged(f"{name} on the refined mesh", finer)
        levels.append(_restricted(finer, lineage))
    last = [level.displacement[-1] for level in levels[::-1]]  # finest first
    deformed = [rigid_motion_removed(surface.points, u, surface.areas) for u in last]
    vector, deformation = (
        estimate_error([relative_l2(v, u, surface.areas) for u, v in itertools.pairwise(fields)])
        for fields in (last, deformed)
    )
    return levels[-1], {
        "relative_l2": vector.error,
        "gci": vector.gci,
        "observed_order": vector.observed_order,
        "relative_l2_deformation": deformation.error,
        "gci_deformation": deformation.gci,
        "levels": float(len(levels)),
    }


def require_converged(name: str, result: ModelResult) -> None:
    """Raise TaskError, or InputError where the scene is at fault, if a result cannot serve as a reference."""
    for status in result.status:
        if status.code == models.REFUSED:
            raise InputError(f"{name}: {status.message}" + (f"; {status.remedy}" if status.remedy else ""))
        if not status.ok:
            raise TaskError(f"{name}: {status.message}", status.remedy)
    if not np.isfinite(result.displacement).all():
        raise TaskError(
            f"{name} gave a displacement that is not finite", "check the scene's supports and loads"
        )


def _restricted(result: ModelResult, lineage: list[Index]) -> ModelResult:
    """A refined level's result at the case's surface nodes; the force of a middle node is shared by its ends."""
    force = result.reaction_force
    for parents in reversed(lineage):
        force = _to_parents(force, parents)
    n_nodes = force.shape[1]
    return dataclasses.replace(
        result,
        displacement=result.displacement[:, :n_nodes],
        reaction_force=force,
        point_fields={name: values[:, :n_nodes] for name, values in result.point_fields.items()},
    )


def _to_parents(values: Array, parents: Index) -> Array:
    """(S, N, 3) nodal forces -> (S, n, 3): half of each to either parent, which for an old node is itself."""
    out = np.zeros((int(parents.max()) + 1, len(values), values.shape[2]))
    for end in parents.T:
        np.add.at(out, end, 0.5 * values.swapaxes(0, 1))
    return out.swapaxes(0, 1)
