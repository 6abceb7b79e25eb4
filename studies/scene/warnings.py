"""Doubts about a scene that can be computed: warnings, no errors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from solver_common.arrays import Array, Index, Mask
from solver_common.closed_surfaces import pieces

from ..body.surface_measures import facet_area_vectors
from ..body.topology import half_edges
from ..study.errors import Finding, plural
from ..study.loads import Constraint
from ..study.schema import Tissue

# shares of the body's smallest extent and volume: beyond these a small-strain reference is no judge
MOST_MOVED, MOST_DRIFT = 0.10, 0.05
FEW_NODES = 5  # of a contact: too few to resolve its pressures
STIFF = 2e9  # larger than Young's modulus of any soft tissue [Pa]: tendon has 1 to 2 GPa
OPPOSED = 0.05  # largest share of a contact's area that faces against its resultant


def scene_warnings(
    constraints: Sequence[Constraint],
    tissue: Tissue,
    masks: Mapping[str, Mask],
    points: Array,
    triangles: Index,
    largest_factor: float = 1.0,
    *,
    small_strain: bool = False,
) -> Iterator[Finding]:
    """Places in the study file, each with a sentence.

    Parameters
    ----------
    masks : (N,) nodes of each region
    points, triangles : the surface, (N, 3) [m] and (F, 3)
    largest_factor : largest load factor
    small_strain : whether a small-strain reference must be able to judge the load, see `MOST_MOVED`
    """
    vectors = facet_area_vectors(points, triangles)
    held = [masks[part.region] for part in constraints if part.holds]
    support = np.logical_or.reduce([np.zeros(len(points), dtype=bool), *held])
    on_support = support[triangles].all(axis=1)
    apart = _apart(support, triangles)
    extent = float(np.ptp(points, axis=0).min())
    if tissue.youngs_modulus > STIFF:
        told = f"{tissue.youngs_modulus / 1e9:.3g} GPa is stiffer than tendon (1 to 2 GPa); a mixed-up unit?"
        yield ("tissue", "youngs_modulus"), told
    for place, part in enumerate(constraints):
        mask, loc = masks[part.region], ("constraints", place, "region")
        if part.holds:
            if mask.any() and not (on_support & mask[triangles].any(axis=1)).any():
                yield (
                    loc,
                    f"holds {plural(int(mask.sum()), 'lone node')} and no facet: on finer meshes what moves there "
                    "grows without limit; hold an area, by a larger region or a smaller mesh_size",
                )
            elif count := int((mask & apart).sum()):
                yield (
                    loc,
                    f"holds {plural(count, 'lone node')} apart from its facets: what they carry falls with the "
                    "mesh size, and with it the answer may change by any amount; take them out of the region, or "
                    "hold an area there by a smaller mesh_size",
                )
            continue
        if part.kind != "contact":
            continue
        if mask.sum() <= FEW_NODES:
            few = plural(int(mask.sum()), "node")
            yield loc, f"touches {few}: the answer there hangs on the mesh; take a smaller mesh_size"
        facets = mask[triangles].all(axis=1)
        pressed = vectors[facets]
        areas, resultant = np.linalg.norm(pressed, axis=1), pressed.sum(axis=0)
        total, size = float(areas.sum()), float(np.linalg.norm(resultant))
        if not total or not size:
            continue  # a smooth profile between nodes, or a scene that is refused later
        _, sides = np.unique(np.sort(half_edges(triangles[facets]), axis=1), axis=0, return_counts=True)
        # the wall of a cavity, where such a pressure is intended
        all_round = part.profile == "uniform" and (sides == 2).all()
        if not all_round and areas[pressed @ resultant < 0].sum() > OPPOSED * total:
            yield (
                loc,
                (
                    f"presses opposite sides of the body: its facets carry {total / size:.3g} times its resultant; "
                    "take a region on one side"
                ),
            )
        force = largest_factor * abs(part.force or (part.pressure or 0.0) * size)
        path = indentation(force, total, tissue.youngs_modulus, tissue.poisson_ratio)
        told = (
            f"presses with {force:.3g} N, which by linear theory moves the surface by {path:.2g} m, more than"
        )
        if path > extent:
            yield loc[:2], f"{told} the body's smallest extent ({extent:.2g} m); a mixed-up unit?"
        elif small_strain and path > MOST_MOVED * extent:
            yield (
                loc[:2],
                f"{told} {MOST_MOVED:.0%} of the body's smallest extent, beyond what the reference judges, which "
                'holds for small strain: lower the load, or take study.reference = "fem"',
            )


def meshing_warnings(quality: Mapping[str, float], accepted: float) -> Iterator[Finding]:
    """Warn if meshing a file's surface changed its volume by more than the accepted error.

    Reference and models share the mesh, so that none of their errors shows it.
    """
    change = quality.get("volume_change", 0.0)
    if abs(change) > accepted:
        told = (
            f"changes the volume of the file's surface by {100.0 * change:+.1f} %, which no error here shows"
        )
        yield ("geometry", "mesh_size"), f"{told}; take a smaller one"


def motion_share(displacement: Array, held: Mask, extent: float) -> float:
    """The largest displacement of (N, 3) [m] over the body's smallest extent [m].

    If all held nodes (N,) have the same motion, it is subtracted: it does not deform the body.
    """
    carried = displacement[held]
    if held.any() and np.allclose(carried, carried[0], rtol=1e-9, atol=0.0):
        displacement = displacement - carried[0]
    return math.sqrt(np.einsum("ij,ij->i", displacement, displacement).max()) / extent


def indentation(force: float, area: float, youngs_modulus: float, poisson_ratio: float) -> float:
    """Mean displacement [m] of a disc under a uniform pressure on a half-space.

    16 F (1 - nu^2) / (3 pi^2 a E); Timoshenko and Goodier, Theory of Elasticity, 3rd edition, section 139.
    """
    radius = math.sqrt(area / math.pi)
    return 16 * force * (1 - poisson_ratio**2) / (3 * math.pi**2 * radius * youngs_modulus)


def _apart(support: Mask, triangles: Index) -> Mask:
    """(N,) held nodes without a path of edges between held nodes to a held facet."""
    edges = half_edges(triangles)
    piece = pieces(len(support), *edges[support[edges].all(axis=1)].T)
    held = triangles[support[triangles].all(axis=1)]
    return np.asarray(support & ~np.isin(piece, piece[held]))
