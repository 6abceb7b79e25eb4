"""Meshes as arrays: measures, orientation, the checks of closed surfaces, slivers and shifts, refinement."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from solver_common.arrays import Array, Index
from tests.bodies import shaped
from vdmbench.body.distort import SLIVER_SHARE, aspect_ratios, distorted
from vdmbench.body.geometry import build_mesh
from vdmbench.body.intersections import intersecting_facets, without_intersections
from vdmbench.body.mesh import Mesh
from vdmbench.body.refine import inherit, refine, refined
from vdmbench.body.remesh import unit_sphere
from vdmbench.body.repair import clean_surface
from vdmbench.body.surface_measures import enclosed_volume, facet_area_vectors
from vdmbench.body.topology import (
    canonical_triangles,
    check_vertex_fans,
    consistent_orientation,
    mesh_from_tetrahedra,
    mesh_from_triangles,
    surface_only,
    tetrahedron_sicn,
    tetrahedron_volumes,
)
from vdmbench.study.errors import MeshError

CORNER = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def cube() -> tuple[Array, Index]:
    """The unit cube as 5 tetrahedra: one regular in the middle, four corners of it cut off."""
    points = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
    tetrahedra = np.array([[0, 3, 5, 6], [0, 3, 1, 5], [0, 6, 2, 3], [0, 5, 4, 6], [3, 6, 7, 5]])
    inverted = tetrahedron_volumes(points, tetrahedra) < 0
    tetrahedra[inverted] = tetrahedra[inverted][:, [0, 2, 1, 3]]
    return points, tetrahedra


def test_volumes_and_quality_of_known_tetrahedra() -> None:
    regular = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    points = np.concatenate([regular, CORNER, [[0.3, 0.3, 0.0]]])
    tetrahedra = np.array([[0, 2, 1, 3], [0, 1, 2, 3], [4, 5, 6, 7], [4, 5, 6, 8]])
    signed = tetrahedron_volumes(points, tetrahedra)
    assert_allclose(np.abs(signed), [8 / 3, 8 / 3, 1 / 6, 0], rtol=1e-14, atol=1e-16)
    assert signed[0] * signed[1] < 0
    # the corner: |S|^2 = tr G^-1 = 4.5 and |S^-1|^2 = tr G = 3, G the Gram matrix of a regular one's edges
    expected = [np.sign(signed[0]), np.sign(signed[1]), 3 / np.sqrt(4.5 * 3), 0]
    assert_allclose(tetrahedron_sicn(points, tetrahedra), expected, rtol=1e-12, atol=1e-12)


def test_content_hash_sees_points_connectivity_and_groups_but_not_quality() -> None:
    points, tetrahedra = cube()
    mesh = mesh_from_tetrahedra(points, tetrahedra)
    moved = points.copy()
    moved[0, 0] -= 1e-15
    others = [
        mesh_from_tetrahedra(moved, tetrahedra),
        mesh_from_tetrahedra(points, tetrahedra[::-1]),
        mesh_from_tetrahedra(points, tetrahedra, groups={"floor": points[:, 2] == 0}),
    ]
    assert len({mesh.content_hash, *(other.content_hash for other in others)}) == 4
    assert replace(mesh, quality={"seconds": 3.0}).content_hash == mesh.content_hash


def test_orientation_is_mended_whatever_the_facets_were() -> None:
    points, triangles = unit_sphere(2)
    rng = np.random.default_rng(0)
    turned = rng.random(len(triangles)) < 0.5
    mixed = np.where(turned[:, None], triangles[:, ::-1], triangles)
    outward, flipped = consistent_orientation(points + 5.0, mixed)
    assert flipped == np.count_nonzero(turned)
    assert_array_equal(canonical_triangles(outward), canonical_triangles(triangles))


def projective_plane() -> Index:
    """The six-vertex projective plane: closed, every edge with two facets, and one-sided."""
    facets = "012 023 034 045 051 124 235 341 452 513"
    return np.array([[int(node) for node in facet] for facet in facets.split()])


def two_cubes_on_an_edge() -> tuple[Array, Index]:
    points, tetrahedra = cube()
    mesh = mesh_from_tetrahedra(points, tetrahedra)
    shift = np.array([1.0, 1.0, 0.0])
    both = np.concatenate([points, points + shift])
    merged = clean_surface_points(both)
    return both, merged[np.concatenate([mesh.triangles, mesh.triangles + 8])]


def clean_surface_points(points: Array) -> Index:
    """For each point the first equal one."""
    return np.array([int(np.flatnonzero((points == point).all(axis=1))[0]) for point in points])


@pytest.mark.parametrize(
    ("points", "triangles", "words"),
    [
        (CORNER, FACES[:3], r"open, in 1 place \(3 edges"),
        (*two_cubes_on_an_edge(), "not manifold: 1 edges"),
        (
            np.concatenate([CORNER, CORNER + 5]),
            np.concatenate([FACES, FACES + 4]),
            r"separate pieces, in 2 places \(.* facets about .*\); keep one",
        ),
        (np.random.default_rng(0).random((6, 3)), projective_plane(), "one-sided"),
        (CORNER * [1, 1, 0], FACES, "no volume"),
    ],
)
def test_surfaces_that_bound_no_solid(points: Array, triangles: Index, words: str) -> None:
    with pytest.raises(MeshError, match=words):
        mesh_from_triangles(points, triangles)


def test_pieces_that_touch_at_a_vertex_are_found() -> None:
    points = np.concatenate([CORNER, -CORNER[1:]])
    mirrored = np.where(FACES > 0, FACES + 3, 0)[:, ::-1]
    with pytest.raises(MeshError, match="at 1 vertices"):
        check_vertex_fans(np.concatenate([FACES, mirrored]))
    check_vertex_fans(FACES)
    with pytest.raises(MeshError, match="separate pieces, in 2 places"):
        mesh_from_triangles(points, np.concatenate([FACES, mirrored]))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"points": np.where(np.arange(8)[:, None] == 3, np.nan, cube()[0])}, "1 points .* not finite"),
        ({"tetrahedra": cube()[1][:0]}, "no tetrahedra"),
        ({"tetrahedra": cube()[1][:, [1, 0, 2, 3]]}, "5 of 5 tetrahedra are inverted"),
        ({"points": cube()[0] * [1, 1, 0]}, "5 of 5 tetrahedra have no volume"),
    ],
)
def test_tetrahedra_that_cannot_be_used(change: dict[str, Any], words: str) -> None:
    points, tetrahedra = cube()
    with pytest.raises(MeshError, match=words):
        mesh_from_tetrahedra(change.get("points", points), change.get("tetrahedra", tetrahedra))


@pytest.mark.parametrize(
    ("tips", "words"),
    [
        ([[0.1, 0.1, 0.5]], "overlap"),
        ([[0, 0, 2.0], [0.1, 0.1, 3.0]], "1 faces belong to more than two"),
    ],
)
def test_tetrahedra_on_one_face_are_refused(tips: list[list[float]], words: str) -> None:
    tetrahedra = np.array([[0, 1, 2, tip] for tip in range(3, 4 + len(tips))])
    with pytest.raises(MeshError, match=words):
        mesh_from_tetrahedra(np.concatenate([CORNER, tips]), tetrahedra)


# --- repair -------------------------------------------------------------------------------------------


def test_soup_becomes_a_clean_surface() -> None:
    points, triangles = unit_sphere(2)
    soup = points[triangles].reshape(-1, 3) * (
        1 + 1e-8 * np.random.default_rng(0).random((3 * len(triangles), 1))
    )
    facets = np.arange(len(soup)).reshape(-1, 3)
    facets = np.concatenate([facets[:, ::-1], facets[:5], [[0, 1, 1]]])  # inside out, 5 repeated, one a line
    clean = clean_surface(np.concatenate([soup, [[7.0, 7, 7]]]), facets)
    assert len(clean.points) == len(points)
    assert len(clean.cells) == len(triangles)
    assert clean.repairs == {
        "points_dropped": 1,
        "points_merged": len(soup) - len(points),
        "facets_dropped": 6,
        "facets_flipped": len(triangles),
        "facets_of_other_pieces": 0,
        "facets_added": 0,
    }
    assert_allclose(
        enclosed_volume(clean.points, clean.cells), enclosed_volume(points, triangles), rtol=1e-7, atol=0
    )


def test_a_double_fin_is_removed() -> None:
    points, triangles = unit_sphere(1)
    a, b = triangles[0, :2]
    fin = [[a, b, len(points)], [b, a, len(points)]]
    clean = clean_surface(np.concatenate([points, [[3.0, 0, 0]]]), np.concatenate([triangles, fin]))
    assert_array_equal(canonical_triangles(clean.cells), canonical_triangles(triangles))


@pytest.mark.parametrize(
    ("points", "triangles", "words"),
    [
        (CORNER, FACES[:0], "no facets"),
        (CORNER, FACES + 1, "do not exist"),
        (CORNER, FACES - 1, "do not exist"),
        (np.where(CORNER == 1, np.inf, CORNER), FACES, "3 points .* not finite"),
        (CORNER * 0, FACES, "all points are the same"),
        (CORNER, np.array([[0, 1, 1], [2, 2, 3]]), "no facet has an area"),
        (CORNER, FACES[:3], "open"),
    ],
)
def test_soup_beyond_repair(points: Array, triangles: Index, words: str) -> None:
    with pytest.raises(MeshError, match=words):
        clean_surface(points, triangles)


# --- self-intersections -------------------------------------------------------------------------------


def test_intersections_are_those_that_sampling_finds() -> None:
    """Two balls cut each other: a facet is hit where its edges, finely sampled, change sides of the other."""
    points, triangles = unit_sphere(2)
    n = len(points)
    shift = np.array([0.9, 0.13, 0.07])
    found = intersecting_facets(
        np.concatenate([points, points + shift]), np.concatenate([triangles, triangles + n])
    )
    assert (found[:, 0] < len(triangles)).all()
    assert (found[:, 1] >= len(triangles)).all()
    normals = facet_area_vectors(points, triangles)

    def inside(x: Array) -> Array:  # of the convex polyhedron about the origin
        return (
            np.einsum("ij,fj->if", x, normals) < np.einsum("fj,fj->f", points[triangles[:, 0]], normals)
        ).all(axis=1)

    samples = np.linspace(0, 1, 101)[:, None]
    # a facet can be cut without its edges changing sides (a corner of the other pokes through): supersets
    for column, offset in ((0, -shift), (1, shift)):
        crossed = set()
        for facet, (a, b, c) in enumerate(points[triangles] + offset):
            path = np.concatenate([a + samples * (b - a), b + samples * (c - b), c + samples * (a - c)])
            within = inside(path)
            if within.any() and not within.all():
                crossed.add(facet + column * len(triangles))
        assert crossed <= set(found[:, column].tolist())
        assert len(crossed) > 20


def test_a_tangle_is_smoothed_out() -> None:
    points, triangles = unit_sphere(3)
    second_ring = np.flatnonzero(np.linalg.norm(points - points[0], axis=1) > 0.25)
    other = second_ring[np.argmin(np.linalg.norm(points[second_ring] - points[0], axis=1))]
    broken = points.copy()
    broken[[0, other]] = points[[other, 0]]
    assert len(intersecting_facets(broken, triangles)) > 0
    mended, found = without_intersections(broken, triangles)
    assert found == len(intersecting_facets(broken, triangles))
    assert len(intersecting_facets(mended, triangles)) == 0
    moved = np.linalg.norm(mended - broken, axis=1) > 0
    assert np.count_nonzero(moved) < 60
    assert enclosed_volume(mended, triangles) == pytest.approx(enclosed_volume(points, triangles), rel=0.02)


def test_a_surface_pushed_through_itself_is_refused() -> None:
    points, triangles = unit_sphere(3)
    pushed = points.copy()
    pushed[points[:, 2] > 0.6, 2] -= 2.5
    with pytest.raises(MeshError, match="cuts through itself"):
        without_intersections(pushed, triangles)


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
