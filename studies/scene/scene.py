"""A study's scene on one mesh as plain arrays, the input of every model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from solver_common.arrays import Array, Index, Mask
from solver_common.quadrature import facet_quadrature

from ..body.mesh import Mesh, read_only
from ..body.surface_measures import Surface, corner_sum, facet_area_vectors, facet_areas, nodal_sum
from ..study.loads import Acts, Springs
from ..study.registry import SCANNED
from ..study.schema import Anisotropy, Study, Tissue, extras_of
from .inclusions import PlacedInclusion, place_inclusions
from .placed import PlacedConstraint, PlacedIndenter, place_indenter
from .regions import SceneError, body_extent, select


@dataclass(frozen=True)
class SurfaceLoad:
    """The load on a scene's body in one step, in the forms that models read; outward positive, read-only.

    Attributes
    ----------
    facet_pressure : (F, Q) contact pressure at the quadrature points, positive into the body [Pa]
    contact_pressure : (N,) the same per node over A_i [Pa]
    contact_force : (N, 3) the same as nodal forces [N]
    prescribed : (N, 3) displacement of held nodes, zero elsewhere [m]
    gravity : (3,) acceleration [m/s^2]
    points : (N, 3) the surface nodes at rest [m]
    dead : dead forces: nodes (k, 2) of edges or (k, 3) of facets, and the resultant (3,) spread evenly there [N]
    depth : of the indenter, if any [m]
    """

    facet_pressure: Array
    contact_pressure: Array
    contact_force: Array
    prescribed: Array
    gravity: Array
    points: Array
    dead: tuple[tuple[Index, Array], ...] = ()
    depth: float = 0.0

    def __post_init__(self) -> None:
        read_only([getattr(self, part.name) for part in fields(self)])

    @cached_property
    def dead_force(self) -> Array:
        """(N, 3) the dead forces as nodal forces: the nodes of an edge or a facet have equal shares [N]."""
        nodal = np.zeros_like(self.contact_force)
        for parts, force in self.dead:
            sides = self.points[parts[:, 1:]] - self.points[parts[:, :1]]
            gram = np.einsum("kai,kbi->kab", sides, sides)
            size = np.sqrt(np.linalg.det(gram))  # length, or twice the area
            share = (size / size.sum())[:, None] * force / parts.shape[1]
            for corner in range(parts.shape[1]):
                np.add.at(nodal, parts[:, corner], share)
        return read_only(nodal)

    @property
    def acts(self) -> bool:
        """Whether anything but weight acts on the body."""
        return self.depth != 0.0 or any(
            part.any() for part in (self.facet_pressure, self.dead_force, self.prescribed)
        )


@dataclass(frozen=True)
class Scene:
    """N surface nodes, F facets with Q quadrature points each, S load steps; SI units, outward positive, read-only.

    Attributes
    ----------
    mesh : the mesh that all models share
    tissue : E [Pa], nu, density [kg/m^3]
    parameters : VDM parameters that the study sets, by name; others follow a rule
    overrides : the same for single models, by full model name
    regions : (N,) masks by name
    fixed : (N,) nodes held at rest
    constrained : (N,) nodes whose displacement is given
    prescribed : (N, 3) displacement of held nodes at load factor 1, zero elsewhere [m]
    facet_pressure : (F, Q) contact pressure at load factor 1, positive into the body [Pa]
    gravity : (3,) acceleration [m/s^2], constant over the load history
    environment_pressure : P_ep, the datum of all pressures [Pa]
    load_factors : (S,)
    anisotropy : fibre direction and contrast, None for an isotropic body
    condition : whether the condition of the VDM models' systems is estimated
    dead : dead forces at load factor 1, see `SurfaceLoad`
    springs : between facets and the ground
    extras : features that not every model takes, see `vdmbench.study.schema.extras_of`
    inclusions : parts of the inside with moduli of their own
    homogeneous : models that ignore the inclusions
    indenter : a rigid one that is pushed in, or None
    """

    mesh: Mesh
    tissue: Tissue
    parameters: Mapping[str, float | str]
    overrides: Mapping[str, Mapping[str, float | str]]
    regions: Mapping[str, Mask]
    fixed: Mask
    constrained: Mask
    prescribed: Array
    facet_pressure: Array
    gravity: Array
    environment_pressure: float
    load_factors: Array
    anisotropy: Anisotropy | None
    condition: bool = False
    dead: tuple[tuple[Index, Array], ...] = ()
    springs: tuple[Springs, ...] = ()
    extras: frozenset[str] = frozenset()
    inclusions: tuple[PlacedInclusion, ...] = ()
    homogeneous: frozenset[str] = frozenset()
    indenter: PlacedIndenter | None = None

    def __post_init__(self) -> None:
        read_only([getattr(self, part.name) for part in fields(self)])

    @property
    def held(self) -> Mask:
        """(N,) nodes whose displacement is known."""
        return self.fixed | self.constrained

    @cached_property
    def _pressed(self) -> Array:
        """(F, 3) mean of pressure times shape function over each facet, per corner [Pa]."""
        barycentric, weights = facet_quadrature()
        return (self.facet_pressure * weights) @ barycentric

    @cached_property
    def contact_force(self) -> Array:
        """(N, 3) nodal contact forces at load factor 1; their sum is minus the integral of p n [N]."""
        vectors = facet_area_vectors(self.mesh.surface_points, self.mesh.triangles)
        thrust = -self._pressed[:, :, None] * vectors[:, None, :]
        return read_only(corner_sum(thrust, self.mesh.triangles, len(self.fixed)))

    @cached_property
    def contact_pressure(self) -> Array:
        """(N,) nodal pressure over A_i at load factor 1: sum A_i p_i is the integral of p [Pa]."""
        triangles, n_nodes = self.mesh.triangles, len(self.fixed)
        areas = facet_areas(self.mesh.surface_points, triangles)
        thrust = corner_sum(self._pressed * areas[:, None], triangles, n_nodes)
        return read_only(thrust / nodal_sum(areas, triangles, n_nodes))

    def load(self, factor: float) -> SurfaceLoad:
        """The load at a load factor; the weight does not scale."""
        return SurfaceLoad(
            factor * self.facet_pressure,
            factor * self.contact_pressure,
            factor * self.contact_force,
            factor * self.prescribed,
            self.gravity,
            self.mesh.surface_points,
            tuple((parts, factor * force) for parts, force in self.dead),
            factor * self.indenter.depth if self.indenter else 0.0,
        )

    @property
    def loads(self) -> list[SurfaceLoad]:
        """The loads of all steps of the history."""
        return [self.load(float(factor)) for factor in self.load_factors]

    def factors_at(self, places: Array) -> Array:
        """Load factors at places along the load history: 1 is its first step, 1.5 half way to the second."""
        factors = [0.0, *self.load_factors.tolist()]
        return np.interp(places, range(len(factors)), factors)

    def at(self, place: float) -> Scene:
        """One step at a place along the load history; on the way to the first step the weight grows too."""
        factor = self.factors_at(np.array([place]))
        return replace(self, load_factors=factor, gravity=min(place, 1.0) * self.gravity)

    def raised(self, factor: float) -> Scene:
        """One step with all loads, weight included, multiplied by `factor` from load factor 1."""
        return replace(self, load_factors=np.array([factor]), gravity=factor * self.gravity)

    @property
    def sags(self) -> bool:
        """Whether weight alone displaces the body; it does not for a scanned shape, which includes the sag."""
        return bool(self.gravity.any()) and SCANNED not in self.extras

    @property
    def contact(self) -> Mask:
        """(N,) nodes that carry contact pressure."""
        return self.contact_pressure != 0.0

    @cached_property
    def surface(self) -> Surface:
        """The surface at rest, with its measures, under these loads."""
        return Surface(
            self.mesh.surface_points, self.mesh.triangles, self.contact, self.contact_force, self.sags
        )


def build_scene(
    study: Study,
    mesh: Mesh,
    masks: Mapping[str, Mask] | None = None,
    inside: Mapping[str, Mask] | None = None,
) -> Scene:
    """Put a study's regions, constraints and loads on a mesh.

    `masks` gives the regions' nodes and `inside` the inclusions' tetrahedra on a refinement, from the coarse mesh.

    Raises
    ------
    SceneError
        a region that selects nothing, or contact on a node that is held.
    """
    regions = study.regions
    if masks is None:
        masks = {name: select(region, mesh) for name, region in regions.items()}
    acting = []
    for number, constraint in enumerate(study.constraints):
        place, name = ("constraints", number), constraint.region
        if not masks[name].any():
            told = f"region {name!r} selects no node of the mesh; enlarge it or take a smaller mesh_size"
            raise SceneError(f"{told}; {body_extent(mesh)}", "regions", name)
        on = PlacedConstraint(constraint, place, regions[name], mesh, masks[name])
        acts = constraint.act(on)
        if acts.pushed is not None and constraint.extra != "indenter":  # answers would be superposed
            raise SceneError(
                f'the kind {constraint.kind!r} has to have the property `extra`, "indenter"', *place
            )
        acting.append((on, acts))
    fixed, constrained, prescribed = _held(acting, len(mesh.surface_nodes))
    _check_apart(study, masks, fixed, constrained, mesh.triangles)
    pressure = np.zeros((len(mesh.triangles), len(facet_quadrature()[1])))
    pushed = [place_indenter(*acts.pushed, mesh, on.place) for on, acts in acting if acts.pushed is not None]
    return Scene(
        mesh=mesh,
        tissue=study.tissue,
        parameters=study.vdm.given(),
        overrides=study.model_parameters(),
        regions=masks,
        fixed=fixed,
        constrained=constrained,
        prescribed=prescribed,
        facet_pressure=sum((acts.pressure for _, acts in acting if acts.pressure is not None), pressure),
        gravity=np.array(study.gravity.acceleration if study.gravity else (0.0, 0.0, 0.0)),
        environment_pressure=study.environment.pressure if study.environment else 0.0,
        load_factors=np.array(study.load.history),
        anisotropy=study.anisotropy,
        condition=study.study.condition,
        dead=tuple((acts.dead[0], np.array(acts.dead[1])) for _, acts in acting if acts.dead is not None),
        springs=tuple(acts.springs for _, acts in acting if acts.springs is not None),
        extras=extras_of(study).union(*(acts.extras for _, acts in acting)),
        inclusions=place_inclusions(study, mesh, inside),
        homogeneous=frozenset(study.study.homogeneous),
        indenter=pushed[0] if pushed else None,  # a study has one at most
    )


def _held(acting: list[tuple[PlacedConstraint, Acts]], n_nodes: int) -> tuple[Mask, Mask, Array]:
    """(N,) nodes at rest, (N,) nodes that are moved, and their (N, 3) displacement [m]."""
    fixed, constrained, prescribed = np.zeros(n_nodes, bool), np.zeros(n_nodes, bool), np.zeros((n_nodes, 3))
    for on, acts in acting:
        if acts.displacement is None:
            fixed |= on.nodes & on.constraint.holds
            continue
        moved = np.broadcast_to(acts.displacement, prescribed.shape)
        both = constrained & on.nodes & (prescribed != moved).any(axis=1)
        if both.any():
            raise SceneError(
                f"{on.constraint.name!r} moves {both.sum()} nodes that another constraint moves differently",
                *on.place,
            )
        constrained |= on.nodes
        prescribed[on.nodes] = moved[on.nodes]
    return fixed, constrained, prescribed


def _check_apart(
    study: Study, masks: Mapping[str, Mask], fixed: Mask, constrained: Mask, triangles: Index
) -> None:
    """Refuse motion, load or support on nodes that another constraint holds."""
    for number, part in enumerate(study.constraints):
        mask = masks[part.region]
        if part.holds:  # nodes that another part holds at rest
            covered = int((mask & fixed).sum()) if part.loads else 0
            told = f"moves {covered} nodes that are fixed"
        elif part.supports:
            covered = int((mask & (fixed | constrained))[triangles].all(axis=1).sum())
            told = f"has {covered} facets that are fixed or constrained"
        else:
            covered = int((mask & (fixed | constrained)).sum())
            told = f"covers {covered} nodes that are fixed or constrained"
        if covered:
            told = f"{part.kind} {part.name!r} {told}; keep the regions apart"
            raise SceneError(told, "constraints", number)
