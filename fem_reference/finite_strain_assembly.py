"""Residual and tangent of the mixed finite-strain element, total Lagrangian, from numpy products.

All quantities are scaled as in `fem_reference.system`: lengths in mean edges, stresses in shear moduli, and the
pressure p = a q. With the tangent's factors (`fem_reference.kinematics.Tangent`) an element matrix is a sum of
products of short vectors over the quadrature points. The products are added to the global blocks at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTet

from fem_reference.assembly import Pattern, chunks, reference_gradients
from fem_reference.kinematics import PAIRS, Kinematics, Law
from fem_reference.mesh import TetMesh
from solver_common.arrays import Array, Index
from solver_common.jit import compiled

# The volume constraint is of degree 4: a rule exact to degree 5 (14 points, all weights positive).
_DEGREE = 5
_CHUNK = 1024  # elements per pass: the arrays stay near the caches
_LANES = 16  # points and padding: compiled loops of this constant length, a multiple of four, use vectors


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

    `stiffness` (m,) multiplies the law's energy in each tetrahedron.
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
        reference = reference_gradients(mesh.order, self._barycentric)
        width = reference.shape[1]
        self._to_gradient = np.ascontiguousarray(reference.transpose(1, 0, 2).reshape(width, -1))
        self._table = np.zeros((3, width, _LANES))
        self._table[..., : len(weights)] = reference.transpose(2, 1, 0)
        length = mesh.mean_edge
        self._barycentric_gradients = mesh.barycentric_gradients * length
        self._weights = (mesh.volumes / length**3)[:, None] * (6.0 * weights)
        # order by node numbers: neighbours then share blocks that are still in the cache
        order = np.argsort(mesh.element_nodes.min(axis=1), kind="stable")
        self._parts = [order[part] for part in chunks(len(order), _CHUNK)]

    def forces(self, displacement: Array, pressure: Array) -> Forces:
        """Internal forces for (n_nodes, 3) displacements and (n,) pressures p."""
        mesh = self.mesh
        nodal = np.zeros((mesh.n_nodes, 3))
        volume = np.zeros(mesh.n_pressures)
        least = np.inf
        for part in self._parts:
            k = self._kinematics(part, displacement)
            least = min(least, 1.0 + float(k.dilation.min()))
            if not least > 0.0:
                return Forces(nodal, volume, least)
            weights = self._weights[part]
            factor = weights * self._stiffness[part, None]
            stress = self.law.stress(k, self._at_points(part, pressure)) * factor[..., None, None]
            # P : grad N = (P G^T) : reference gradient, G the constant barycentric gradients
            count = len(weights)
            axes = np.swapaxes(self._barycentric_gradients[part], 1, 2)
            pulled = (stress.reshape(count, -1, 3) @ axes).reshape(stress.shape)
            local = self._to_gradient @ pulled.swapaxes(2, 3).reshape(count, -1, 3)
            nodal += mesh.summed(mesh.element_nodes[part], local)
            shares = (weights * k.dilation) @ self._barycentric
            volume += np.bincount(
                mesh.pressure_elements[part].ravel(), weights=shares.ravel(), minlength=mesh.n_pressures
            )
        return Forces(nodal, volume, least)

    def tangent(self, displacement: Array, pressure: Array, lame: float = 0.0) -> tuple[Array, Array]:
        """Derivatives of the nodal forces and of the volumes with respect to the displacement.

        `lame` is lambda over the shear modulus for a displacement element, which has no pressure: the tangent at
        rest is then Hooke's law.

        Returns
        -------
        stiffness : (pattern.size, 3, 3) blocks
        divergence : (coupling.size, 1, 3) blocks: integral of N J F^-T : grad v.
            Its negative transpose is the derivative of the nodal forces with respect to p.
        """
        stiffness = np.zeros((self.pattern.size, 3, 3))
        divergence = np.zeros((self.coupling.size, 1, 3))
        for part in self._parts:
            k = self._kinematics(part, displacement)
            tangent = self.law.tangent(k, self._at_points(part, pressure))
            weights = self._weights[part] * self._stiffness[part, None]
            _add_products(
                stiffness,
                divergence,
                part,
                self.pattern.place,
                self.coupling.place,
                self._barycentric_gradients,
                self._table,
                k.inverse,
                weights[..., None, None] * tangent.metric,
                weights * tangent.crossed,
                weights * (tangent.dilational + lame),
                (self._weights[part] * (1.0 + k.dilation))[..., None] * self._barycentric,
            )
            if tangent.elasticity is not None:
                elasticity = weights[..., None, None] * tangent.elasticity
                matrices = self._elastic(part, k.deformation_gradient, elasticity)
                _add(stiffness, self.pattern.place[part], matrices)
        _complete(stiffness, self.pattern.indptr, self.pattern.indices)
        return stiffness, divergence

    def strain_energy(self, displacement: Array) -> float:
        """Integral of W."""
        return self._integral(
            lambda part: self.law.energy(self._kinematics(part, displacement)) * self._stiffness[part, None]
        )

    def pressure_integral(self, displacement: Array, pressure: Array) -> float:
        """Integral of -tr(Cauchy stress)/3 over the deformed body."""

        def trace(part: Index) -> Array:
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
        deviation, strains = -np.inf, np.empty_like(self._weights)
        for part in self._parts:
            k = self._kinematics(part, displacement)
            deviation = max(deviation, float(np.abs(k.dilation).max()))
            strains[part] = 0.5 * np.linalg.eigvalsh(k.doubled_strain)[..., -1]
        return deviation, strains

    def least_volume_ratio(self, displacement: Array) -> tuple[float, Array]:
        """Least det F at the quadrature points, and the undeformed place (3,) of that point [m]."""
        ratios = np.empty_like(self._weights)
        for part in self._parts:
            ratios[part] = self._kinematics(part, displacement).dilation
        cell, point = np.unravel_index(ratios.argmin(), ratios.shape)
        corners = self.mesh.points[self.mesh.tetrahedra[cell]]
        return 1.0 + float(ratios[cell, point]), self._barycentric[point] @ corners

    @property
    def volumes(self) -> Array:
        """(m, Q) undeformed volumes of the quadrature points, in units of the mean edge cubed."""
        return self._weights

    def _elastic(self, part: Index, deformation: Array, elasticity: Array) -> Array:
        """(e, 3, n, 3, n) element matrices of the (e, q, 6, 6) elasticity, which includes the weights."""
        count, points = elasticity.shape[:2]
        gradients = np.tensordot(self._barycentric_gradients[part], self._table[..., :points], (1, 0))
        strains = _strains(deformation, np.ascontiguousarray(np.moveaxis(gradients, 3, 1)))
        width = strains.shape[-1]
        weighted = (elasticity @ strains).reshape(count, -1, width)
        matrices = np.swapaxes(strains.reshape(count, -1, width), 1, 2) @ weighted
        return np.asarray(matrices.reshape(count, 3, width // 3, 3, width // 3))

    def _kinematics(self, part: Index, displacement: Array) -> Kinematics:
        local = np.swapaxes(displacement[self.mesh.element_nodes[part]], 1, 2)
        count = len(local)
        by_coordinate = (local @ self._to_gradient).reshape(count, -1, 3)
        gradient = (by_coordinate @ self._barycentric_gradients[part]).reshape(count, 3, -1, 3)
        return Kinematics(np.ascontiguousarray(np.swapaxes(gradient, 1, 2)))

    def _at_points(self, part: Index, pressure: Array) -> Array:
        """(e, q) pressures in units of each tetrahedron's own shear modulus."""
        local = pressure[self.mesh.pressure_elements[part]] / self._stiffness[part, None]
        return np.asarray(local @ self._barycentric.T)

    def _integral(self, integrand: Callable[[Index], Array]) -> float:
        return sum(float(np.einsum("eq,eq->", self._weights[part], integrand(part))) for part in self._parts)


