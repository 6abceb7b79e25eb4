"""Areas, volumes, normals and the checks of `SurfaceMesh` and of the deformed surface."""

from pathlib import Path

import meshio
import numpy as np
import pytest
import pyvista
from numpy.testing import assert_allclose, assert_array_equal

from tests.vdm.vdm_shapes import box, icosphere, torus
from tests.verification.records import Verified
from vdm import SurfaceError, SurfaceMesh
from vdm.deformed import DeformableSurface, follow


def test_box_by_hand():
    surface = SurfaceMesh(*box(1, (1.0, 2.0, 3.0)))
    assert_allclose(surface.volume, 6.0, rtol=1e-15, atol=0.0)
    assert_allclose(surface.area, 22.0, rtol=1e-15, atol=0.0)
    # equations 2 and 4
    assert_allclose(surface.nodal_areas.sum(), surface.area, rtol=1e-15, atol=0.0)
    assert_allclose(surface.nodal_volumes.sum(), surface.volume, rtol=1e-15, atol=0.0)
    assert_allclose(surface.area_vectors.sum(axis=0), 0.0, rtol=0.0, atol=1e-14)
    assert surface.genus == 0
    assert len(surface.edges) == 18


def test_equation_1_facet_by_facet():
    surface = SurfaceMesh(*icosphere(1, (1.0, 2.0, 0.5)))
    expected = np.zeros(surface.n_nodes)
    for a, b, c in surface.triangles:
        p, q, r = surface.points[[a, b, c]]
        expected[[a, b, c]] += np.linalg.norm(np.cross(q - p, r - p)) / 6.0
    assert_allclose(surface.nodal_areas, expected, rtol=1e-14, atol=0.0)
    assert_allclose(surface.nodal_volumes, expected * surface.volume / surface.area, rtol=1e-14, atol=0.0)


@pytest.mark.anchor(
    "VDM: gradient of the volume", "g_i = sum A_f n_f / 3, by differences of the exact cubic V(s)"
)
def test_area_vectors_are_the_gradient_of_the_volume(verified: Verified):
    surface = SurfaceMesh(*icosphere(1, (1.0, 0.8, 1.3)))
    body = DeformableSurface(surface)
    direction = np.random.default_rng(0).standard_normal(surface.points.shape)
    step = 1e-4
    volumes = [body.at(s * step * direction).volume for s in (-2, -1, 0, 1, 2)]
    # V is cubic in the step, so that the five-point rule is exact up to rounding / step
    slope = (volumes[0] - 8 * volumes[1] + 8 * volumes[3] - volumes[4]) / (12 * step)
    verified.at_most("g . du - dV", np.vdot(surface.area_vectors, direction) - slope, 1e-10)
    assert_allclose(body.at(np.zeros_like(direction)).volume, surface.volume, rtol=1e-14, atol=0.0)
    fourth = volumes[0] - 4 * volumes[1] + 6 * volumes[2] - 4 * volumes[3] + volumes[4]
    assert_allclose(fourth, 0.0, rtol=0.0, atol=1e-14)


def test_deformed_areas_are_those_of_a_new_surface():
    points, triangles = torus()
    displacement = 0.003 * np.random.default_rng(1).standard_normal(points.shape)
    new, moved = (
        SurfaceMesh(points + displacement, triangles),
        DeformableSurface(SurfaceMesh(points, triangles)),
    )
    state = moved.at(displacement)
    assert_allclose(state.nodal_areas, new.nodal_areas, rtol=1e-13, atol=0.0)
    assert_allclose(state.area_vectors, new.area_vectors, rtol=0.0, atol=1e-13 * new.area)
    assert_allclose(state.volume, new.volume, rtol=1e-13, atol=0.0)
    assert new.genus == 1


def test_volume_far_from_the_origin():
    points, triangles = icosphere(2)
    near, far = SurfaceMesh(points, triangles), SurfaceMesh(points + 1e4, triangles)
    assert_allclose(far.volume, near.volume, rtol=1e-11, atol=0.0)


def test_cotangent_weights_of_a_regular_tetrahedron_and_a_flat_box():
    points = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float)
    surface = SurfaceMesh(points, np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]))
    # both angles opposite an edge are 60 degrees
    assert_allclose(surface.cotangent_weights, 1.0 / np.sqrt(3.0), rtol=1e-14, atol=0.0)
    grid = SurfaceMesh(*box(3))
    # the Laplacian of a coordinate is zero inside a flat face
    laplacian = grid.laplacian(grid.cotangent_weights) @ grid.points
    inside = np.count_nonzero((grid.points == 0.0) | (grid.points == 1.0), axis=1) == 1
    assert_allclose(laplacian[inside], 0.0, rtol=0.0, atol=1e-14)


