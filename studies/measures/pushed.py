"""Curves of force against depth of a constraint that pushes the body: pure functions on arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver_common.arrays import Array, Mask

from ..body.mesh import Mesh
from ..body.surface_measures import Surface, facet_area_vectors
from ..scene.regions import select
from ..scene.result import ModelResult
from ..study.loads import Constraint
from ..study.registry import SCANNED
from ..study.schema import Study, extras_of, has_weight

_BEYOND = 1e-9  # of the largest depth: rounding


@dataclass(frozen=True)
class Answer:
    """A model's answer to S load steps at N surface nodes.

    Attributes
    ----------
    displacement : (S, N, 3) [m]
    reaction : (S, N, 3) force of the support [N]; None if unknown
    linear : whether the answer is linear in the load, also beyond the steps
    values : inputs that differ from the study's: key -> value, SI
    indenter_force : (S,) force of a rigid indenter along its push [N]; None without one
    """

    displacement: Array
    reaction: Array | None = None
    linear: bool = False
    values: Mapping[str, float] | None = None
    indenter_force: Array | None = None

    @classmethod
    def of(
        cls, result: ModelResult, *, linear: bool = False, values: Mapping[str, float] | None = None
    ) -> Answer:
        """The answer of a result."""
        force = result.scalars.get("indenter_force")
        return cls(result.displacement, result.reaction_force, linear, values, force)


class Pushed:
    """One constraint that pushes a body, and the curve of force against depth for any answer.

    Parameters
    ----------
    mask : (N,) nodes of its region on the undeformed `surface`
    factors : (S,) load factors of the steps

    Attributes
    ----------
    rests : whether it has neither depth nor force without load
    """

    def __init__(
        self, study: Study, constraint: Constraint, mask: Mask, surface: Surface, factors: Array
    ) -> None:
        self.constraint, self._mask, self._surface = constraint, mask, surface
        self._factors = factors
        # without load a scanned body is at its scan, but a region that is moved also carries weight
        scanned = SCANNED in extras_of(study) and constraint.kind != "constrained"
        self.rests = scanned or not has_weight(study)
        # a pressure's resultant depends on the mesh, and vanishes for a pressure from all sides
        self.unit = "Pa" if constraint.kind == "contact" and constraint.force is None else "N"

    @classmethod
    def on(cls, study: Study, mesh: Mesh, name: str) -> Pushed:
        """The constraint with a name on a mesh."""
        constraint = next(part for part in study.constraints if part.name == name)
        surface = Surface(mesh.surface_points, mesh.triangles)
        mask = select(study.regions[constraint.region], mesh)
        return cls(study, constraint, mask, surface, np.array(study.load.history))

    def curve(self, answer: Answer) -> tuple[Array, Array]:
        """(S,) depths [m] and (S,) forces [N]; pressures [Pa] for a constraint given by its pressure.

        NaN where the answer does not determine them.
        """
        given = {**self.constraint.model_dump(exclude_none=True), **self._changed(answer)}
        if self.constraint.kind == "contact":
            size = given["pressure" if self.unit == "Pa" else "force"]
            # inward normal displacement of the contact node that moves farthest
            normals = self._surface.normals[self._mask]
            inward = -np.einsum("sij,ij->si", answer.displacement[:, self._mask], normals)
            farthest = inward[np.arange(len(inward)), np.abs(inward).argmax(axis=1)]
            return farthest, self._factors * float(size)
        if self.constraint.kind == "indenter":
            force = answer.indenter_force
            depths = self._factors * float(given["depth"])
            return depths, np.full(len(depths), np.nan) if force is None else force
        prescribed = np.array(given["displacement"], dtype=float)
        depths = self._factors * float(np.linalg.norm(prescribed))
        if answer.reaction is None:
            return depths, np.full(len(depths), np.nan)
        total = answer.reaction[:, self._mask].sum(axis=1)
        return depths, np.asarray(total @ (prescribed / np.linalg.norm(prescribed)))

    def force_at(self, depth: float, answer: Answer) -> float:
        """The force at a depth [N]: a monotone cubic through the load steps, or a line for a linear answer.

        NaN beyond the deepest step, except for a linear answer of a body that rests without load.
        """
        depths, forces = self.curve(answer)
        if self.unit == "Pa":  # uniform: the study's checks refuse a measured force for other profiles
            facets = self._surface.triangles[self._mask[self._surface.triangles].all(axis=1)]
            vectors = facet_area_vectors(self._surface.points, facets)
            forces = forces * float(np.linalg.norm(vectors.sum(axis=0)))
        solved = np.cumprod(np.isfinite(depths) & np.isfinite(forces)).astype(bool)  # up to where it stopped
        depths, forces = depths[solved], forces[solved]
        if self.rests:
            depths, forces = np.append(depths, 0.0), np.append(forces, 0.0)
        depths, first = np.unique(depths, return_index=True)
        forces = forces[first]
        if len(depths) < 2:
            return np.nan
        low, high = depths[0], depths[-1]
        if answer.linear:
            return float(forces[0] + (depth - low) * (forces[-1] - forces[0]) / (high - low))
        from scipy.interpolate import PchipInterpolator  # slow to load, and not needed by a report

        rounding = _BEYOND * (high - low)
        if not low - rounding <= depth <= high + rounding:
            return np.nan
        return float(PchipInterpolator(depths, forces)(min(max(depth, low), high)))

    def _changed(self, answer: Answer) -> dict[str, Any]:
        """Keys of the constraint that an input changes, with whole vectors."""
        start = f"constraints.{self.constraint.name}."
        found: dict[str, Any] = {}
        for key, value in (answer.values or {}).items():
            name, _, place = key.removeprefix(start).partition(".")
            if not key.startswith(start):
                continue
            if place:
                whole = list(found.get(name, getattr(self.constraint, name)))
                whole[int(place)] = value
                found[name] = whole
            else:
                found[name] = value
        return found
