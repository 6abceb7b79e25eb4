"""The scaled linear system of one mesh, one Poisson ratio and one set of supports.

Lengths are measured in mean edges and stresses in shear moduli, so every entry is of order one and the system
does not depend on Young's modulus. In these units stress = 2 eps(u) - p I with p = -lambda div u, and with the
scaled pressure q = p / a, a = sqrt(2 |nu|), lambda = 2 nu / (1 - 2 nu):

    [   A   -a B^T ] [u]   [f]      A: 2 eps(u) : eps(v),  B: q div u,  M: P1 mass
    [ -a B   -c M  ] [q] = [0]      c = (1 - 2 nu) sign(nu)

The scaling keeps every block finite for any Poisson ratio in (-1, 0.5]: c is zero for an incompressible body and
the pressure uncouples at nu = 0. A displacement element has Hooke's law in A and no pressure rows. Fibres add
(M : eps(u)) (M : eps(v)) to A, with M = sqrt(k / mu) a x a of their modulus k and direction a.

Where moduli vary, each tetrahedron has the factor g in A, its shear modulus in units of the reference. c M is
then a sum over the tetrahedra with c = |nu| (1 - 2 nu_e) / (nu_e g), where nu is that of the reference.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_array, bsr_array, bsr_matrix, csc_array, csr_array

from fem_reference.assembly import Pattern, coupling_pattern, mass_matrix, scalar_pattern
from fem_reference.finite_strain_assembly import ElementAssembly
from fem_reference.kinematics import Law
from fem_reference.materials import TransverselyIsotropic
from fem_reference.mesh import TetMesh
from fem_reference.springs import Springs
from solver_common.arrays import Array, Index, Mask
from solver_common.jit import compiled
from solver_common.solution import solver_error


@dataclass(frozen=True)
class LinearSystem:
    """Matrices on the kept nodes, those with at least one free component; held components are identity rows.

    Attributes
    ----------
    mesh : the mesh
    held : (n_nodes, 3) components whose displacement is given
    kept : (K,) nodes in the system
    stiffness : (3K, 3K) A
    divergence : (n, 3K) a B, or None for a displacement element
    gradient : (3K, n) its transpose, or None
    mass : (n, n) M, weighted like the pressure's Schur complement where moduli vary, or None
    compliance : (n, n) c M, None where it is zero
    compressibility : c, the least of all tetrahedra
    pressure_scale : a
    divergence_coefficient : lambda of the displacement element, 0 where the pressure carries it
    fibres : (3, 3) M, None for an isotropic body
    relative_stiffness : (m,) g, None where it is one everywhere
    schur_factor : the pressure's Schur complement is about -schur_factor M
    springs : elastic supports, included in A, or None
    support : nodes with a held component
    support_rows : (3 * supports, 3 n_nodes) their rows of A, without elimination
    support_divergence : (n, 3 * supports) their columns of B, or None
    """

    mesh: TetMesh
    held: Mask
    kept: Index
    stiffness: bsr_array
    divergence_coefficient: float
    fibres: Array | None
    relative_stiffness: Array | None
    springs: Springs | None
    support: Index
    support_rows: bsr_array
    # of a pressure field
    divergence: csr_array | None = None
    gradient: csr_array | None = None
    mass: csr_array | None = None
    compliance: csr_array | None = None
    compressibility: float = 0.0
    pressure_scale: float = 0.0
    schur_factor: float = 0.0
    support_divergence: csr_array | None = None

    @property
    def mixed(self) -> bool:
        """Whether there is a pressure field."""
        return self.divergence is not None

    @property
    def n_displacements(self) -> int:
        """Number of displacement unknowns, 3K."""
        return 3 * len(self.kept)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.n_displacements + (0 if self.mass is None else self.mass.shape[0])

    def apply(self, x: Array) -> Array:
        """The system matrix times x, (size,) or (size, S)."""
        u, q = x[: self.n_displacements], x[self.n_displacements :]
        out = np.empty_like(x)
        a = self.stiffness
        out[: len(u)] = a @ u if u.ndim > 1 else _product(a.indptr, a.indices, a.data, u)
        if self.divergence is not None and self.gradient is not None and self.mass is not None:
            out[: len(u)] -= self.gradient @ q
            out[len(u) :] = -(self.divergence @ u)
            if self.compliance is not None:
                out[len(u) :] -= self.compliance @ q
        return out

    def lower_triangle(self, compressibility: float) -> csc_array:
        """Lower triangle of the matrix by columns, with `compressibility` in place of the least c."""
        stiffness = csr_array(self.stiffness)
        if self.divergence is None or self.gradient is None or self.mass is None:
            return _lower(stiffness)
        if compressibility == self.compressibility and self.compliance is not None:
            pressures = self.compliance
        else:
            pressures = (compressibility - self.compressibility) * self.mass
            if self.compliance is not None:
                pressures = self.compliance + pressures
        return _lower(
            block_array([[stiffness, -self.gradient], [-self.divergence, -pressures]], format="csr")
        )

    def right_hand_side(self, forces: Array, prescribed: Array) -> Array:
        """(size, S) from scaled nodal forces and held values, both (S, n_nodes, 3)."""
        steps = len(forces)
        given = np.where(self.held, prescribed, 0.0)[:, self.support].reshape(steps, -1).T
        load = forces.reshape(steps, -1).T - self.support_rows.T @ given
        top = load.reshape(-1, 3, steps)[self.kept]
        top[self.held[self.kept]] = 0.0
        top = top.reshape(-1, steps)
        if self.support_divergence is None:
            return np.ascontiguousarray(top)
        return np.concatenate([top, self.pressure_scale * (self.support_divergence @ given)])

    def expand(self, x: Array, prescribed: Array) -> tuple[Array, Array]:
        """Nodal displacements (S, n_nodes, 3) and pressures (S, n or 0) from the (size, S) solution."""
        steps = x.shape[1]
        u = np.where(self.held, prescribed, 0.0)
        found = x[: self.n_displacements].T.reshape(steps, -1, 3)
        u[:, self.kept] = np.where(self.held[self.kept], u[:, self.kept], found)
        return u, self.pressure_scale * x[self.n_displacements :].T

    def reactions(self, displacement: Array, pressure: Array, forces: Array) -> Array:
        """(S, n_nodes, 3) forces of the support on the body at held components and of springs, scaled."""
        steps = len(displacement)
        internal = self.support_rows @ displacement.reshape(steps, -1).T
        if self.support_divergence is not None:
            internal = internal - self.support_divergence.T @ pressure.T
        reaction = np.zeros_like(displacement)
        reaction[:, self.support] = internal.T.reshape(steps, -1, 3) - forces[:, self.support]
        held = np.where(self.held, reaction, 0.0)
        return held if self.springs is None else held + self.springs.forces(displacement)


def build_system(
    mesh: TetMesh,
    held: Mask,
    *,
    mixed: bool,
    poisson_ratio: float,
    law: Law,
    pattern: Pattern | None = None,
    relative_stiffness: Array | None = None,
    poisson_ratios: Array | None = None,
    springs: Springs | None = None,
) -> LinearSystem:
    """Assemble the scaled system.

    Parameters
    ----------
    mesh : P2 for the mixed element
    held : (n_nodes, 3) components whose displacement is given
    mixed : pressure field or displacement only
    poisson_ratio : in (-1, 0.5], below 0.5 for a displacement element
    law : in units of the shear modulus; the system is its small-strain limit
    pattern : the mesh's pattern, if the caller keeps it; None makes a temporary one
    relative_stiffness : (m,) g, None where it is one everywhere
    poisson_ratios : (m,) in (0, 0.5] where they vary; `poisson_ratio` then sets the scaling
    springs : elastic supports, or None

    Raises
    ------
    SolverError
        If the held nodes of an incompressible body leave its pressure without a datum.
    """
    pattern = pattern or scalar_pattern(mesh)
    lame = 0.0 if mixed else 2.0 * poisson_ratio / (1.0 - 2.0 * poisson_ratio)
    coupling = coupling_pattern(mesh, pattern)
    assembly = ElementAssembly(mesh, pattern, coupling, law, relative_stiffness)
    blocks, volumes = assembly.tangent(np.zeros((mesh.n_nodes, 3)), np.zeros(mesh.n_pressures), lame)
    if springs is not None:
        springs.add_to(blocks, mesh, pattern)
    kept = np.flatnonzero(~held.all(axis=1))
    support = np.flatnonzero(held.any(axis=1))
    numbered = pattern.numbered
    width = 3 * mesh.n_nodes

    rows = numbered[support]
    support_rows = _bsr(blocks[rows.data], rows, (3 * len(support), width))
    inner = numbered[kept][:, kept]
    stiffness = _bsr(blocks[inner.data], inner, (3 * len(kept), 3 * len(kept)))
    hold_components(stiffness, held[kept])
    del blocks
    displacement = LinearSystem(
        mesh=mesh,
        held=held,
        kept=kept,
        stiffness=stiffness,
        divergence_coefficient=lame,
        fibres=law.small_strain if isinstance(law, TransverselyIsotropic) else None,
        relative_stiffness=relative_stiffness,
        springs=springs,
        support=support,
        support_rows=support_rows,
    )
    if not mixed:
        return displacement

    scale = float(np.sqrt(2.0 * abs(poisson_ratio)))
    inner = coupling.numbered[:, kept]
    data = scale * volumes[inner.data]
    data[held[kept][inner.indices][:, None, :]] = 0.0
    divergence = csr_array(_bsr(data, inner, (mesh.n_pressures, 3 * len(kept))))
    outer = coupling.numbered[:, support]
    # A pressure drives a gradient field, where 2 g eps : eps is twice g (div u)^2: a^2 / 2 = |nu|.
    gain: float | Array = abs(poisson_ratio)
    compressibility: float | Array = (1.0 - 2.0 * poisson_ratio) * (-1.0 if poisson_ratio < 0.0 else 1.0)
    if poisson_ratios is not None:
        compressibility = poisson_ratio * (1.0 - 2.0 * poisson_ratios) / poisson_ratios
    if relative_stiffness is not None:
        compressibility, gain = compressibility / relative_stiffness, gain / relative_stiffness
    compliance, mass, schur_factor = _pressure_matrices(mesh, compressibility, compressibility + gain)
    system = replace(
        displacement,
        divergence=divergence,
        gradient=csr_array(divergence.T),
        mass=mass,
        compliance=compliance,
        compressibility=float(np.min(compressibility)),
        pressure_scale=scale,
        schur_factor=schur_factor,
        support_divergence=csr_array(_bsr(volumes[outer.data], outer, (mesh.n_pressures, 3 * len(support)))),
    )
    if not np.any(compressibility):
        _check_pressure_datum(mesh, divergence)
    return system


def _pressure_matrices(
    mesh: TetMesh, compressibility: float | Array, schur: float | Array
) -> tuple[csr_array | None, csr_array, float]:
    """c M, the mass matrix M and the factor of the pressure's approximate Schur complement."""
    unit = mesh.mean_edge**3
    if isinstance(schur, float):
        mass = mass_matrix(mesh)
        mass.data /= unit
        return (csr_array(mass * compressibility) if compressibility else None), mass, schur
    factor = float(schur @ mesh.volumes / mesh.volume)
    mass = mass_matrix(mesh, schur / (factor * unit))
    weights = np.asarray(compressibility / unit)
    return (mass_matrix(mesh, weights) if weights.any() else None), mass, factor


