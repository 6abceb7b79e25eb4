"""Small-strain elasticity as a scikit-fem user writes it: the reference for `fem_reference.linear`.

Method: mixed displacement-pressure form of stress = 2 G eps - p I with p = -lambda div u, to which fibres along a
add k (a.eps a) a x a:

    2 G eps(u) : eps(v) + k (a.eps(u) a) (a.eps(v) a) - p div v  =  loads . v    for all v
                             q div u + (1/lambda) q p            =  0            for all q

with lambda = 2 G nu / (1 - 2 nu), and q p = 0 where nu = 0: every Poisson ratio in (-1, 0.5] will do. Taylor-Hood
element, sparse LU factor. Order: 3 in displacement, 2 in strain and pressure (L2). Source: Hughes, The Finite
Element Method, section 4.3.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse.linalg import SuperLU, splu
from skfem import BilinearForm, Functional, bmat, condense, solve
from skfem.helpers import ddot, div, dot, mul, sym_grad

from fem_reference.loads import Load
from fem_reference.materials import make_law
from fem_reference.plain_body import Dofs, PlainBody, lu_status
from fem_reference.solution import Solution, check_outputs

# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators


def along(u, w):
    """a.eps(u) a, for the direction a of the fibres."""
    return dot(mul(sym_grad(u), np.broadcast_to(w.a, u.grad.shape[1:])), w.a)


@BilinearForm
def stiffness(u, v, w):
    return 2.0 * w.G * ddot(sym_grad(u), sym_grad(v))


@BilinearForm
def fibre_stiffness(u, v, w):
    return w.k * along(u, w) * along(v, w)


@BilinearForm
def divergence(u, q, _):
    return q * div(u)


@BilinearForm
def mass(p, q, w):
    return w.gives * p * q


@Functional
def pressure_integral(w):
    """-tr(stress) / 3."""
    return w.p - (2.0 * w.G * div(w.u) + w.k * along(w.u, w)) / 3.0


class PlainLinearProblem:
    """One body, one material and one set of supports in scikit-fem's objects; solved load by load.

    Parameters
    ----------
    mesh, supports : as `fem_reference.plain_body.PlainBody`
    youngs_modulus, poisson_ratio, density, fibre_direction, contrast : as `fem_reference.linear.LinearProblem`

    Attributes
    ----------
    body : the mesh, the bases and the held dofs; see `fem_reference.plain_body.PlainBody`
    matrix : of all dofs, displacement first, without elimination
    values : the material values of the forms

    Raises
    ------
    SolverError
        For input that `LinearProblem` refuses before assembly.
    """

    def __init__(
        self,
        *mesh: ArrayLike,
        youngs_modulus: ArrayLike,
        poisson_ratio: ArrayLike,
        density: float = 0.0,
        fibre_direction: ArrayLike | None = None,
        contrast: float = 1.0,
        **supports: Any,
    ) -> None:
        start = time.perf_counter()
        material = "neo-hookean" if fibre_direction is None else "transversely-isotropic"
        law = make_law(material, 1.0, 1.0, fibre_direction, contrast)
        self.body = body = PlainBody(*mesh, **supports, intorder=2)
        self.values, moduli = body.parameters(youngs_modulus, poisson_ratio, density, law)
        self.density = density
        self._told: dict[str, float | str] = {
            "youngs_modulus": moduli.youngs_modulus,
            "poisson_ratio": moduli.poisson_ratio,
            "density": density,
            "contrast": contrast,
        }
        A = stiffness.assemble(body.basis, **self.values) + body.springs
        if fibre_direction is not None:
            A = A + fibre_stiffness.assemble(body.basis, **self.values)
        B = divergence.assemble(body.basis, body.pressure_basis)
        M = mass.assemble(body.pressure_basis, **self.values)
        self.matrix = bmat([[A, -B.T], [self.values["couples"] * B, M]], "csr")
        self._factor: SuperLU | None = None
        self.seconds_setup = time.perf_counter() - start

    def dofs(self, load: Load) -> Dofs:
        """Solve one load. Raises SolverError for one of a wrong shape or with values that are not finite."""
        start = time.perf_counter()
        body, n = self.body, self.body.basis.N
        body.check([load])
        f, x = np.zeros(self.matrix.shape[0]), np.zeros(self.matrix.shape[0])
        f[:n] = body.body_forces(load, self.density) + body.dead_pressure(load)
        x[:n] = body.given(load)
        A, b, x, free = condense(self.matrix, f, x=x, D=body.held_dofs)
        x = solve(A, b, x, free, solver=self._lu)
        u, p = x[:n], x[n:]
        unbalanced = self.matrix @ x - f
        reaction = -(body.springs @ u)
        reaction[body.held_dofs] += unbalanced[body.held_dofs]
        residual = float(np.linalg.norm(unbalanced[free]) / (np.linalg.norm(b) or 1.0))
        inside = {"u": body.basis.interpolate(u), "p": body.pressure_basis.interpolate(p), **self.values}
        return Dofs(
            displacement=u,
            pressure=p,
            reaction=reaction,
            energy=0.5 * float(u @ (f[:n] + reaction)),
            mean_pressure=float(pressure_integral.assemble(body.basis, **inside)) / body.volume,
            residual=residual,
            status=lu_status(residual),
            seconds=time.perf_counter() - start,
        )

    def solve(self, loads: Sequence[Load], outputs: frozenset[str] = frozenset()) -> Solution:
        """Solve one step per load, each by itself; there are no further `outputs`.

        Raises
        ------
        SolverError
            For a load of the wrong shape or with values that are not finite, and for an output.
        """
        check_outputs(outputs, [])
        self.body.check(loads)
        steps = [self.dofs(load) for load in loads]
        return self.body.solution(steps, len(loads), self.seconds_setup, self._told)

    def _lu(self, A, b):
        """One factor for all loads, and one step of refinement."""
        if self._factor is None:
            self._factor = splu(A.tocsc())
        x = self._factor.solve(b)
        return x + self._factor.solve(b - A @ x)
