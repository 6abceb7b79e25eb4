"""Finite-strain elasticity on tetrahedra, for every Poisson ratio in (-1, 0.5], 0.5 included: the fast path.

Method: total Lagrangian, mixed displacement-pressure form, Taylor-Hood element; Newton's method along a load
path. `fem_reference.plain_finite_strain` verifies it.
Order: 3 in displacement, 2 in strain and pressure (L2).
Source: Bonet and Wood, Nonlinear Continuum Mechanics, 2nd ed., chapters 6 to 9.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fem_reference.assembly import coupling_pattern, scalar_pattern
from fem_reference.condition import condition_estimate
from fem_reference.finite_contact import Indentation, RigidContact
from fem_reference.finite_strain_assembly import ElementAssembly
from fem_reference.finite_strain_outputs import OUTPUTS, Record
from fem_reference.follower import FollowerPressure
from fem_reference.indenter import Indenter, told_sunk
from fem_reference.linear import Fields
from fem_reference.loads import (
    Load,
    check_cavities,
    check_loads,
    check_nodal,
    held_nodes,
    loads_at,
    nodal_forces,
    prescribed_nodes,
)
from fem_reference.materials import NeoHookean, make_law
from fem_reference.mesh import TetMesh
from fem_reference.moduli import check_density, check_fibres, make_moduli
from fem_reference.newton import LoadPath, Newton, ScaledLoad, State, Substep
from fem_reference.solution import Solution, SolverError, check_outputs
from fem_reference.springs import ElasticSupport, make_springs
from fem_reference.system import LinearSystem, build_system
from fem_reference.tangent_solver import Factors, TangentSolver, TangentSystem
from solver_common.arrays import Array
from solver_common.jit import clock
from solver_common.solution import solver_error

__all__ = ["OUTPUTS", "PRESSURES", "FiniteStrainProblem", "Load"]


PRESSURES = ("follower", "dead")


class FiniteStrainProblem:
    """One body, one material and one set of supports, for load histories of any size.

    Mixed displacement-pressure Taylor-Hood elements (P2-P1), total Lagrangian, for the laws of
    `fem_reference.materials`. The small-load limit is `fem_reference.linear.LinearProblem`. Newton's method uses
    the consistent tangent. A load step that does not converge is cut into substeps, which grow again where
    convergence is easy.

    Parameters
    ----------
    points, tetrahedra, surface_nodes, triangles : see `fem_reference.mesh.TetMesh`
    youngs_modulus : of the isotropic part, one number or one per tetrahedron [Pa], positive
    poisson_ratio : of the isotropic part, in (-1, 0.5], or one per tetrahedron in (0, 0.5]
    parts : (m,) number of each tetrahedron's part: the pressure may jump between parts, as where moduli jump
    elastic_supports : springs under parts of the surface
    cavities : (F, k) facets of the walls of cavities filled with an incompressible fluid: each keeps its volume
    density : of the undeformed body [kg/m^3]
    held : (N,) surface nodes whose displacement is given, or (N, 3) single components of them (rollers)
    material : one of `fem_reference.materials.MATERIALS`
    fibre_direction : (3,) of any length, for the transversely isotropic law
    contrast : Young's modulus along the fibres over `youngs_modulus`, 1 or more
    material_parameters : the dimensionless ones of the law, see `fem_reference.materials.make_law`
    pressure : "follower" acts on the deformed surface along its normal; "dead" keeps its first forces
    solver : "auto" chooses by size, `expected_loads` and memory; "direct" or "iterative" insist
    expected_loads : number of load steps to come, for the choice
    max_newton : iterations before a substep is halved, unless the residual just fell to a tenth
    tolerance : of the residual of the scaled system, relative to its internal forces
    memory_limit : bytes the solver may take; None for what the machine has left

    Raises
    ------
    SolverError
        Before any solve: unusable mesh, material, support or option, or too little memory.
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
        cavities: ArrayLike | None = None,
        material: str = "neo-hookean",
        fibre_direction: ArrayLike | None = None,
        contrast: float = 1.0,
        material_parameters: Mapping[str, ArrayLike] | None = None,
        pressure: str = "follower",
        solver: str = "auto",
        expected_loads: int = 1,
        max_newton: int = 12,
        tolerance: float = 1e-9,
        memory_limit: float | None = None,
    ) -> None:
        start = clock()
        check_density(density)
        if pressure not in PRESSURES:
            raise _bad_option(f"pressure {pressure!r} is unknown", f"use one of {', '.join(PRESSURES)}")
        if max_newton < 1:
            raise _bad_option(f"max_newton is {max_newton}", "give 1 or more")
        if not 0.0 < tolerance < 1.0:
            raise _bad_option(f"tolerance is {tolerance}", "give a number between 0 and 1")
        self.mesh = TetMesh(points, tetrahedra, surface_nodes, triangles, order=2, parts=parts)
        moduli = make_moduli(self.mesh, youngs_modulus, poisson_ratio, mixed=True)
        self.youngs_modulus = moduli.youngs_modulus
        self.poisson_ratio = moduli.poisson_ratio
        self.density = float(density)
        self.shear_modulus = moduli.shear_modulus
        self.material = material
        self.pressure = pressure
        # in units of the shear modulus, like all below
        self._law = make_law(
            material, 2.0 * (1.0 + self.poisson_ratio), 1.0, fibre_direction, contrast, material_parameters
        )
        if self._law.fibre is not None:
            check_fibres(moduli)
        self._contrast = float(contrast)
        springs = make_springs(self.mesh, elastic_supports, self.shear_modulus)
        self.held = held_nodes(self.mesh, np.asarray(held), springs)
        pattern = self._pattern = scalar_pattern(self.mesh)
        coupling = coupling_pattern(self.mesh, pattern)
        self.system: LinearSystem = build_system(
            self.mesh,
            self.held,
            mixed=True,
            law=NeoHookean(1.0),
            poisson_ratio=self.poisson_ratio,
            pattern=pattern,
            relative_stiffness=moduli.stiffness,
            poisson_ratios=moduli.poisson_ratios,
            springs=springs,
        )
        self.solver = TangentSolver(self.system, solver, expected_loads, memory_limit)
        self._assembly = ElementAssembly(self.mesh, pattern, coupling, self._law, moduli.stiffness)
        self._newton = Newton(
            self.system,
            pattern,
            coupling,
            self._assembly,
            FollowerPressure(self.mesh, pattern),
            self.solver,
            max_newton,
            float(tolerance),
            check_cavities(self.mesh, cavities),
        )
        self.seconds_setup = clock() - start

    def substeps(self, loads: Sequence[Load], path: LoadPath | None = None) -> Iterator[tuple[int, Substep]]:
        """Follow a load history from the undeformed body, one attempt at a time; each load by `path` if given.

        Yields the number of the load step with each attempt, converged or not. Ends at a load step that cannot be
        reached. See `fem_reference.newton.Substep`; its quantities are in mean edges and shear moduli.

        Raises
        ------
        SolverError
            For a load of the wrong shape or with values that are not finite.
        """
        check_loads(self.mesh, loads)
        return self._follow([self._scaled(load) for load in loads], path)

    def tangent(self, reached: Substep) -> TangentSystem:
        """The tangent at the state of a substep, in its scaled units."""
        return self._newton.tangent(reached.state, reached.load)

    def softest(self, reached: Substep) -> float:
        """Lowest eigenvalue of the tangent at a substep's state, over that at rest; see `Newton.softest`."""
        return self._newton.softest(reached)

    def solve_nodal(self, forces: Array, prescribed: Array) -> Fields:
        """Follow a history of dead forces and prescribed displacements at the nodes.

        Parameters
        ----------
        forces : (S, n_nodes, 3) [N]
        prescribed : (S, n_nodes, 3) displacement of held nodes; ignored elsewhere [m]

        Returns
        -------
        Fields
            NaN from the first load step that cannot be reached.

        Raises
        ------
        SolverError
            For arrays of the wrong shape or with values that are not finite.
        """
        check_nodal(self.mesh, forces, prescribed)
        steps, length = len(forces), self.mesh.mean_edge
        force_unit = self.shear_modulus * length**2
        nothing = self._newton.rest.load.pressure
        loads = [
            ScaledLoad(nothing, force / force_unit, given / length)
            for force, given in zip(forces, prescribed, strict=True)
        ]
        fields = Fields(
            displacement=np.full((steps, self.mesh.n_nodes, 3), np.nan),
            pressure=np.full((steps, self.mesh.n_pressures), np.nan),
            reaction=np.full((steps, self.mesh.n_nodes, 3), np.nan),
            residual=np.full(steps, np.nan),
            iterations=np.zeros(steps, dtype=np.int64),
        )
        for number, attempt in self._follow(loads):
            fields.iterations[number] += len(attempt.residuals) - 1
            if attempt.converged and attempt.load_factor == 1.0:
                fields.displacement[number] = attempt.state.displacement * length
                fields.pressure[number] = attempt.state.pressure * self._stress_unit
                fields.reaction[number] = attempt.reaction * force_unit
                fields.residual[number] = attempt.residuals[-1]
        return fields

    def sag(self, gravity: ArrayLike, near: Fields | None = None) -> Fields:
        """The nodal fields under the weight alone.

        Parameters
        ----------
        gravity : (3,) [m/s^2]
        near : fields of a body of nearly the same shape, to start from

        Raises
        ------
        SolverError
            where the weight cannot be reached; its status is that of the load step.
        """
        length, load, rest, found = self.mesh.mean_edge, self._weight(gravity), self._newton.rest, None
        if near is not None:
            found = self._newton.solve(self._state(near), load, 1.0)
        if found is None or not found.converged:
            record = Record(self._newton, self.shear_modulus, 1, frozenset())
            for found in self._newton.follow(rest.state, rest.load, load, examines=False):
                record.add(0, found)
            record.end()
            status = record.solution(0.0, {}, {}).status[0]
            if not status.ok:
                raise SolverError(status)
        assert found is not None
        return Fields(
            found.state.displacement[None] * length,
            found.state.pressure[None] * self._stress_unit,
            found.reaction[None] * self.shear_modulus * length**2,
            np.array(found.residuals[-1:]),
            np.array([len(found.residuals) - 1]),
        )

    def is_stable(self, gravity: ArrayLike, near: Fields) -> bool:
        """Whether the `sag` under gravity (3,) [m/s^2] is a stable equilibrium.

        Raises
        ------
        SolverError
            where memory does not suffice for a factor.
        """
        state = self._state(near)
        tangent = self._newton.tangent(state, self._weight(gravity)).symmetric()
        return Factors(tangent, None).is_stable(tangent, self._newton.kept_volumes(state))

    def _weight(self, gravity: ArrayLike) -> ScaledLoad:
        on_surface = np.zeros((len(self.mesh.surface_nodes), 3))
        return self._scaled(Load(self._newton.rest.load.pressure, on_surface, np.asarray(gravity, float)))

    def _state(self, near: Fields) -> State:
        """Scaled state, from nodal fields of a body of nearly the same shape."""
        displacement = near.displacement[0] / self.mesh.mean_edge
        pressure = near.pressure[0] / self._stress_unit
        return State(displacement, pressure, self._newton.rest.state.fluid)

    @property
    def _stress_unit(self) -> float:
        """Unit of scaled pressures [Pa]."""
        return self.system.pressure_scale * self.shear_modulus

    def indent(
        self,
        indenter: Indenter,
        facets: NDArray[np.bool_],
        depths: Sequence[float],
        load: Load | Sequence[Load] | None = None,
        outputs: frozenset[str] = frozenset(),
    ) -> Indentation:
        """Push a rigid frictionless indenter in, from the undeformed body; see `fem_reference.finite_contact`.

        Parameters
        ----------
        indenter : a sphere or a capsule
        facets : (F,) facets that it can touch
        depths : depth at each step, from the place where its tip rests [m]
        load : all other loads, in full from the first step or step by step
        outputs : further scalars of its solution, see `OUTPUTS`; no condition

        Raises
        ------
        SolverError
            For an indenter that does not suit this body, depths that are not finite, and a load that is refused.
        """
        check_outputs(outputs, OUTPUTS.keys() - {"condition_estimate"})
        mesh, length = self.mesh, self.mesh.mean_edge
        loads = loads_at(mesh, depths, load)
        check_loads(mesh, loads)
        contact = RigidContact(mesh, self._pattern, indenter, facets)
        points = mesh.node_points / length
        scaled = [
            replace(self._scaled(b), depth=float(d) / length) for b, d in zip(loads, depths, strict=True)
        ]
        record = Record(self._newton, self.shear_modulus, len(depths), outputs)
        force = np.full((len(depths), 3), np.nan)
        penalty, area, inside = np.full((3, len(depths)), np.nan)
        self._newton.contact = contact
        try:
            for step, last in self._follow(scaled):
                record.add(step, last)
                if last.converged and last.load_factor == 1.0:
                    x, depth = points + last.state.displacement, scaled[step].depth
                    force[step] = contact.forces(x, depth).sum(axis=0) * self.shear_modulus * length**2
                    penalty[step] = contact.energy(x, depth) * self.shear_modulus * length**3
                    area[step] = contact.area(x, depth) * length**2
                    inside[step] = contact.inside(x, depth) * length
            record.end()
        finally:
            self._newton.contact = None
        solution = record.solution(self.seconds_setup, self._told(), {})
        status = [told_sunk(*step) for step in zip(solution.status, inside, depths, strict=True)]
        solution = replace(solution, status=tuple(status))
        return Indentation(solution, force, penalty, area, inside)

    def _follow(
        self, loads: Sequence[ScaledLoad], path: LoadPath | None = None
    ) -> Iterator[tuple[int, Substep]]:
        last = self._newton.rest
        for number, end in enumerate(loads):
            self._newton.place = (number, len(loads))
            way = path.follow(self._newton, end) if path else self._newton.follow(last.state, last.load, end)
            for last in way:
                yield number, last
            if not (last.converged and last.load_factor == 1.0):
                return

    def solve(
        self, loads: Sequence[Load], outputs: frozenset[str] = frozenset(), path: LoadPath | None = None
    ) -> Solution:
        """Follow a load history: each step starts from the one before it, the first from the undeformed body.

        Parameters
        ----------
        loads : the load steps
        outputs : further scalars, see `OUTPUTS`
        path : if given, steps start from the states that it knows for this problem's loads; it remembers theirs

        Returns
        -------
        Solution
            `iterations` counts Newton iterations. A failed step holds the last equilibrium on the way to its
            load; scalars["load_factor"] is the share reached. Later steps hold NaN.

        Raises
        ------
        SolverError
            For a load of the wrong shape or with values that are not finite, and for an unknown output.
        """
        check_outputs(outputs, OUTPUTS)
        record = Record(self._newton, self.shear_modulus, len(loads), outputs)
        factorisations, steps = self.solver.factorisations, self.solver.steps
        for number, attempt in self.substeps(loads, path):
            record.add(number, attempt)
        record.end()
        condition = {
            number: condition_estimate(self.tangent(reached).symmetric())
            for number, reached in record.states.items()
        }
        return record.solution(
            self.seconds_setup,
            self._told()
            | {
                "factorisations": float(self.solver.factorisations - factorisations),
                "linear_iterations": float(self.solver.steps - steps),
            },
            condition,
        )

    def _told(self) -> dict[str, float | str]:
        """Properties recorded with every solution."""
        return {
            "element": "P2-P1",
            "material": self.material,
            "contrast": self._contrast,
            "pressure": self.pressure,
            "youngs_modulus": self.youngs_modulus,
            "poisson_ratio": self.poisson_ratio,
            "density": self.density,
            "solver": self.solver.preconditioner.name,
            "factorisation": self.solver.preconditioner.library,
            "solver_reason": self.solver.reason,
            "solver_estimated_bytes": self.solver.preconditioner.estimated_bytes,
            "dofs": float(self.system.size),
            "tetrahedra": float(len(self.mesh.tetrahedra)),
        }

    def _scaled(self, load: Load) -> ScaledLoad:
        dead = load
        follower = np.zeros(np.shape(load.facet_pressure))
        if self.pressure == "follower":
            follower = np.asarray(load.facet_pressure, dtype=np.float64) / self.shear_modulus
            dead = replace(load, facet_pressure=np.zeros_like(follower))
        length = self.mesh.mean_edge
        return ScaledLoad(
            follower,
            nodal_forces(self.mesh, [dead], self.density)[0] / (self.shear_modulus * length**2),
            prescribed_nodes(self.mesh, [load])[0] / length,
        )


_bad_option = partial(solver_error, "bad-option")
