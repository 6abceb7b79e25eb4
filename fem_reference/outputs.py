"""Scalars of a solution that are computed only when asked for."""

from __future__ import annotations

import numpy as np
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTet

from fem_reference.assembly import reference_gradients, tetrahedron_quadrature
from fem_reference.mesh import TetMesh
from fem_reference.system import LinearSystem
from solver_common.arrays import Array

OUTPUTS = {
    "condition_estimate": "condition number of the scaled system, see `fem_reference.condition`",
    "compliance": "work of the applied forces on the displacement, f.u [J]",
    "max_det_f_deviation": "largest |det(I + grad u) - 1| at the quadrature points",
    "max_principal_strain": "largest principal Green-Lagrange strain at the quadrature points",
    "p95_principal_strain": "principal Green-Lagrange strain that 95 % of the volume stays below",
    "volume": "volume of the deformed body, the integral of det(I + grad u) [m^3]",
}


SHARE = (
    0.95  # of the volume: on five scenes and three meshes that strain settles to 1 to 6 %, that of 99 % to 40
)


def strain_below(strain: Array, volumes: Array) -> float:
    """The principal strain below which `SHARE` of the volume stays, from strains at points with volumes."""
    order = np.argsort(strain, axis=None)
    below = np.cumsum(volumes.ravel()[order])
    return float(strain.ravel()[order[np.searchsorted(below, SHARE * below[-1])]])


def displacement_gradient(mesh: TetMesh, displacement: Array, barycentric: Array) -> Array:
    """(m, Q, 3, 3) gradient du_i/dx_j at (Q, 4) barycentric points of each tetrahedron."""
    reference = reference_gradients(mesh.order, barycentric)
    local = displacement[mesh.element_nodes]
    by_coordinate = np.einsum("qna,mni->mqia", reference, local, optimize=True)
    return np.asarray(by_coordinate @ mesh.barycentric_gradients[:, None])


def mean_pressure(system: LinearSystem, shear_modulus: float, displacement: Array, pressure: Array) -> Array:
    """(S,) volume mean of -tr(stress)/3 [Pa], from fields (S, n_nodes, 3) [m] and (S, n_pressures) [Pa]."""
    mesh = system.mesh
    # the volume integral of grad u is the surface integral of u x n, exact for P1 and P2 traces
    share = np.repeat([0.0, 1.0 / 3.0], 3) if mesh.order == 2 else np.full(3, 1.0 / 3.0)
    trace = np.einsum("sfni,n->sfi", displacement[:, mesh.facet_nodes], share)
    gradient: Array = np.einsum("sfi,fj->sij", trace, mesh.area_vectors) / mesh.volume
    if system.relative_stiffness is not None:  # the mean is then weighted by the stiffness
        weights = mesh.volumes * system.relative_stiffness / mesh.volume
        centre = np.full((1, 4), 0.25)  # the gradient is linear in a tetrahedron
        gradients = (displacement_gradient(mesh, u, centre)[:, 0] for u in displacement)
        gradient = np.array([np.einsum("m,mij->ij", weights, g) for g in gradients])
    dilation: Array = np.einsum("sii->s", gradient)
    mean = -shear_modulus * (system.divergence_coefficient + 2.0 / 3.0) * dilation
    if system.mixed:
        mean = mean + pressure[:, mesh.pressure_elements].mean(axis=2) @ mesh.volumes / mesh.volume
    if system.fibres is not None:
        tension = np.einsum("ij,sij->s", system.fibres, gradient) * np.trace(system.fibres)
        mean = mean - shear_modulus * tension / 3.0
    return np.asarray(mean)


def strain_outputs(mesh: TetMesh, displacements: Array, names: frozenset[str]) -> dict[str, Array]:
    """(S,) values of the outputs in `names` that need the displacement gradient.

    `displacements` is (S, n_nodes, 3) [m].
    """
    steps = range(len(displacements))
    result: dict[str, Array] = {}
    if "volume" in names:
        local_points, weights = get_quadrature(RefTet, 3)  # det of a gradient linear in space: exact
        barycentric = np.vstack([1.0 - local_points.sum(axis=0), local_points]).T
        gradients = (displacement_gradient(mesh, u, barycentric) for u in displacements)
        means = [np.linalg.det(h + np.eye(3)) @ weights for h in gradients]
        result["volume"] = 6.0 * np.array(means) @ mesh.volumes
    local = names & {"max_det_f_deviation", "max_principal_strain", "p95_principal_strain"}
    result |= {name: np.zeros(len(displacements)) for name in sorted(local)}
    points, weights = tetrahedron_quadrature()
    for step in steps if local else ():
        f = displacement_gradient(mesh, displacements[step], points) + np.eye(3)
        if "max_det_f_deviation" in local:
            result["max_det_f_deviation"][step] = np.abs(np.linalg.det(f) - 1.0).max()
        if local - {"max_det_f_deviation"}:
            strain: Array = np.asarray(
                np.linalg.eigvalsh(0.5 * (np.swapaxes(f, -1, -2) @ f - np.eye(3)))[..., -1], dtype=float
            )
            found = {
                "max_principal_strain": strain.max(),
                "p95_principal_strain": strain_below(strain, mesh.volumes[:, None] * weights),
            }
            for name in local & found.keys():
                result[name][step] = found[name]
    return result
