"""Scalars of a solution that are computed only when asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from skfem import ElementTetP1, ElementTetP2
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTet

from fem_reference.assembly import reference_gradients, tetrahedron_quadrature
from fem_reference.mesh import TetMesh

if TYPE_CHECKING:
    from fem_reference.linear import Fields, LinearProblem

Array = NDArray[np.float64]

OUTPUTS = {
    "compliance": "work of the applied forces on the displacement, f.u [J]",
    "max_det_f_deviation": "largest |det(I + grad u) - 1| at the quadrature points",
    "max_principal_strain": "largest principal Green-Lagrange strain at the quadrature points",
    "discretisation_error": "estimated relative L2 error of the strain, see `strain_error_estimate`",
}

_NODES = np.vstack(
    [
        np.eye(4),
        [[0.5 * (k in e) for k in range(4)] for e in ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))],
    ]
)


def displacement_gradient(mesh: TetMesh, displacement: Array, barycentric: Array) -> Array:
    """(m, Q, 3, 3) gradient du_i/dx_j at (Q, 4) barycentric points of each tetrahedron."""
    reference = reference_gradients(mesh.order, barycentric)
    local = displacement[mesh.element_nodes]
    by_coordinate = np.einsum("qna,mni->mqia", reference, local, optimize=True)
    return np.asarray(by_coordinate @ mesh.barycentric_gradients[:, None])


def mean_pressure(problem: LinearProblem, fields: Fields) -> Array:
    """(S,) volume mean of -tr(stress)/3 [Pa]."""
    mesh = problem.mesh
    # The volume integral of div u is the flux through the surface, exact for the P1 and P2 traces.
    share = np.repeat([0.0, 1.0 / 3.0], 3) if mesh.order == 2 else np.full(3, 1.0 / 3.0)
    trace = np.einsum("sfni,n->sfi", fields.displacement[:, mesh.facet_nodes], share)
    dilation: Array = np.einsum("sfi,fi->s", trace, mesh.area_vectors) / mesh.volume
    if problem.system.mixed:
        means = fields.pressure[:, mesh.tetrahedra].mean(axis=2)
        return np.asarray(means @ mesh.volumes / mesh.volume - problem.shear_modulus * dilation / 1.5)
    return -problem.youngs_modulus / (3.0 * (1.0 - 2.0 * problem.poisson_ratio)) * dilation


def strain_outputs(mesh: TetMesh, displacements: Array, names: frozenset[str]) -> dict[str, Array]:
    """(S,) values of the outputs in `names` that need the displacement gradient.

    `displacements` is (S, n_nodes, 3) [m].
    """
    result: dict[str, Array] = {name: np.zeros(len(displacements)) for name in sorted(names)}
    local = names & {"max_det_f_deviation", "max_principal_strain"}
    points, _ = tetrahedron_quadrature()
    for step, displacement in enumerate(displacements):
        if local:
            f = displacement_gradient(mesh, displacement, points) + np.eye(3)
            if "max_det_f_deviation" in local:
                result["max_det_f_deviation"][step] = np.abs(np.linalg.det(f) - 1.0).max()
            if "max_principal_strain" in local:
                strain = 0.5 * (np.swapaxes(f, -1, -2) @ f - np.eye(3))
                result["max_principal_strain"][step] = np.linalg.eigvalsh(strain)[..., -1].max()
        if "discretisation_error" in names:
            result["discretisation_error"][step] = strain_error_estimate(mesh, displacement)
    return result


def strain_error_estimate(mesh: TetMesh, displacement: Array) -> float:
    """Estimated norm(eps(u) - eps(u_h)) / norm(eps(u_h)), L2 norms over the body.

    The unknown strain is replaced by a recovered one: the volume-weighted mean of the elements' strains at each
    node, interpolated with the displacement's shape functions (Zienkiewicz and Zhu 1987,
    doi 10.1002/nme.1620240206). For an incompressible material this is the relative error in the energy norm.
    """
    width = mesh.element_nodes.shape[1]
    gradient = displacement_gradient(mesh, displacement, _NODES[:width])
    strain = 0.5 * (gradient + np.swapaxes(gradient, -1, -2)).reshape(-1, width, 9)
    nodes = mesh.element_nodes.ravel()
    weight = np.repeat(mesh.volumes, width)
    total = np.bincount(nodes, weights=weight, minlength=mesh.n_nodes)
    recovered = np.empty((mesh.n_nodes, 9))
    for k in range(9):
        values = weight * strain[:, :, k].ravel()
        recovered[:, k] = np.bincount(nodes, weights=values, minlength=mesh.n_nodes) / total
    mass = _reference_mass(mesh.order)
    difference = recovered[mesh.element_nodes] - strain
    error = np.einsum("m,mak,ab,mbk->", mesh.volumes, difference, mass, difference, optimize=True)
    size = np.einsum("m,mak,ab,mbk->", mesh.volumes, strain, mass, strain, optimize=True)
    return float(np.sqrt(error / size)) if size > 0.0 else 0.0


def _reference_mass(order: int) -> Array:
    """Mass matrix of the shape functions on a tetrahedron of volume one."""
    points, weights = get_quadrature(RefTet, 2 * order)
    element = ElementTetP2() if order == 2 else ElementTetP1()
    values = np.array([element.lbasis(points, i)[0] for i in range(10 if order == 2 else 4)])
    return np.asarray(6.0 * (values * weights) @ values.T)
