"""Unilateral contact at finite strain: a rigid frictionless indenter against the deformed surface.

c is the distance of a deformed point from the indenter, negative inside, and n the indenter's normal. The
pressure per undeformed area along n is p = max(0, -k c) at every quadrature point of the facets. k is a penalty
with the consistent tangent k n x n - p H, H the second derivative of c (Wriggers 2006, Computational Contact
Mechanics, section 6.3). A pressure of one shear modulus sinks in by a three-hundredth of a mean edge; the depth
is reported.

The unknowns of Newton's method are the displacement and the pressures. Its tangent takes p from the last linear
solve (Magisano, Leonetti and Garcea 2017, Comput. Methods Appl. Mech. Eng. 313, 986, do so with stresses). A
point that this solve pressed stays in contact, even where the surface has since moved away (the primal-dual
active set of Hintermueller, Ito and Kunisch 2002, doi 10.1137/S1052623401383558). If distance alone decided, a
stiff penalty on a soft body would open and close from one iteration to the next.

The indenter has passed a surface point that is near the axis and behind its middle: nothing pushes that point
back. A substep that passes a point fails.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fem_reference.assembly import Pattern
from fem_reference.indenter import Capsule, Indenter, Sphere
from fem_reference.mesh import TetMesh, triangle_p2
from fem_reference.solution import Solution
from solver_common.arrays import Array, Mask
from solver_common.quadrature import facet_quadrature
from solver_common.solution import solver_error

PENALTY = 300.0  # of a shear modulus per mean edge
_CUTS = 6  # parts of a facet edge: a surface that crosses the axis has a point of this lattice near it
_LATTICE = np.array([(i, j, _CUTS - i - j) for i in range(_CUTS + 1) for j in range(_CUTS + 1 - i)]) / _CUTS
_APART = 1.0 / 3.0  # of an edge: distance between the points at which a facet is held off


@dataclass(frozen=True)
class Indentation:
    """Response to an indenter in S steps; NaN from the first step that was not reached.

    Attributes
    ----------
    solution : as for any load history
    force : (S, 3) force of the indenter on the body [N]
    penalty_energy : (S,) energy stored in the penalty, zero for an ideal contact [J]
    contact_area : (S,) undeformed area under pressure [m^2]
    inside : (S,) greatest depth of a surface point inside the indenter, at the quadrature points and on a lattice
        of every facet [m]
    """

    solution: Solution
    force: Array
    penalty_energy: Array
    contact_area: Array
    inside: Array


class RigidContact:
    """Contact forces on one mesh, in the scaled units of `fem_reference.system`.

    Parameters
    ----------
    mesh, pattern : the body's
    indenter : a sphere or a capsule
    facets : (F,) facets that it can touch

    Raises
    ------
    SolverError
        For a shape with an edge, facets of a wrong shape, or a radius that falls between their points.
    """

    def __init__(
        self, mesh: TetMesh, pattern: Pattern, indenter: Indenter, facets: NDArray[np.bool_]
    ) -> None:
        shape = indenter.shape
        if not isinstance(shape, Sphere | Capsule):
            raise _bad_contact("an indenter with an edge needs the linear body", "use a sphere or a capsule")
        chosen = np.asarray(facets)
        if chosen.shape != (len(mesh.triangles),) or chosen.dtype != bool or not chosen.any():
            raise _bad_contact(
                "the indenter has no facet to touch", f"give a mask of ({len(mesh.triangles)},)"
            )
        unit = mesh.mean_edge
        self._nodes = mesh.facet_nodes[chosen]
        corners = mesh.node_points[self._nodes[:, :3]]
        longest = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max())
        if shape.radius < _APART * longest:
            raise _bad_contact(
                f"a radius of {shape.radius:.3g} m falls between the points of facets of {longest:.3g} m",
                f"use facets of at most {shape.radius / _APART:.3g} m there",
            )
        points, weights = facet_quadrature()
        self._shape = triangle_p2(points)
        self._everywhere = np.vstack([self._shape, triangle_p2(_LATTICE)])
        self._measure = np.linalg.norm(mesh.area_vectors[chosen], axis=1)[:, None] * weights / unit**2
        self._axis, self._radius = indenter.axis, shape.radius / unit
        self._start = np.asarray(indenter.tip, dtype=np.float64) / unit - self._radius * self._axis
        self._along, self._half = np.zeros(3), 0.0
        if isinstance(shape, Capsule):
            self._along = np.array(shape.along) / np.linalg.norm(shape.along)
            self._half = 0.5 * shape.length / unit
        self._pattern, self._mesh = pattern, mesh

    @property
    def untouched(self) -> Array:
        """(f, Q) zero pressures."""
        return np.zeros_like(self._measure)

    def predicted(self, positions: Array, depth: float, pressure: Array, step: Array) -> Array:
        """(f, Q) pressures after a step (n_nodes, 3), by the linear model at this state; negative where it pulls.

        Parameters
        ----------
        pressure : (f, Q) of the last linear solve, see `add_stiffness`
        """
        distance, normal, _ = self._distance(positions, depth)
        change = np.einsum("fqi,fqi->fq", normal, self._shape @ step[self._nodes])
        return np.where(_is_on(distance, pressure), -PENALTY * (distance + change), 0.0)

    def lacking(self, positions: Array, depth: float, pressure: Array) -> float:
        """Largest distance of points in contact from the depth that their pressures (f, Q) require."""
        distance = self._distance(positions, depth)[0]
        return float(np.abs(np.where(_is_on(distance, pressure), distance + pressure / PENALTY, 0.0)).max())

    def forces(self, positions: Array, depth: float, pressure: Array | None = None) -> Array:
        """(n_nodes, 3) forces on the body of (f, Q) pressures, by default those of the penalty."""
        distance, normal, _ = self._distance(positions, depth)
        pressure = self._pressure(distance) if pressure is None else pressure
        traction = (pressure * self._measure)[..., None] * normal
        return self._mesh.summed(self._nodes, self._shape.T @ traction)

    def add_stiffness(
        self, blocks: Array, positions: Array, depth: float, pressure: Array | None = None
    ) -> None:
        """Add the negative derivative of the forces to the (pattern.size, 3, 3) blocks.

        Parameters
        ----------
        pressure : (f, Q) of the last linear solve, whose points stay in contact; by default those of the penalty
        """
        distance, normal, curvature = self._distance(positions, depth)
        pressure = self._pressure(distance) if pressure is None else pressure
        on = _is_on(distance, pressure) * self._measure
        tensors = (PENALTY * on)[..., None, None] * normal[..., :, None] * normal[..., None, :]
        tensors -= (pressure * self._measure)[..., None, None] * curvature
        touched = on.any(axis=1)
        if not touched.any():
            return
        values = np.einsum("qa,qb,fqij->fabij", self._shape, self._shape, tensors[touched], optimize=True)
        np.add.at(blocks, self._pattern.places(self._nodes[touched]), values.reshape(-1, 3, 3))

    def inside(self, positions: Array, depth: float) -> float:
        """Greatest depth of a surface point inside the indenter."""
        distance = np.linalg.norm(self._from_middle(positions, depth, self._everywhere)[0], axis=-1)
        return float(np.clip(self._radius - distance, 0.0, None).max())

    def passes(self, positions: Array, depth: float) -> bool:
        """Whether the surface is behind the indenter's middle and within half its radius of the axis."""
        y, _ = self._from_middle(positions, depth, self._everywhere)
        along = y @ self._axis
        across = np.linalg.norm(y - along[..., None] * self._axis, axis=-1)
        return bool(((along < 0.0) & (across < 0.5 * self._radius)).any())

    def is_pushed_on(self, positions: Array, depth: float) -> bool:
        """Whether the body pushes the indenter onward: the indenter is then behind the surface that it met."""
        return float((self.forces(positions, depth) @ self._axis).sum()) < 0.0

    def energy(self, positions: Array, depth: float) -> float:
        """Energy of the penalty."""
        distance, _, _ = self._distance(positions, depth)
        return float(0.5 / PENALTY * (self._pressure(distance) ** 2 * self._measure).sum())

    def touched(self, positions: Array, depth: float) -> int:
        """Number of facets under pressure."""
        return int((self._pressure(self._distance(positions, depth)[0]) > 0.0).any(axis=1).sum())

    def area(self, positions: Array, depth: float) -> float:
        """Undeformed area under pressure."""
        distance, _, _ = self._distance(positions, depth)
        return float(((self._pressure(distance) > 0.0) * self._measure).sum())

    def _pressure(self, distance: Array) -> Array:
        return PENALTY * np.clip(-distance, 0.0, None)

    def _distance(self, positions: Array, depth: float) -> tuple[Array, Array, Array]:
        """(f, Q) distances from the indenter, their gradients and their second derivatives."""
        y, place = self._from_middle(positions, depth, self._shape)
        length = np.maximum(np.linalg.norm(y, axis=-1), 1e-12)
        normal = y / length[..., None]
        flat = np.eye(3) - normal[..., :, None] * normal[..., None, :]
        flat -= (np.abs(place) < self._half)[..., None, None] * np.outer(self._along, self._along)
        return length - self._radius, normal, flat / length[..., None, None]

    def _from_middle(self, positions: Array, depth: float, shape: Array) -> tuple[Array, Array]:
        """(f, Q, 3) vectors from the nearest points of the indenter's middle line, and the (f, Q) places there."""
        y = shape @ positions[self._nodes] - (self._start + depth * self._axis)
        place = y @ self._along
        return y - np.clip(place, -self._half, self._half)[..., None] * self._along, place


def _is_on(distance: Array, pressure: Array) -> Mask:
    """Which points are in contact: inside the indenter, or pressed by the last linear solve."""
    return (distance < 0.0) | (pressure > 0.0)


_bad_contact = partial(solver_error, "bad-contact")
