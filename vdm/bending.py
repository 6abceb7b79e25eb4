"""The error of a form on its own body, measured by pure bending, which has an exact solution on every shape.

A solid of Young's modulus E and Poisson's ratio nu bends in the plane of axes a and b, with c the third axis:

`u_a = a b, u_b = -(a^2 + nu b^2 - nu c^2) / 2, u_c = -nu b c`

Its only stress is E b along a (Timoshenko and Goodier 1970, article 102). On the surface this is a traction
E b n_a, linear on every facet, so that the nodal forces are exact. The supported nodes are given their exact
displacement, all others their exact force. Six such bendings about the principal axes of the surface are solved
and compared with the exact displacement.

No residual shows an operator with the wrong stiffness. A skin does not know what is inside; boundary integrals
lose a lobe that is thinner than their facets are wide.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np

from solver_common.arrays import Array
from vdm.problem import Problem
from vdm.solvers.linear import BorderedFactor
from vdm.surface import SurfaceMesh, rigid_basis


def bending_error(problem: Problem, factor: BorderedFactor) -> float:
    """Error of the displacement over the six bendings, relative to their deformation; root mean squares by area.

    NaN where the parameters do not give the tissue's stiffness.
    """
    form, surface = problem.formulation, problem.formulation.surface
    n = surface.n_nodes
    modulus = form.parameters.tissue_modulus
    if modulus is None or form.parameters.ground is not None or form.parameters.lumps is not None:
        return np.nan  # the exact bendings are those of one homogeneous tissue, held or free
    if form.parameters.fluid_in_cavities:
        return np.nan
    mesh, nu = form.resolved, form.parameters.poisson_ratio
    exact = bendings(mesh, nu)[0][:, :n]
    forces = form.known_forces(lambda part: modulus * bendings(part, nu, mesh)[1])
    error = size = 0.0
    areas = surface.nodal_areas[:, None]
    rigid = rigid_basis(surface)
    for u, force in zip(exact, forces, strict=True):
        x = np.where(problem.free[:, None], 0.0, form.unknown(u))
        left = (force - form.apply(x)).reshape(-1)[factor.unknowns]
        x.reshape(-1)[factor.unknowns] = factor.solve(left, -form.rows.dotted(x.reshape(-1)))[0]
        deformed = u.reshape(-1) - rigid @ (rigid.T @ u.reshape(-1))
        error += float((areas * (form.displacement(x) - u) ** 2).sum())
        size += float((areas * deformed.reshape(-1, 3) ** 2).sum())
    return float(np.sqrt(error / size))


def bendings(surface: SurfaceMesh, nu: float = 0.5, body: SurfaceMesh | None = None) -> tuple[Array, Array]:
    """(6, N, 3) displacements [m^2] per curvature [1/m], and (6, N, 3) nodal forces [m^3] per curvature and E.

    The axes are the principal axes of `body`, by default the surface itself; `surface` may be of one of its parts.
    """
    body = body or surface
    middle = body.points.mean(axis=0)
    centred = body.points - middle
    axes = np.linalg.eigh(centred.T @ (body.nodal_areas[:, None] * centred))[1]
    x, facets = ((surface.points - middle) @ axes).T, (surface.facet_vectors @ axes).T
    moved, forces = np.zeros((2, 6, 3, surface.n_nodes))
    for k, (a, b, c) in enumerate(permutations(range(3))):
        moved[k, a] = x[a] * x[b]
        moved[k, b] = -0.5 * (x[a] ** 2 + nu * x[b] ** 2 - nu * x[c] ** 2)
        moved[k, c] = -nu * x[b] * x[c]
        # a shape function times a linear field: a twelfth of its value there and of the sum of all three
        at_corners = x[b][surface.triangles]
        shares = 1.0 / 12.0 * facets[a][:, None] * (at_corners + at_corners.sum(axis=1, keepdims=True))
        forces[k, a] = np.bincount(surface.triangles.ravel(), shares.ravel(), surface.n_nodes)
    return moved.transpose(0, 2, 1) @ axes.T, forces.transpose(0, 2, 1) @ axes.T
