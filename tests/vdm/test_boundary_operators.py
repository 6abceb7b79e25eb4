"""The Galerkin boundary operators: rigid motions, pressures, Kelvin's fields, and facets that share a traction."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from tests.vdm.vdm_shapes import box, icosphere, torus
from vdm import Load, Model, Parameters, SurfaceMesh
from vdm.boundary import collapses, kernels, operators
from vdm.boundary.coarsening import coarsened
from vdm.boundary.operators import Facets, assembled, layers, surface_stiffness
from vdm.boundary.tractions import shared
from vdm.surface import rigid_basis

Array = NDArray[np.float64]
RATIOS = (-0.5, 0.0, 0.3, 0.4999, 0.5)


def body(level: int = 1) -> Facets:
    return Facets.of(*icosphere(level, (1.0, 0.7, 0.5)))


def equations(facets: Facets, nu: float) -> tuple[Array, Array, Array]:
    """V (3F, 3F), J = M/2 + K (3F, 3N) and D (3N, 3N) of `V t = J u`, `f = D u + J^T t`."""
    parts = assembled(facets, nu)
    return parts.single, parts.jump, parts.hypersingular


@pytest.mark.parametrize("shape", [icosphere(1), box(3, (1.0, 0.8, 0.05))], ids=["ball", "thin plate"])
def test_every_rule_agrees_with_a_finer_one(shape: tuple[Array, NDArray[np.int64]]) -> None:
    """Each facet cut into four, the cut ones summed: other rules at other distances, the same integrals."""
    points, triangles = shape
    facets = Facets.of(points, triangles)
    corners = points[triangles]
    middles = 0.5 * (corners + np.roll(corners, -1, axis=1))
    ab, bc, ca = (middles[:, k] for k in range(3))
    a, b, c = (corners[:, k] for k in range(3))
    cut = np.stack([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]).transpose(2, 0, 1, 3)
    nodes, numbers = np.unique(cut.reshape(-1, 3).round(12), axis=0, return_inverse=True)
    finer = Facets.of(nodes, numbers.reshape(-1, 3))
    whole, *_, double = layers(facets, 0.3)
    parts, *_, double_parts = layers(finer, 0.3)
    n = len(triangles)
    summed = parts.reshape(n, 4, 3, n, 4, 3).sum(axis=(1, 4)).reshape(3 * n, 3 * n)
    # 3e-4 where facets touch, 1e-3 where they face each other closer than they are wide
    assert_allclose(summed, whole, rtol=0.0, atol=1e-3 * np.abs(whole).max())
    # of a constant: the nodes of the finer mesh sum up
    assert_allclose(
        double_parts.reshape(n, 4, -1).sum(axis=(1, 2)),
        double.sum(axis=1),
        rtol=0.0,
        atol=1e-4 * facets.areas.max(),
    )


@pytest.mark.parametrize("nu", RATIOS)
def test_a_shear_strain_is_answered_by_its_tractions(nu: float) -> None:
    """A uniform strain is linear and its tractions are constant on facets: only quadrature is left."""
    facets = body()
    strain = np.array([[1.0, 0.4, 0.0], [0.4, -0.3, 0.2], [0.0, 0.2, -0.7]])
    u, t = (facets.points @ strain).reshape(-1), (2.0 * facets.normals @ strain).reshape(-1)
    single, jump, hypersingular = equations(facets, nu)
    moved = single @ t
    assert_allclose(jump @ u, moved, rtol=0.0, atol=2e-4 * np.abs(moved).max())
    force = np.zeros((len(facets.points), 3))
    np.add.at(force, facets.triangles, (facets.areas[:, None] * t.reshape(-1, 3) / 3.0)[:, None])
    balanced = hypersingular @ u + jump.T @ t
    assert_allclose(balanced, force.reshape(-1), rtol=0.0, atol=2e-4 * np.abs(force).max())
    # a bulk modulus of 5,000 mu answers what quadrature leaves of a volume
    atol = (5e-3 if nu == 0.4999 else 5e-4) * np.abs(force).max()
    lacking = (surface_stiffness(facets, nu) @ u).reshape(-1, 3) - force
    if nu == 0.5:  # the stiffness leaves the mean pressure to the fluid
        pressed = np.zeros_like(force)
        np.add.at(pressed, facets.triangles, (facets.areas[:, None] * facets.normals / 3.0)[:, None])
        lacking -= pressed * np.vdot(pressed, lacking) / np.vdot(pressed, pressed)
    assert_allclose(lacking, 0.0, rtol=0.0, atol=atol)


@pytest.mark.parametrize(("nu", "flat"), [(0.5, 1.0), (0.3, 0.2)], ids=["torus", "slivers"])
def test_single_precision_is_not_seen_in_an_answer(
    nu: float, flat: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without forces of their own for smooth displacements it leaves 1e-5, on slivers 1e-3."""
    points, triangles = torus(n=14, m=8)
    facets = Facets.of(points * [1.0, 1.0, flat], triangles)
    motions = rigid_basis(SurfaceMesh(facets.points, triangles))
    free = np.repeat(points[:, 0] > points[:, 0].min() + 0.02, 3)
    force = np.where(points[:, 0] > points[:, 0].max() - 0.02, 1.0, 0.0)[:, None] * [0.0, 0.0, 1.0]
    answers = []
    for most in (len(points), 0):
        monkeypatch.setattr(operators, "DOUBLE_NODES", most)
        stiffness = surface_stiffness(facets, nu)
        left = stiffness @ motions
        left -= 0.5 * motions @ (motions.T @ left)
        stiffness -= left @ motions.T + motions @ left.T
        answers.append(np.linalg.solve(stiffness[np.ix_(free, free)], force.reshape(-1)[free]))
    exact, found = answers
    assert np.linalg.norm(found - exact) < (2e-6 if flat == 1.0 else 5e-5) * np.linalg.norm(exact)
    assert not np.array_equal(found, exact)


