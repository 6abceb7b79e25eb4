"""Closed surfaces made in plain numpy for the tests of `vdm`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vdm import FORMULATIONS, Load, Model, Parameters, SurfaceMesh

Array = NDArray[np.float64]
Index = NDArray[np.int64]

GOLDEN = (1.0 + 5.0**0.5) / 2.0


def icosahedron() -> tuple[Array, Index]:
    """12 nodes on the unit sphere and 20 outward facets."""
    corners = [(0.0, s, t * GOLDEN) for s in (-1.0, 1.0) for t in (-1.0, 1.0)]
    points = np.array([np.roll(c, k) for k in range(3) for c in corners])
    points /= np.linalg.norm(points[0])
    edge = np.sort(np.linalg.norm(points[0] - points, axis=1))[1]
    near = np.abs(np.linalg.norm(points[:, None] - points, axis=2) - edge) < 1e-9
    facets = [
        (i, j, k)
        for i in range(12)
        for j in range(i)
        for k in range(j)
        if near[i, j] and near[j, k] and near[i, k]
    ]
    outward = [f if np.linalg.det(points[list(f)]) > 0.0 else (f[0], f[2], f[1]) for f in facets]
    return points, np.array(outward)


def icosphere(levels: int, semi_axes: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> tuple[Array, Index]:
    """An icosahedron split `levels` times on the unit sphere (10 * 4^levels + 2 nodes), then stretched."""
    points, triangles = icosahedron()
    for _ in range(levels):
        points, triangles = halved(points, triangles)
        points /= np.linalg.norm(points, axis=1)[:, None]
    return points * np.array(semi_axes), triangles


def halved(points: Array, triangles: Index) -> tuple[Array, Index]:
    """Every facet in four, by the middles of its edges."""
    n = len(points)
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    keys = np.minimum(start, end) * n + np.maximum(start, end)
    unique, inverse = np.unique(keys, return_inverse=True)
    points = np.concatenate([points, 0.5 * (points[unique // n] + points[unique % n])])
    ab, bc, ca = (n + inverse.reshape(-1, 3)).T
    a, b, c = triangles.T
    parts = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    return points, np.concatenate([np.stack(t, axis=1) for t in parts])


def octahedron(radius: float = 1.0) -> tuple[Array, Index]:
    """6 nodes on the axes and 8 outward facets."""
    points = radius * np.repeat(np.eye(3), 2, axis=0) * np.tile([[1.0], [-1.0]], (3, 1))
    facets = [(a, b, c) for a in (0, 1) for b in (2, 3) for c in (4, 5)]
    outward = [f if np.linalg.det(points[list(f)]) > 0.0 else f[::-1] for f in facets]
    return points, np.array(outward)


def torus(major: float = 0.05, minor: float = 0.02, n: int = 24, m: int = 12) -> tuple[Array, Index]:
    """A torus of n x m nodes about the z axis: genus 1."""
    u, v = np.meshgrid(2 * np.pi * np.arange(n) / n, 2 * np.pi * np.arange(m) / m, indexing="ij")
    ring = major + minor * np.cos(v)
    points = np.stack([ring * np.cos(u), ring * np.sin(u), minor * np.sin(v)], axis=2).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    a, b = i * m + j, (i + 1) % n * m + j
    c, d = (i + 1) % n * m + (j + 1) % m, i * m + (j + 1) % m
    triangles = np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3)
    return points, triangles


def box(
    n: int = 4,
    size: tuple[float, float, float] = (1.0, 1.0, 1.0),
    counts: tuple[int, int, int] | None = None,
) -> tuple[Array, Index]:
    """The surface of a box, n x n squares of two triangles per face, or `counts` of them along x, y and z."""
    along = counts or (n, n, n)
    corners: dict[tuple[int, int, int], int] = {}
    triangles: list[tuple[int, int, int]] = []

    def node(p: tuple[int, int, int]) -> int:
        return corners.setdefault(p, len(corners))

    for axis in range(3):
        for side in (0, along[axis]):
            for i in range(along[(axis + 1) % 3]):
                for j in range(along[(axis + 2) % 3]):
                    square = []
                    for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1)):
                        p = [0, 0, 0]
                        p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3] = side, i + di, j + dj
                        square.append(node((p[0], p[1], p[2])))
                    a, b, c, d = square if side else square[::-1]
                    triangles += [(a, b, c), (a, c, d)]
    points = np.array(list(corners), dtype=np.float64) / along * np.array(size)
    return points, np.array(triangles)


# a body of three axes of 162 nodes, and the nodes of its base
POINTS, TRIANGLES = icosphere(2, (0.05, 0.06, 0.045))
BODY = SurfaceMesh(POINTS, TRIANGLES)
BASE = POINTS[:, 2] < -0.03


def model(formulation: str, parameters: Parameters | None = None, **options: Any) -> Model:
    """The body, its base held and its parameters by the rule unless told otherwise."""
    rule = parameters or Parameters.from_tissue(5000.0, BODY, formulation)
    return Model(POINTS, TRIANGLES, rule, formulation=formulation, **{"fixed": BASE, **options})


def pressed(surface: SurfaceMesh, facet_pressure: Array, prescribed: Array | None = None) -> Load:
    """A pressure per facet (F,) [Pa], a third of its force to each of its nodes."""
    nodes = surface.triangles.ravel()
    thrust = np.bincount(nodes, np.repeat(facet_pressure * surface.facet_areas / 3.0, 3))
    force = np.zeros_like(surface.points)
    np.add.at(force, nodes, np.repeat(-facet_pressure[:, None] * surface.facet_vectors / 3.0, 3, axis=0))
    return Load(thrust / surface.nodal_areas, force, prescribed)


# forms whose operator is a matrix, which every solver takes; the sparse form refuses others by name
WITH_MATRIX = [name for name in FORMULATIONS if name != "bem-sparse"]
