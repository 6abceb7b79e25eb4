"""The finite-strain solution against FElupe, an independent code, on the very same mesh and quadrature points.

Needs the extra `benchmark`. FElupe has three fields: displacement P2, pressure and volume ratio P1, all continuous.
They are ours once the volume ratio is eliminated: at every vertex K (ratio - 1) = p, K = lambda and p = -pressure.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTet

from fem_reference import finite_strain_assembly
from fem_reference.finite_strain import FiniteStrainProblem
from fem_reference.mesh import TetMesh
from fem_reference.plain_finite_strain import PlainFiniteStrainProblem
from tests.fem.shapes import cube

felupe = pytest.importorskip("felupe", reason="needs FElupe: pip install '.[benchmark]'")

Array = NDArray[np.float64]

YOUNG, DENSITY, GRAVITY, LIFT = 3000.0, 300.0, (0.4, -0.7, 0.5), (0.15, 0.05, -0.1)


def _solve_in_felupe(mesh: TetMesh, nu: float) -> tuple[Array, Array]:
    """(n_nodes, 3) displacements and (n,) pressures of a cube held below whose top moves, from its own solver."""
    points, weights = get_quadrature(RefTet, finite_strain_assembly._DEGREE)
    region = felupe.RegionQuadraticTetra(
        felupe.Mesh(mesh.node_points, mesh.element_nodes, "tetra10"),
        quadrature=felupe.quadrature.Scheme(points.T, weights),
    )
    field = felupe.FieldsMixed(region, n=3)
    shear = YOUNG / (2.0 * (1.0 + nu))
    distortion = felupe.NeoHookeCompressible(mu=shear, lmbda=0.0)
    law = felupe.NearlyIncompressible(distortion, bulk=2.0 * shear * nu / (1.0 - 2.0 * nu))
    below, above = (np.abs(mesh.node_points[:, 2] - z) < 1e-12 for z in (0.0, 1.0))
    supports = {"below": felupe.Boundary(field[0], mask=below)}
    for k, value in enumerate(LIFT):
        others = tuple(int(j != k) for j in range(3))
        supports[f"above {k}"] = felupe.Boundary(field[0], mask=above, skip=others, value=value)
    held, free = felupe.dof.partition(field, supports)
    solved = felupe.newtonraphson(
        items=[felupe.SolidBody(law, field), felupe.SolidBodyForce(field, values=GRAVITY, scale=DENSITY)],
        dof0=held,
        dof1=free,
        ext0=felupe.dof.apply(field, supports, held),
        tol=1e-12,
        verbose=0,
    )
    return solved.x[0].values, -solved.x[1].values[: mesh.n_vertices, 0]


@pytest.mark.parametrize("nu", [0.45, 0.4999])
@pytest.mark.parametrize("kind", [FiniteStrainProblem, PlainFiniteStrainProblem])
def test_finite_strain_solution_equals_felupe(kind: type, nu: float) -> None:
    b = cube(2, distort=0.25)
    top = b.surface[:, 2] > 1.0 - 1e-12
    problem = kind(
        *b.arrays,
        youngs_modulus=YOUNG,
        poisson_ratio=nu,
        density=DENSITY,
        held=top | (b.surface[:, 2] < 1e-12),
    )
    load = b.load(prescribed=np.where(top[:, None], LIFT, 0.0), gravity=GRAVITY)
    if isinstance(problem, PlainFiniteStrainProblem):
        (state,) = problem.history([load])
        u, p = state.displacement.reshape(-1, 3), state.pressure
    else:
        fields = problem.fields([load])
        u, p = fields.displacement[0], fields.pressure[0]
    assert np.abs(u).max() > 0.1, "the deformation is large"
    theirs = _solve_in_felupe(TetMesh(*b.arrays), nu)
    for a, t in zip((u, p), theirs, strict=True):
        assert_allclose(a, t, rtol=0, atol=1e-8 * np.abs(t).max())
