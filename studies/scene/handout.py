"""A scene at one load as another program takes it: on the points of its mesh, in metres, kilograms and seconds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from solver_common.arrays import Array, Index, Mask
from solver_common.quadrature import facet_quadrature

from ..body.mesh import Mesh
from ..study.loads import Springs
from .inclusions import PlacedInclusion
from .scene import Scene, SurfaceLoad

LOCKS_FROM = 0.45  # Poisson's ratio from which linear tetrahedra are visibly too stiff


@dataclass(frozen=True)
class Handout:
    """n points, m tetrahedra, N surface nodes and F facets; SI units.

    Attributes
    ----------
    name : of the study and its case, one line
    mesh : the mesh; point `mesh.surface_nodes[i]` is surface node i
    regions : (N,) masks by name
    youngs_modulus, poisson_ratio, density : of the tissue [Pa], [1], [kg/m^3]
    fibres : whether it has fibres, which no scene here expresses
    extras : what it has of `vdmbench.study.extras`; an export says beside its name which it takes
    springs : between facets and the ground
    inclusions : parts of the inside with moduli of their own
    gravity : (3,) acceleration [m/s^2]
    held : (n,) points whose displacement is given
    displacement : (n, 3) of these, zero elsewhere [m]
    force : (n, 3) contact and line forces, dead, without the weight [N]
    facet_pressure : (F,) mean contact pressure, positive into the body [Pa]
    load_factor : of the study's load history
    """

    name: str
    mesh: Mesh
    regions: dict[str, Mask]
    youngs_modulus: float
    poisson_ratio: float
    density: float
    fibres: bool
    extras: tuple[str, ...]
    springs: tuple[Springs, ...]
    inclusions: tuple[PlacedInclusion, ...]
    gravity: Array
    held: Mask
    displacement: Array
    force: Array
    facet_pressure: Array
    load_factor: float

    @cached_property
    def mass(self) -> Array:
        """(n,) a quarter of each tetrahedron's mass at each of its points [kg]."""
        corners = self.mesh.points[self.mesh.tetrahedra]
        volume = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0
        share = np.repeat(0.25 * self.density * volume, 4)
        found: Array = np.bincount(
            self.mesh.tetrahedra.ravel(), weights=share, minlength=len(self.mesh.points)
        ).astype(float)
        return found

    @property
    def whole_force(self) -> Array:
        """(n, 3) forces with the weight, which is exact for linear tetrahedra [N]."""
        return self.force + self.mass[:, None] * self.gravity

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


def hand_out(scene: Scene, load: SurfaceLoad, name: str = "", factor: float = 1.0) -> Handout:
    """A scene whose mesh has tetrahedra, under one of its loads, that of `factor`."""
    mesh = scene.mesh
    n = len(mesh.points)
    held, displacement, force = np.zeros(n, dtype=bool), np.zeros((n, 3)), np.zeros((n, 3))
    held[mesh.surface_nodes] = scene.held
    displacement[mesh.surface_nodes] = np.where(scene.held[:, None], load.prescribed, 0.0)
    force[mesh.surface_nodes] = load.contact_force + load.dead_force
    return Handout(
        name=" ".join(name.split()),
        mesh=mesh,
        regions=dict(scene.regions),
        youngs_modulus=scene.tissue.youngs_modulus,
        poisson_ratio=scene.tissue.poisson_ratio,
        density=scene.tissue.density,
        fibres=scene.anisotropy is not None,
        extras=tuple(sorted(scene.extras)),
        springs=scene.springs,
        inclusions=scene.inclusions,
        gravity=load.gravity,
        held=held,
        displacement=displacement,
        force=force,
        facet_pressure=load.facet_pressure @ facet_quadrature()[1],
        load_factor=factor,
    )


def cannot_express(body: Handout, takes: frozenset[str]) -> str:
    """Why linear tetrahedra of an isotropic law that take these extras cannot be this scene; "" where they can."""
    if body.poisson_ratio == 0.5:
        return "its tetrahedra have no law for an incompressible tissue; give a poisson_ratio below 0.5"
    if body.fibres:
        return "its law is isotropic; leave [anisotropy] out"
    if others := sorted(set(body.extras) - takes):
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
    if body.poisson_ratio >= LOCKS_FROM:
        told.append(
            f"Linear tetrahedra are too stiff at a Poisson ratio of {body.poisson_ratio:g}: they move too little."
        )
    if not body.held.any():
        told.append("Nothing holds the body: a static solver finds no answer.")
    return told
