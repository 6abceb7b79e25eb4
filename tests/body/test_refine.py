"""A refined scene is the same scene: same body, same support, same load, finer elements."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from vdmbench.body.mesh import Mesh
from vdmbench.body.refine import inherit, refine, refined
from vdmbench.body.surface_measures import enclosed_volume, facet_area_vectors
from vdmbench.body.topology import surface_only


def wedge() -> Mesh:
    """Two tetrahedra on one facet, one node of the body's five in the middle of nothing: all on the surface."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], dtype=float)
    tetrahedra = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])
    triangles = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 4], [2, 3, 4], [3, 1, 4]])
    return Mesh(points, tetrahedra, np.arange(5), triangles)


def volumes(mesh: Mesh) -> np.ndarray:
    a, b, c, d = (mesh.points[mesh.tetrahedra[:, k]] for k in range(4))
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6


def test_refinement_keeps_body_and_surface() -> None:
    coarse = wedge()
    fine, parents = refine(coarse)
    assert len(fine.tetrahedra) == 16
    assert len(fine.triangles) == 24
    assert (volumes(fine) > 0).all()
    assert_allclose(volumes(fine).sum(), volumes(coarse).sum(), rtol=1e-14, atol=0)
    assert_allclose(fine.surface_points[:5], coarse.surface_points, rtol=0, atol=0)
    assert (np.diff(fine.surface_nodes) > 0).all()
    # the surface is that of the fine tetrahedra, outward: same enclosed volume, and facets are a quarter each
    assert_allclose(
        enclosed_volume(fine.surface_points, fine.triangles), volumes(coarse).sum(), rtol=1e-14, atol=0
    )
    children = facet_area_vectors(fine.surface_points, fine.triangles).reshape(6, 4, 3)
    whole = facet_area_vectors(coarse.surface_points, coarse.triangles)
    assert_allclose(children, np.repeat(whole[:, None] / 4, 4, axis=1), rtol=1e-13, atol=1e-15)
    middles = coarse.surface_points[parents].mean(axis=1)
    assert_allclose(fine.surface_points, middles, rtol=1e-15, atol=1e-16)


def test_a_surface_without_an_inside_is_split_as_that_of_a_body() -> None:
    body = wedge()
    fine, parents = refine(body)
    bare, same_parents = refine(surface_only(body))
    assert bare.tetrahedra.shape == (0, 4)
    assert_allclose(bare.points, bare.surface_points, rtol=0, atol=0)
    # the middles of the edges may come in another order
    place = {tuple(row): node for node, row in enumerate(np.sort(same_parents, axis=1).tolist())}
    order = np.array([place[tuple(row)] for row in np.sort(parents, axis=1).tolist()])
    assert_allclose(bare.surface_points[order], fine.surface_points, rtol=0, atol=1e-15)
    facets = {tuple(sorted(row)) for row in order[fine.triangles].tolist()}
    assert facets == {tuple(sorted(row)) for row in bare.triangles.tolist()}
    assert_allclose(
        enclosed_volume(bare.surface_points, bare.triangles), volumes(body).sum(), rtol=1e-14, atol=0
    )
    again, _ = refine(bare)
    assert len(again.triangles) == 16 * len(body.triangles)


def test_the_boundary_of_the_tetrahedra_is_the_surface() -> None:
    fine, _ = refine(wedge())
    facets = np.sort(fine.tetrahedra[:, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]].reshape(-1, 3), axis=1)
    unique, counts = np.unique(facets, axis=0, return_counts=True)
    boundary = {tuple(row) for row in unique[counts == 1].tolist()}
    assert boundary == {tuple(row) for row in np.sort(fine.surface_nodes[fine.triangles], axis=1).tolist()}


def test_a_region_keeps_its_facets() -> None:
    coarse = wedge()
    fine, parents = refine(coarse)
    mask = np.array([True, True, True, False, False])  # one facet, in the plane z = 0
    inherited = inherit(mask, coarse, parents)
    assert inherited.sum() == 6
    area = np.linalg.norm(facet_area_vectors(fine.surface_points, fine.triangles), axis=1)
    assert_allclose(area[inherited[fine.triangles].all(axis=1)].sum(), 0.5, rtol=1e-14, atol=0)
    # two nodes without a facet between them: no node appears between them
    assert inherit(np.array([True, False, False, False, True]), coarse, parents).sum() == 2
    lone_edge = np.array([True, True, False, False, False])
    assert inherit(lone_edge, coarse, parents).sum() == 2


def test_forces_on_a_refinement_keep_their_sum_and_moment_on_the_body() -> None:
    """Half of a middle's force goes to either end of its edge, twice on two levels."""
    hierarchy = refined(wedge(), 2)
    coarse, fine = wedge().surface_points, hierarchy.finest.surface_points
    force = np.random.default_rng(2).normal(size=(2, len(fine), 3))
    found = hierarchy.restrict(force)
    assert_allclose(found.sum(axis=1), force.sum(axis=1), rtol=0, atol=1e-13)
    moments = (np.cross(points, forces).sum(axis=1) for points, forces in ((coarse, found), (fine, force)))
    assert_allclose(*moments, rtol=0, atol=1e-13)
