"""A scene at one load as another program takes it: on the points of its mesh, in metres, kilograms and seconds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from solver_common.arrays import Array, Index, Mask
from solver_common.quadrature import facet_quadrature

from ..body.mesh import Mesh
from ..study.schema import Tissue
from .scene import Scene, SurfaceLoad

T = TypeVar("T", bound=np.generic)

LOCKS_FROM = 0.45  # Poisson's ratio from which linear tetrahedra are visibly too stiff


@dataclass(frozen=True)
class Handout:
    """A scene with tetrahedra under one load, in SI units: n points, `mesh.surface_nodes[i]` is surface node i.

    Attributes
    ----------
    name : of the study and its case, one line
    load_factor : of the study's load history
    """

    scene: Scene
    load: SurfaceLoad
    name: str = ""
    load_factor: float = 1.0

    @property
    def mesh(self) -> Mesh:
        """The scene's own."""
        return self.scene.mesh

    @property
    def tissue(self) -> Tissue:
        """Moduli and density."""
        return self.scene.tissue

    @cached_property
    def held(self) -> Mask:
        """(n,) points whose displacement is given."""
        return self._at_points(self.scene.held)

    @cached_property
    def displacement(self) -> Array:
        """(n, 3) of these, zero elsewhere [m]."""
        return self._at_points(np.where(self.scene.held[:, None], self.load.prescribed, 0.0))

    @cached_property
    def force(self) -> Array:
        """(n, 3) contact and line forces, dead, without the weight [N]."""
        return self._at_points(self.load.contact_force + self.load.dead_force)

    @cached_property
    def facet_pressure(self) -> Array:
        """(F,) mean contact pressure, positive into the body [Pa]."""
        return self.load.facet_pressure @ facet_quadrature()[1]

    def _at_points(self, values: NDArray[T]) -> NDArray[T]:
        """(n, ...) of values (N, ...) at the surface nodes, zero inside."""
        found = np.zeros((len(self.mesh.points), *values.shape[1:]), dtype=values.dtype)
        found[self.mesh.surface_nodes] = values
        return found

    @cached_property
    def mass(self) -> Array:
        """(n,) a quarter of each tetrahedron's mass at each of its points [kg]."""
        corners = self.mesh.points[self.mesh.tetrahedra]
        volume = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0
        share = np.repeat(0.25 * self.tissue.density * volume, 4)
        found: Array = np.bincount(
            self.mesh.tetrahedra.ravel(), weights=share, minlength=len(self.mesh.points)
        ).astype(float)
        return found

    @property
    def whole_force(self) -> Array:
        """(n, 3) forces with the weight, which is exact for linear tetrahedra [N]."""
        return self.force + self.mass[:, None] * self.load.gravity

    @property
    def moved(self) -> Mask:
        """(n,) held points that do not stay at rest."""
        return self.held & self.displacement.any(axis=1)

    @property
    def surface_number(self) -> Index:
        """(n,) number of the surface node at each point, -1 inside."""
        numbers = np.full(len(self.mesh.points), -1)
        numbers[self.mesh.surface_nodes] = np.arange(len(self.mesh.surface_nodes))
        return numbers


def cannot_express(body: Handout, takes: frozenset[str]) -> str:
    """Why linear tetrahedra of an isotropic law that take these extras cannot be this scene; "" where they can."""
    if body.tissue.poisson_ratio == 0.5:
        return "its tetrahedra have no law for an incompressible tissue; give a poisson_ratio below 0.5"
    if body.scene.anisotropy:
        return "its law is isotropic; leave [anisotropy] out"
    if others := sorted(set(body.scene.extras) - takes):
        return f"not expressed here: {', '.join(others)}; leave out what makes them"
    return ""


def remarks(body: Handout) -> list[str]:
    """What the head of a scene says: units, load, and what the scene leaves out."""
    told = [
        body.name,
        "Lengths in m, forces in N, stresses in Pa, masses in kg. Points as in mesh.vtu.",
        f"The load is that of load factor {body.load_factor:g}.",
        "Its forces are dead: pressure does not turn with the surface.",
    ]
    ratio = body.tissue.poisson_ratio
    if ratio >= LOCKS_FROM:
        told.append(f"Linear tetrahedra are too stiff at a Poisson ratio of {ratio:g}: they move too little.")
    if not body.held.any():
        told.append("Nothing holds the body: a static solver finds no answer.")
    return told
