"""The fast assembly against scikit-fem's own forms on a distorted mesh."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.sparse import csr_array
from skfem import BilinearForm, LinearForm
from skfem.helpers import ddot, div, sym_grad

from fem_reference import assembly
from fem_reference.mesh import TetMesh
from tests.unit.fem_shapes import cube, divergence_matrix, elasticity_matrix


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("divergence", [0.0, 12.5])
def test_operators_equal_scikit_fem(order: int, divergence: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(assembly, "_CHUNK", 100)  # several passes on a small mesh
    b = cube(3, distort=0.3)
    mesh = TetMesh(*b.arrays, order=order)
    vector, scalar = mesh.bases(intorder=2)
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
