"""A formulation with its supports: the right-hand sides of a load, and a step's results from its unknowns."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vdm.constraints import ConstraintError, Load, Mask, Support
from vdm.deformed import DeformableSurface, DeformedSurface
from vdm.formulations.base import Formulation
from vdm.material import Parameters
from vdm.solution import CONVERGED, SolverError, Status
from vdm.surface import SurfaceMesh

Array = NDArray[np.float64]

# share of a unit motion at the held nodes below which it counts as left free: what resists it is its square, of
# which rounding leaves no three digits to any solver, and an iterative one would not notice
FREE_MOTION = 1e-6


@dataclass(frozen=True)
class Step:
    """One load step on N nodes, SI units; `unknown` (N, d) and `border` (m,) start the next step."""

    displacement: Array
    pressure_change: float
    reaction_force: Array
    energy: float
    unknown: Array
    border: Array
    iterations: int = 0
    status: Status = CONVERGED


@dataclass(frozen=True)
class Problem:
    """What a solver solves: `K x - columns s = force` at free nodes, x given at held ones, and the border rows.

    Raises
    ------
    ConstraintError
        where no node is free.
    """

    formulation: Formulation
    support: Support

    def __post_init__(self) -> None:
        if self.support.held.all():
            raise ConstraintError("every node is fixed or constrained; leave some free")

    @property
    def free(self) -> Mask:
        """(N,) nodes that are solved for."""
        return ~self.support.held

    def force(self, load: Load) -> Array:
        """(N, d) generalised force [N] of contact and gravity (right-hand sides of 23 and 24)."""
        force = self.formulation.contact_force(self.support.signed(load))
        if self.support.hydrostatic is not None:
            force = force + self.formulation.pressure_force(self.support.hydrostatic)
        return force

    def held_unknown(self, load: Load) -> Array:
        """(N, d) x of the held nodes, zero elsewhere."""
        values = np.zeros((self.formulation.surface.n_nodes, self.formulation.components))
        if load.prescribed is not None and self.support.constrained.any():
            moved = self.formulation.unknown(load.prescribed)
            values[self.support.constrained] = moved[self.support.constrained]
        return values

    @cached_property
    def body(self) -> DeformableSurface:
        """The surface, ready to be deformed."""
        return DeformableSurface(self.formulation.surface)

    def deformed(self, x: Array) -> DeformedSurface:
        """The surface at x (N, d)."""
        return self.body.at(self.formulation.displacement(x))

    def deformed_force(self, load: Load, state: DeformedSurface, column: Array) -> Array:
        """(N, d) force of contact and gravity on the deformed surface; `column` is that of a unit pressure."""
        force = self.formulation.deformed_contact_force(self.support.signed(load), state)
        if self.support.gravity is not None:
            depth = state.positions @ self.support.gravity
            # the datum stays at the highest point of the rest surface
            datum = float((self.body.rest @ self.support.gravity).min())
            force = force + column * (self.support.density * (depth - datum))[:, None]
        return force

    def finish(
        self,
        x: Array,
        border: Array,
        force: Array,
        iterations: int = 0,
        status: Status = CONVERGED,
        applied: Array | None = None,
    ) -> Step:
        """Displacement, reactions and energy of a solved step; `applied` is K x, where it is known.

        The reaction is what the balance lacks at held nodes: internal force less fluid and contact. The energy is
        half the work of the material's nodal forces on the displacement.
        """
        internal = self.formulation.internal_force(x, border, applied)
        displacement = self.formulation.displacement(x)
        energy = 0.5 * float(np.vdot(displacement, self.formulation.nodal_force(internal)))
        lacking = internal - self.formulation.columns.first * border[0] - force
        return self.package(x, border, lacking, energy, iterations, status)

    def package(
        self,
        x: Array,
        border: Array,
        lacking: Array,
        energy: float,
        iterations: int = 0,
        status: Status = CONVERGED,
    ) -> Step:
        """A step whose balance lacks the generalised force (N, d) `lacking` at held nodes."""
        reaction = self.formulation.nodal_force(np.where(self.support.held[:, None], lacking, 0.0))
        displacement = self.formulation.displacement(x)
        return Step(displacement, float(border[0]), reaction, energy, x, border, iterations, status)


def check_held(
    formulation: type[Formulation], surface: SurfaceMesh, parameters: Parameters, held: Mask
) -> None:
    """Refuses supports that leave a motion free which costs no energy, before anything is assembled.

    A factor of the singular operator may exist to rounding, and answers with displacements of any size.

    Raises
    ------
    SolverError
        with the formulation's remedy.
    """
    motions = formulation.free_motions(surface, parameters)
    count = motions.shape[2]
    stopped = 0
    if count and held.any():
        stopped = int(np.linalg.matrix_rank(motions[held].reshape(-1, count), tol=FREE_MOTION))
    if stopped < count:
        message = "the supports leave the body free to move without any resistance"
        raise SolverError(Status("singular", message, formulation.remedy))
