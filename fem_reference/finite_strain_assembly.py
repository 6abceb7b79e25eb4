"""Residual and tangent of the mixed finite-strain element, total Lagrangian, from numpy products.

Everything is scaled as in `fem_reference.system`: lengths in mean edges, stresses in shear moduli, and the pressure
p = a q. With the tangent's factors (`fem_reference.kinematics.Tangent`) an element matrix is a sum of products of
short vectors over the quadrature points, done for many elements at a time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTet

from fem_reference.assembly import Pattern, chunks, reference_gradients
from fem_reference.kinematics import PAIRS, Kinematics, Law
from fem_reference.mesh import TetMesh
from solver_common.arrays import Array, Index
from solver_common.jit import compiled

# The volume constraint is of degree 4: a rule exact to degree 5 (14 points, all weights positive).
_DEGREE = 5
_CHUNK = 1024  # elements per pass: its arrays stay near the caches


@dataclass(frozen=True)
class Forces:
    """Internal forces of a state, scaled.

    Attributes
    ----------
    nodal : (n_nodes, 3) integral of P : grad N
    volume : (n,) integral of N (J - 1) over the P1 functions
    least_determinant : the smallest det F at the quadrature points
    """

    nodal: Array
    volume: Array
    least_determinant: float


@dataclass(eq=False)
class ElementAssembly:
    """Internal forces and their derivative on one mesh, for one law in units of the shear modulus.

    `stiffness` is an (m,) factor of each tetrahedron: its energy is that much of the law's.
    """

    mesh: TetMesh
    pattern: Pattern
    coupling: Pattern
    law: Law
    stiffness: Array | None = None

    def __post_init__(self) -> None:
        mesh = self.mesh
        self._stiffness = np.ones(len(mesh.volumes)) if self.stiffness is None else self.stiffness
        points, weights = get_quadrature(RefTet, _DEGREE)
        self._barycentric = np.vstack([1.0 - points.sum(axis=0), points]).T
        self._reference = reference_gradients(mesh.order, self._barycentric)
        self._to_gradient = np.ascontiguousarray(
            self._reference.transpose(1, 0, 2).reshape(self._reference.shape[1], -1)
        )
        self._by_coordinate = np.ascontiguousarray(self._reference.transpose(2, 0, 1).reshape(3, -1))
        length = mesh.mean_edge
        self._barycentric_gradients = mesh.barycentric_gradients * length
        self._weights = (mesh.volumes / length**3)[:, None] * (6.0 * weights)

    def forces(self, displacement: Array, pressure: Array) -> Forces:
        """Internal forces for (n_nodes, 3) displacements and (n,) pressures p."""
        mesh = self.mesh
        nodal = np.zeros((mesh.n_nodes, 3))
        volume = np.zeros(mesh.n_pressures)
        least = np.inf
        for part in self._parts():
            k = self._kinematics(part, displacement)
            least = min(least, 1.0 + float(k.dilation.min()))
            if not least > 0.0:
                return Forces(nodal, volume, least)
            weights = self._weights[part]
            factor = weights * self._stiffness[part, None]
            stress = self.law.stress(k, self._at_points(part, pressure)) * factor[..., None, None]
            # P : grad N = (P G^T) : reference gradient, G the constant barycentric gradients
            pulled = stress @ np.swapaxes(self._barycentric_gradients[part], 1, 2)[:, None]
            count = len(weights)
            local = self._to_gradient @ pulled.swapaxes(2, 3).reshape(count, -1, 3)
            nodal += mesh.summed(mesh.element_nodes[part], local)
            shares = (weights * k.dilation) @ self._barycentric
            volume += np.bincount(
                mesh.pressure_elements[part].ravel(), weights=shares.ravel(), minlength=mesh.n_pressures
            )
        return Forces(nodal, volume, least)

    def tangent(self, displacement: Array, pressure: Array) -> tuple[Array, Array]:
        """Derivatives of the nodal forces and of the volumes with respect to the displacement.

        Returns
        -------
        stiffness : (pattern.size, 3, 3) blocks
        divergence : (coupling.size, 1, 3) blocks: integral of N J F^-T : grad v.
            Its negative transpose is the derivative of the nodal forces with respect to p.
        """
        stiffness = np.zeros((self.pattern.size, 3, 3))
        divergence = np.zeros((self.coupling.size, 1, 3))
        for part in self._parts():
            matrices, couplings = self._element_matrices(part, displacement, pressure)
            for i in range(3):
                _add(stiffness[:, i], self.pattern.place[part], matrices[:, i])
            _add(divergence[:, 0], self.coupling.place[part], couplings)
        return stiffness, divergence

    def strain_energy(self, displacement: Array) -> float:
        """Integral of W."""
        return self._integral(
            lambda part: self.law.energy(self._kinematics(part, displacement)) * self._stiffness[part, None]
        )

    def pressure_integral(self, displacement: Array, pressure: Array) -> float:
        """Integral of -tr(Cauchy stress)/3 over the deformed body."""

        def trace(part: slice) -> Array:
            k = self._kinematics(part, displacement)
            stress = self.law.stress(k, self._at_points(part, pressure))
            work = np.einsum("eqij,eqij->eq", stress, k.deformation_gradient)
            return work * self._stiffness[part, None] / -3.0

        return self._integral(trace)

    def volume(self, displacement: Array) -> float:
        """Volume of the deformed body."""
        return self._integral(lambda part: 1.0 + self._kinematics(part, displacement).dilation)

    def largest(self, displacement: Array) -> tuple[float, Array]:
        """Largest |det F - 1|, and the (m, Q) largest principal Green-Lagrange strains at the quadrature points."""
        deviation, strains = -np.inf, []
        for part in self._parts():
            k = self._kinematics(part, displacement)
            deviation = max(deviation, float(np.abs(k.dilation).max()))
            strains.append(0.5 * np.linalg.eigvalsh(k.doubled_strain)[..., -1])
        return deviation, np.concatenate(strains)

    def least_volume_ratio(self, displacement: Array) -> tuple[float, Array]:
        """Least det F at the quadrature points, and that point in the undeformed body, (3,) [m]."""
        ratios = np.concatenate([self._kinematics(part, displacement).dilation for part in self._parts()])
        cell, point = np.unravel_index(ratios.argmin(), ratios.shape)
        corners = self.mesh.points[self.mesh.tetrahedra[cell]]
        return 1.0 + float(ratios[cell, point]), self._barycentric[point] @ corners

    @property
    def volumes(self) -> Array:
        """(m, Q) undeformed volumes that the quadrature points stand for, in units of the mean edge cubed."""
        return self._weights

    def _element_matrices(self, part: slice, displacement: Array, pressure: Array) -> tuple[Array, Array]:
        """(e, 3, n, 3, n) stiffness and (e, 4, 3, n) divergence of the elements of one pass."""
        k = self._kinematics(part, displacement)
        tangent = self.law.tangent(k, self._at_points(part, pressure))
        weights = self._weights[part] * self._stiffness[part, None]
        count, points = weights.shape
        width = self._reference.shape[1]
        shape = (count, 3, width, 3, width)
        # (e, 3, points * n) from one product, then (e, points, 3, n)
        gradients = np.swapaxes(self._barycentric_gradients[part], 1, 2) @ self._by_coordinate
        gradients = np.ascontiguousarray(gradients.reshape(count, 3, points, width).swapaxes(1, 2))
        spatial = np.swapaxes(k.inverse, 2, 3) @ gradients
        metric = weights[..., None, None] * tangent.metric
        out = _products(gradients, spatial, metric, weights * tangent.crossed, weights * tangent.dilational)
        if tangent.along is not None and self.law.fibre is not None:
            fibre = self.law.fibre
            stretched = k.deformation_gradient @ fibre
            along = stretched[..., None] * (fibre @ gradients)[:, :, None]
            dyads = along.reshape(count, points, -1)
            scaled = dyads * (weights * tangent.along)[..., None]
            out += (np.swapaxes(scaled, 1, 2) @ dyads).reshape(shape)
        if tangent.elasticity is not None:
            strains = _strains(k.deformation_gradient, gradients)
            weighted = (weights[..., None, None] * tangent.elasticity) @ strains
            flat = (count, -1, 3 * width)
            out += (np.swapaxes(strains.reshape(flat), 1, 2) @ weighted.reshape(flat)).reshape(shape)
        volumes = (self._weights[part] * (1.0 + k.dilation))[..., None] * self._barycentric
        coupling = np.swapaxes(volumes, 1, 2) @ spatial.reshape(count, points, 3 * width)
        return out, coupling.reshape(count, 4, 3, width)

    def _kinematics(self, part: slice, displacement: Array) -> Kinematics:
        local = np.swapaxes(displacement[self.mesh.element_nodes[part]], 1, 2)
        count = len(local)
        by_coordinate = (local @ self._to_gradient).reshape(count, -1, 3)
        gradient = (by_coordinate @ self._barycentric_gradients[part]).reshape(count, 3, -1, 3)
        return Kinematics(np.ascontiguousarray(np.swapaxes(gradient, 1, 2)))

    def _at_points(self, part: slice, pressure: Array) -> Array:
        """(e, q) pressures in units of each tetrahedron's own shear modulus."""
        local = pressure[self.mesh.pressure_elements[part]] / self._stiffness[part, None]
        return np.asarray(local @ self._barycentric.T)

    def _integral(self, integrand: Callable[[slice], Array]) -> float:
        return sum(
            float(np.einsum("eq,eq->", self._weights[part], integrand(part))) for part in self._parts()
        )

    def _parts(self) -> list[slice]:
        return chunks(len(self._weights), _CHUNK)


