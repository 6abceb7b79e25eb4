"""Unilateral contact of a linear body with a rigid frictionless indenter.

The contact pressure is continuous and linear on each facet, one order below the displacement; its vertex values
are the multipliers. With their hat functions psi_i, the gap c of the undeformed surface and the push e,

    G_i = integral of psi_i (c + e.u) >= 0,   p_i >= 0,   p_i G_i = 0,

as in Hertz's theory: the slopes of surface and indenter are small, and forces act along e. The compliance of the
body is W = B^T C B, from one solve per vertex. G = g + W p is a linear complementarity problem, solved by the
primal-dual active set (Hintermueller, Ito and Kunisch 2002, doi 10.1137/S1052623401383558).

With five cells to the contact radius, the error in Hertz's force is 1 %, in the pressure at a vertex some 15 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from fem_reference.indenter import Indenter, told_sunk
from fem_reference.linear import LinearProblem, Load
from fem_reference.linear_algebra import BATCH
from fem_reference.loads import loads_at
from fem_reference.solution import Solution, Status
from solver_common.arrays import Array
from solver_common.jit import clock
from solver_common.quadrature import facet_quadrature
from solver_common.solution import solver_error

_MOST_CHANGES = 60  # of the active set; about ten are typical


@dataclass(frozen=True)
class ContactSolution:
    """An indentation in S steps.

    Attributes
    ----------
    solution : the body's fields under contact and all other loads
    force : (S,) force of the indenter on the body, along its push [N]
    contact_area : (S,) area with positive pressure, counted by vertices [m^2]
    contact_pressure : (S, N) along the push, at the surface nodes [Pa]
    least_gap : (S,) the smallest mean gap about a vertex, not negative except for rounding [m]
    changes : (S,) of the active set
    status : S outcomes
    """

    solution: Solution
    force: Array
    contact_area: Array
    contact_pressure: Array
    least_gap: Array
    changes: NDArray[np.int64]
    status: tuple[Status, ...]


class ContactProblem:
    """A linear body and an indenter, ready for many depths.

    Parameters
    ----------
    problem : the body; make it with solver="direct" or many `expected_loads`
    indenter : where it starts and which way it goes
    region : (N,) surface nodes that it can touch: a facet counts if its three vertices are among them

    Attributes
    ----------
    vertices : (C,) numbers of the surface nodes with a pressure
    compliance : (C, C) W [m^3/Pa]
    seconds_setup : that of `problem` included [s]

    Raises
    ------
    SolverError
        For a region without a facet under the indenter, or of a wrong shape.
    """

    def __init__(self, problem: LinearProblem, indenter: Indenter, region: ArrayLike) -> None:
        start = clock()
        mesh = problem.mesh
        mask = np.asarray(region, dtype=bool)
        if mask.shape != (len(mesh.surface_nodes),):
            raise _bad_contact(f"region has shape {mask.shape}", f"give shape ({len(mesh.surface_nodes)},)")
        self.problem, self.indenter = problem, indenter
        facets = np.flatnonzero(mask[mesh.triangles].all(axis=1))
        points, weights = facet_quadrature()
        triangles = mesh.triangles[facets]
        corners = mesh.points[mesh.surface_nodes[triangles]]
        gap = indenter.gap(np.einsum("qa,fai->fqi", points, corners))
        # points that the indenter passes by take no part
        measure = np.linalg.norm(mesh.area_vectors[facets], axis=1)[:, None] * weights * np.isfinite(gap)
        if not measure.any():
            raise _bad_contact("no facet of the region lies under the indenter", "choose more surface nodes")
        self.vertices, place = np.unique(triangles[measure.any(axis=1)], return_inverse=True)
        facets, gap, measure = (a[measure.any(axis=1)] for a in (facets, gap, measure))
        place = place.reshape(-1, 3)
        count = len(self.vertices)

        def summed(values: Array) -> Array:
            sums = np.bincount(place.ravel(), weights=(values @ points).ravel(), minlength=count)
            return np.asarray(sums, dtype=np.float64)

        self._gap_at = np.where(measure > 0.0, gap, np.inf)
        self._corners, self._shares = mesh.triangles[facets], points
        self._area = summed(measure)
        self._gap = summed(measure * np.where(np.isfinite(gap), gap, 0.0))
        local = np.einsum("fq,qa,qi->fai", measure, mesh.facet_functions(points), points)
        nodes = np.broadcast_to(mesh.facet_nodes[facets][:, :, None], local.shape)
        columns = np.broadcast_to(place[:, None], local.shape)
        self._spread = csr_array(
            (local.ravel(), (nodes.ravel(), columns.ravel())), shape=(mesh.n_nodes, count)
        )
        self.compliance = np.empty((count, count))
        nothing = np.zeros((BATCH, mesh.n_nodes, 3))
        for first in range(0, count, BATCH):
            part = slice(first, min(first + BATCH, count))
            forces = self._forces(np.eye(count)[part])
            moved = problem.solve_nodal(forces, nothing[: len(forces)]).displacement @ indenter.axis
            self.compliance[part] = np.asarray(self._spread.T @ moved.T).T
        self.compliance = 0.5 * (self.compliance + self.compliance.T)
        self.seconds_setup = problem.seconds_setup + clock() - start

    def solve(self, depths: Sequence[float], load: Load | Sequence[Load] | None = None) -> ContactSolution:
        """One step per depth of the indenter [m], measured from where its tip is at rest.

        Parameters
        ----------
        depths : in any order; each is solved faster from a near one
        load : all other loads, for every step or for each

        Raises
        ------
        SolverError
            For a depth that is not finite, and a load that the body refuses.
        """
        mesh = self.problem.mesh
        bases = loads_at(mesh, depths, load)
        lifted = self._lifted(bases)
        pressures = np.zeros((len(depths), len(self.vertices)))
        changes, settled = np.zeros(len(depths), dtype=np.int64), np.zeros(len(depths), dtype=bool)
        active = np.zeros(len(self.vertices), dtype=bool)
        for step, depth in enumerate(depths):
            pressures[step], active, changes[step], settled[step] = self._complementarity(
                lifted[step] - depth * self._area, active
            )
        loads = [self._loaded(b, force) for b, force in zip(bases, self._forces(pressures), strict=True)]
        solution = self.problem.solve(loads)
        gaps = (lifted - np.outer(depths, self._area) + pressures @ self.compliance) / self._area
        inside = np.array([self._inside(*step) for step in zip(solution.displacement, depths, strict=True)])
        at_surface = np.zeros((len(depths), len(mesh.surface_nodes)))
        at_surface[:, self.vertices] = pressures
        return ContactSolution(
            solution=solution,
            force=pressures @ self._area,
            contact_area=(pressures > 0.0) @ self._area,
            contact_pressure=at_surface,
            least_gap=gaps.min(axis=1),
            changes=changes,
            status=tuple(
                told_sunk(_outcome(own, done), sunk, depth)
                for own, done, sunk, depth in zip(
                    solution.status, settled.tolist(), inside, depths, strict=True
                )
            ),
        )

    def _inside(self, displacement: Array, depth: float) -> float:
        """Greatest depth of a surface point inside the indenter [m]; displacement (N, 3) of the surface nodes."""
        moved = (displacement @ self.indenter.axis)[self._corners] @ self._shares.T
        return float(np.clip(depth - self._gap_at - moved, 0.0, None).max())

    def _lifted(self, loads: Sequence[Load]) -> Array:
        """(S, C) gap integrals under these loads without the indenter; equal loads in a row are solved once."""
        found: list[Array] = []
        for step, load in enumerate(loads):
            if step and load is loads[step - 1]:
                found.append(found[-1])
                continue
            moved = self.problem.fields(load).displacement[0] @ self.indenter.axis
            found.append(self._gap + self._spread.T @ moved)
        return np.array(found)

    def _complementarity(
        self, gap: Array, active: NDArray[np.bool_]
    ) -> tuple[Array, NDArray[np.bool_], int, bool]:
        """Pressures, their active set, its changes and whether it settled."""
        scale = self._area.sum() / np.trace(self.compliance)
        for change in range(_MOST_CHANGES):
            pressure = np.zeros(len(gap))
            if active.any():
                pressure[active] = np.linalg.solve(self.compliance[np.ix_(active, active)], -gap[active])
            opened = np.where(active, 0.0, gap + self.compliance @ pressure)
            following = pressure - scale * opened > 0.0
            if (following == active).all():
                return pressure, active, change, True
            active = following
        return pressure, active, _MOST_CHANGES, False

    def _forces(self, pressures: Array) -> Array:
        """(S, n_nodes, 3) forces of (S, C) pressures."""
        along = np.asarray(self._spread @ pressures.T).T
        return np.asarray(along[:, :, None] * self.indenter.axis)

    @staticmethod
    def _loaded(base: Load, force: Array) -> Load:
        forces = force if base.forces is None else base.forces + force
        return Load(base.facet_pressure, base.prescribed, base.gravity, forces)


def _outcome(own: Status, settled: bool) -> Status:
    if settled or not own.ok:
        return own
    return Status(
        "not-converged",
        f"the contact did not settle in {_MOST_CHANGES} changes of its active set",
        "go deeper in smaller steps, or use a finer mesh under the indenter",
    )


_bad_contact = partial(solver_error, "bad-contact")
