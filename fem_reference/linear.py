"""Small-strain elasticity on tetrahedra, for every Poisson ratio in (-1, 0.5], 0.5 included: the fast path.

Method: mixed displacement-pressure form, Taylor-Hood element; scaled by shear modulus and mean edge, so that the
system does not contain Young's modulus; sparse LDL^T or preconditioned GMRES. `fem_reference.plain_linear`
verifies it.
Order: 3 in displacement, 2 in strain and pressure (L2).
Source: Hughes, The Finite Element Method, section 4.3.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fem_reference.condition import condition_estimate
from fem_reference.linear_algebra import BATCH, Solver, choose_solver
from fem_reference.loads import (
    Load,
    cavity_forces,
    check_cavities,
    check_loads,
    check_nodal,
    gather_to_vertices,
    held_nodes,
    independent_loads,
    nodal_forces,
    prescribed_nodes,
)
from fem_reference.materials import make_law
from fem_reference.mesh import TetMesh
from fem_reference.moduli import check_density, check_fibres, make_moduli
from fem_reference.outputs import OUTPUTS, mean_pressure, strain_outputs
from fem_reference.solution import CONVERGED, Solution, Status, check_outputs
from fem_reference.springs import ElasticSupport, make_springs
from fem_reference.system import LinearSystem, build_system
from solver_common.arrays import Array
from solver_common.jit import clock
from solver_common.solution import solver_error

__all__ = ["ELEMENTS", "Fields", "LinearProblem", "Load"]


ELEMENTS = {"P2-P1": (2, True), "P2": (2, False), "P1": (1, False)}


@dataclass(frozen=True)
class Fields:
    """Nodal fields of S steps; a flat field of one step is a dof vector of `fem_reference.mesh.TetMesh.bases`.

    Attributes
    ----------
    displacement : (S, n_nodes, 3) [m]
    pressure : (S, n_pressures) p = -lambda div u at the vertices, one for each part where parts meet (see
        `fem_reference.mesh.TetMesh`); (S, 0) for a displacement element [Pa]
    reaction : (S, n_nodes, 3) force of supports and springs on the body [N]
    residual : (S,) true relative residual of the scaled system
    iterations : (S,) Krylov iterations, 0 for a direct solve
    """

    displacement: Array
    pressure: Array
    reaction: Array
    residual: Array
    iterations: NDArray[np.int64]


def _combination(values: Array, coefficients: Array) -> Array:
    """(S, ...) sums of (r, ...) values with coefficients (r, S)."""
    flat: Array = coefficients.T @ values.reshape(len(values), -1)
    return flat.reshape(coefficients.shape[1], *values.shape[1:])


def _works(forces: Array, displacement: Array, coefficients: Array) -> Array:
    """(S,) work of forces (r, n, 3) on displacements (r, n, 3), both combined with the coefficients (r, S)."""
    works = forces.reshape(len(forces), -1) @ displacement.reshape(len(displacement), -1).T
    return np.einsum("as,as->s", coefficients, works @ coefficients)


class LinearProblem:
    """One body, one material and one set of supports, ready for many loads.

    Mixed displacement-pressure Taylor-Hood elements (P2-P1) on stress = 2 G strain - p I with
    p = -lambda div u (Hughes, The Finite Element Method, section 4.3). The displacement elements "P2" and "P1"
    exist to show locking. Fibres along a unit vector a add k (a.eps a) a x a to the stress, k = (c - 1) E:
    the small-strain limit of `fem_reference.materials.TransverselyIsotropic`.

    Parameters
    ----------
    points, tetrahedra, surface_nodes, triangles : see `fem_reference.mesh.TetMesh`
    youngs_modulus : of the isotropic part, one number or one per tetrahedron [Pa], positive
    poisson_ratio : of the isotropic part, in (-1, 0.5], below 0.5 for "P2" and "P1"; or (m,) in (0, 0.5]
    parts : (m,) number of each tetrahedron's part: the pressure may jump between parts, as where moduli jump
    elastic_supports : springs under parts of the surface
    cavities : (F, k) facets of the walls of cavities filled with an incompressible fluid: each keeps its volume
    density : [kg/m^3]
    held : (N,) surface nodes whose displacement is given, or (N, 3) single components of them (rollers)
    solver : "auto" chooses by size, `expected_loads` and memory; "direct" or "iterative" insist
    expected_loads : number of loads to come, for the choice
    element : "P2-P1", "P2" or "P1"
    fibre_direction : (3,) of any length, None for an isotropic body
    contrast : Young's modulus along the fibres over `youngs_modulus`, 1 or more
    memory_limit : bytes the solver may take; None for what the machine has left

    Raises
    ------
    SolverError
        Before any solve: unusable mesh, material or support, or too little memory.
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
        solver: str = "auto",
        expected_loads: int = 1,
        element: str = "P2-P1",
        fibre_direction: ArrayLike | None = None,
        contrast: float = 1.0,
        memory_limit: float | None = None,
    ) -> None:
        start = clock()
        if element not in ELEMENTS:
            raise solver_error(
                "bad-element", f"element {element!r} is unknown", f"use one of {', '.join(ELEMENTS)}"
            )
        order, mixed = ELEMENTS[element]
        check_density(density)
        self.mesh = TetMesh(points, tetrahedra, surface_nodes, triangles, order=order, parts=parts)
        moduli = make_moduli(self.mesh, youngs_modulus, poisson_ratio, mixed=mixed)
        self.element = element
        self.youngs_modulus = moduli.youngs_modulus
        self.poisson_ratio = moduli.poisson_ratio
        self.density = float(density)
        self.shear_modulus = moduli.shear_modulus
        self.contrast = float(contrast)
        material = "neo-hookean" if fibre_direction is None else "transversely-isotropic"
        law = make_law(material, 2.0 * (1.0 + self.poisson_ratio), 1.0, fibre_direction, self.contrast)
        if law.fibre is not None:
            check_fibres(moduli)
        springs = make_springs(self.mesh, elastic_supports, self.shear_modulus)
        self.held = held_nodes(self.mesh, np.asarray(held), springs)
        self.supported: NDArray[np.bool_] = np.asarray(self.held.any(axis=1))
        if springs is not None:
            self.supported[springs.nodes] = True
        self.system: LinearSystem = build_system(
            self.mesh,
            self.held,
            mixed=mixed,
            poisson_ratio=self.poisson_ratio,
            law=law,
            relative_stiffness=moduli.stiffness,
            poisson_ratios=moduli.poisson_ratios,
            springs=springs,
        )
        self.solver: Solver = choose_solver(self.system, solver, expected_loads, memory_limit)
        self._cavities = check_cavities(self.mesh, cavities)
        self.seconds_setup = clock() - start

    def fields(self, load: Load) -> Fields:
        """The nodal fields of one load, a single step. Raises SolverError as `solve` does."""
        check_loads(self.mesh, [load])
        return self._solve_some([load])[1]

    def mean_pressure(self, fields: Fields) -> Array:
        """(S,) volume mean of -tr(stress)/3 [Pa]."""
        return mean_pressure(self.system, self.shear_modulus, fields.displacement, fields.pressure)

    @cached_property
    def condition(self) -> float:
        """Condition number of the system, estimated by about a dozen solves: see `fem_reference.condition`."""
        return condition_estimate(self.system, self.solver)

    def solve(self, loads: Sequence[Load], outputs: frozenset[str] = frozenset()) -> Solution:
        """Solve one step per load; linear combinations of other loads are combined from their solutions.

        `seconds_per_step` is the time of the first load, solved alone; the others are solved in batches.

        Parameters
        ----------
        loads : the load steps, independent of each other
        outputs : further scalars, see `fem_reference.outputs.OUTPUTS`

        Raises
        ------
        SolverError
            For a load of the wrong shape or with values that are not finite, and for an unknown output.
        """
        start = clock()
        check_outputs(outputs, OUTPUTS)
        check_loads(self.mesh, loads)
        chosen, coefficients = independent_loads(loads)
        if not len(chosen):  # all loads are zero: solve one of them
            chosen, coefficients = np.zeros(1, dtype=np.int64), np.zeros((1, len(loads)))
        basis = [loads[k] for k in chosen]
        forces, fields = self._solve_some(basis[:1])
        seconds = clock() - start
        if len(basis) > 1:
            more = self._solve_some(basis[1:])
            forces = np.concatenate([forces, more[0]])
            names = [field.name for field in dataclasses.fields(Fields)]
            fields = Fields(
                *(np.concatenate([getattr(f, name) for f in (fields, more[1])]) for name in names)
            )
        return self._combined(forces, fields, coefficients, outputs, seconds)

    def _solve_some(self, loads: Sequence[Load]) -> tuple[Array, Fields]:
        """Nodal forces and fields of some loads."""
        forces = nodal_forces(self.mesh, loads, self.density)
        return forces, self.solve_nodal(forces, prescribed_nodes(self.mesh, loads))

    def _combined(
        self, forces: Array, fields: Fields, coefficients: Array, outputs: frozenset[str], seconds: float
    ) -> Solution:
        """The S steps that are combinations of r solved ones, with coefficients (r, S).

        Linear results are combined at the surface only. Works come from the r x r works of each step's forces on
        each displacement. A combination has the largest residual and iteration count of its terms.
        """
        part_of = coefficients != 0.0
        residual = np.where(part_of, fields.residual[:, None], 0.0).max(axis=0)
        work = _works(forces, fields.displacement, coefficients)
        scalars = self._strain_outputs(fields, coefficients, outputs - {"compliance", "condition_estimate"})
        scalars["relative_residual"] = residual
        if "compliance" in outputs:
            scalars["compliance"] = work
        if "condition_estimate" in outputs:
            scalars["condition_estimate"] = np.full(len(residual), self.condition)
        return Solution(
            displacement=_combination(fields.displacement[:, self.mesh.surface_nodes], coefficients),
            fluid_pressure=_combination(self.mean_pressure(fields), coefficients),
            reaction_force=_combination(gather_to_vertices(self.mesh, fields.reaction), coefficients),
            energy=0.5 * (work + _works(fields.reaction, fields.displacement, coefficients)),
            iterations=np.where(part_of, fields.iterations[:, None], 0).max(axis=0),
            status=tuple(self._status(value) for value in residual),
            seconds_setup=self.seconds_setup,
            seconds_per_step=np.full(len(residual), seconds),
            parameters=self._parameters(float(residual.max())),
            scalars=scalars,
        )

    def _strain_outputs(self, fields: Fields, coefficients: Array, names: frozenset[str]) -> dict[str, Array]:
        if not names:
            return {}
        # in batches: all steps at once can take many times the memory of the solved ones
        parts = [coefficients[:, first : first + BATCH] for first in range(0, coefficients.shape[1], BATCH)]
        found = [strain_outputs(self.mesh, _combination(fields.displacement, part), names) for part in parts]
        return {name: np.concatenate([part[name] for part in found]) for name in found[0]}

    def solve_nodal(self, forces: Array, prescribed: Array) -> Fields:
        """Solve for forces given at the nodes.

        Parameters
        ----------
        forces : (S, n_nodes, 3) [N]
        prescribed : (S, n_nodes, 3) displacement of held nodes; ignored elsewhere [m]

        Raises
        ------
        SolverError
            For arrays of the wrong shape or with values that are not finite.
        """
        check_nodal(self.mesh, forces, prescribed)
        length = self.mesh.mean_edge
        force_unit = self.shear_modulus * length**2
        scaled_forces = forces / force_unit
        scaled_given = prescribed / length
        rhs = self.system.right_hand_side(scaled_forces, scaled_given)
        # scaled by the largest entry: the square of 1e-170 underflows, and 32 bits end at 1e-38
        largest = np.abs(rhs).max(axis=0, initial=0.0)
        unit = np.where(largest > 0.0, largest, 1.0)
        solved = self.solver.solve(rhs / unit)
        u, p = self.system.expand(solved.x * unit, scaled_given)
        if self._cavities.size:
            pushes, moved, pressed, schur = self._fluid
            push = -np.einsum("knc,snc->sk", pushes, u) @ np.linalg.pinv(schur, 1e-10, hermitian=True)
            u, p = u + np.tensordot(push, moved, 1), p + push @ pressed
            scaled_forces = scaled_forces + np.tensordot(push, pushes, 1)
        reaction = self.system.reactions(u, p, scaled_forces)
        return Fields(
            displacement=u * length,
            pressure=p * self.shear_modulus,
            reaction=reaction * force_unit,
            residual=solved.residual,
            iterations=solved.iterations,
        )

    @cached_property
    def _fluid(self) -> tuple[Array, Array, Array, Array]:
        """Scaled forces, displacement, pressure and work (k, k) of a unit pressure in each filled cavity.

        The forces are also the gradient of the cavity's volume.
        """
        nothing = np.zeros((len(self._cavities.T), self.mesh.n_nodes, 3))
        pushes = cavity_forces(self.mesh, self._cavities) / self.mesh.mean_edge**2
        solved = self.solver.solve(self.system.right_hand_side(pushes, nothing))
        moved, pressed = self.system.expand(solved.x, nothing)
        return pushes, moved, pressed, np.einsum("knc,lnc->kl", pushes, moved)

    def _status(self, residual: float) -> Status:
        if residual <= self.solver.tolerance:
            return CONVERGED
        remedy = "improve the worst tetrahedra of the mesh"
        if self.solver.name != "direct":
            remedy += ' or use solver="direct"'
        if not self.system.mixed:
            remedy = "use the element P2-P1: a displacement element is ill-conditioned near incompressibility"
        return Status(
            "not-converged",
            f"the {self.solver.name} solver reached a relative residual of {residual:.1e},"
            f" {self.solver.tolerance:.0e} is needed",
            remedy,
        )

    def _parameters(self, residual: float) -> dict[str, float | str]:
        return {
            "element": self.element,
            "youngs_modulus": self.youngs_modulus,
            "poisson_ratio": self.poisson_ratio,
            "density": self.density,
            "contrast": self.contrast,
            "solver": self.solver.name,
            "factorisation": self.solver.library,
            "solver_reason": self.solver.reason,
            "solver_estimated_bytes": self.solver.estimated_bytes,
            "dofs": float(self.system.size),
            "tetrahedra": float(len(self.mesh.tetrahedra)),
            "relative_residual": residual,
        }
