"""A formulation with its supports: the right-hand sides of a load, and a step's results from its unknowns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from solver_common.arrays import Array, Mask
from vdm.constraints import ConstraintError, Load, Support
from vdm.deformed import DeformableSurface, DeformedSurface
from vdm.formulations.base import Formulation
from vdm.material import Parameters
from vdm.solution import CONVERGED, SolverError, Status
from vdm.surface import SurfaceMesh

HeldForce = Callable[[], Array]

# a motion counts as free where the held nodes take less than this share of a unit motion: the stiffness is its
# square, which rounding leaves with fewer than three digits, unnoticed by an iterative solver
FREE_MOTION = 1e-6


@dataclass(frozen=True)
class Problem:
    """A system to solve: `K x - columns s = force` at free nodes, given x at held ones, and the border rows.

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

    @cached_property
    def free(self) -> Mask:
        """(N,) nodes whose x is unknown."""
        return ~self.support.held

    @cached_property
    def held_nodes(self) -> NDArray[np.int64]:
        """(n_held,) nodes that are fixed or constrained."""
        return np.flatnonzero(self.support.held)

    def force(self, load: Load) -> Array:
        """(N, d) generalised force [N] of contact and gravity (right-hand sides of 23 and 24), a new array."""
        force = self.formulation.contact_force(self.support.signed(load))
        if self.support.hydrostatic is not None:
            force = force + self.formulation.pressure_force(self.support.hydrostatic)
        if load.dead_force is not None:
            force = force + self._dead_force(load.dead_force)
        # a copy: a step keeps the force, and the caller may change the load
        return force.copy() if force is load.contact_force else force

    def _dead_force(self, force: Array) -> Array:
        """(N, 3) given forces as they are. Raises ConstraintError where nodes move along normals only."""
        if self.formulation.components != 3:
            raise ConstraintError(
                f"the {self.formulation.name} form moves along normals only and takes no force in another "
                "direction; use the vector form or boundary elements"
            )
        return force

    def held_unknown(self, load: Load) -> Array:
        """(N, d) x of the held nodes, zero elsewhere."""
        values = np.zeros((self.formulation.surface.n_nodes, self.formulation.components))
        if load.prescribed is not None and self.support.constrained.any():
            moved = self.formulation.unknown(load.prescribed)
            values[self.support.constrained] = moved[self.support.constrained]
        return values

    def own_motion(self, force: Array) -> Array:
        """(N, d) motion of each free node alone under its part of a force (N, d), neighbours held; zero elsewhere.

        It is the scale of rounding errors where forces cancel: a pressure from all sides moves nothing.
        """
        moved: Array = np.abs(force) / self._diagonal
        moved[self.held_nodes] = 0.0
        return moved

    @cached_property
    def _diagonal(self) -> Array:
        """(N, d) diagonal of K."""
        formulation = self.formulation
        return formulation.diagonal().reshape(formulation.surface.n_nodes, formulation.components)

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
            force = force + column * (load.weight * self.support.density * (depth - datum))[:, None]
        return force if load.dead_force is None else force + self._dead_force(load.dead_force)


@dataclass(frozen=True, kw_only=True)
class Step(ABC):
    """One load step on N nodes, SI units; `unknown` (N, d) and `border` (m,) start the next step.

    Results are computed from these two when first read, and kept: a frame without reactions does not pay for
    them. Do not write to the arrays of a step.
    """

    problem: Problem = field(repr=False)
    unknown: Array
    border: Array
    iterations: int = 0
    status: Status = CONVERGED

    def __post_init__(self) -> None:
        self.unknown.setflags(write=False)
        self.border.setflags(write=False)

    @property
    def pressure_change(self) -> float:
        """dP [Pa]."""
        return float(self.border[0])

    @cached_property
    def displacement(self) -> Array:
        """(N, 3) [m]."""
        displacement = self.problem.formulation.displacement(self.unknown)
        displacement.setflags(write=False)
        return displacement

    @cached_property
    def product(self) -> Array:
        """K x (N, d), by the operator at rest."""
        return self.problem.formulation.apply(self.unknown)

    @cached_property
    def reaction_force(self) -> Array:
        """(N, 3) force of the support on the body [N], zero at free nodes."""
        lacking = np.zeros(self.unknown.shape)
        lacking[self.problem.held_nodes] = self.lacking_at_held()
        return self.problem.formulation.nodal_force(lacking)

    @property
    @abstractmethod
    def energy(self) -> float:
        """Elastic energy [J]."""

    @abstractmethod
    def lacking_at_held(self) -> Array:
        """(n_held, d) generalised force missing in the balance of held nodes: internal less fluid and contact."""


@dataclass(frozen=True, kw_only=True)
class LinearStep(Step):
    """A step of the rest operator: balance `K x - columns s = force`.

    Attributes
    ----------
    force : (N, d) generalised force of contact and gravity
    held_force : gives K x at held nodes (n_held, d), where the solver's factor knows it
    """

    force: Array = field(repr=False)
    held_force: HeldForce | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.force.setflags(write=False)

    @cached_property
    def internal(self) -> Array:
        """(N, d) force of the material alone."""
        formulation = self.problem.formulation
        if self.held_force is None:
            return formulation.internal_force(self.unknown, self.border, self.product)
        # at free nodes the internal force balances fluid and contact
        balanced = self.force + formulation.columns.times(self.border)
        balanced[self.problem.held_nodes] = self.held_force()
        return formulation.internal_force(self.unknown, self.border, balanced)

    @cached_property
    def energy(self) -> float:
        """Half the work of the material's nodal forces on the displacement [J]."""
        nodal = self.problem.formulation.nodal_force(self.internal)
        return 0.5 * float(np.vdot(self.displacement, nodal))

    @property
    def normal_traction(self) -> Array:
        """(N,) normal force of the material over the area that a pressure acts on [Pa].

        At free nodes it balances fluid and contact (9, with the tension of equation 8).
        """
        formulation = self.problem.formulation
        normals = formulation.surface.normals
        pressed = formulation.nodal_force(formulation.pressure_force(np.ones(len(normals))))
        force, area = (
            np.einsum("ic,ic->i", part, normals) for part in (formulation.nodal_force(self.internal), pressed)
        )
        return np.asarray(force / area)

    def lacking_at_held(self) -> Array:
        """As in `Step`."""
        nodes = self.problem.held_nodes
        column = self.problem.formulation.columns.first[nodes]
        lacking: Array = self.internal[nodes] - column * self.border[0] - self.force[nodes]
        return lacking


def check_held(
    formulation: type[Formulation], surface: SurfaceMesh, parameters: Parameters, held: Mask
) -> None:
    """Refuse supports that leave a motion free which costs no energy, before assembly.

    Rounding may give the singular operator a factor, which answers with displacements of any size.

    Raises
    ------
    SolverError
        with the formulation's remedy.
    """
    motions = formulation.free_motions(surface, parameters, held)
    count = motions.shape[2]
    if count and np.linalg.matrix_rank(motions.reshape(-1, count), tol=FREE_MOTION) < count:
        message = "the supports leave the body free to move without any resistance"
        raise SolverError(Status("singular", message, formulation.remedy))
