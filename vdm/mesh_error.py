"""How far a form of boundary integrals is from its answer on a finer mesh: by one on half of its nodes.

The coarse answer u_H comes of the integrals of the fine one u_h. The form is of second order: its error falls with
the area of a facet, so with one over the nodes n, and

`|u_h - u| ~ |u_H - u_h| / (n_h / n_H - 1)`

(Richardson 1911; the hierarchical estimator of Bank and Smith 1993, with one level down in place of one up). The
fine form is cut along the rims of what is held (`vdm.boundary.rims`), the coarse one is not: of what a rim adds the
estimate is too large.

With the integrals of the fine form the coarse one does not see what these lack, which is most of the error of the
change of shape where walls are thin. `shape` is by a coarse form with integrals of its own, on facets of its own.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from solver_common.arrays import Array
from vdm.constraints import Load
from vdm.peers.bem import BoundaryFormulation
from vdm.peers.bem_sparse import HalfFormulation, HalvedFormulation, SparseFormulation
from vdm.problem import Problem, Step
from vdm.solution import SolverError
from vdm.solvers.linear import BorderedFactor, LinearSolver
from vdm.surface import SurfaceError, rigid_basis

_Coarse = tuple[LinearSolver, float]


class MeshError:
    """Estimates for the loads of one set-up: the problem of a `BoundaryFormulation`, and its factor at rest."""

    def __init__(self, problem: Problem, factor: BorderedFactor) -> None:
        form = problem.formulation
        assert isinstance(form, BoundaryFormulation)
        self._problem = problem
        self._areas = form.surface.nodal_areas[:, None]
        self._fine = LinearSolver(problem, factor=factor)
        self._halved = self._on(HalvedFormulation, form)

    def of(self, load: Load, linear: Step | None = None) -> float:
        """Error of the displacement [1] over its size, root mean squares by area, in the linear answer to a load.

        `linear` is that answer where it is known. NaN for a mesh that has no coarser one, and where nothing moves.
        """
        fine = (linear or self._fine.step(load)).displacement
        return self._left(self._halved, load, fine)[0]

    def shape(self, load: Load) -> float:
        """The larger error of displacement and of change of shape, by integrals of their own; else as `of`."""
        return max(self._left(self._half, load, self._fine.step(load).displacement))

    @cached_property
    def _half(self) -> _Coarse | None:
        form = self._problem.formulation
        return self._on(HalfFormulation, form.surface, form.parameters, self._problem.support.held)

    def _on(self, make: type[SparseFormulation], *given: Any) -> _Coarse | None:
        """The problem on a coarser form, and by how much it has less nodes, less 1; None where there is none."""
        form = self._problem.formulation
        assert isinstance(form, BoundaryFormulation)
        try:
            coarse = make(*given)
            less = form.n_coarse / coarse.n_coarse - 1.0
            return (LinearSolver(replace(self._problem, formulation=coarse)), less) if less > 0.0 else None
        except (SolverError, SurfaceError, np.linalg.LinAlgError):
            return None  # of a mesh that is hardly more than its supports, or than a small cavity

    def _left(self, coarse: _Coarse | None, load: Load, fine: Array) -> tuple[float, float]:
        """Errors of the displacement, and of what is left of it without its rigid motion."""
        if coarse is None:
            return np.nan, np.nan
        solver, less = coarse
        weights = np.sqrt(self._areas)
        change, moved = ((weights * u).reshape(-1) for u in (solver.step(load).displacement - fine, fine))
        if not moved.any():
            return np.nan, np.nan
        motions = rigid_basis(self._problem.formulation.surface)
        rigid = np.linalg.qr(np.repeat(weights, 3, axis=0) * motions)[0]
        off, size = (np.linalg.norm([u, u - rigid @ (rigid.T @ u)], axis=1) for u in (change, moved))
        displacement, shape = off / size / less
        return float(displacement), float(shape)
