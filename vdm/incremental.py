"""The paper's time step as an increment: each load step moves the nodes, and the next starts from there.

Figures 6 to 8 solve K dL = R once a step. Here geometry, normals, areas and operator are those of the surface
after the last step, and R is the change of the load. Earlier strain is forgotten.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from solver_common.arrays import Array
from vdm.constraints import ConstraintError, Load
from vdm.material import Parameters
from vdm.model import Model
from vdm.solution import Solution, SolverError, Status
from vdm.surface import SurfaceError, SurfaceMesh


class IncrementalModel:
    """A model whose every load step is a linear increment on the surface after the last step.

    A single load step gives the answer of `Model` with its linear solver. An answer depends on the path to its
    load.

    Parameters
    ----------
    points, triangles, parameters, formulation, options : as in `vdm.Model`, without gravity; moduli keep
        their values at rest

    Raises
    ------
    ValueError
        as `vdm.Model`; gravity, whose pressure is no increment.
    """

    def __init__(
        self,
        points: ArrayLike,
        triangles: ArrayLike,
        parameters: Parameters | Callable[[SurfaceMesh], Parameters],
        *,
        formulation: str = "paper",
        **options: Any,
    ) -> None:
        if np.any(options.get("gravity", 0.0)):
            raise ConstraintError(
                "the incremental solver takes no weight; leave gravity out, or use nonlinear"
            )
        self.options = {**options, "formulation": formulation}
        self.at_rest = Model(points, triangles, parameters, **self.options)
        self.surface = self.at_rest.surface
        self.parameters = self.at_rest.formulation.parameters
        self.seconds_setup = self.at_rest.seconds_setup

    def solve(self, loads: Sequence[Load], condition: bool = False) -> Solution:
        """One increment per load.

        `reaction_force` and `fluid_pressure` are sums over the increments; `energy` is the work done along the
        path. A surface that folds ends the history.
        """
        n_nodes = self.surface.n_nodes
        displacement, force, reaction = (np.zeros((len(loads) + 1, n_nodes, 3)) for _ in range(3))
        environment = float(self.options.get("environment_pressure", 0.0))
        pressure, energy = np.full(len(loads) + 1, environment), np.zeros(len(loads) + 1)
        residual, seconds = (np.full(len(loads), np.nan) for _ in range(2))
        status: list[Status] = []
        last = Load(np.zeros(n_nodes), prescribed=np.zeros((n_nodes, 3)))
        for k, load in enumerate(loads):
            start = time.perf_counter()
            try:
                model = self.at_rest if k == 0 else self._at(displacement[k])
                step = model.solve([_increment(load, last)], condition=False)
            except (SurfaceError, SolverError) as error:
                told = f"the surface that step {k} left cannot be solved on: {error}"
                failed = Status("diverged", told, "take a smaller load, or the nonlinear solver")
                status += [failed] * (len(loads) - k)
                for values in (displacement, reaction, pressure, energy):
                    values[k + 1 :] = np.nan
                break
            moved = step.displacement[0]
            displacement[k + 1] = displacement[k] + moved
            reaction[k + 1] = reaction[k] + step.reaction_force[0]
            thrust = load.contact_pressure * model.surface.nodal_areas
            force[k + 1] = reaction[k + 1] - thrust[:, None] * model.surface.normals
            pressure[k + 1] = pressure[k] + step.fluid_pressure[0] - environment
            energy[k + 1] = energy[k] + 0.5 * float(np.vdot(force[k] + force[k + 1], moved))
            residual[k] = step.scalars["relative_residual"][0]
            status.append(step.status[0])
            seconds[k] = time.perf_counter() - start
            last = load
        return Solution(
            displacement=displacement[1:],
            fluid_pressure=pressure[1:],
            reaction_force=reaction[1:],
            energy=energy[1:],
            iterations=np.zeros(len(loads), dtype=np.int64),
            status=tuple(status),
            seconds_setup=self.seconds_setup,
            seconds_per_step=seconds,
            parameters=self.at_rest.formulation.record() | {"solver": "incremental"},
            scalars={"relative_residual": residual}
            | (self.at_rest.condition_scalars(len(loads)) if condition else {}),
        )

    def _at(self, displacement: Array) -> Model:
        moved = self.surface.points + displacement
        return Model(moved, self.surface.triangles, self.parameters, **self.options)


def _increment(load: Load, last: Load) -> Load:
    """The change of the load since the last one; the contact follows the surface as a pressure."""
    if load.dead_force is not None:
        raise ConstraintError("the incremental solver takes no force along a line; use nonlinear")
    prescribed = None
    if load.prescribed is not None and last.prescribed is not None:
        prescribed = load.prescribed - last.prescribed
    return Load(load.contact_pressure - last.contact_pressure, prescribed=prescribed)
