"""Slivers and random shifts: as bad as asked for, no worse anywhere else, the same every time."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.bodies import shaped
from vdmbench.body.distort import SLIVER_SHARE, aspect_ratios, distorted
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh import Mesh
from vdmbench.body.surface_measures import facet_area_vectors
from vdmbench.body.topology import tetrahedron_sicn, tetrahedron_volumes
from vdmbench.study.errors import MeshError


def body(*, volume: bool, **distortions: float) -> Mesh:
    parameters = {"semi_axes": (0.06, 0.045, 0.02), **distortions}
    return build_mesh(shaped("ellipsoid", 0.008, parameters), volume=volume)


@pytest.fixture(scope="module", params=[False, True], ids=["surface", "tetrahedra"])
def plain(request: pytest.FixtureRequest) -> Mesh:
    return body(volume=request.param)


def normals(mesh: Mesh) -> np.ndarray:
    vectors = facet_area_vectors(mesh.surface_points, mesh.triangles)
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_the_aspect_ratio_is_the_longest_edge_over_its_height() -> None:
    points = np.array([[0.0, 0, 0], [4, 0, 0], [2, 0.5, 0], [2, 4 * np.sqrt(3) / 2, 0]])
    assert_allclose(
        aspect_ratios(points, np.array([[0, 1, 2], [0, 1, 3]])), [8.0, 2 / 3**0.5], rtol=1e-14, atol=0
    )


@pytest.mark.parametrize("ratio", [20.0, 1e4])
def test_one_facet_in_twenty_five_is_a_sliver_and_the_others_are_sound(plain: Mesh, ratio: float) -> None:
    mesh = distorted(plain, slivers=ratio, perturbation=None)
    ratios = aspect_ratios(mesh.surface_points, mesh.triangles)
    slivers = ratios > 15
    assert slivers.sum() == mesh.quality["slivers"] == round(SLIVER_SHARE * len(mesh.triangles))
    assert_allclose(ratios[slivers], ratio, rtol=1e-6, atol=0)
    assert (ratios[~slivers] < 12).all()
    turn = np.einsum("ij,ij->i", normals(mesh), normals(plain))
    assert (turn > 0.5).all(), "no facet is turned over"
    assert_allclose(turn[slivers], 1.0, rtol=0, atol=1e-8, err_msg="a sliver stays in the plane of its facet")
    moved = (mesh.points != plain.points).any(axis=1)
    assert moved.sum() == slivers.sum(), "one node each"
    if len(mesh.tetrahedra):
        flat = moved[mesh.tetrahedra].any(axis=1)
        assert (tetrahedron_volumes(mesh.points, mesh.tetrahedra) > 0).all()
        sicn = tetrahedron_sicn(mesh.points, mesh.tetrahedra)
        assert np.count_nonzero(sicn <= 0.02) <= slivers.sum()
        assert_array_equal(sicn[~flat], tetrahedron_sicn(plain.points, plain.tetrahedra)[~flat])
        assert mesh.quality["worst_sicn"] == sicn.min()


def test_shifts_stay_within_the_share_of_the_shortest_edge(plain: Mesh) -> None:
    mesh = distorted(plain, slivers=None, perturbation=0.4)
    cells = plain.tetrahedra if len(plain.tetrahedra) else plain.triangles
    shift = np.linalg.norm(mesh.points - plain.points, axis=1)
    for node in range(0, len(plain.points), 37):
        around = np.unique(cells[(cells == node).any(axis=1)])
        edges = np.linalg.norm(plain.points[around[around != node]] - plain.points[node], axis=1)
        assert 0 < shift[node] <= 0.4 * edges.min() * (1 + 1e-12)
    assert np.median(shift) > 0.15 * 0.008, "and they are that large"
    if len(mesh.tetrahedra):
        assert (tetrahedron_volumes(mesh.points, mesh.tetrahedra) > 0).all()
    assert (np.einsum("ij,ij->i", normals(mesh), normals(plain)) > 0.2).all()


def test_the_seed_decides_and_nothing_else() -> None:
    first, again, other = (body(volume=False, perturbation=0.2, slivers=50, seed=s) for s in (1, 1, 2))
    assert first.content_hash == again.content_hash != other.content_hash
    assert_array_equal(first.triangles, other.triangles)


def test_a_mesh_that_cannot_be_distorted_is_refused() -> None:
    # every facet is a needle already, so that none is sound beside another
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 100, 0], [0, 0, 1]])
    facets = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    mesh = Mesh(points, np.empty((0, 4), dtype=np.int64), np.arange(4), facets)
    with pytest.raises(MeshError, match="no facet of this mesh can be squeezed"):
        distorted(mesh, slivers=1e4, perturbation=None)