def _bsr(blocks: Array, pattern: csr_array, shape: tuple[int, int]) -> bsr_array:
    return bsr_array((blocks, pattern.indices, pattern.indptr), shape=shape)


@compiled
def _product(rows: NDArray[np.int32], columns: NDArray[np.int32], blocks: Array, x: Array) -> Array:
    """A matrix of (k, 3, 3) blocks times a vector, in two thirds of SciPy's time."""
    out = np.empty_like(x)
    for row in range(len(rows) - 1):
        first = second = third = 0.0
        for k in range(rows[row], rows[row + 1]):
            at = 3 * columns[k]
            a, b, c = x[at], x[at + 1], x[at + 2]
            first += blocks[k, 0, 0] * a + blocks[k, 0, 1] * b + blocks[k, 0, 2] * c
            second += blocks[k, 1, 0] * a + blocks[k, 1, 1] * b + blocks[k, 1, 2] * c
            third += blocks[k, 2, 0] * a + blocks[k, 2, 1] * b + blocks[k, 2, 2] * c
        out[3 * row], out[3 * row + 1], out[3 * row + 2] = first, second, third
    return out


def hold_components(stiffness: bsr_array | bsr_matrix, held: Mask) -> None:
    """Turn held components of nodes that stay in the system into identity rows and columns, in place."""
    if not held.any():
        return
    rows = np.repeat(np.arange(len(held)), np.diff(stiffness.indptr))
    columns = stiffness.indices
    touched = np.flatnonzero(held[rows].any(axis=1) | held[columns].any(axis=1))
    out = held[rows[touched]][:, :, None] | held[columns[touched]][:, None, :]
    values = np.where(out, 0.0, stiffness.data[touched])
    diagonal = rows[touched] == columns[touched]
    values[diagonal] += np.eye(3) * held[rows[touched[diagonal]]][:, None, :]
    stiffness.data[touched] = values


def _check_pressure_datum(mesh: TetMesh, divergence: csr_array) -> None:
    count, label = mesh.components
    for body in range(count):
        flux = divergence.T @ (label[mesh.pressure_vertices] == body).astype(np.float64)
        if np.abs(flux).max(initial=0.0) < 1e-10:
            raise solver_error(
                "enclosed",
                "an incompressible body is held over its whole surface, which leaves its pressure undefined",
                "free a part of the surface or set poisson_ratio to 0.4999",
            )


def _lower(matrix: csr_array) -> csc_array:
    """Lower triangle by columns of a symmetric matrix: the upper triangle by rows, read as columns."""
    matrix.sort_indices()
    rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    upper = matrix.indices >= rows
    counts = np.bincount(rows[upper], minlength=matrix.shape[0])
    indptr = np.concatenate([[0], np.cumsum(counts)])
    return csc_array((matrix.data[upper], matrix.indices[upper], indptr), shape=matrix.shape)
