"""Bodies that a rigid indenter touches: elements with unilateral contact, and what they say of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from solver_common.arrays import Array

from ..scene.scene import Scene, SurfaceLoad

if TYPE_CHECKING:
    from fem_reference.finite_strain import FiniteStrainProblem
    from fem_reference.linear import LinearProblem
    from fem_reference.loads import Load
    from solver_common.solution import Solution

LoadsOf = Callable[[Sequence[SurfaceLoad]], list["Load"]]


def count(scene: Scene) -> int:
    """How many nodes an indenter can touch: a linear body is solved once for each."""
    return len(_nodes(scene)) if scene.indenter else 0


def linear(
    scene: Scene, problem: LinearProblem, loads_of: LoadsOf
) -> Callable[[Sequence[SurfaceLoad]], Solution]:
    """Answers of a linear body."""
    from fem_reference.contact import ContactProblem

    assert scene.indenter is not None
    region = np.zeros(len(scene.fixed), dtype=bool)
    region[_nodes(scene)] = True
    contact = ContactProblem(problem, scene.indenter.indenter, region)

    def solve(loads: Sequence[SurfaceLoad]) -> Solution:
        found = contact.solve([load.depth for load in loads], loads_of(loads))
        return _told(found.solution, found.force, found.contact_area, status=found.status)

    return solve


def finite_strain(
    scene: Scene, problem: FiniteStrainProblem, loads_of: LoadsOf, outputs: frozenset[str]
) -> Callable[[Sequence[SurfaceLoad]], Solution]:
    """Answers of a body at finite strain, each step from the one before it."""
    placed = scene.indenter
    assert placed is not None

    def solve(loads: Sequence[SurfaceLoad]) -> Solution:
        depths = [load.depth for load in loads]
        found = problem.indent(
            placed.indenter, placed.facets, depths, loads_of(loads), outputs - {"condition_estimate"}
        )
        return _told(found.solution, found.force @ placed.indenter.axis, found.contact_area)

    return solve


def _nodes(scene: Scene) -> Array:
    assert scene.indenter is not None
    return np.unique(scene.mesh.triangles[scene.indenter.facets])


def _told(solution: Solution, force: Array, area: Array, **changed: object) -> Solution:
    """With the force along the push [N] and the area under pressure [m^2] of each step."""
    scalars = {**solution.scalars, "indenter_force": force, "contact_area": area}
    return dataclasses.replace(solution, scalars=scalars, **changed)  # type: ignore[arg-type]
