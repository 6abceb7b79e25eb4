"""A constraint on its mesh: what the kinds of constraints make pressures and lines from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from solver_common.arrays import Array, Index, Mask
from solver_common.quadrature import facet_quadrature

from ..body.mesh import Mesh
from ..body.surface_measures import facet_area_vectors
from ..study.errors import InputError, Loc
from ..study.schema import Constraint, Region
from .contact_profile import on_facets, sampled

_LEAST_RESULTANT = 1e-6  # of a contact, over the sum of its facets' forces: below it is rounding or chance
_CLEAR_RESULTANT = 0.1  # the same, from which on samples of a profile tell that it has one


class SceneError(InputError):
    """A scene that cannot be put on its mesh; the message says which part and what to change.

    `place` is that part in the study, as ("constraints", 1) or ("regions", "base").
    """

    def __init__(self, text: str, place: Loc = ("constraints",)) -> None:
        super().__init__(text)
        self.place = place


@dataclass(frozen=True)
class PlacedConstraint:
    """See `vdmbench.study.loads.Placed`; `place` is its own in the study, `region` in the mesh's coordinates.

    Where it is only `checked`, samples stand for the integrals of a smooth profile that clearly presses one way.
    """

    constraint: Constraint
    place: Loc
    region: Region
    mesh: Mesh
    nodes: Mask
    checked: bool = False

    @property
    def points(self) -> Array:
        """(N, 3) surface nodes [m]."""
        return self.mesh.surface_points

    @property
    def triangles(self) -> Index:
        """(F, 3) nodes of the facets."""
        return self.mesh.triangles

    def pressure(self, profile: str | None) -> Array:
        """(F, Q) pressure of peak 1 over the region.

        A uniform pressure acts on the facets whose three nodes are in the region. A smooth profile is integrated
        over the facets (`vdmbench.scene.contact_profile`): its resultant hangs neither on mesh level nor on model.
        """
        shape = self._remembered(profile, lambda: self._shape(profile))
        if not shape.any():
            raise self._error("loads no facet; enlarge its region or take a smaller mesh_size")
        return shape

    def resultant(self, pressure: Array) -> float:
        """Size of the resultant of a pressure, over its unit [m^2]."""
        resultant, total = self._resultant_and_total(pressure)
        if resultant < _LEAST_RESULTANT * total:
            raise self._error(
                "presses from all sides, so that its pressures have no resultant to be given by force; give "
                "pressure, or a region on one side"
            )
        return resultant

    def at_quadrature(self, values: Array) -> Array:
        """(F, Q) from (N,) values, linear on each facet of the region, 0 on the others."""
        barycentric, _ = facet_quadrature()
        return self.pressure(None) * (values[self.triangles] @ barycentric.T)

    def edges(self) -> Index:
        """(k, 2) edges of the surface between the nodes of a region that has no facet of its own."""
        triangles, mask = self.triangles, self.nodes
        sides = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
        edges = np.unique(sides[mask[sides].all(axis=1)], axis=0)
        if not len(edges):
            raise self._error("has no edge between its nodes; enlarge its region")
        if (count := int(mask[triangles].all(axis=1).sum())) > 0:
            raise self._error(f"covers {count} facets; a line is one node wide: make its region narrower")
        return np.asarray(edges, dtype=np.int64)

    def facets(self) -> Mask:
        """(F,) mask of the facets whose three nodes are in the region."""
        inside = np.all(self.nodes[self.triangles], axis=1)
        if not inside.any():
            raise self._error("has no facet; enlarge its region or take a smaller mesh_size")
        return np.asarray(inside)

    def _resultant_and_total(self, pressure: Array) -> tuple[float, float]:
        vectors = facet_area_vectors(self.points, self.triangles)
        areas = pressure @ facet_quadrature()[1]
        return float(np.linalg.norm(areas @ vectors)), float(np.abs(areas) @ np.linalg.norm(vectors, axis=1))

    def _shape(self, profile: str | None) -> Array:
        barycentric, weights = facet_quadrature()
        if profile in (None, "uniform"):
            inside = np.all(self.nodes[self.triangles], axis=1)
            return np.repeat(inside[:, None].astype(float), len(weights), axis=1)
        if self.checked:
            samples = sampled(str(profile), self.region, self.mesh, barycentric)
            resultant, total = self._resultant_and_total(samples)
            if resultant > _CLEAR_RESULTANT * total:
                return samples
        return on_facets(str(profile), self.region, self.mesh, (barycentric, weights))

    def _remembered(self, profile: str | None, work: Callable[[], Array]) -> Array:
        asked = ("pressure", profile, self.checked, self.region.model_dump_json(), self.nodes.tobytes())
        return self.mesh.remembered(asked, work)

    def _error(self, text: str) -> SceneError:
        return SceneError(f"{self.constraint.kind} {self.constraint.name!r} {text}", self.place)
