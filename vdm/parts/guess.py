"""About how a body moves at small displacements, for a hundredth of what its boundary elements cost.

Inside it displacements are polynomials, sums of the monomials m_i up to `DEGREE`, and so is the pressure, of one
degree less, which keeps the volume at nu = 1/2 (Ritz's method, mixed):

`int 2 mu e(v) : (e(u) - tr e(u) I / 3) - p div v = F . v`, `int q (div u + p / kappa) = 0`.

A monomial of degree k is integrated on the surface, `(k + 3) int_V m = int_S m x . n`, with x . n constant on a
facet. No polynomial is at rest where the body is held and moves beside it: what it leaves there springs bear, as in
`vdm.peers.bem_sparse`, between the waves of a mesh of as many nodes as monomials and those of the surface's own.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from solver_common.arrays import Array
from vdm.boundary.quadrature import sixteen_points
from vdm.constraints import Load
from vdm.peers.bem import BoundaryFormulation
from vdm.problem import Problem
from vdm.surface import SurfaceMesh

# energies are of degree 8, to which the rule on facets is exact
DEGREE = 5


def guessed(problem: Problem, load: Load) -> Array:
    """(N, 3) displacement [m] of a problem of boundary elements, whose rotations are some ten per cent off."""
    form, support = problem.formulation, problem.support
    assert isinstance(form, BoundaryFormulation)
    surface, mu, nu = form.surface, form.shear_modulus, form.poisson_ratio
    arms = surface.points - surface.points.mean(axis=0)
    axes = np.linalg.eigh(arms.T @ arms)[1]
    local = arms @ axes
    sizes = np.abs(local).max(axis=0)
    local /= sizes
    powers = np.array([power for power in product(range(DEGREE + 1), repeat=3) if sum(power) <= DEGREE])
    lower = powers[powers.sum(axis=1) < DEGREE]
    moments = _moments(local, surface)
    mass = moments[tuple((lower[:, None] + lower).T)]
    # of each component and monomial the derivatives d/dx, d/dy, d/dz in turn, in terms of the lower monomials
    along = [
        powers[:, k, None] * (powers[:, None] == lower + one).all(axis=2)
        for k, one in enumerate(np.eye(3, dtype=np.int64))
    ]
    slopes = np.einsum("ak,kij->aij", axes / sizes, along).reshape(-1, len(lower))
    swelling = slopes @ mass
    products = (swelling @ slopes.T).reshape(3, len(powers), 3, len(powers))
    stiffness = products.transpose(2, 1, 0, 3) - products / 1.5
    stiffness += np.eye(3)[:, None, :, None] * np.einsum("aiaj->ij", products)[:, None]
    stiffness = mu * stiffness.reshape(len(slopes), -1)
    values = _powers(local.T, DEGREE)[powers.T, np.arange(3)[:, None]].prod(axis=0)
    areas = surface.nodal_areas
    waves = 0.5 * np.pi * (1.0 / np.sqrt(areas) + np.sqrt(len(powers) / surface.area))
    springs = np.where(support.held, mu / (1.0 - nu) * waves * areas, 0.0)
    stiffness += np.kron(np.eye(3), (values * springs) @ values.T)
    if form.parameters.ground is not None:
        spread = np.einsum("in,ab->nabi", values, np.eye(3)).reshape(-1, len(slopes))
        stiffness += spread.T @ (form.parameters.ground @ spread)
    force = replace(problem, support=replace(support, hydrostatic=None)).force(load)
    force = values @ (force + springs[:, None] * problem.held_unknown(load))
    if support.gravity is not None:
        force += np.outer(moments[tuple(powers.T)], support.density * support.gravity)
    give = 1.5 * (1.0 - 2.0 * nu) / (1.0 + nu)
    system = np.block([[stiffness / mu, swelling], [swelling.T, -give * mass]])
    right = np.append(force.T / mu, np.zeros(len(lower)))
    found = np.linalg.solve(system, right)[: len(slopes)].reshape(3, -1)
    return (found @ values).T


def _moments(points: Array, surface: SurfaceMesh) -> Array:
    """(n, n, n) integrals of x^i y^j z^k over the volume, where nodes are at `points` (N, 3), an affine map."""
    rule, weights = sixteen_points()
    corners = points[surface.triangles]
    places = np.einsum("ka,fac->cfk", rule, corners).reshape(3, -1)
    x, y, z = _powers(places, 2 * DEGREE - 2).transpose(1, 0, 2)
    z *= np.outer(np.linalg.det(corners), weights).reshape(-1)
    found = np.zeros((len(x),) * 3)
    for k in range(len(x)):
        found[: len(x) - k, :, k] = (z[k] * x[: len(x) - k]) @ y.T
    degrees = np.arange(len(x))
    found /= 3 + degrees[:, None, None] + degrees[:, None] + degrees
    return np.asarray(found * (surface.volume / found[0, 0, 0]))


def _powers(values: Array, most: int) -> Array:
    """(most + 1, ...) powers of values."""
    found = np.ones((most + 1, *values.shape))
    for k in range(most):
        np.multiply(found[k], values, out=found[k + 1])
    return found
