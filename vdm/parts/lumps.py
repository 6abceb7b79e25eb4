"""A body with lumps: inner regions with their own moduli. Each region has boundary elements; they share nodes.

A is the sum of the stiffnesses S_r of all regions, each on its own closed boundary. Static condensation of the
inner nodes i leaves the stiffness of the surface nodes o:

`S = A_oo - A_oi X A_io`, `X = A_ii^-1 - A_ii^-1 G (G^T A_ii^-1 G)^-1 G^T A_ii^-1`.

G are the area vectors of the incompressible regions, whose Lagrange multipliers are their pressures. The region at
the surface is not among them: its pressure is the body's.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import linalg

from solver_common.arrays import Array, Index, Mask
from vdm.boundary.refinement import take_over
from vdm.boundary.rims import Rims
from vdm.material import INCOMPRESSIBLE
from vdm.parts.part import dofs
from vdm.peers.bem import MAX_NODES, BoundaryFormulation, too_large
from vdm.solution import SolverError
from vdm.surface import motions_of

# share of the number of surface nodes: lumps with fewer nodes get halved facets, so that the surface's error
# dominates
HALVED = 0.25


@dataclass(frozen=True)
class _Inside:
    """The k condensed inner nodes of a system with n others.

    Attributes
    ----------
    coupling : (3n, 3k) A_oi
    factor : Cholesky factor of A_ii, from `scipy.linalg.cho_factor`
    pressed : (3k, m) A_ii^-1 G
    schur : (m, m) G^T A_ii^-1 G
    """

    coupling: Array
    factor: tuple[Array, bool]
    pressed: Array
    schur: Array

    @classmethod
    def of(cls, matrix: Array, n: int, pressures: Array) -> tuple[Array, _Inside]:
        """S (3n, 3n) from A (3(n + k), 3(n + k)) and G (3k, m), and the condensed nodes."""
        own, coupling = matrix[3 * n :, 3 * n :], matrix[: 3 * n, 3 * n :].copy()
        factor = linalg.cho_factor(own, lower=True, check_finite=False)
        pressed = np.asarray(linalg.cho_solve(factor, pressures))
        inside = cls(coupling, factor, pressed, pressures.T @ pressed)
        left = matrix[: 3 * n, : 3 * n] - coupling @ inside.solve(coupling.T)
        return 0.5 * (left + left.T), inside

    def solve(self, force: Array) -> Array:
        """X f, (3k, m)."""
        moved = np.asarray(linalg.cho_solve(self.factor, force))
        return moved - self.pressed @ np.linalg.solve(self.schur, self.pressed.T @ force)

    def carried(self, force: Array) -> Array:
        """(3n, m) forces equivalent to (3(n + k), m) at all nodes."""
        n = len(self.coupling)
        return np.asarray(force[:n] - self.coupling @ self.solve(force[n:]))


@dataclass
class _Regions:
    """Sums over the regions added so far, at the nodes of the surface, its rims and the inside.

    Attributes
    ----------
    points : (n, 3) [m]
    dtype : precision of the integrals
    matrix : (3n, 3n) stiffness A [N/m]
    weight : (3n, 4) forces of the pressures x, y, z and 1
    """

    points: Array
    dtype: type[np.floating[Any]]
    matrix: Array = field(init=False)
    weight: Array = field(init=False)

    def __post_init__(self) -> None:
        size = 3 * len(self.points)
        self.matrix, self.weight = np.zeros((size, size)), np.zeros((size, 4))

    def add(
        self, triangles: Index, modulus: float, ratio: float, numbers: Index | None, arms: Array
    ) -> Array:
        """Add a region with the closed outward boundary `triangles` (F, 3); returns its area vectors (n, 3).

        Facets with the same number in `numbers` (F,) share a traction. `weight` gains the forces of the pressures
        x, y, z, the columns of `arms` (n, 3), and 1, as in `BoundaryFormulation.pressure_force`.
        """
        from vdm.boundary.operators import Facets, surface_stiffness

        nodes, local = np.unique(triangles, return_inverse=True)
        facets = Facets.of(self.points[nodes], local.reshape(-1, 3), numbers)
        stiffness = modulus * surface_stiffness(facets, ratio, self.dtype)
        own = facets.points - facets.points.mean(axis=0)
        rigid = np.linalg.qr(motions_of(own / np.abs(own).max()).reshape(-1, 6))[0]
        take_over(stiffness, rigid, np.zeros_like(rigid))
        at = dofs(nodes)
        self.matrix[np.ix_(at, at)] += stiffness
        vectors = np.zeros((len(self.points), 3))
        thirds = np.repeat(facets.areas[:, None] * facets.normals / 3.0, 3, axis=0)
        np.add.at(vectors, triangles.ravel(), thirds)
        pressures = np.column_stack([arms, np.ones(len(arms))])
        push = (vectors[:, :, None] * pressures[:, None, :])[nodes].reshape(-1, 4)
        if ratio < 0.5:
            x = arms[nodes]
            swollen = x[:, :, None] * np.column_stack([x, np.ones(len(x))])[:, None, :]
            swollen[:, :, :3] -= 0.5 * np.square(x).sum(axis=1)[:, None, None] * np.eye(3)
            bulk = 2.0 * modulus * (1.0 + ratio) / (3.0 * (1.0 - 2.0 * ratio))
            push = push - stiffness @ swollen.reshape(-1, 4) / (3.0 * bulk)
        self.weight[at] += push
        return vectors


class LumpyFormulation(BoundaryFormulation):
    """The `BoundaryFormulation` of a body with lumps (`Parameters.lumps`), whose inner nodes are condensed.

    If the body is incompressible and a lump is not, the body gets Poisson's ratio `INCOMPRESSIBLE`.

    Raises
    ------
    SolverError
        more than `MAX_NODES` nodes, inner ones included.
    """

    _weight: Array

    def _assemble(self, held: Mask) -> None:
        from vdm.boundary.operators import precision
        from vdm.boundary.tractions import shared

        surface, lumps = self.surface, self.parameters.lumps
        assert lumps is not None
        if len(lumps.points) < HALVED * surface.n_nodes:
            lumps = lumps.halved(surface.points)
        total = surface.n_nodes + len(lumps.points)
        if total > MAX_NODES:
            raise SolverError(too_large(total))
        ratios = np.where(lumps.poisson_ratios > INCOMPRESSIBLE, 0.5, lumps.poisson_ratios)
        if self.poisson_ratio == 0.5 and ratios.min() < 0.5:
            self.poisson_ratio = INCOMPRESSIBLE
        self._rims = Rims.of(surface, held)
        cut = self._rims.surface
        n = cut.n_nodes
        sums = _Regions(np.vstack([cut.points, lumps.points]), precision(surface.n_nodes))
        arms = sums.points - surface.points.mean(axis=0)

        # the nodes of the rims come between those of the surface and the inner ones
        bounds = lumps.bounds(np.where(lumps.facets < surface.n_nodes, 0, n - surface.n_nodes) + lumps.facets)
        numbers = np.arange(len(cut.triangles))
        if sums.dtype is np.float32:
            near = np.concatenate([held, np.zeros(n - len(held), np.bool_)])
            numbers = shared(cut, near)
        numbers = np.concatenate([numbers, numbers.max() + 1 + np.arange(len(bounds[0]))])
        whole = np.vstack([cut.triangles, bounds[0]])
        sums.add(whole, self.shear_modulus, self.poisson_ratio, numbers, arms)
        pressures = []
        for facets, modulus, ratio in zip(bounds[1:], lumps.shear_moduli, ratios, strict=True):
            vectors = sums.add(facets, modulus, ratio, None, arms)
            if ratio == 0.5:
                pressures.append(vectors[n:].reshape(-1))
        columns = np.array(pressures).reshape(-1, 3 * len(lumps.points)).T
        left, inside = _Inside.of(sums.matrix, n, columns)
        self.matrix = self._rims.condensed(left)
        self._weight = self._rims.carried(inside.carried(sums.weight).reshape(-1, 3, 4))

    def record(self) -> dict[str, float | str]:
        assert self.parameters.lumps is not None
        return {**super().record(), "lumps": float(len(self.parameters.lumps.shear_moduli))}

    def pressure_force(self, pressure: Array) -> Array:
        """As in `BoundaryFormulation`; each region has its own compressibility."""
        arms = self.surface.points - self.surface.points.mean(axis=0)
        fitted = np.linalg.lstsq(np.column_stack([arms, np.ones(len(arms))]), pressure, rcond=None)[0]
        return np.asarray(self._weight @ fitted)