def test_a_following_force_is_the_follower_pressure():
    surface = SurfaceMesh(*icosphere(1))
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    force = np.random.default_rng(2).standard_normal(surface.points.shape)
    body = DeformableSurface(surface)
    grown = body.at(2.0 * surface.points @ turn.T - surface.points)
    pressed = follow(-3.0 * surface.area_vectors, surface.area_vectors, grown)
    assert_allclose(pressed, -12.0 * surface.area_vectors @ turn.T, rtol=0.0, atol=1e-13)
    # a body that turns takes its forces along, whatever their angle to the surface
    taken = follow(force, surface.area_vectors, grown)
    assert_allclose(taken, 4.0 * force @ turn.T, rtol=0.0, atol=1e-13)
    # one node's own turn comes on top: its force keeps its length per area and its angle to the normal
    dented = body.at(np.where(surface.points[:, 2:] > 0.99, [0.05, 0.0, -0.1], 0.0))
    size = np.linalg.norm(dented.area_vectors, axis=1) / np.linalg.norm(surface.area_vectors, axis=1)
    followed = follow(force, surface.area_vectors, dented)
    assert_allclose(
        np.linalg.norm(followed, axis=1), size * np.linalg.norm(force, axis=1), rtol=1e-13, atol=0.0
    )
    along = np.einsum("ic,ic->i", followed, dented.area_vectors) / size**2
    assert_allclose(along, np.einsum("ic,ic->i", force, surface.area_vectors), rtol=0.0, atol=1e-13)


def _bad_surfaces():
    points, triangles = icosphere(1)
    other = points + 5.0
    swapped = triangles.copy()
    swapped[0] = swapped[0][[0, 2, 1]]
    flat = points.copy()
    a, b, c = triangles[0]
    flat[c] = 0.5 * (flat[a] + flat[b])
    nan = points.copy()
    nan[3, 1] = np.nan
    # two bodies that share one node
    joined = np.concatenate([points, (2.0 * points[0] - points)[1:]])
    mirrored = np.where(triangles == 0, 0, triangles + len(points) - 1)[:, ::-1]
    # pieces that are no cavities: not turned inside out, outside, and both
    pieces = (
        (0.5 * points, triangles),
        (0.5 * points + 3.0, triangles[:, ::-1]),
        (0.5 * points + 3.0, triangles),
    )
    no_body = {
        f"piece {k}": (
            np.vstack([points, x]),
            np.vstack([triangles, t + len(points)]),
            "do not bound one body",
        )
        for k, (x, t) in enumerate(pieces)
    }
    return no_body | {
        "open": (points, triangles[1:], "open"),
        "duplicate": (points, np.concatenate([triangles, triangles[:1]]), "not manifold"),
        "swapped": (points, swapped, "oriented against"),
        "inverted": (points, triangles[:, ::-1], "inverted"),
        "flat": (flat, triangles, "no area"),
        "repeated": (
            points,
            np.where(np.arange(len(triangles))[:, None] == 0, triangles[0, 0], triangles),
            "no area",
        ),
        "two": (
            np.concatenate([points, other]),
            np.concatenate([triangles, triangles + len(points)]),
            "2 components",
        ),
        "pinched": (joined, np.concatenate([triangles, mirrored]), "touches itself at 1 nodes"),
        "nan": (nan, triangles, "nan or inf"),
        "orphan": (np.concatenate([points, [[0, 0, 0]]]), triangles, "no facet"),
        "range": (points[:-1], triangles, "outside 0..40"),
        "float": (points, triangles.astype(float), "integers"),
        "shape": (points[:, :2], triangles, "shape"),
        "few": (points, triangles[:2], "F >= 4"),
    }


@pytest.mark.parametrize("name", _bad_surfaces())
def test_bad_surfaces_have_one_clear_error(name):
    points, triangles, message = _bad_surfaces()[name]
    with pytest.raises(SurfaceError, match=message):
        SurfaceMesh(points, triangles)


def test_what_pyvista_reads_of_an_stl_is_taken(tmp_path: Path) -> None:
    points, triangles = icosphere(2)
    meshio.write_points_cells(tmp_path / "ball.stl", points, [("triangle", triangles)])
    read = pyvista.read(tmp_path / "ball.stl")
    surface = SurfaceMesh(read.points, read.faces)
    assert surface.volume == pytest.approx(SurfaceMesh(points, triangles).volume, rel=1e-6)
    with pytest.raises(SurfaceError, match="a 3 before each triangle"):
        SurfaceMesh(points, np.full(8, 4))


def test_corners_of_their_own_are_named_and_merged_on_request() -> None:
    points, triangles = icosphere(2)
    soup, own = points[triangles].reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)
    extra = len(soup) - len(points)
    told = (
        rf"the surface is open: .*; {extra} points stand where another one stands \(first: 0\).* merge=True"
    )
    with pytest.raises(SurfaceError, match=told):
        SurfaceMesh(soup, own)
    merged = SurfaceMesh(soup, own, merge=True)
    assert merged.n_nodes == len(points)
    assert_array_equal(merged.points[merged.triangles], points[triangles])
    assert_array_equal(merged.points[0], soup[0])
    untouched = SurfaceMesh(points, triangles, merge=True)
    assert_array_equal(untouched.points[untouched.triangles], points[triangles])
    with pytest.raises(SurfaceError, match=r"close the holes$"):
        SurfaceMesh(points, triangles[1:])