@compiled
def _products(gradients: Array, spatial: Array, metric: Array, crossed: Array, dilational: Array) -> Array:
    """(e, 3, n, 3, n) element matrices of the first three terms of `Tangent`, with weights in their factors.

    `gradients` and `spatial` are (e, q, 3, n), by undeformed and by deformed coordinates.
    """
    elements, points, _, width = gradients.shape
    out = np.empty((elements, 3, width, 3, width))
    blocks, scalar = np.empty((3, 3, width, width)), np.empty((width, width))
    for e in range(elements):
        blocks[:], scalar[:] = 0.0, 0.0
        for q in range(points):
            g, s, m = gradients[e, q], spatial[e, q], metric[e, q]
            for a in range(width):
                for i in range(3):
                    x = m[i, 0] * g[0, a] + m[i, 1] * g[1, a] + m[i, 2] * g[2, a]
                    for b in range(width):
                        scalar[a, b] += x * g[i, b]
                    for k in range(i, 3):  # symmetric: the other half follows
                        x, y = dilational[e, q] * s[i, a], crossed[e, q] * s[k, a]
                        for b in range(width):
                            blocks[i, k, a, b] += x * s[k, b] + y * s[i, b]
        for i in range(3):
            blocks[i, i] += scalar
            for k in range(i, 3):
                out[e, i, :, k] = blocks[i, k]
                out[e, k, :, i] = blocks[i, k].T
    return out


@compiled
def _add(sums: Array, place: Index, values: Array) -> None:
    """Add (e, r, 3, n) element blocks to (size, 3) sums at (e, r n) places."""
    elements, rows, components, columns = values.shape
    for e in range(elements):
        for a in range(rows):
            for i in range(components):
                for b in range(columns):
                    sums[place[e, a * columns + b], i] += values[e, a, i, b]


def _strains(deformation: Array, gradients: Array) -> Array:
    """(e, q, 6, 3 n) derivatives of the Green-Lagrange strain, shears doubled, from (e, q, 3, n) gradients."""
    first, second = PAIRS
    rows = np.swapaxes(deformation, 2, 3)
    out = rows[:, :, first, :, None] * gradients[:, :, second, None, :]
    shear = first != second
    swapped = rows[:, :, second[shear], :, None] * gradients[:, :, first[shear], None, :]
    out[:, :, shear] += swapped
    return np.asarray(out.reshape(*out.shape[:3], -1))
