"""Scalars of a solution that are computed only when asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fem_reference.assembly import reference_gradients, tetrahedron_quadrature
from fem_reference.mesh import TetMesh

if TYPE_CHECKING:
    from fem_reference.linear import Fields, LinearProblem

Array = NDArray[np.float64]

OUTPUTS = {
    "compliance": "work of the applied forces on the displacement, f.u [J]",
    "max_det_f_deviation": "largest |det(I + grad u) - 1| at the quadrature points",
    "max_principal_strain": "largest principal Green-Lagrange strain at the quadrature points",
}


def displacement_gradient(mesh: TetMesh, displacement: Array, barycentric: Array) -> Array:
    """(m, Q, 3, 3) gradient du_i/dx_j at (Q, 4) barycentric points of each tetrahedron."""
    reference = reference_gradients(mesh.order, barycentric)
    local = displacement[mesh.element_nodes]
    by_coordinate = np.einsum("qna,mni->mqia", reference, local, optimize=True)
    return np.asarray(by_coordinate @ mesh.barycentric_gradients[:, None])


def mean_pressure(problem: LinearProblem, fields: Fields) -> Array:
    """(S,) volume mean of -tr(stress)/3 [Pa]."""
    mesh = problem.mesh
    if problem.system.mixed:
        means = fields.pressure[:, mesh.tetrahedra].mean(axis=2)
        return np.asarray(means @ mesh.volumes / mesh.volume)
    bulk_modulus = problem.youngs_modulus / (3.0 * (1.0 - 2.0 * problem.poisson_ratio))
    # The volume integral of div u is the flux through the surface, exact for the P1 and P2 traces.
    share = np.repeat([0.0, 1.0 / 3.0], 3) if mesh.order == 2 else np.full(3, 1.0 / 3.0)
    trace = np.einsum("sfni,n->sfi", fields.displacement[:, mesh.facet_nodes], share)
    mean: Array = -bulk_modulus * np.einsum("sfi,fi->s", trace, mesh.area_vectors) / mesh.volume
    return mean


class StrainOutputs:
    """The outputs of `OUTPUTS` that need the displacement gradient."""

    def __init__(self, problem: LinearProblem, fields: Fields) -> None:
        self._problem = problem
        self._fields = fields

    def compute(self, names: frozenset[str]) -> dict[str, Array]:
        """(S,) values by name."""
        result = {name: np.zeros(len(self._fields.displacement)) for name in names}
        if not result:
            return result
        mesh = self._problem.mesh
        points, _ = tetrahedron_quadrature()
        for step, displacement in enumerate(self._fields.displacement):
            f = displacement_gradient(mesh, displacement, points) + np.eye(3)
            if "max_det_f_deviation" in result:
                result["max_det_f_deviation"][step] = np.abs(np.linalg.det(f) - 1.0).max()
            if "max_principal_strain" in result:
                strain = 0.5 * (np.swapaxes(f, -1, -2) @ f - np.eye(3))
                result["max_principal_strain"][step] = np.linalg.eigvalsh(strain)[..., -1].max()
        return result