@compiled
def _add_products(
    stiffness: Array,
    divergence: Array,
    part: Index,
    place: Index,
    coupling: Index,
    axes: Array,
    table: Array,
    inverse: Array,
    metric: Array,
    crossed: Array,
    dilational: Array,
    volumes: Array,
) -> None:
    """Add the first three terms of `Tangent` and the couplings of some elements to the global blocks.

    `part` (e,) numbers the elements in `place`, `coupling` and `axes`, which are those of all elements; the other
    arrays are of these elements. `table` (3, n, _LANES) are the reference gradients, `axes` (m, 3, 3) the
    gradients of the reference coordinates, `inverse` (e, q, 3, 3) is F^-1. The factors and the (e, q, 4) pressure
    shares include the weights. Of a pair of nodes the one first in the element gets the block; `_complete` adds
    the other.

    The inner loops use no views of arrays: numba's reference counts of views take longer than the products.
    """
    elements, points = crossed.shape
    width = table.shape[1]
    # all points of one component, then zeros
    pulling, stretching = np.zeros((3, 3, _LANES)), np.zeros((3, 3, _LANES))
    factors, shares = np.zeros((2, _LANES)), np.zeros((4, _LANES))
    shape = (width, 3, _LANES)
    gradient, spatial, stretched = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    crossing, dilating = np.zeros(shape), np.zeros(shape)
    for e in range(elements):
        of = part[e]
        for q in range(points):
            factors[0, q], factors[1, q] = crossed[e, q], dilational[e, q]
            for i in range(3):
                for j in range(3):
                    pulling[i, j, q], stretching[i, j, q] = inverse[e, q, i, j], metric[e, q, i, j]
            for row in range(4):
                shares[row, q] = volumes[e, q, row]
        for a in range(width):
            for i in range(3):
                for q in range(_LANES):
                    gradient[a, i, q] = (
                        axes[of, 0, i] * table[0, a, q]
                        + axes[of, 1, i] * table[1, a, q]
                        + axes[of, 2, i] * table[2, a, q]
                    )
            for i in range(3):
                for q in range(_LANES):
                    x, y, z = gradient[a, 0, q], gradient[a, 1, q], gradient[a, 2, q]
                    pulled = pulling[0, i, q] * x + pulling[1, i, q] * y + pulling[2, i, q] * z
                    spatial[a, i, q] = pulled
                    crossing[a, i, q] = factors[0, q] * pulled
                    dilating[a, i, q] = factors[1, q] * pulled
                    stretched[a, i, q] = (
                        stretching[i, 0, q] * x + stretching[i, 1, q] * y + stretching[i, 2, q] * z
                    )
        for a in range(width):
            for b in range(a, width):
                at = place[of, a * width + b]
                _add_pair(stiffness, at, a, b, stretched, crossing, dilating, gradient, spatial)
        for row in range(4):
            for a in range(width):
                for i in range(3):
                    total = 0.0
                    for q in range(_LANES):
                        total += shares[row, q] * spatial[a, i, q]
                    divergence[coupling[of, row * width + a], 0, i] += total


