"""How far a form of boundary integrals is from its answer on a finer mesh: by one on half of its nodes.

The coarse answer u_H comes of the integrals of the fine one u_h. The form is of second order: its error falls with
the area of a facet, so with one over the nodes n, and

`|u_h - u| ~ |u_H - u_h| / (n_h / n_H - 1)`

(Richardson 1911; the hierarchical estimator of Bank and Smith 1993, with one level down in place of one up). The
fine form is cut along the rims of what is held (`vdm.boundary.rims`), the coarse one is not: of what a rim adds the
estimate is too large.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vdm.constraints import Load
from vdm.peers.bem import BoundaryFormulation
from vdm.peers.bem_sparse import HalvedFormulation
from vdm.problem import Problem, Step
from vdm.solution import SolverError
from vdm.solvers.linear import BorderedFactor, LinearSolver


class MeshError:
    """Estimates for the loads of one set-up: the problem of a `BoundaryFormulation`, and its factor at rest."""

    def __init__(self, problem: Problem, factor: BorderedFactor) -> None:
        form = problem.formulation
        assert isinstance(form, BoundaryFormulation)
        self._areas = form.surface.nodal_areas[:, None]
        self._fine = LinearSolver(problem, factor=factor)
        self._coarse: LinearSolver | None = None
        try:
            coarse = HalvedFormulation(form)
            self._ratio = form.n_coarse / coarse.n_coarse
            if self._ratio > 1.0:
                self._coarse = LinearSolver(replace(problem, formulation=coarse))
        except (SolverError, np.linalg.LinAlgError):  # of a mesh that is hardly more than its supports
            pass

    def of(self, load: Load, linear: Step | None = None) -> float:
        """Error of the displacement [1] over its size, root mean squares by area, in the linear answer to a load.

        `linear` is that answer where it is known. NaN for a mesh that has no coarser one, and where nothing moves.
        """
        if self._coarse is None:
            return np.nan
        fine = (linear or self._fine.step(load)).displacement
        change = self._coarse.step(load).displacement - fine
        size = float((self._areas * fine**2).sum())
        return (
            float(np.sqrt((self._areas * change**2).sum() / size) / (self._ratio - 1.0)) if size else np.nan
        )
