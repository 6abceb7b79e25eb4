"""Uniform remeshing of closed surfaces, by pyvista and pyacvd."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import numpy as np
import pyacvd
import pyvista as pv

from solver_common.arrays import Array, Index

from ..study.errors import MeshError
from .surface_measures import facet_areas
from .topology import canonical_triangles, consistent_orientation

# Edges of the sampled surface are at most mesh_size / 2.5, which gives about 17 samples for each new node.
# Fewer leave uneven triangles; more only take longer.
_SAMPLES_PER_EDGE = 2.5
_MOST_SAMPLES = 100  # for each node; more are needed only for needle-like facets
_ATTEMPTS = 4  # each with finer samples: clusters of a coarse sample can touch themselves


def unit_sphere(subdivisions: int) -> tuple[Array, Index]:
    """A nearly uniform triangulation of the unit sphere, 10 * 4^subdivisions + 2 points."""
    sphere = pv.Icosphere(radius=1.0, nsub=subdivisions)
    return np.asarray(sphere.points, dtype=np.float64), np.asarray(sphere.regular_faces, dtype=np.int64)


def uniform_surface(points: Array, triangles: Index, mesh_size: float) -> tuple[Array, Index]:
    """Cover a closed surface with nearly equilateral triangles of edge `mesh_size` [m].

    Approximated centroidal Voronoi clustering (Valette and Chassery 2004, doi
    10.1111/j.1467-8659.2004.00769.x): the surface is sampled, the samples are gathered in clusters of equal
    area, each cluster becomes a node on the imported surface and clusters that meet become triangles. The
    number of nodes is that of equilateral triangles, area / (mesh_size^2 sqrt(3) / 2).

    Raises MeshError where the clusters do not make one closed manifold surface.
    """
    imported = polydata(points, triangles)
    area = float(facet_areas(points, triangles).sum())
    n_nodes = max(round(2 / np.sqrt(3) * area / mesh_size**2), 12)
    complaint = ""
    for attempt in range(_ATTEMPTS):
        longest_edge = mesh_size / (_SAMPLES_PER_EDGE * 1.2**attempt)
        samples, sample_triangles = subdivided(
            points, triangles, longest_edge, max_points=max(_MOST_SAMPLES * n_nodes, 4 * len(points))
        )
        clusters, weights = _clustered(polydata(samples, sample_triangles), n_nodes)
        corners = clusters[sample_triangles]
        a, b, c = corners.T
        # a triangle for each triple of clusters that meet in a sample triangle
        facets = np.unique(canonical_triangles(corners[(a != b) & (b != c) & (c != a)]), axis=0)
        try:
            if len(np.unique(facets)) != n_nodes:
                raise MeshError("some nodes have no facet")
            middles = [np.bincount(clusters, weights * x) / np.bincount(clusters, weights) for x in samples.T]
            nodes = _closest(imported, np.stack(middles, axis=1))
            facets, _ = consistent_orientation(nodes, facets)
        except MeshError as error:
            complaint = str(error)
            continue
        return nodes, facets
    raise MeshError(
        f"the surface cannot be remeshed uniformly at mesh_size {mesh_size:g} m ({complaint}); "
        "use a smaller mesh_size, or mend parts thinner than it"
    )


def caps(points: Array, faces: Index) -> Index:
    """Facets that close the holes of a surface, between the nodes of the rims."""
    extent = float(np.ptp(points, axis=0).max())
    closed = polydata(points, faces).fill_holes(2.0 * extent)
    found: Index = np.asarray(closed.regular_faces, dtype=faces.dtype)[len(faces) :]
    return found


def surface_distance(
    points: Array, triangles: Index, other_points: Array, other_triangles: Index
) -> tuple[float, Array]:
    """Mean distance between two surfaces, seen from both, and (N,) the largest near each node of the other.

    Distances are in the unit of the points. The mean is weighted by area, over the middles of all edges. The
    largest includes nodes and centroids; each counts at the nearest node.
    """
    from scipy.spatial import KDTree  # slow to load

    distances, weights, largest = [], [], np.zeros(len(other_points))
    nearest = KDTree(other_points)
    for (p, t), target in (
        ((points, triangles), polydata(other_points, other_triangles)),
        ((other_points, other_triangles), polydata(points, triangles)),
    ):
        middles = 0.5 * (p[t] + p[np.roll(t, 1, axis=1)]).reshape(-1, 3)
        probes = np.concatenate([middles, p[t].mean(axis=1), p])
        signed = pv.PolyData(probes).compute_implicit_distance(target)["implicit_distance"]
        found = np.abs(np.asarray(signed, dtype=np.float64))
        np.maximum.at(largest, nearest.query(probes)[1], found)
        distances.append(found[: len(middles)])
        weights.append(np.repeat(facet_areas(p, t), 3))
    return float(np.average(np.concatenate(distances), weights=np.concatenate(weights))), largest


def _closest(surface: pv.PolyData, points: Array) -> Array:
    """The point of the surface nearest to each of `points`."""
    found: tuple[object, Array] = surface.find_closest_cell(points, return_closest_point=True)  # type: ignore[assignment]
    return np.asarray(found[1], dtype=np.float64)


def subdivided(
    points: Array, triangles: Index, longest_edge: float, *, max_points: int
) -> tuple[Array, Index]:
    """The same surface with no edge longer than `longest_edge`; longer edges are halved repeatedly.

    Raises MeshError if that takes more than `max_points`: the facets are needles.
    """
    while len(points) <= max_points:
        n = len(points)
        ends = np.stack(
            [triangles, np.roll(triangles, -1, axis=1)], axis=2
        )  # edge k runs from corner k to k + 1
        low, high = ends.min(axis=2), ends.max(axis=2)
        _, first, edge = np.unique((low * n + high).ravel(), return_index=True, return_inverse=True)
        a, b = points[low.ravel()[first]], points[high.ravel()[first]]
        long = np.linalg.norm(a - b, axis=1) > longest_edge
        if not long.any():
            return points, triangles
        middle = np.where(long, n + np.cumsum(long) - 1, -1)[edge.reshape(-1, 3)]
        points = np.concatenate([points, 0.5 * (a + b)[long]])
        triangles = _split(triangles, middle)
    raise MeshError("the surface has needles far longer than mesh_size; mend them, or use a larger mesh_size")


def _split(triangles: Index, middle: Index) -> Index:
    """Facets cut at the middles of their edges (-1 where an edge stays whole)."""
    cuts = (middle >= 0).sum(axis=1)
    # turn each facet so that with one cut edge 0 is cut, with two edge 2 is whole
    turn = np.where(cuts == 2, (np.argmin(middle, axis=1) + 1) % 3, np.argmax(middle >= 0, axis=1))
    order = (turn[:, None] + np.arange(3)) % 3
    v = np.take_along_axis(triangles, order, axis=1)
    m = np.take_along_axis(middle, order, axis=1)
    corners = np.concatenate([v, m], axis=1)  # columns 0..2 the corners, 3..5 the middles of edges 0..2
    templates = {
        0: [[0, 1, 2]],
        1: [[0, 3, 2], [3, 1, 2]],
        2: [[0, 3, 4], [3, 1, 4], [0, 4, 2]],
        3: [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]],
    }
    return np.concatenate(
        [corners[cuts == n][:, template].reshape(-1, 3) for n, template in templates.items()]
    )


def _clustered(samples: pv.PolyData, n_clusters: int) -> tuple[Index, Array]:
    """Cluster of each sample, and the area of each sample."""
    with warnings.catch_warnings():
        # pyacvd 0.3 uses an attribute that pyvista has renamed
        warnings.filterwarnings("ignore", message=".*_connectivity_array")
        clustering = pyacvd.Clustering(samples)
        clusters = clustering.cluster(n_clusters)
    return clusters.astype(np.int64), np.asarray(clustering.area)


def polydata(points: Array, triangles: Index, fields: Mapping[str, Array] | None = None) -> pv.PolyData:
    """A surface with fields at its nodes, (N,) or (N, 3)."""
    surface = pv.PolyData.from_regular_faces(points, triangles.astype(int))
    surface.point_data.update(fields or {})
    return surface
