"""The fast assembly against scikit-fem's own forms on a distorted mesh."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.sparse import bsr_array, csr_array
from skfem import BilinearForm, LinearForm
from skfem.helpers import ddot, div, sym_grad

from fem_reference import assembly
from fem_reference.mesh import TetMesh
from solver_common.arrays import Array
from tests.fem.shapes import cube


def _whole(blocks: Array, pattern: assembly.Pattern) -> csr_array:
    rows, columns = blocks.shape[1] * (len(pattern.indptr) - 1), blocks.shape[2] * pattern.columns
    return csr_array(bsr_array((blocks, pattern.indices, pattern.indptr), shape=(rows, columns)))


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
    nodes = assembly.scalar_pattern(mesh)
    pressures = assembly.coupling_pattern(mesh, nodes)
    for ours, theirs in (
        (_whole(assembly.elasticity_blocks(mesh, nodes, divergence), nodes), stiffness),
        (_whole(assembly.divergence_blocks(mesh, pressures), pressures), coupling),
        (assembly.mass_matrix(mesh), mass),
    ):
        assert abs(ours - csr_array(theirs)).max() <= 1e-14 * abs(theirs).max()
    assert_allclose(assembly.gravity_weights(mesh), weights, rtol=0, atol=1e-14 * np.abs(weights).max())
