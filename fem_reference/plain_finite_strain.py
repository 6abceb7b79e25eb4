"""Finite-strain elasticity as a scikit-fem user writes it: the reference for `fem_reference.finite_strain`.

Method: the forms of `fem_reference.plain_forms` on the Taylor-Hood element; Newton's method with the whole,
unsymmetric tangent and a sparse LU factor. Each load starts from the equilibrium under the previous one; a load
step that fails is halved. Order: 3 in displacement, 2 in strain and pressure (L2), 2 for Newton's method.
Source: Bonet and Wood, Nonlinear Continuum Mechanics, 2nd ed., chapters 6 to 9.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix
from skfem import bmat, condense, solve
from skfem.helpers import mul

from fem_reference import plain_forms as forms
from fem_reference.loads import Load
from fem_reference.materials import NeoHookean, TransverselyIsotropic, make_law
from fem_reference.outputs import strain_below
from fem_reference.plain_body import Dofs, PlainBody
from fem_reference.solution import CONVERGED, Solution, Status, check_outputs
from solver_common.arrays import Array
from solver_common.solution import solver_error

# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators

OUTPUTS = ("max_det_f_deviation", "max_principal_strain", "p95_principal_strain", "volume")
_LEAST_STEP = 2.0**-8  # of a load step
_MOST_ITERATIONS = 12
_TOLERANCE = 1e-8  # of the last update, relative: Newton's method squares the error after it


class PlainFiniteStrainProblem:
    """One body, one material and one set of supports in scikit-fem's objects, for load histories of any size.

    Parameters
    ----------
    mesh, supports : as `fem_reference.plain_body.PlainBody`
    youngs_modulus, poisson_ratio, density, material, fibre_direction, contrast, pressure, material_parameters : as
        `fem_reference.finite_strain.FiniteStrainProblem`

    Attributes
    ----------
    body : the mesh, the bases and the held dofs; see `fem_reference.plain_body.PlainBody`
    values : the material values of the forms

    Raises
    ------
    SolverError
        For input that `FiniteStrainProblem` refuses before assembly.
    """

    def __init__(
        self,
        *mesh: ArrayLike,
        youngs_modulus: ArrayLike,
        poisson_ratio: ArrayLike,
        density: float = 0.0,
        material: str = "neo-hookean",
        fibre_direction: ArrayLike | None = None,
        contrast: float = 1.0,
        pressure: str = "follower",
        material_parameters: Mapping[str, ArrayLike] | None = None,
        **supports: Any,
    ) -> None:
        start = time.perf_counter()
        law = make_law(material, 1.0, 1.0, fibre_direction, contrast, material_parameters)
        if not isinstance(law, NeoHookean | TransverselyIsotropic):
            remedy = 'use material="neo-hookean", or FiniteStrainProblem'
            raise solver_error("bad-material", f"{material} is not written out here", remedy)
        self.body = PlainBody(*mesh, **supports, intorder=5)
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
        self._mass = forms.mass.assemble(self.body.pressure_basis, **self.values)
        self.seconds_setup = time.perf_counter() - start

    def fields(self, x: Array) -> dict[str, Array]:
        """The fields of the forms inside the body in the state x, displacement first."""
        n = self.body.basis.N
        H = np.asarray(self.body.basis.interpolate(x[:n]).grad)
        F = H + np.eye(3)[:, :, None, None]
        p = np.asarray(self.body.pressure_basis.interpolate(x[n:]))
        fields = {**self.values, **forms.kinematics(H), "F": F, "p": p}
        return fields | {"Fa": mul(F, np.broadcast_to(self.values["a"], F.shape[1:]))}

    def residual(self, x: Array, load: Load) -> tuple[Array, Array]:
        """The residual in the state x, and the forces of gravity and contact in it."""
        body, fields = self.body, self.fields(x)
        forces = body.body_forces(load, self.density)
        if self.follows:
            forces = forces + forms.follower.assemble(body.surface_basis, **self._on_surface(x, load))
        else:
            forces = forces + body.dead_pressure(load)
        inside = forms.internal.assemble(body.basis, **fields) + body.springs @ x[: body.basis.N]
        constraint = forms.volume_change.assemble(body.pressure_basis, **fields)
        return np.concatenate([inside - forces, constraint]), forces

    def tangent(self, x: Array, load: Load) -> csr_matrix:
        """The derivative of the residual."""
        body, fields = self.body, self.fields(x)
        A = forms.stiffness.assemble(body.basis, **fields) + body.springs
        if self.has_fibres:
            A = A + forms.fibre_stiffness.assemble(body.basis, **fields)
        if self.follows and np.any(load.facet_pressure):
            A = A + forms.follower_stiffness.assemble(body.surface_basis, **self._on_surface(x, load))
        B = forms.coupling.assemble(body.basis, body.pressure_basis, **fields)
        return bmat([[A, -B.T], [self.values["couples"] * B, self._mass]], "csr")

    def _on_surface(self, x: Array, load: Load) -> dict[str, Array]:
        basis = self.body.surface_basis
        H = np.asarray(basis.interpolate(x[: basis.N]).grad)
        return {**forms.kinematics(H), "contact": self.body.pressure_at_points(load)}

    def newton(self, x: Array, load: Load) -> tuple[Array, int] | None:
        """The equilibrium under a load from the state x, and the iterations to it; None where there is none."""
        body, n = self.body, self.body.basis.N
        for iteration in range(1, _MOST_ITERATIONS + 1):
            move = np.zeros_like(x)
            move[:n] = body.given(load) - x[:n]
            unbalanced, _ = self.residual(x, load)
            update = solve(*condense(self.tangent(x, load), -unbalanced, x=move, D=body.held_dofs))
            x = x + update
            inside_out = not (
                forms.kinematics(self.body.basis.interpolate(x[:n]).grad)["dilation"] > -1.0
            ).all()
            if inside_out or not np.isfinite(x).all():
                return None
            if np.linalg.norm(update[:n]) <= _TOLERANCE * np.linalg.norm(x[:n]):
                return x, iteration
        return None

    def measured(self, x: Array, load: Load, status: Status) -> Dofs:
        """The results of a state x in equilibrium under a load."""
        basis, n, held = self.body.basis, self.body.basis.N, self.body.held_dofs
        unbalanced, forces = self.residual(x, load)
        inside = self.fields(x)
        reaction = -(self.body.springs @ x[:n])
        reaction[held] += unbalanced[held]
        deformed = float(forms.volume.assemble(basis, **inside))
        strain = np.asarray(
            np.linalg.eigvalsh(0.5 * np.moveaxis(inside["strain"], (0, 1), (-2, -1))), dtype=float
        )
        free = np.linalg.norm(np.delete(unbalanced[:n], held))
        return Dofs(
            displacement=x[:n],
            pressure=x[n:],
            reaction=reaction,
            energy=float(forms.energy.assemble(basis, **inside)),
            mean_pressure=float(forms.pressure_integral.assemble(basis, **inside)) / deformed,
            residual=float(free / (np.linalg.norm(forces + reaction) or 1.0)),
            status=status,
            scalars={
                "max_det_f_deviation": float(np.abs(inside["dilation"]).max()),
                "max_principal_strain": float(strain[..., -1].max()),
                "p95_principal_strain": strain_below(strain[..., -1], basis.dx),
                "volume": deformed,
            },
        )

    def follow(self, x: Array, start: Load | None, end: Load) -> tuple[Array, float, int]:
        """Go from one load to another in substeps; returns the state, the share reached and the iterations."""
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
        """The state at each load; each starts from the previous one, the first from the undeformed body.

        A load step that fails yields the last equilibrium on the way to it, and ends the history.

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

    def solve(self, loads: Sequence[Load], outputs: frozenset[str] = frozenset()) -> Solution:
        """Follow a load history; as `fem_reference.finite_strain.FiniteStrainProblem.solve`, fewer `outputs`."""
        check_outputs(outputs, OUTPUTS)
        steps = list(self.history(loads, sorted(outputs)))
        return self.body.solution(steps, len(loads), self.seconds_setup, self._told)


def between(start: Load | None, end: Load, share: float) -> Load:
    """The load at a share of the way between two loads; None stands for no load."""
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
        f"Newton's method did not converge beyond {reached:.4g} of load step {number + 1}",
        "load the body less, or use a finer mesh where it deforms most",
    )