@compiled
def _add_pair(
    sums: Array, at: int, a: int, b: int, stretched: Array, c: Array, d: Array, gradient: Array, s: Array
) -> None:
    """Add the block of nodes a and b in one pass over their (3, _LANES) products, unrolled for speed."""
    xx = xy = xz = yx = yy = yz = zx = zy = zz = scalar = 0.0
    for q in range(_LANES):
        scalar += stretched[a, 0, q] * gradient[b, 0, q] + stretched[a, 1, q] * gradient[b, 1, q]
        scalar += stretched[a, 2, q] * gradient[b, 2, q]
        xx += (c[a, 0, q] + d[a, 0, q]) * s[b, 0, q]
        xy += d[a, 0, q] * s[b, 1, q] + c[a, 1, q] * s[b, 0, q]
        xz += d[a, 0, q] * s[b, 2, q] + c[a, 2, q] * s[b, 0, q]
        yx += d[a, 1, q] * s[b, 0, q] + c[a, 0, q] * s[b, 1, q]
        yy += (c[a, 1, q] + d[a, 1, q]) * s[b, 1, q]
        yz += d[a, 1, q] * s[b, 2, q] + c[a, 2, q] * s[b, 1, q]
        zx += d[a, 2, q] * s[b, 0, q] + c[a, 0, q] * s[b, 2, q]
        zy += d[a, 2, q] * s[b, 1, q] + c[a, 1, q] * s[b, 2, q]
        zz += (c[a, 2, q] + d[a, 2, q]) * s[b, 2, q]
    sums[at, 0, 0] += xx + scalar
    sums[at, 0, 1] += xy
    sums[at, 0, 2] += xz
    sums[at, 1, 0] += yx
    sums[at, 1, 1] += yy + scalar
    sums[at, 1, 2] += yz
    sums[at, 2, 0] += zx
    sums[at, 2, 1] += zy
    sums[at, 2, 2] += zz + scalar


@compiled
def _add(sums: Array, place: Index, matrices: Array) -> None:
    """Add (e, 3, n, 3, n) symmetric element matrices to blocks at (e, n n) places, as `_add_products` does."""
    elements, _, width, _, _ = matrices.shape
    for e in range(elements):
        for i in range(3):
            for a in range(width):
                for k in range(3):
                    for b in range(a, width):
                        sums[place[e, a * width + b], i, k] += matrices[e, i, a, k, b]


@compiled
def _complete(sums: Array, indptr: NDArray[np.int32], indices: NDArray[np.int32]) -> None:
    """Make a matrix of (size, 3, 3) blocks symmetric: each off-diagonal block is added to its mirror."""
    mirrors = indptr[:-1].copy()  # position of the current row in each row below; columns are sorted
    for row in range(len(mirrors)):
        for at in range(indptr[row], indptr[row + 1]):
            column = indices[at]
            if column > row:
                mirror = mirrors[column]
                mirrors[column] += 1
                for i in range(3):
                    for k in range(3):
                        sums[at, i, k] += sums[mirror, k, i]
                        sums[mirror, k, i] = sums[at, i, k]


def _strains(deformation: Array, gradients: Array) -> Array:
    """(e, q, 6, 3 n) derivatives of the Green-Lagrange strain, shears doubled, from (e, q, 3, n) gradients."""
    first, second = PAIRS
    rows = np.swapaxes(deformation, 2, 3)
    out = rows[:, :, first, :, None] * gradients[:, :, second, None, :]
    shear = first != second
    swapped = rows[:, :, second[shear], :, None] * gradients[:, :, first[shear], None, :]
    out[:, :, shear] += swapped
    return np.asarray(out.reshape(*out.shape[:3], -1))
