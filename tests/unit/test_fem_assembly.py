"""The fast assembly against scikit-fem's own forms on a distorted mesh."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.sparse import csr_array
from skfem import Basis, BilinearForm, ElementTetP1, ElementTetP2, ElementVector, LinearForm
from skfem.helpers import ddot, div, sym_grad

from fem_reference import assembly
from fem_reference.mesh import TetMesh
from fem_reference.system import build_system
from tests.unit.fem_shapes import cube, divergence_matrix, elasticity_matrix


def _bases(mesh: TetMesh, order: int) -> tuple[Basis, Basis]:
    # scikit-fem's rules to degree 4 are exact to rounding, and 2 is all that these forms need
    element = ElementTetP2() if mesh.order == 2 else ElementTetP1()
    vector = Basis(mesh.skfem_mesh, ElementVector(element), intorder=order)
    return vector, vector.with_element(ElementTetP1())


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("divergence", [0.0, 12.5])
def test_operators_equal_scikit_fem(order: int, divergence: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(assembly, "_CHUNK", 100)  # several passes on a small mesh
    b = cube(3, distort=0.3)
    mesh = TetMesh(*b.arrays, order=order)
    vector, scalar = _bases(mesh, 2)
    stiffness = BilinearForm(
        lambda u, v, _: 2.0 * ddot(sym_grad(u), sym_grad(v)) + divergence * div(u) * div(v)
    ).assemble(vector)
    coupling = BilinearForm(lambda u, q, _: q * div(u)).assemble(vector, scalar)
    mass = BilinearForm(lambda p, q, _: p * q).assemble(scalar)
    weights = LinearForm(lambda v, _: v[0]).assemble(vector)[::3]
    for ours, theirs in (
        (elasticity_matrix(mesh, divergence), stiffness),
        (divergence_matrix(mesh), coupling),
        (assembly.mass_matrix(mesh), mass),
    ):
        assert abs(csr_array(ours) - csr_array(theirs)).max() <= 1e-14 * abs(theirs).max()
    assert_allclose(assembly.gravity_weights(mesh), weights, rtol=0, atol=1e-14 * np.abs(weights).max())


def test_the_rule_behind_the_check_is_sufficient() -> None:
    b = cube(2, distort=0.3)
    mesh = TetMesh(*b.arrays)
    form = BilinearForm(lambda u, v, _: ddot(sym_grad(u), sym_grad(v)))
    two, four = (form.assemble(_bases(mesh, order)[0]) for order in (2, 4))
    assert abs(two - four).max() <= 1e-14 * abs(two).max()
    one = form.assemble(_bases(mesh, 1)[0])
    assert abs(one - four).max() > 1e-3 * abs(four).max(), "one point is not enough"


def test_the_pattern_mirrors_itself() -> None:
    b = cube(2, distort=0.2)
    mesh = TetMesh(*b.arrays)
    pattern = assembly.scalar_pattern(mesh)
    rows = np.repeat(np.arange(mesh.n_nodes), np.diff(pattern.indptr))
    assert np.array_equal(rows[pattern.mirror], pattern.indices)
    assert np.array_equal(pattern.indices[pattern.mirror], rows)
    pairs = {(int(i), int(j)) for nodes in mesh.element_nodes for i in nodes for j in nodes}
    assert pairs == set(zip(rows.tolist(), pattern.indices.tolist(), strict=True))
    assert len(pairs) == pattern.size, "no pair is stored twice"


@pytest.mark.parametrize("rollers", [False, True])
@pytest.mark.parametrize("poisson_ratio", [-0.4, 0.0, 0.3, 0.5])
def test_the_system_is_the_whole_operator_without_its_held_part(poisson_ratio: float, rollers: bool) -> None:
    """The scaled block system against a dense one cut from the unscaled matrices."""
    b = cube(2, distort=0.2)
    mesh = TetMesh(*b.arrays)
    held = np.repeat(mesh.node_points[:, :1] < 1e-12, 3, axis=1)
    if rollers:
        held[:, 1:] = mesh.node_points[:, 1:] < 1e-12
    system = build_system(mesh, held, mixed=True, poisson_ratio=poisson_ratio)
    length, nu = mesh.mean_edge, poisson_ratio
    a = elasticity_matrix(mesh, 0.0).toarray() / length
    d = divergence_matrix(mesh).toarray() * np.sqrt(2.0 * abs(nu)) / length**2
    c = (1.0 - 2.0 * nu) * (-1.0 if nu < 0.0 else 1.0) * assembly.mass_matrix(mesh).toarray() / length**3
    whole = np.block([[a, -d.T], [-d, -c]])

    rng = np.random.default_rng(0)
    u = np.where(held, 0.0, rng.standard_normal(held.shape))
    given = np.where(held, rng.standard_normal(held.shape), 0.0)
    q = rng.standard_normal(mesh.n_vertices)
    force = rng.standard_normal(held.shape)
    x = np.concatenate([u[system.kept].ravel(), q])
    free = np.concatenate([~held.ravel(), np.ones(len(q), dtype=bool)])
    cut = np.concatenate([~held[system.kept].ravel(), np.ones(len(q), dtype=bool)])

    product = whole @ np.concatenate([u.ravel(), q])
    assert_allclose(system.apply(x)[cut], product[free], rtol=0, atol=1e-13 * np.abs(product).max())
    lower = system.lower_triangle(system.compressibility).toarray()
    full = lower + np.tril(lower, -1).T
    assert_allclose(full @ x, system.apply(x), rtol=0, atol=1e-13 * np.abs(product).max())
    assert np.array_equal(lower, np.tril(lower))

    rhs = system.right_hand_side(force[None], given[None])[:, 0]
    expected = np.concatenate([force.ravel(), np.zeros(len(q))]) - whole @ np.concatenate(
        [given.ravel(), np.zeros(len(q))]
    )
    assert_allclose(rhs[cut], expected[free], rtol=0, atol=1e-13 * np.abs(expected).max())
    assert_allclose(rhs[~cut], 0.0, rtol=0, atol=0)

    nodal, pressure = system.expand(x[:, None], given[None])
    assert_allclose(nodal[0], u + given, rtol=0, atol=0)
    reaction = system.reactions(nodal, pressure, force[None])[0]
    internal = (whole @ np.concatenate([(u + given).ravel(), q]))[: held.size].reshape(held.shape)
    assert_allclose(
        reaction,
        np.where(held, internal - force, 0.0),
        rtol=0,
        atol=1e-13 * np.abs(internal).max(),
    )
