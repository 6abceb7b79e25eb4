"""Parts of a body with their own moduli: their tetrahedra, and the moduli of each tetrahedron."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from solver_common.arrays import Array, Index, Mask
from solver_common.closed_surfaces import pieces, solid_angles

from ..body.mesh import Mesh
from ..body.topology import OUTWARD_FACES
from ..study.schema import Inclusion, Study, Tissue
from .regions import SceneError, holds, in_group

_PLACES = 24  # along each axis, to find the deepest place for a message


@dataclass(frozen=True)
class PlacedInclusion:
    """An inclusion and its tetrahedra (m,) on a mesh."""

    declared: Inclusion
    inside: Mask


def place_inclusions(
    study: Study, mesh: Mesh, known: Mapping[str, Mask] | None = None
) -> tuple[PlacedInclusion, ...]:
    """The inclusions of a study on a mesh.

    None on a mesh without tetrahedra; there each inclusion is only checked to lie in the body.

    A tetrahedron belongs to the last inclusion that contains its centroid, by the rules of regions. `known` are
    the tetrahedra on a refinement, where the inclusions are those of the coarse mesh.

    Raises
    ------
    SceneError
        an inclusion outside the body or without a tetrahedron, or a group that the mesh lacks.
    """
    if not study.inclusions:
        return ()
    if len(mesh.tetrahedra):
        return on_mesh(study.inclusions, mesh, known)
    for k, part in enumerate(study.inclusions):
        if (told := _outside(part, mesh)) and not holds(part, mesh, mesh.surface_points).any():
            raise SceneError(f"inclusion {part.name!r}: {told}", "inclusions", k)
    return ()


def on_mesh(
    declared: Sequence[Inclusion], mesh: Mesh, known: Mapping[str, Mask] | None = None
) -> tuple[PlacedInclusion, ...]:
    """`place_inclusions` on a mesh with tetrahedra."""
    inside = [
        known[part.name] if known else _inside(part, mesh, "inclusions", k) for k, part in enumerate(declared)
    ]
    for k, part in enumerate(declared):
        elsewhere = "" if inside[k].any() else _outside(part, mesh)
        inside[k] = inside[k] & ~np.logical_or.reduce(
            [np.zeros(len(mesh.tetrahedra), bool), *inside[k + 1 :]]
        )
        if not inside[k].any():
            remedy = elsewhere or "enlarge it or take a smaller mesh_size"
            raise SceneError(
                f"inclusion {part.name!r} has no tetrahedron of its own; {remedy}", "inclusions", k
            )
    return tuple(PlacedInclusion(part, mask) for part, mask in zip(declared, inside, strict=True))


def moduli(tissue: Tissue, inclusions: Sequence[PlacedInclusion]) -> tuple[Array, Array | float, Index]:
    """Young's modulus (m,) [Pa], Poisson's ratio (m,) or one for all, and part (m,) of each tetrahedron.

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


def interfaces(mesh: Mesh, inclusions: Sequence[PlacedInclusion]) -> tuple[Index, Index, Index]:
    """Interfaces between and around the inclusions: facets (I, 3), regions on both sides (I, 2), owners (m,).

    Facets are in point numbers of the mesh; their normals point from the first region to the second. Region 0 is
    the tissue at the surface. Each further region is a connected piece of an inclusion, or of the tissue inside
    one. Owners are numbers in the list of inclusions, -1 for tissue.

    Raises
    ------
    SceneError
        an inclusion at the surface of the body, or one that touches another and does not surround it.
    """
    label = np.full(len(mesh.tetrahedra), -1)
    for k, part in enumerate(inclusions):
        label[part.inside] = k
    faces = mesh.tetrahedra[:, OUTWARD_FACES].reshape(-1, 3)
    _, number = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True)
    order = np.argsort(number.ravel(), kind="stable")
    paired = np.flatnonzero(np.diff(number.ravel()[order]) == 0)
    first, second = order[paired], order[paired + 1]
    one, other = first // 4, second // 4
    alike = label[one] == label[other]
    lowest = pieces(len(label), one[alike], other[alike])
    at_surface = np.ones(len(faces), bool)
    at_surface[[*first, *second]] = False
    outside = np.unique(lowest[np.flatnonzero(at_surface) // 4])
    for piece in outside[label[outside] >= 0]:
        raise SceneError(
            f"inclusion {inclusions[label[piece]].declared.name!r} reaches the surface of the body, which a model "
            "of surfaces has no answer for; move it inside, take a smaller mesh_size, or use finite elements",
            "inclusions",
            int(label[piece]),
        )
    if len(outside) > 1:
        raise SceneError("the inclusions cut the body in two; use finite elements", "inclusions")
    regions = np.concatenate([outside, np.setdiff1d(np.unique(lowest), outside)])
    region = np.empty(len(label), np.int64)
    region[regions] = np.arange(len(regions))
    region = region[lowest]
    sides = np.stack([region[one], region[other]], axis=1)[~alike]
    pairs = set(map(tuple, np.sort(sides, axis=1).tolist()))
    if len(pairs) != len(regions) - 1:
        around = [{sum(pair) - k for pair in pairs if k in pair} for k in range(len(regions))]
        circling = set(range(len(regions)))  # regions that lead back to themselves through others
        while ends := {k for k in circling if len(around[k] & circling) < 2}:
            circling -= ends
        numbers = {int(k) for k in label[regions[sorted(circling)]] if k >= 0}
        names = " and ".join(repr(inclusions[k].declared.name) for k in sorted(numbers))
        raise SceneError(
            f"inclusions touch each other ({names}), which a model of surfaces has no answer for; leave room "
            "between them, take a smaller mesh_size, or use finite elements",
            "inclusions",
        )
    return faces[first[~alike]], sides, label[regions[1:]]


def _outside(part: Inclusion, mesh: Mesh) -> str:
    """The deepest place of the body, for a message on an inclusion whose middle is outside; else ""."""
    ends = (part.ball.center,) if part.ball else (part.box.min, part.box.max) if part.box else ()
    points, triangles = mesh.surface_points, mesh.triangles
    if not ends or solid_angles(np.mean(ends, axis=0)[None], points, triangles)[0] > 0.5:
        return ""
    from scipy.spatial import KDTree  # slow to load, for a message

    axes = np.linspace(points.min(axis=0), points.max(axis=0), _PLACES)
    places = np.stack(np.meshgrid(*axes.T, indexing="ij"), axis=-1).reshape(-1, 3)
    depth = KDTree(points).query(places)[0] * (solid_angles(places, points, triangles) > 0.5)
    told = ", ".join(f"{1000.0 * x:.3g}" for x in places[depth.argmax()])
    return (
        f"its middle lies outside the body, which is deepest near ({told}) mm, {1000.0 * depth.max():.3g} mm from "
        "its surface"
    )


def _inside(inclusion: Inclusion, mesh: Mesh, *place: str | int) -> Mask:
    """(m,) tetrahedra of an inclusion, including those of later ones."""
    found = holds(inclusion, mesh, mesh.points[mesh.tetrahedra].mean(axis=1))
    return found & in_group(inclusion.group, mesh.volumes, *place) if inclusion.group is not None else found