@pytest.mark.parametrize("n_nodes", [operators.DOUBLE_NODES, operators.DOUBLE_NODES + 1])
def test_what_is_compiled_once_is_compiled_before_it_is_timed(n_nodes: int) -> None:
    """After `compile_for` a set-up in that precision finds every loop as machine code."""
    operators.compile_for(n_nodes)
    loops = (
        kernels.all_pairs,
        kernels.mirror,
        kernels.add_layers,
        kernels.add_transposed,
        kernels.add_own_transposed,
        collapses.usable,
        collapses.costs,
    )
    known = [len(loop.signatures) for loop in loops]
    for nu in (0.3, 0.5):
        surface_stiffness(body(), nu, operators.precision(n_nodes))
    coarsened(SurfaceMesh(*icosphere(2)), 60)
    assert [len(loop.signatures) for loop in loops] == known


Index = NDArray[np.int64]


def rough(level: int = 2) -> tuple[Array, Index]:
    """An ellipsoid whose facets are all unlike."""
    points, triangles = icosphere(level, (0.05, 0.04, 0.03))
    return points + 1e-3 * np.random.default_rng(0).standard_normal(points.shape), triangles


def members(numbers: Index) -> list[Index]:
    return [np.flatnonzero(numbers == number) for number in range(numbers.max() + 1)]


@pytest.mark.parametrize("shape", [rough(), box(8, (0.04, 0.04, 0.04))], ids=["rough", "box"])
def test_neighbours_share_a_traction_but_at_the_rim(shape: tuple[Array, Index]) -> None:
    points, triangles = shape
    surface, held = SurfaceMesh(points, triangles), points[:, 2] < np.median(points[:, 2]) - 0.01
    numbers = shared(surface, held)
    i, j = surface.edges.T
    rim = surface.edges[held[i] != held[j]]
    at_rim = np.isin(triangles, rim[held[rim]]).any(axis=1)
    alone = 0
    for facets in members(numbers):
        if len(facets) == 1:
            alone += not at_rim[facets[0]]
        else:
            first, second = facets
            assert len(set(triangles[first]) & set(triangles[second])) == 2
            assert not at_rim[facets].any()
    assert at_rim.any()
    assert alone < 0.16 * (~at_rim).sum()


def test_facets_at_a_right_angle_or_more_share_none() -> None:
    """A box has no pair over an edge; at the rim of a double cone, sharper than that, two would have no normal."""
    around = 2.0 * np.pi * np.arange(12) / 12
    rim = np.stack([np.cos(around), np.sin(around), np.zeros(12)], axis=1)
    cone = np.vstack([rim, [[0.0, 0.0, 0.2], [0.0, 0.0, -0.2]]])
    i, j = np.arange(12), np.roll(np.arange(12), -1)
    sides = np.vstack([np.stack([i, j, np.full(12, 12)], axis=1), np.stack([j, i, np.full(12, 13)], axis=1)])
    for points, triangles in (box(8, (0.04, 0.04, 0.04)), (cone, sides)):
        surface = SurfaceMesh(points, triangles)
        normals = Facets.of(points, triangles).normals
        pairs = [two for two in members(shared(surface, np.zeros(len(points), np.bool_))) if len(two) == 2]
        assert len(pairs) > 0.4 * len(triangles)
        assert min(normals[first] @ normals[second] for first, second in pairs) > 0.8


@pytest.mark.parametrize("nu", [0.3, 0.4999, 0.5])
def test_the_operators_are_those_of_all_tractions_summed_up(nu: float) -> None:
    points, triangles = rough(1)
    numbers = shared(SurfaceMesh(points, triangles), points[:, 0] < -0.03)
    own, few = Facets.of(points, triangles), Facets.of(points, triangles, numbers)
    spread = np.zeros((len(triangles), 3, few.n_tractions, 3))
    for f, number in enumerate(numbers):
        mean = (own.areas[:, None] * own.normals)[numbers == number].sum(axis=0)
        mean /= np.linalg.norm(mean)
        spread[f, :, number] = np.eye(3) + np.outer(own.normals[f] - mean, mean)
    spread = spread.reshape(3 * len(triangles), -1)
    whole, parts = assembled(own, nu), assembled(few, nu)
    for found, expected in (
        (parts.single, spread.T @ whole.single @ spread),
        (parts.jump, spread.T @ whole.jump),
        (parts.hypersingular, whole.hypersingular),
    ):
        assert_allclose(found, expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())


def test_a_solid_next_to_incompressible_keeps_its_volume(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a uniform pressure among the shared tractions it loses its bulk modulus."""
    monkeypatch.setattr(operators, "DOUBLE_NODES", 0)
    points, triangles = rough()
    load = Load(np.where(points[:, 2] > 0.02, 10.0, 0.0))
    answers = []
    for nu in (0.4997, 0.5):
        parameters = Parameters(shear_modulus=1e3, poisson_ratio=nu)
        model = Model(points, triangles, parameters, formulation="bem", fixed=points[:, 2] < -0.02)
        answers.append(model.solve([load]).displacement[0])
    assert np.linalg.norm(answers[0] - answers[1]) < 3e-3 * np.linalg.norm(answers[1])
