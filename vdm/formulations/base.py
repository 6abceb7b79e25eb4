"""The interface of every formulation: an operator, its border and the maps to displacements and forces."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from scipy import sparse

from solver_common.arrays import Array, Mask
from vdm.constraints import Load
from vdm.deformed import DeformedSurface, follow
from vdm.formulations.border import Columns, DenseColumns
from vdm.material import Parameters
from vdm.solvers.cholesky import Cholesky
from vdm.surface import SurfaceMesh, rigid_motions

# largest error of shortened contact columns, over the largest answer to contact pressures of the same size
LEFT_OUT = 1e-7


class Factor(Protocol):
    """A factorised block: solves right-hand sides (n,) or (n, m)."""

    def solve(self, right_hand_side: Array) -> Array:
        """The solution, same shape."""
        ...


@runtime_checkable
class ReactingFactor(Factor, Protocol):
    """A factor that also gives the force at held nodes, more cheaply than the product K x."""

    def solve_with_inside(self, right_hand_side: Array) -> tuple[Array, Array]:
        """The solution, same shape, and the motion inside (k,) or (k, m) that belongs to it."""
        ...

    def held_force(self, inside: Array) -> Array:
        """K x (n_held, d) at the held nodes, which rest, for a motion inside (k,)."""
        ...


class SparseFactor(Factor, Protocol):
    """A factor of a sparse matrix (size, size)."""

    size: int


_STOPPED = 1e-10  # energy of a rigid motion over the largest one: below this, springs leave it free
Factorise = Callable[[sparse.csr_array], SparseFactor]


class Formulation(ABC):
    """N nodes with d unknowns x each, and m border unknowns s; the first of s is dP [Pa].

    Balance of each node, a generalised force [N]: `K x - columns s = force`; border: `rows x + corner s = 0`.
    Unknowns and forces have shape (N, d), columns and rows (N, d, m). K is symmetric. All rows but the first, the
    volume's, equal their columns.
    """

    name: ClassVar[str]
    components: ClassVar[int]
    has_matrix: bool = True  # whether `stiffness` gives one
    left_out_far: float = LEFT_OUT  # error allowed in `vdm.solvers.columns`
    # what to change where a motion that costs no energy is free
    remedy: ClassVar[str] = "hold an area of the surface, the nodes of some of its facets"
    columns: Columns
    rows: Columns
    corner: Array

    def __init__(self, surface: SurfaceMesh, parameters: Parameters) -> None:
        self.surface = surface
        self.parameters = parameters

    @classmethod
    def supported(
        cls,
        surface: SurfaceMesh,
        parameters: Parameters,
        held: Mask,  # noqa: ARG003
    ) -> Formulation:
        """The form of a body held at some nodes (N,); most forms do not depend on them."""
        return cls(surface, parameters)

    @classmethod
    def free_motions(cls, surface: SurfaceMesh, parameters: Parameters, nodes: Mask) -> Array:  # noqa: ARG003
        """(n, d, r) motions x at `nodes` (N,), of the order of one, that cost no energy; supports must stop them.

        They are known before assembly: here the six rigid motions, for a body that is not tied to space.
        """
        return rigid_motions(surface, nodes)

    @classmethod  # noqa: B027 - most have nothing to compile
    def compile(cls, surface: SurfaceMesh, parameters: Parameters) -> None:
        """Compile the loops, once on a machine, before a set-up is timed."""

    @abstractmethod
    def apply(self, x: Array) -> Array:
        """K x, (N, d)."""

    @abstractmethod
    def factor(self, free: Mask, factorise: Factorise = Cholesky) -> Factor:
        """Factor of K over the free nodes; right-hand sides are (n_free * d,) or (n_free * d, m).

        `factorise` makes it from a sparse matrix; a formulation with a dense matrix has its own factor and
        refuses others.
        """

    def response(self, factor: Factor, columns: Columns) -> Columns:
        """K^-1 columns, at the nodes of the factor."""
        values = columns.dense()
        return DenseColumns(factor.solve(values.reshape(-1, columns.count)).reshape(values.shape))

    @abstractmethod
    def stiffness(self) -> sparse.csr_array:
        """K as a matrix (N d, N d), for the solvers that assemble the whole state matrix."""

    def diagonal(self) -> Array:
        """(N d,) diagonal of K."""
        return self.stiffness().diagonal()

    @abstractmethod
    def contact_force(self, load: Load) -> Array:
        """Generalised force (N, d) of a contact that pushes inward."""

    @abstractmethod
    def unknown(self, displacement: Array) -> Array:
        """x (N, d) of a displacement (N, 3)."""

    @abstractmethod
    def displacement(self, x: Array) -> Array:
        """(N, 3) displacement [m] of x."""

    @abstractmethod
    def nodal_force(self, generalised: Array) -> Array:
        """(N, 3) force [N] of a generalised force (N, d)."""

    def record(self) -> dict[str, float | str]:
        """Name and material for the record of a run."""
        return {"formulation": self.name, **self.parameters.record()}

    def state_matrix(self) -> sparse.csr_array:
        """K of equation 22 with its border, (N d + m, N d + m), in the formulation's own unknowns and rows."""
        columns, rows = (part.dense().reshape(-1, part.count) for part in (self.columns, self.rows))
        unit_rows, unit_columns = sparse.diags_array(self.row_scale), sparse.diags_array(self.column_scale)
        block = unit_rows @ self.stiffness() @ unit_columns
        right = sparse.csr_array(-self.row_scale[:, None] * columns)
        below = sparse.csr_array((rows * self.column_scale[:, None]).T)
        return sparse.csr_array(sparse.block_array([[block, right], [below, sparse.csr_array(self.corner)]]))

    @property
    def row_scale(self) -> Array:
        """(N d,) factors from balance rows [N] to the rows of the state matrix."""
        return np.ones(self.surface.n_nodes * self.components)

    @property
    def column_scale(self) -> Array:
        """(N d,) x per unknown of the state matrix."""
        return np.ones(self.surface.n_nodes * self.components)

    @abstractmethod
    def deformed_internal_force(self, x: Array, state: DeformedSurface) -> Array:
        """Generalised force (N, d) of the material at a large displacement."""

    @abstractmethod
    def deformed_energy(self, x: Array, state: DeformedSurface) -> float:
        """Elastic energy [J] of that force."""

    @abstractmethod
    def deformed_columns(self, state: DeformedSurface) -> tuple[Array, Array]:
        """Generalised force of a unit fluid pressure, and the gradient of `kept_volume` in x; (N, d) each."""

    def kept_volume(self, x: Array, state: DeformedSurface) -> float:  # noqa: ARG002 - of the positions alone
        """The volume [m^3] that the fluid keeps: the polyhedron's. `rows` is its gradient at rest."""
        return state.volume

    def printed_volume_row(self, state: DeformedSurface) -> Array:
        """(N, d) row of equation 33 on a deformed surface; the gradient of `kept_volume`, or as printed."""
        return self.deformed_columns(state)[1]

    @abstractmethod
    def deformed_contact_force(self, load: Load, state: DeformedSurface) -> Array:
        """Generalised force (N, d) of a contact that follows the surface."""

    @property
    def resolved(self) -> SurfaceMesh:
        """The surface on which forces may be given: N nodes, then the k nodes that the form adds."""
        return self.surface

    def carried(self, force: Array) -> Array:
        """(N, d) generalised force of forces (N + k, 3) at the nodes of `resolved`."""
        pressure = -np.einsum("ic,ic->i", force, self.surface.normals) / self.surface.nodal_areas
        return self.contact_force(Load(pressure, force))

    def known_forces(self, forces: Callable[[SurfaceMesh], Array]) -> Array:
        """(m, N, d) generalised forces of m fields, which `forces` gives on a mesh as (m, N + k, 3)."""
        return np.stack([self.carried(force) for force in forces(self.resolved)])

    @property
    def pressed(self) -> Array:
        """(N, d) generalised force of a unit pressure from inside."""
        return self.columns.first

    def pressure_force(self, pressure: Array) -> Array:
        """Generalised force (N, d) of a pressure (N,) that pushes outward from inside."""
        force: Array = self.columns.first * pressure[:, None]
        return force

    def internal_force(self, x: Array, border: Array, applied: Array | None = None) -> Array:
        """(N, d) generalised force of the material alone: K x less the border terms other than the fluid's.

        `applied` is K x, where it is known.
        """
        force = self.apply(x) if applied is None else applied
        if len(border) > 1:
            force = force - self.columns.times(np.append(0.0, border[1:]))
        return force


