"""Parts of a body with moduli of their own: the tetrahedra that they take, and the moduli of each tetrahedron."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from solver_common.arrays import Array, Index, Mask

from ..body.mesh import Mesh
from ..study.schema import Inclusion, Study, Tissue
from .coordinates import origin, shifted
from .placed import SceneError


@dataclass(frozen=True)
class PlacedInclusion:
    """An inclusion in the coordinates of a mesh, and its (m,) tetrahedra there."""

    declared: Inclusion
    inside: Mask


def place_inclusions(
    study: Study, mesh: Mesh, known: Mapping[str, Mask] | None = None
) -> tuple[PlacedInclusion, ...]:
    """The inclusions of a study on a mesh; none on one without tetrahedra.

    A tetrahedron belongs to a ball or a box where its centroid lies in it, and to the last that it lies in. `known`
    are the tetrahedra where the mesh is a refinement, on which the inclusions are those of the coarse mesh.

    Raises
    ------
    SceneError
        an inclusion without a tetrahedron, a group that the mesh has not.
    """
    if not study.inclusions or not len(mesh.tetrahedra):
        return ()
    by = tuple(origin(study, mesh.centre).tolist())
    return on_mesh([_moved(inclusion, by) for inclusion in study.inclusions], mesh, known)


def on_mesh(
    declared: Sequence[Inclusion], mesh: Mesh, known: Mapping[str, Mask] | None = None
) -> tuple[PlacedInclusion, ...]:
    """The same of inclusions in the mesh's own coordinates."""
    inside = [
        known[part.name] if known else _inside(part, mesh, ("inclusions", k))
        for k, part in enumerate(declared)
    ]
    for k, part in enumerate(declared):
        inside[k] = inside[k] & ~np.logical_or.reduce(
            [np.zeros(len(mesh.tetrahedra), bool), *inside[k + 1 :]]
        )
        if not inside[k].any():
            raise SceneError(
                f"inclusion {part.name!r} has no tetrahedron of its own; enlarge it or take a smaller mesh_size",
                ("inclusions", k),
            )
    return tuple(PlacedInclusion(part, mask) for part, mask in zip(declared, inside, strict=True))


def moduli(tissue: Tissue, inclusions: Sequence[PlacedInclusion]) -> tuple[Array, Array | float, Index]:
    """Young's modulus of each tetrahedron (m,) [Pa], Poisson's ratio, one where all have the same, and its part.

    Part 0 is the tissue around the inclusions, part k the k-th of them.
    """
    count = len(inclusions[0].inside)
    young, ratio = np.full(count, tissue.youngs_modulus), np.full(count, tissue.poisson_ratio)
    part = np.zeros(count, dtype=np.int64)
    for k, inclusion in enumerate(inclusions, start=1):
        young[inclusion.inside] = inclusion.declared.youngs_modulus
        if inclusion.declared.poisson_ratio is not None:
            ratio[inclusion.inside] = inclusion.declared.poisson_ratio
        part[inclusion.inside] = k
    return young, ratio if np.ptp(ratio) else tissue.poisson_ratio, part


def _moved(inclusion: Inclusion, by: tuple[float, ...]) -> Inclusion:
    if inclusion.ball is not None:
        ball = inclusion.ball.model_copy(update={"center": shifted(inclusion.ball.center, by)})
        return inclusion.model_copy(update={"ball": ball})
    if inclusion.box is not None:
        corners = {"min": shifted(inclusion.box.min, by), "max": shifted(inclusion.box.max, by)}
        return inclusion.model_copy(update={"box": inclusion.box.model_copy(update=corners)})
    return inclusion


def _inside(inclusion: Inclusion, mesh: Mesh, place: tuple[str, int]) -> Mask:
    """(m,) tetrahedra of an inclusion in the mesh's coordinates, whatever others take."""
    if inclusion.group is not None:
        if inclusion.group not in mesh.volumes:
            known = ", ".join(sorted(mesh.volumes)) or "none"
            raise SceneError(
                f"the mesh has no group {inclusion.group!r} of tetrahedra; it has: {known}", place
            )
        return mesh.volumes[inclusion.group]
    centroids = mesh.points[mesh.tetrahedra].mean(axis=1)
    if inclusion.ball is not None:
        offset = centroids - np.array(inclusion.ball.center)
        return np.asarray(np.linalg.norm(offset, axis=1) <= inclusion.ball.radius)
    assert inclusion.box is not None  # a study is checked
    low, high = np.array(inclusion.box.min), np.array(inclusion.box.max)
    return np.asarray(np.all((centroids >= low) & (centroids <= high), axis=1))
