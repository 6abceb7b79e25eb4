"""Cleans imported facets and tetrahedra, or raises a clear error: numpy and scipy only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from solver_common.arrays import Array, Index, Mask
from solver_common.closed_surfaces import closed_pieces, pieces

from ..study.errors import MeshError
from .surface_measures import enclosed_volume, facet_areas
from .topology import (
    CLOSE_IT,
    check_finite,
    consistent_orientation,
    half_edges,
    tetrahedron_volumes,
)

_SAME_POINT = 1e-6  # of the largest extent: single precision (STL) keeps about 1e-7


@dataclass(frozen=True)
class Clean:
    """Clean content of a file; every point is used.

    Attributes
    ----------
    points : (n, 3), in the file's unit
    cells : (F, 3) facets of a closed, manifold surface, outward, or (m, 4) positive tetrahedra
    repairs : numbers of points, facets and tetrahedra that were merged, dropped, turned or added
    groups : named sets of points, (n,) masks
    """

    points: Array
    cells: Index
    repairs: dict[str, float]
    groups: dict[str, Mask] = field(default_factory=dict)

    @property
    def area(self) -> float:
        """Area of the facets, in the square of the points' unit."""
        return float(facet_areas(self.points, self.cells).sum())

    @property
    def volume(self) -> float:
        """Volume inside the facets, in the cube of the points' unit."""
        return enclosed_volume(self.points, self.cells)


def clean_surface(points: Array, triangles: Index, repair: str = "") -> Clean:
    """Merge equal points, drop facets without area, repeated facets and unused points, orient all facets outward.

    Parameters
    ----------
    repair : further repairs: "largest-piece" keeps only the piece with the most area, "fill-holes" closes holes
        by facets between the nodes of their rims, "both" does one after the other

    Raises MeshError for coordinates that are not finite, no facets, facets with points that do not exist, and a
    result that is open, not manifold, one-sided, in pieces beside each other, or without an inside.
    """
    from scipy.spatial import KDTree  # slow to load: only where a file is read

    check_finite(points)
    if len(triangles) == 0:
        raise MeshError("holds no facets; give the closed surface of a solid")
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise MeshError("facets name points that do not exist; the file is damaged")
    used = np.unique(triangles)
    extent = float(np.ptp(points[used], axis=0).max())
    if extent == 0.0:
        raise MeshError("all points are the same; the file is damaged")
    close = KDTree(points[used]).query_pairs(_SAME_POINT * extent, output_type="ndarray")
    target = pieces(len(used), close[:, 0], close[:, 1])  # the first point at each place
    renumbered = np.full(len(points), -1)
    renumbered[used] = target
    faces = _without_repeats(renumbered[triangles])
    if len(faces) == 0:
        raise MeshError("no facet has an area; the file is damaged")
    sound = len(faces)
    if repair in ("largest-piece", "both"):
        faces = _largest_piece(points[used], faces)
    in_piece, remedy = len(faces), CLOSE_IT
    if repair in ("fill-holes", "both"):
        from .remesh import caps  # slow to load

        faces = np.concatenate([faces, caps(points[used], faces)])
        remedy = 'repair = "fill-holes" does not close it: close it where it was made'
    kept, local = np.unique(faces, return_inverse=True)
    clean_points = points[used][kept]
    outward, flipped = consistent_orientation(clean_points, local.reshape(-1, 3), remedy)
    repairs = {
        "points_merged": int(np.count_nonzero(target != np.arange(len(used)))),
        "points_dropped": len(points) - len(used),
        "facets_dropped": len(triangles) - sound,
        "facets_flipped": flipped,
        "facets_of_other_pieces": sound - in_piece,
        "facets_added": len(faces) - in_piece,
    }
    return Clean(clean_points, outward, {name: float(count) for name, count in repairs.items()})


def clean_tetrahedra(points: Array, tetrahedra: Index, groups: Mapping[str, Mask]) -> Clean:
    """Drop unused points and repeated tetrahedra; turn all if all are inverted (numbered the other way).

    Raises MeshError for no tetrahedra, and for points that do not exist.
    """
    if len(tetrahedra) == 0:
        raise MeshError(
            "holds no tetrahedra, or is damaged; give a volume mesh, or a surface as STL, OBJ, PLY or VTP"
        )
    if tetrahedra.min() < 0 or tetrahedra.max() >= len(points):
        raise MeshError("tetrahedra name points that do not exist; the file is damaged")
    _, first = np.unique(np.sort(tetrahedra, axis=1), axis=0, return_index=True)
    used, local = np.unique(tetrahedra[np.sort(first)], return_inverse=True)
    tetrahedra = local.reshape(-1, 4)
    check_finite(points[used])
    volumes = tetrahedron_volumes(points[used], tetrahedra)
    inverted = int(np.count_nonzero(volumes < 0))
    if inverted == len(tetrahedra):
        tetrahedra = tetrahedra[:, [0, 2, 1, 3]]
    turned = inverted if inverted == len(tetrahedra) else 0
    repairs = {"points_dropped": float(len(points) - len(used)), "tetrahedra_turned": float(turned)}
    return Clean(points[used], tetrahedra, repairs, {name: mask[used] for name, mask in groups.items()})


def _largest_piece(points: Array, faces: Index) -> Index:
    """The facets of the piece with the most area."""
    piece = closed_pieces(faces)
    area = np.bincount(piece, weights=facet_areas(points, faces))
    largest: Index = faces[piece == area.argmax()]
    return largest


def _without_repeats(faces: Index) -> Index:
    """Facets with three different corners, each once; a fin, doubled on a closed surface, is removed entirely.

    Facets whose three corners lie on a line stay: they connect their neighbours.
    """
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    _, first, copies = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    order = np.argsort(first)
    faces, repeated = faces[first[order]], copies[order] > 1
    _, edge, uses = np.unique(
        np.sort(half_edges(faces), axis=1), axis=0, return_inverse=True, return_counts=True
    )
    fits = (uses[edge.ravel()] == 2).reshape(-1, 3).all(axis=1)
    kept: Index = faces[fits | ~repeated]
    return kept
