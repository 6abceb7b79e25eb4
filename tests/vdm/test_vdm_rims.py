"""Facets that are cut along the rims of what is held: the same body, all nodes' answer, and a better one."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from solver_common.arrays import Mask
from tests.vdm.vdm_shapes import BODY, POINTS, TRIANGLES, box
from vdm import Load, Model, Parameters, SurfaceMesh
from vdm.boundary.rims import Rims
from vdm.constraints import Support
from vdm.formulations.base import rigid_motions
from vdm.peers.bem import BoundaryFormulation
from vdm.problem import Problem
from vdm.solvers.linear import LinearSolver

BASE = POINTS[:, 2] < -0.02
SIDES = (0.04, 0.04, 0.04)


def soft(nu: float) -> Parameters:
    return Parameters(shear_modulus=1700.0, poisson_ratio=nu)


def problem(form: BoundaryFormulation, held: Mask) -> Problem:
    return Problem(form, Support(fixed=held, constrained=np.zeros_like(held)))


def test_a_cut_surface_is_the_same_body() -> None:
    rims = Rims.of(BODY, BASE)
    i, j = BODY.edges.T
    crossing = BASE[i] != BASE[j]
    assert rims.surface.n_nodes == BODY.n_nodes + crossing.sum() > BODY.n_nodes
    assert rims.surface.volume == pytest.approx(BODY.volume, rel=1e-13)
    assert rims.surface.area == pytest.approx(BODY.area, rel=1e-13)
    assert_allclose(rims.surface.points[: BODY.n_nodes], POINTS, rtol=0.0, atol=0.0)
    held, free = np.where(BASE[i], i, j)[crossing], np.where(BASE[i], j, i)[crossing]
    quarters = POINTS[held] + 0.25 * (POINTS[free] - POINTS[held])
    assert_allclose(rims.surface.points[BODY.n_nodes :], quarters, rtol=0.0, atol=1e-15)
    whole = Rims.of(BODY, np.zeros_like(BASE))
    assert whole.surface is BODY


def test_a_mirrored_body_is_cut_as_its_mirror_image() -> None:
    """Also along a rim so long that walks do not tell its nodes apart: lengths do."""
    points, triangles = box(counts=(2, 24, 3), size=(0.02, 0.24, 0.03))
    held = points[:, 2] <= points[:, 2].min()
    bodies = SurfaceMesh(points, triangles), SurfaceMesh(points * [1.0, -1.0, 1.0], triangles[:, ::-1])
    one, other = (np.sort(Rims.of(body, held).surface.triangles, axis=1).tolist() for body in bodies)
    assert sorted(one) == sorted(other)


@pytest.mark.parametrize("nu", [0.3, 0.45])
def test_the_eliminated_nodes_leave_the_answer_of_the_cut_surface(nu: float) -> None:
    """Forces at all its nodes, the new ones adding nothing to the volume: one system with a multiplier for that."""
    form = BoundaryFormulation(BODY, soft(nu), BASE)
    none = np.zeros(form.resolved.n_nodes, np.bool_)
    on_all = form._dense(Rims.of(form.resolved, none), none)
    force = np.random.default_rng(0).standard_normal(form.resolved.points.shape)
    n, shares = BODY.n_nodes, Rims.of(BODY, BASE).shares
    # sum of a . (u_new - shares of the ends)
    areas = np.zeros_like(force)
    areas[n:] = form.resolved.area_vectors[n:]
    areas[:n] -= shares[n:].T @ areas[n:]
    free = np.repeat(np.append(~BASE, np.ones(len(force) - n, np.bool_)), 3)
    added = areas.reshape(-1)[free, None]
    system = np.block([[on_all[np.ix_(free, free)], added], [added.T, np.zeros((1, 1))]])
    right = np.zeros_like(force)
    right.reshape(-1)[free] = np.linalg.solve(system, np.append(force.reshape(-1)[free], 0.0))[:-1]
    push = Load(np.zeros(n), form.carried(force))
    found = LinearSolver(problem(form, BASE)).step(push).displacement
    assert_allclose(found, right[:n], rtol=0.0, atol=1e-9 * np.abs(right).max())


def test_the_fluid_keeps_the_volume_between_the_nodes_that_there_were() -> None:
    form = BoundaryFormulation(BODY, soft(0.5), BASE)
    matrix = form.matrix
    scale = np.abs(matrix).max()
    assert_allclose(matrix, matrix.T, rtol=0.0, atol=1e-9 * scale)
    rigid = rigid_motions(BODY, np.ones_like(BASE)).reshape(-1, 6)
    assert_allclose(matrix @ rigid, 0.0, rtol=0.0, atol=1e-9 * scale)
    # a uniform pressure does no work on the nodes of the rim
    uniform = form.carried(form.resolved.area_vectors)
    assert_allclose(uniform, BODY.area_vectors, rtol=0.0, atol=1e-12 * BODY.area)


def on_a_patch(n: int) -> tuple[SurfaceMesh, Mask, Load]:
    """A cube on the middle of its foot, pushed sideways at its top."""
    points, triangles = box(n, SIDES)
    surface = SurfaceMesh(points, triangles)
    x, y, z = (points - 0.5 * np.array([*SIDES[:2], 0.0])).T
    held = (z < 1e-9) & (np.maximum(np.abs(x), np.abs(y)) < 0.0101)
    force = np.zeros_like(points)
    force[:, 0] = np.where(z > SIDES[2] - 1e-9, surface.area_vectors[:, 2], 0.0)
    return surface, held, Load(np.zeros(len(points)), force)


def test_the_answer_is_nearer_to_that_of_a_finer_mesh() -> None:
    """A fifth of the distance without cuts, which is 22 %, 4 cells against 8 along an edge."""
    nu = 0.5
    finest, its_patch, its_push = on_a_patch(8)
    surface, held, push = on_a_patch(4)
    form = BoundaryFormulation(finest, soft(nu), its_patch)
    expected = LinearSolver(problem(form, its_patch)).step(its_push).displacement
    nearest = np.argmin(np.linalg.norm(surface.points[:, None] - finest.points, axis=2), axis=1)
    errors = []
    for cut in (np.zeros_like(held), held):
        found = (
            LinearSolver(problem(BoundaryFormulation(surface, soft(nu), cut), held)).step(push).displacement
        )
        errors.append(np.linalg.norm(found - expected[nearest]) / np.linalg.norm(expected[nearest]))
    assert errors[0] > 0.15
    assert errors[1] < 0.2 * errors[0]


@pytest.mark.parametrize("formulation", ["bem", "bem-sparse"])
def test_a_model_cuts_along_all_that_it_holds_and_moves(formulation: str) -> None:
    top = POINTS[:, 2] > 0.03
    model = Model(POINTS, TRIANGLES, soft(0.5), formulation=formulation, fixed=BASE, constrained=top)
    assert model.formulation.resolved.n_nodes == Rims.of(BODY, BASE | top).surface.n_nodes
