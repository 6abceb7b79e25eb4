"""Finite-strain elasticity as a scikit-fem user writes it: the reference for `fem_reference.finite_strain`.

Method: total Lagrangian, mixed displacement-pressure form of the neo-Hookean solid (Bonet and Wood, Nonlinear
Continuum Mechanics, 2nd ed., eq. 6.27), F = I + H, H = grad u, J = det F, with fibres along a (Merodio and Ogden
2005, doi 10.1016/j.ijsolstr.2004.10.023) of modulus k and the pressure p on the surface with normal N:

    P : grad v  =  density g . v  -  p_contact (J F^-T N) . v     for all v
            q (J - 1) + (1/lambda) q p  =  0                       for all q
    P = G (F - F^-T) - p J F^-T + k/2 (a.C a - 1) (F a) x a,  C = F^T F

with lambda = 2 G nu / (1 - 2 nu), and q p = 0 where nu = 0: every Poisson ratio in (-1, 0.5] will do. Taylor-Hood
element; Newton's method with the whole, unsymmetric tangent and a sparse LU factor; a load step that fails is cut
in two. Order: 3 in displacement, 2 in strain and pressure (L2), of Newton's method 2. Source: as named above;
follower pressure from Bonet and Wood, section 8.5.2.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix
from skfem import BilinearForm, Functional, LinearForm, bmat, condense, solve
from skfem.helpers import ddot, det, dot, grad, inv, mul, trace, transpose

from fem_reference.loads import Load
from fem_reference.materials import NeoHookean, TransverselyIsotropic, make_law
from fem_reference.plain_body import Dofs, PlainBody
from fem_reference.solution import CONVERGED, Solution, SolverError, Status, check_outputs
from fem_reference.springs import ElasticSupport
from solver_common.arrays import Array

# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators

OUTPUTS = ("max_det_f_deviation", "max_principal_strain", "volume")
_MOST_ITERATIONS = 12
_LEAST_STEP = 2.0**-8  # of a load step
_TOLERANCE = 1e-8  # of the last update, relative: Newton's method squares what is left after it


def kinematics(H):
    """F^-T, J - 1 and C - I of displacement gradients (3, 3, ...), without the cancellation of F - I."""
    dilation = trace(H) + 0.5 * (trace(H) ** 2 - ddot(H, transpose(H))) + det(H)
    inverse = inv(H + np.eye(3)[:, :, None, None])
    return {
        "Fit": transpose(inverse),
        "dilation": dilation,
        "strain": H + transpose(H) + mul(transpose(H), H),
    }


def along(A, w):
    """A a, for the direction a of the fibres."""
    return mul(A, np.broadcast_to(w.a, A.shape[1:]))


def stress(w):
    """P."""
    P = mul(w.Fit, w.G * w.strain)  # G (F - F^-T) = F^-T G (C - I)
    P = P - w.p * (1.0 + w.dilation) * w.Fit
    return P + 0.5 * w.k * stretch(w) * w.Fa[:, None] * w.a[None, :]


def stretch(w):
    """a.C a - 1."""
    return dot(along(w.strain, w), w.a)


@LinearForm
def internal(v, w):
    return ddot(stress(w), grad(v))


@LinearForm
def volume_change(q, w):
    return (w.couples * w.dilation + w.gives * w.p) * q


@BilinearForm
def stiffness(u, v, w):
    du, dv = mul(grad(u), transpose(w.Fit)), mul(grad(v), transpose(w.Fit))  # grad u F^-1
    hydrostatic = w.p * (1.0 + w.dilation)
    shear = w.G * ddot(grad(u), grad(v)) + (w.G + hydrostatic) * ddot(du, transpose(dv))
    return shear - hydrostatic * trace(du) * trace(dv)


@BilinearForm
def fibre_stiffness(u, v, w):
    du, dv = along(grad(u), w), along(grad(v), w)
    return 0.5 * w.k * stretch(w) * dot(du, dv) + w.k * dot(w.Fa, du) * dot(w.Fa, dv)


@BilinearForm
def coupling(u, q, w):
    return q * (1.0 + w.dilation) * ddot(w.Fit, grad(u))


@BilinearForm
def mass(p, q, w):
    return w.gives * p * q


@LinearForm
def follower(v, w):
    return -w.contact * (1.0 + w.dilation) * dot(mul(w.Fit, w.n), v)


@BilinearForm
def follower_stiffness(u, v, w):
    turned = ddot(w.Fit, grad(u)) * w.Fit - mul(w.Fit, mul(transpose(grad(u)), w.Fit))
    return w.contact * (1.0 + w.dilation) * dot(mul(turned, w.n), v)


@Functional
def energy(w):
    """W + p^2 / (2 lambda), with I1 - 3 = tr(C - I)."""
    distortion = 0.5 * trace(w.strain) - np.log1p(w.dilation)
    W = w.G * distortion + 0.125 * w.k * stretch(w) ** 2
    return W + (0.5 * w.gives / w.couples * w.p**2 if w.couples else 0.0)


@Functional
def pressure_integral(w):
    """-tr(Cauchy stress) / 3 over the deformed body."""
    return -ddot(stress(w), w.F) / 3.0


@Functional
def volume(w):
    return 1.0 + w.dilation


class PlainFiniteStrainProblem:
    """One body, one material and one set of supports in scikit-fem's objects, for load histories of any size.

    Parameters
    ----------
    points, tetrahedra, surface_nodes, triangles, youngs_modulus, poisson_ratio, density, held, parts,
    elastic_supports, material, fibre_direction, contrast, pressure, material_parameters : as
        `fem_reference.finite_strain.FiniteStrainProblem`

    Attributes
    ----------
    body : the mesh, the bases and the held dofs; see `fem_reference.plain_body.PlainBody`
    values : what the forms are given of the material

    Raises
    ------
    SolverError
        For what `FiniteStrainProblem` refuses before assembly.
    """

    def __init__(
        self,
        points: ArrayLike,
        tetrahedra: ArrayLike,
        surface_nodes: ArrayLike,
        triangles: ArrayLike,
        *,
        youngs_modulus: ArrayLike,
        poisson_ratio: ArrayLike,
        density: float = 0.0,
        held: ArrayLike,
        parts: ArrayLike | None = None,
        elastic_supports: Sequence[ElasticSupport] = (),
        material: str = "neo-hookean",
        fibre_direction: ArrayLike | None = None,
        contrast: float = 1.0,
        pressure: str = "follower",
        material_parameters: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        start = time.perf_counter()
        law = make_law(material, 1.0, 1.0, fibre_direction, contrast, material_parameters)
        if not isinstance(law, NeoHookean | TransverselyIsotropic):
            remedy = 'use material="neo-hookean", or FiniteStrainProblem'
            raise SolverError(Status("bad-material", f"{material} is not written out here", remedy))
        self.body = PlainBody(
            points,
            tetrahedra,
            surface_nodes,
            triangles,
            parts=parts,
            elastic_supports=elastic_supports,
            held=held,
            intorder=5,
        )
        self.values, moduli = self.body.parameters(youngs_modulus, poisson_ratio, density, law)
        self.density, self.follows = density, pressure == "follower"
        self.has_fibres = isinstance(law, TransverselyIsotropic)
        self._told: dict[str, float | str] = {
            "material": material,
            "contrast": contrast,
            "pressure": pressure,
            "youngs_modulus": moduli.youngs_modulus,
            "poisson_ratio": moduli.poisson_ratio,
            "density": density,
        }
        self._mass = mass.assemble(self.body.pressure_basis, **self.values)
        self.seconds_setup = time.perf_counter() - start

    def fields(self, x: Array) -> dict[str, Array]:
        """What the forms are given inside the body in the state x, displacement first."""
        n = self.body.basis.N
        H = np.asarray(self.body.basis.interpolate(x[:n]).grad)
        F = H + np.eye(3)[:, :, None, None]
        p = np.asarray(self.body.pressure_basis.interpolate(x[n:]))
        fields = {**self.values, **kinematics(H), "F": F, "p": p}
        return fields | {"Fa": mul(F, np.broadcast_to(self.values["a"], F.shape[1:]))}

    def residual(self, x: Array, load: Load) -> tuple[Array, Array]:
        """What is unbalanced in the state x, and the forces that act: gravity and contact."""
        body, fields = self.body, self.fields(x)
        forces = body.body_forces(load, self.density)
        if self.follows:
            forces = forces + follower.assemble(body.surface_basis, **self._on_surface(x, load))
        else:
            forces = forces + body.dead_pressure(load)
        inside = internal.assemble(body.basis, **fields) + body.springs @ x[: body.basis.N]
        constraint = volume_change.assemble(body.pressure_basis, **fields)
        return np.concatenate([inside - forces, constraint]), forces

    def tangent(self, x: Array, load: Load) -> csr_matrix:
        """The derivative of the residual."""
        body, fields = self.body, self.fields(x)
        A = stiffness.assemble(body.basis, **fields) + body.springs
        if self.has_fibres:
            A = A + fibre_stiffness.assemble(body.basis, **fields)
        if self.follows and np.any(load.facet_pressure):
            A = A + follower_stiffness.assemble(body.surface_basis, **self._on_surface(x, load))
        B = coupling.assemble(body.basis, body.pressure_basis, **fields)
        return bmat([[A, -B.T], [self.values["couples"] * B, self._mass]], "csr")

    def _on_surface(self, x: Array, load: Load) -> dict[str, Array]:
        basis = self.body.surface_basis
        H = np.asarray(basis.interpolate(x[: basis.N]).grad)
        return {**kinematics(H), "contact": self.body.pressure_at_points(load)}

    def newton(self, x: Array, load: Load) -> tuple[Array, int] | None:
        """The equilibrium under a load from the state x, and the iterations to it; None where there is none."""
        body, n = self.body, self.body.basis.N
        for iteration in range(1, _MOST_ITERATIONS + 1):
            move = np.zeros_like(x)
            move[:n] = body.given(load) - x[:n]
            unbalanced, _ = self.residual(x, load)
            update = solve(*condense(self.tangent(x, load), -unbalanced, x=move, D=body.held_dofs))
            x = x + update
            inside_out = not (kinematics(self.body.basis.interpolate(x[:n]).grad)["dilation"] > -1.0).all()
            if inside_out or not np.isfinite(x).all():
                return None
            if np.linalg.norm(update[:n]) <= _TOLERANCE * np.linalg.norm(x[:n]):
                return x, iteration
        return None

    def follow(self, x: Array, start: Load | None, end: Load) -> tuple[Array, float, int]:
        """Go from a load to another in substeps: the state, the share that was reached, the iterations."""
        reached, step, iterations = 0.0, 1.0, 0
        while reached < 1.0 and step >= _LEAST_STEP:
            target = min(1.0, reached + step)
            found = self.newton(x, between(start, end, target))
            if found is None:
                step *= 0.5
                continue
            x, reached, iterations = found[0], target, iterations + found[1]
        return x, reached, iterations

    def history(self, loads: Sequence[Load], outputs: Iterable[str] = OUTPUTS) -> Iterator[Dofs]:
        """The state at each load; each starts from the one before, the first from the undeformed body.

        A load step that fails yields the last equilibrium on the way to it, and is the last one.

        Raises
        ------
        SolverError
            For a load of the wrong shape or with values that are not finite.
        """
        self.body.check(loads)
        x, before = np.zeros(self.body.basis.N + self.body.pressure_basis.N), None
        for number, load in enumerate(loads):
            began = time.perf_counter()
            x, reached, iterations = self.follow(x, before, load)
            status = CONVERGED if reached == 1.0 else _failed(number, reached)
            found = self.measured(x, between(before, load, reached), status)
            scalars = {"load_factor": reached, **{name: found.scalars[name] for name in outputs}}
            seconds = time.perf_counter() - began
            yield replace(found, iterations=iterations, scalars=scalars, seconds=seconds)
            if not status.ok:
                return
            before = load

    def measured(self, x: Array, load: Load, status: Status) -> Dofs:
        """The state x in equilibrium under a load, with what follows from it."""
        basis, n, held = self.body.basis, self.body.basis.N, self.body.held_dofs
        unbalanced, forces = self.residual(x, load)
        inside = self.fields(x)
        reaction = -(self.body.springs @ x[:n])
        reaction[held] += unbalanced[held]
        deformed = float(volume.assemble(basis, **inside))
        strain = np.linalg.eigvalsh(0.5 * np.moveaxis(inside["strain"], (0, 1), (-2, -1)))
        free = np.linalg.norm(np.delete(unbalanced[:n], held))
        return Dofs(
            displacement=x[:n],
            pressure=x[n:],
            reaction=reaction,
            energy=float(energy.assemble(basis, **inside)),
            mean_pressure=float(pressure_integral.assemble(basis, **inside)) / deformed,
            residual=float(free / (np.linalg.norm(forces + reaction) or 1.0)),
            status=status,
            scalars={
                "max_det_f_deviation": float(np.abs(inside["dilation"]).max()),
                "max_principal_strain": float(strain[..., -1].max()),
                "volume": deformed,
            },
        )

    def solve(self, loads: Sequence[Load], outputs: frozenset[str] = frozenset()) -> Solution:
        """Follow a load history; as `fem_reference.finite_strain.FiniteStrainProblem.solve`, fewer `outputs`."""
        check_outputs(outputs, OUTPUTS)
        steps = list(self.history(loads, sorted(outputs)))
        return self.body.solution(steps, len(loads), self.seconds_setup, self._told)


def between(start: Load | None, end: Load, share: float) -> Load:
    """The load at a share of the way from a load, or from none, to another."""
    if share == 1.0:
        return end

    def mixed(name: str) -> Any:
        first, last = (None if load is None else getattr(load, name) for load in (start, end))
        if first is None and last is None:
            return None
        parts = ((1.0 - share, first), (share, last))
        return sum(s * np.asarray(value) for s, value in parts if value is not None)

    return Load(**{field.name: mixed(field.name) for field in fields(Load)})


def _failed(number: int, reached: float) -> Status:
    return Status(
        "not-converged",
        f"Newton's method did not converge beyond {reached:.4g} of load step {number}",
        "load the body less, or use a finer mesh where it deforms most",
    )
