"""Estimates how far a form of boundary integrals is from its answer on a finer mesh, from a coarser one.

The coarse answer u_H has half of the nodes and the integrals of the fine one u_h. The form is of second order:
its error falls with a facet's area, that is with one over the number of nodes n, and

`|u_h - u| ~ |u_H - u_h| / (n_h / n_H - 1)`

(Richardson 1911; the hierarchical estimator of Bank and Smith 1993, with one level down in place of one up). The
fine form is cut along the rims of held nodes (`vdm.boundary.rims`), the coarse one is not: near a rim the
estimate is too large.

With the integrals of the fine form the coarse one does not see their error. Where walls are thin, that is most of
the error in the change of shape. `shape` therefore uses a coarse form with its own integrals on its own facets.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from solver_common.arrays import Array
from solver_common.solution import NO_MOTION
from vdm.constraints import Load
from vdm.peers.bem import BoundaryFormulation
from vdm.peers.bem_sparse import HalfFormulation, HalvedFormulation, SparseFormulation
from vdm.problem import Problem, Step
from vdm.solution import SolverError
from vdm.solvers.linear import BorderedFactor, LinearSolver
from vdm.surface import SurfaceError, rigid_basis

_Coarse = tuple[LinearSolver, float]


class MeshError:
    """Estimates for all loads of one set-up, from the problem of a `BoundaryFormulation` and its factor at rest."""

    def __init__(self, problem: Problem, factor: BorderedFactor) -> None:
        form = problem.formulation
        assert isinstance(form, BoundaryFormulation)
        self._problem = problem
        self._areas = form.surface.nodal_areas[:, None]
        self._fine = LinearSolver(problem, factor=factor)
        self._halved = self._on(HalvedFormulation, form)

    def of(self, load: Load, linear: Step | None = None, *, shape: bool = False) -> tuple[float, float]:
        """Relative errors of the linear answer to a load, root mean squares by area.

        The first is that of the displacement. The second, where `shape` is set, is the larger one of displacement
        and change of shape, with a coarse form of its own integrals. `linear` is the linear answer, where known.
        NaN where the mesh has no coarser one or nothing moves.
        """
        fine = (linear or self._fine.step(load)).displacement
        own = max(self._left(self._half, load, fine)) if shape else np.nan
        return self._left(self._halved, load, fine)[0], own

    @cached_property
    def _half(self) -> _Coarse | None:
        form = self._problem.formulation
        return self._on(HalfFormulation, form.surface, form.parameters, self._problem.support.held)

    def _on(self, make: type[SparseFormulation], *given: Any) -> _Coarse | None:
        """The problem's solver on a coarser form, which `make` builds from what is `given`, and n_h / n_H - 1.

        None where the mesh is hardly more than its supports, or where no coarse mesh bounds a body: a cavity near
        the surface sticks out of it.
        """
        form = self._problem.formulation
        assert isinstance(form, BoundaryFormulation)
        try:
            solver = LinearSolver(replace(self._problem, formulation=make(*given)))
        except (SolverError, SurfaceError, np.linalg.LinAlgError):
            return None
        coarse = solver.problem.formulation
        assert isinstance(coarse, SparseFormulation)
        less = form.n_coarse / coarse.n_coarse - 1.0
        return (solver, less) if less > 0.0 else None

    @cached_property
    def _rigid(self) -> Array:
        """(3N, 6) orthonormal rigid motions, weighted as displacements are."""
        motions = rigid_basis(self._problem.formulation.surface)
        return np.linalg.qr(np.repeat(np.sqrt(self._areas), 3, axis=0) * motions)[0]

    def _left(self, coarse: _Coarse | None, load: Load, fine: Array) -> tuple[float, float]:
        """Relative errors of the displacement, and of the displacement without its rigid motion."""
        if coarse is None:
            return np.nan, np.nan
        solver, less = coarse
        weights, rigid = np.sqrt(self._areas), self._rigid
        change, moved = ((weights * u).reshape(-1) for u in (solver.step(load).displacement - fine, fine))
        points = self._problem.formulation.surface.points
        if np.abs(fine).max() <= NO_MOTION * np.ptp(points, axis=0).max():
            return np.nan, np.nan
        off, size = (np.linalg.norm([u, u - rigid @ (rigid.T @ u)], axis=1) for u in (change, moved))
        displacement, shape = off / size / less
        return float(displacement), float(shape)
