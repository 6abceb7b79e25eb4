"""One frame of a resting contact: the same product for every model that is linear in the contact's pressure."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fem_reference.condensed import CondensedProblem
from fem_reference.linear import LinearProblem
from fem_reference.loads import Load
from solver_common.arrays import Array, Index
from solver_common.quadrature import facet_quadrature
from vdm.solvers.columns import ContactColumns
from vdm.solvers.compliance import ContactCompliance
from vdm.solvers.linear import LinearSolver

from ..scene.scene import Scene

Problem = LinearSolver | LinearProblem | CondensedProblem
Frame = Callable[[Array], tuple[Array, float]]


def contact_frame(problem: Problem, scene: Scene) -> Frame:
    """Frames on the scene's contact nodes: pressures (k,) [Pa] -> displacement (N, 3) [m], fluid pressure [Pa].

    One column per contact node, in single precision: the answer to the node's part of the scene's contact, at unit
    nodal pressure. The parts share the contact between the nodes as its force is shared, so that under the scene's
    own nodal pressures a frame is the model's answer to the scene's contact. Nothing else loads the body: no
    weight, no held node that moves.
    """
    nodes = np.flatnonzero(scene.contact)
    if not isinstance(problem, LinearSolver):
        columns = _element_columns(problem, scene, nodes)
        return ContactColumns(columns.astype(np.float32), scene.mesh.surface_points, nodes).frame
    push = scene.contact_force / np.where(scene.contact, scene.contact_pressure, 1.0)[:, None]
    prepared = ContactCompliance(problem.problem, problem, push=push).prepare(nodes)

    def frame(pressure: Array) -> tuple[Array, float]:
        unknown, fluid_pressure = prepared.frame(pressure)
        return problem.problem.formulation.displacement(unknown), fluid_pressure

    return frame


def _element_columns(problem: LinearProblem | CondensedProblem, scene: Scene, nodes: Index) -> Array:
    """(3 N + 1, k) displacement of the surface, one component after the other, and mean pressure."""
    corners, _ = facet_quadrature()
    still, weightless = np.zeros_like(scene.prescribed), np.zeros(3)
    loads = [
        Load(
            scene.facet_pressure * ((scene.mesh.triangles == node) @ corners.T) / pressure, still, weightless
        )
        for node, pressure in zip(nodes, scene.contact_pressure[nodes], strict=True)
    ]
    solution = problem.solve(loads)
    displacement = solution.displacement.transpose(2, 1, 0).reshape(-1, len(nodes))
    return np.concatenate([displacement, solution.fluid_pressure[None]])
