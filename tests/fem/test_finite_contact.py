"""A rigid indenter at finite strain: its tangent, the linear limit, the work it does, and what cannot be."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.sparse import bsr_array

from fem_reference.assembly import scalar_pattern
from fem_reference.contact import ContactProblem
from fem_reference.finite_contact import RigidContact
from fem_reference.indenter import Capsule, Indenter, Shape, Sphere
from fem_reference.mesh import TetMesh
from tests.fem.shapes import cube
from tests.verification.records import Verified

SOFT = {"youngs_modulus": 3.0, "poisson_ratio": 0.45}
DOWN, TIP = (0.0, 0.0, -1.0), (0.5, 0.5, 1.0)


@pytest.mark.anchor("contact forces of an indenter", "central differences")
@pytest.mark.parametrize(
    "shape", [Sphere(0.8), Capsule(0.5, 0.4, (1.0, 1.0, 0.0))], ids=["sphere", "capsule"]
)
def test_contact_tangent_by_finite_differences(shape: Shape, verified: Verified) -> None:
    b = cube(3, distort=0.2)
    mesh = TetMesh(*b.arrays)
    pattern = scalar_pattern(mesh)
    contact = RigidContact(mesh, pattern, Indenter(shape, TIP, DOWN), b.top)
    rng = np.random.default_rng(3)
    x = mesh.node_points / mesh.mean_edge + rng.uniform(-0.02, 0.02, (mesh.n_nodes, 3))
    depth = 0.2 / mesh.mean_edge
    blocks = np.zeros((pattern.size, 3, 3))
    contact.add_stiffness(blocks, x, depth)
    size = 3 * mesh.n_nodes
    stiffness = bsr_array((blocks, pattern.indices, pattern.indptr), shape=(size, size))
    assert abs(stiffness - stiffness.T).max() < 1e-12 * abs(stiffness).max()
    dx, h = rng.standard_normal(x.shape), 1e-7
    slope = (contact.forces(x + h * dx, depth) - contact.forces(x - h * dx, depth)) / (2.0 * h)
    expected = -(stiffness @ dx.ravel()).reshape(-1, 3)
    assert np.abs(expected).max() > 1.0
    verified.at_most(type(shape).__name__, (slope - expected) / np.abs(expected).max(), 1e-6)


@pytest.mark.anchor("indenter at finite strain", "the linear body's contact; the work of the indenter")
def test_a_small_indentation_is_the_linear_one(verified: Verified) -> None:
    """Two discretisations of the contact: the force is one to what the mesh resolves of the contact area."""
    b = cube(6)
    indenter = Indenter(Sphere(20.0), TIP, DOWN)
    linear = ContactProblem(
        b.problem(b.bottom, **SOFT),
        indenter,
        b.surface[:, 2] == 1.0,
    ).solve([4e-3])
    finite = b.finite(b.bottom, **SOFT).indent(indenter, b.top, [4e-3])
    assert finite.solution.status[0].ok, finite.solution.status
    assert finite.inside[0] <= 1e-4
    verified.equal(
        "force, over that of the linear contact", -finite.force[0, 2] / linear.force[0], 1.0, atol=0.04
    )


@pytest.mark.anchor("indenter at finite strain", "the linear body's contact; the work of the indenter")
def test_force_is_the_slope_of_the_energy(verified: Verified) -> None:
    """To a fifth of the height: the force along the push integrates to the energy that the body stores."""
    b = cube(3)
    problem = b.finite(b.bottom, **SOFT)
    indenter = Indenter(Sphere(0.7), TIP, DOWN)
    depths = 0.1 * (np.polynomial.legendre.leggauss(6)[0] + 1.0)
    assert_allclose(problem.indent(indenter, b.top, [-0.1]).force, 0.0, rtol=0, atol=1e-15)
    s = problem.indent(indenter, b.top, [*depths, 0.2])
    assert all(status.ok for status in s.solution.status), s.solution.status
    work = 0.1 * np.polynomial.legendre.leggauss(6)[1] @ -s.force[:-1, 2]
    assert np.all(np.diff(-s.force[:, 2]) > 0.0)
    assert np.all(s.inside <= 0.015 * problem.mesh.mean_edge)  # between the points that are held off too
    elastic = s.solution.energy[-1]
    assert s.penalty_energy[-1] <= 0.02 * elastic
    stored = elastic + s.penalty_energy[-1]
    verified.equal("work of a sphere over the stored energy, depth 0.2", work / stored, 1.0, atol=2e-3)
    r = np.linalg.norm(b.surface + s.solution.displacement[-1] - (0.5, 0.5, 1.0 + 0.7 - 0.2), axis=1)
    assert r[b.surface[:, 2] == 1.0].min() > 0.7 - 0.01


def test_an_indenter_never_goes_through_the_surface() -> None:
    """Deeper than it is wide in one step: it pushes, or the step has failed by name, on the way and not at rest."""
    b = cube(3)
    found = b.finite(b.bottom, **SOFT | {"poisson_ratio": 0.2}).indent(
        Indenter(Sphere(0.17), (0.5, 0.5, 1.0), DOWN), b.top, [0.45]
    )
    if found.solution.status[0].ok:
        assert -found.force[0, 2] > 0.0
        assert found.contact_area[0] > 0.0
    else:
        assert "beyond" in found.solution.status[0].message
        assert found.solution.scalars["load_factor"][0] > 0.3


def test_a_mesh_too_coarse_for_its_indenter_is_told() -> None:
    b = cube(4)
    found = b.finite(b.bottom, **SOFT).indent(Indenter(Sphere(0.13), (0.6, 0.55, 1.0), DOWN), b.top, [0.03])
    assert found.solution.status[0].ok
    assert found.inside[0] > 0.1 * 0.03
    assert "inside the indenter" in found.solution.status[0].message
