"""Checks and small constructions on triangles and tetrahedra as plain arrays: numpy only.

Without SciPy, whose import would delay each first look at a study by a sixth of a second.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from solver_common.arrays import Array, Index, Mask
from solver_common.closed_surfaces import pieces, solid_angles

from ..study.errors import MeshError
from .mesh import Mesh
from .surface_measures import enclosed_volume, facet_areas, piece_volumes

_MOST_TOLD = 3  # holes or pieces in a message
_LARGEST = 1e100  # coordinate
_MOST_PLACES = 50  # points of a wall that are tested to lie inside the body
# Faces of a positive tetrahedron, turned so that their normals point out of it.
OUTWARD_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])

# Inverse of the edge matrix of the regular tetrahedron with unit edges (rows: edges from vertex 0).
_REGULAR_INVERSE = np.linalg.inv(
    np.array(
        [[1.0, 0.0, 0.0], [0.5, np.sqrt(3) / 2, 0.0], [0.5, np.sqrt(3) / 6, np.sqrt(2.0 / 3.0)]],
    )
)


def tetrahedron_volumes(points: Array, tetrahedra: Index) -> Array:
    """Signed volumes (m,) of (m, 4) tetrahedra [unit of `points` cubed]."""
    p = points[tetrahedra]
    edges = p[:, 1:] - p[:, :1]
    volumes: Array = np.einsum("ij,ij->i", edges[:, 0], np.cross(edges[:, 1], edges[:, 2])) / 6.0
    return volumes


def tetrahedron_sicn(points: Array, tetrahedra: Index) -> Array:
    """Signed inverse condition number (m,): 1 for a regular tetrahedron, 0 for a flat one, negative inverted.

    3 det(S) / (|S|_F |cof S|_F) with S the map from the regular tetrahedron (the `minSICN` of gmsh).
    """
    p = points[tetrahedra]
    jacobian = _REGULAR_INVERSE @ (p[:, 1:] - p[:, :1])
    cofactor = np.stack([np.cross(jacobian[:, i - 2], jacobian[:, i - 1]) for i in range(3)], axis=1)
    determinant = np.einsum("ij,ij->i", jacobian[:, 0], cofactor[:, 0])
    norms = np.linalg.norm(jacobian, axis=(1, 2)) * np.linalg.norm(cofactor, axis=(1, 2))
    return np.divide(3.0 * determinant, norms, out=np.zeros_like(norms), where=norms > 0)


def canonical_triangles(triangles: Index) -> Index:
    """The same facets and orientations, smallest node first, rows in lexicographic order."""
    start = np.argmin(triangles, axis=1)
    turned = np.take_along_axis(triangles, (start[:, None] + np.arange(3)) % 3, axis=1)
    return np.ascontiguousarray(turned[np.lexsort(turned.T[::-1])], dtype=np.int64)


def boundary_triangles(tetrahedra: Index) -> Index:
    """Outward boundary facets (F, 3) of positive tetrahedra, in canonical order.

    Raises MeshError where a face belongs to more than two tetrahedra.
    """
    faces = tetrahedra[:, OUTWARD_FACES].reshape(-1, 3)
    _, first, counts = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    shared = int(np.count_nonzero(counts > 2))
    if shared:
        raise MeshError(
            f"{shared} faces belong to more than two tetrahedra; repair or remesh the volume mesh"
        )
    return canonical_triangles(faces[first[counts == 1]])


def half_edges(triangles: Index) -> Index:
    """Directed edges (3F, 2), facet by facet."""
    return triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)


CLOSE_IT = 'close it, or give repair = "fill-holes"'


def facet_pairs(points: Array, triangles: Index, remedy: str = CLOSE_IT) -> tuple[Index, Index, Mask]:
    """Facets either side of each edge of a closed manifold surface; `remedy` is for an open one.

    Returns (E,) indices of both facets and an (E,) mask, true where both run along the edge the same way: one of
    them is then turned over. Raises MeshError for an edge without exactly two facets.
    """
    directed = half_edges(triangles)
    _, inverse, counts = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True)
    rims = directed[counts[inverse.ravel()] == 1]
    crowded = int(np.count_nonzero(counts > 2))
    if len(rims):
        places = _told_places(points, rims, pieces(len(points), *rims.T)[rims[:, 0]], "edges")
        raise MeshError(f"the surface is open, in {places}; {remedy}")
    if crowded:
        raise MeshError(
            f"the surface is not manifold: {crowded} edges have more than two facets; "
            "remove inner walls and fins so that it bounds one solid"
        )
    order = np.argsort(inverse.ravel(), kind="stable").reshape(-1, 2)
    same_way = directed[order[:, 0], 0] == directed[order[:, 1], 0]
    return order[:, 0] // 3, order[:, 1] // 3, same_way


def _told_places(points: Array, parts: Index, label: Index, kind: str) -> str:
    """Number of connected places, and position and size of the first ones, in the file's unit.

    Parameters
    ----------
    parts : (n, k) edges or facets
    label : (n,) the number of each part's place
    """
    extent = float(np.ptp(points, axis=0).max())
    decimals = 2 - math.floor(math.log10(extent)) if extent else 0
    names, sizes = np.unique(label, return_counts=True)
    told = []
    for k in np.argsort(-sizes, kind="stable")[:_MOST_TOLD]:
        corners = points[parts[label == names[k]].ravel()]
        low, high = corners.min(axis=0), corners.max(axis=0)
        place = ", ".join(f"{round(x, decimals) + 0.0:.12g}" for x in 0.5 * (low + high))
        told.append(f"{sizes[k]} {kind} about ({place}), {(high - low).max():.3g} across")
    more = f" and {len(names) - _MOST_TOLD} more" if len(names) > _MOST_TOLD else ""
    return f"{len(names)} place{'s' * (len(names) > 1)} ({'; '.join(told)}{more})"


def consistent_orientation(points: Array, triangles: Index, remedy: str = CLOSE_IT) -> tuple[Index, int]:
    """Facets oriented away from the body, and how many were turned.

    Closed pieces within the outer one, and not within each other, are the walls of cavities; their facets point
    into these. trimesh's repair of winding detects no one-sided surface, and does not tell cavities from pieces
    beside the body.

    Raises MeshError for an open, non-manifold or one-sided surface, pieces beside each other, parts that touch at
    a vertex only, or no volume inside.
    """
    first, second, same_way = facet_pairs(points, triangles, remedy)
    n_facets = len(triangles)
    # every facet twice, as it is and turned over; join those sides of neighbours that agree
    joined = np.concatenate([first, first + n_facets])
    agreeing = np.concatenate([second + n_facets * same_way, second + n_facets * ~same_way])
    labels = pieces(2 * n_facets, joined, agreeing).reshape(2, n_facets)
    if (labels[0] == labels[1]).any():
        raise MeshError("the surface is one-sided (it cannot be oriented); it bounds no solid")
    lowest = labels.min(axis=0)
    names, piece = np.unique(lowest, return_inverse=True)
    side = labels[0] != lowest
    turned = np.where(side[:, None], triangles[:, ::-1], triangles)
    scale = float(facet_areas(points, turned).sum()) ** 1.5
    volumes = piece_volumes(points, turned, piece.ravel(), len(names))
    outer = int(np.argmax(np.abs(volumes)))
    if (np.abs(volumes) <= 1e-9 * scale).any():
        raise MeshError("the surface encloses no volume; give the boundary of a solid")
    over = (volumes < 0) == (np.arange(len(names)) == outer)
    side ^= over[piece.ravel()]
    turned = np.where(side[:, None], triangles[:, ::-1], triangles)
    for k in np.flatnonzero(np.arange(len(names)) != outer):
        wall = np.unique(turned[piece.ravel() == k])
        places = points[wall[:: len(wall) // _MOST_PLACES + 1]]
        if not (np.round(solid_angles(places, points, turned[piece.ravel() != k])) == 1).all():
            raise separate_pieces(points, triangles, lowest)
    check_vertex_fans(turned)
    return np.ascontiguousarray(turned), int(np.count_nonzero(side))


def separate_pieces(points: Array, triangles: Index, label: Index, remedy: str = "") -> MeshError:
    """The error for a surface in pieces; `label` (F,) is the piece of each facet."""
    return MeshError(
        f"the surface has separate pieces, in {_told_places(points, triangles, label, 'facets')}; keep one closed "
        f'piece, or give repair = "largest-piece"{remedy}'
    )


def check_vertex_fans(triangles: Index) -> None:
    """Raise MeshError where two parts of a closed, consistently oriented surface touch at one vertex only."""
    directed = half_edges(triangles)
    n_points = int(triangles.max()) + 1
    # Half-edge (a, b) of one facet meets (b, a) of its neighbour: their corners at a belong to one fan.
    forward = directed[:, 0] * n_points + directed[:, 1]
    backward = directed[:, 1] * n_points + directed[:, 0]
    by_forward = np.argsort(forward, kind="stable")
    opposite = by_forward[np.searchsorted(forward[by_forward], backward)]
    here = np.arange(len(directed))  # half-edge 3 f + c starts at corner c of facet f
    corner_in_neighbour = opposite - opposite % 3 + (opposite + 1) % 3
    fans = len(np.unique(pieces(len(here), here, corner_in_neighbour)))
    touching = fans - len(np.unique(triangles))
    if touching:
        raise MeshError(
            f"the surface is not manifold: it touches itself at {touching} vertices; separate the parts there"
        )


def check_finite(points: Array) -> None:
    """Raise MeshError for coordinates that are NaN, infinite, or so large that their squares overflow."""
    bad = int(np.count_nonzero(~(np.abs(points) < _LARGEST).all(axis=1)))
    if bad:
        raise MeshError(
            f"{bad} points have coordinates that are not finite numbers below {_LARGEST:.0e}; "
            "export the mesh again"
        )


def mesh_from_tetrahedra(
    points: Array,
    tetrahedra: Index,
    *,
    groups: Mapping[str, Mask] | None = None,
    quality: Mapping[str, float] | None = None,
) -> Mesh:
    """The Mesh of positive tetrahedra, with its boundary extracted, checked and described.

    `groups` are masks over `points`: they name sets of surface nodes, and of tetrahedra with all their nodes in
    the mask. Raises MeshError for coordinates that are not finite, inverted or flat tetrahedra, and a boundary
    that is no closed manifold surface.
    """
    check_finite(points)
    check_tetrahedra(points, tetrahedra)
    triangles = boundary_triangles(tetrahedra)
    _, turned = consistent_orientation(points, triangles)
    if turned:
        raise MeshError(
            "the tetrahedra overlap: their boundary does not face outward everywhere; remesh the volume"
        )
    figures = {"worst_sicn": float(tetrahedron_sicn(points, tetrahedra).min()), **(quality or {})}
    mesh = _described(points, tetrahedra, triangles, figures)
    on_surface = {name: mask[mesh.surface_nodes] for name, mask in (groups or {}).items()}
    volumes = {name: np.all(mask[tetrahedra], axis=1) for name, mask in (groups or {}).items()}
    return replace(
        mesh,
        groups={name: mask for name, mask in on_surface.items() if mask.any()},
        volumes={name: mask for name, mask in volumes.items() if mask.any()},
    )


def mesh_from_triangles(
    points: Array, triangles: Index, *, quality: Mapping[str, float] | None = None
) -> Mesh:
    """The Mesh of a closed surface without an inside, with the checks of `mesh_from_tetrahedra`."""
    check_finite(points)
    outward, _ = consistent_orientation(points, triangles)
    return _described(points, np.empty((0, 4), dtype=np.int64), canonical_triangles(outward), quality or {})


def _described(points: Array, tetrahedra: Index, triangles: Index, quality: Mapping[str, float]) -> Mesh:
    """The Mesh with its counts and measures; `triangles` are of the points."""
    surface_nodes, local = np.unique(triangles, return_inverse=True)
    figures = {
        "points": float(len(points)),
        "tetrahedra": float(len(tetrahedra)),
        "surface_nodes": float(len(surface_nodes)),
        "triangles": float(len(triangles)),
        "volume": enclosed_volume(points, triangles),
        "area": float(facet_areas(points, triangles).sum()),
    }
    return Mesh(
        points=np.ascontiguousarray(points, dtype=np.float64),
        tetrahedra=np.ascontiguousarray(tetrahedra, dtype=np.int64),
        surface_nodes=surface_nodes.astype(np.int64),
        triangles=np.ascontiguousarray(local.reshape(-1, 3), dtype=np.int64),
        quality={**figures, **quality},
    )


def surface_only(mesh: Mesh) -> Mesh:
    """The same surface nodes, facets and groups without the inside."""
    surface = mesh_from_triangles(mesh.surface_points, mesh.triangles)
    return replace(
        surface,
        groups=mesh.groups,
        quality={**mesh.quality, **surface.quality},
        moved=mesh.moved,
    )


def check_tetrahedra(points: Array, tetrahedra: Index) -> None:
    """Raise MeshError for no tetrahedra, and for flat or inverted ones."""
    if len(tetrahedra) == 0:
        raise MeshError("the mesh holds no tetrahedra; give a volume mesh of four-node tetrahedra")
    sicn = tetrahedron_sicn(points, tetrahedra)
    flat = int(np.count_nonzero(np.abs(sicn) < 1e-8))
    inverted = int(np.count_nonzero(sicn <= -1e-8))
    if flat:
        raise MeshError(
            f"{flat} of {len(tetrahedra)} tetrahedra have no volume; remesh or optimise the volume mesh"
        )
    if inverted:
        raise MeshError(
            f"{inverted} of {len(tetrahedra)} tetrahedra are inverted (negative volume); remesh the volume"
        )