class ScalarFormulation(Formulation):
    """One unknown per node, along the outward normal: x_i = scale_i L_i."""

    components = 1
    scale: Array
    operator: sparse.csr_array

    def apply(self, x: Array) -> Array:
        return np.asarray(self.operator @ x)

    def volume_gradient(self, state: DeformedSurface) -> Array:
        """(N, 1) gradient of the exact volume in x: g_i . n_i / scale_i."""
        along = np.einsum("ic,ic->i", state.area_vectors, self.surface.normals)
        gradient: Array = (along / self.scale)[:, None]
        return gradient

    def factor(self, free: Mask, factorise: Factorise = Cholesky) -> Factor:
        block = self.operator if free.all() else self.operator[free][:, free]
        return factorise(block)

    def stiffness(self) -> sparse.csr_array:
        return self.operator

    def unknown(self, displacement: Array) -> Array:
        normal = np.einsum("ic,ic->i", displacement, self.surface.normals)
        return (self.scale * normal)[:, None]

    def displacement(self, x: Array) -> Array:
        return (x[:, 0] / self.scale)[:, None] * self.surface.normals

    def nodal_force(self, generalised: Array) -> Array:
        return generalised * self.surface.normals


class DisplacementFormulation(Formulation):
    """Three unknowns per node: x is the displacement, and a generalised force is a force."""

    components = 3

    @classmethod
    def free_motions(cls, surface: SurfaceMesh, parameters: Parameters, nodes: Mask) -> Array:
        """The rigid motions that springs to the ground leave free."""
        motions = rigid_motions(surface, nodes)
        if parameters.ground is None:
            return motions
        whole = rigid_motions(surface, np.ones(surface.n_nodes, dtype=np.bool_))
        whole = whole.reshape(-1, whole.shape[2])
        energy, axes = np.linalg.eigh(whole.T @ (parameters.ground @ whole))
        return motions @ axes[:, energy <= _STOPPED * energy.max()]

    def ground_force(self, x: Array) -> Array:
        """(N, 3) force of the springs to the ground, if any, at a displacement; they do not turn."""
        ground = self.parameters.ground
        return np.zeros_like(x) if ground is None else np.asarray(ground @ x.reshape(-1)).reshape(-1, 3)

    def unknown(self, displacement: Array) -> Array:
        return displacement

    def displacement(self, x: Array) -> Array:
        return x

    def nodal_force(self, generalised: Array) -> Array:
        return generalised

    def contact_force(self, load: Load) -> Array:
        if load.contact_force is None:
            return self.surface.area_vectors * -load.contact_pressure[:, None]
        return load.contact_force

    def deformed_columns(self, state: DeformedSurface) -> tuple[Array, Array]:
        return state.area_vectors, state.area_vectors

    def deformed_contact_force(self, load: Load, state: DeformedSurface) -> Array:
        if load.contact_force is None:
            return -load.contact_pressure[:, None] * state.area_vectors
        return follow(load.contact_force, self.surface.area_vectors, state)
