"""A linear model's solution as a multiple of one that is there, where the loads are."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .meshing.mesh import Array
from .scene import Scene

if TYPE_CHECKING:
    from vdm.solution import Solution


@dataclass(frozen=True)
class Solved:
    """One load step that was solved, of a model that is linear in contact and prescribed displacement together.

    Attributes
    ----------
    loads : contact pressure, contact force and prescribed displacement of the step, each flat
    step : its solution, S = 1, with the median time of all steps that were solved with it
    environment_pressure : datum of its fluid pressure [Pa]
    """

    loads: tuple[Array, ...]
    step: Solution
    environment_pressure: float

    @classmethod
    def largest_step(cls, scene: Scene, solution: Solution) -> Solved | None:
        """Of a solved history its largest step; None where it has no load."""
        largest = int(np.abs(scene.load_factors).argmax())
        factor, k = float(scene.load_factors[largest]), slice(largest, largest + 1)
        loads = tuple(factor * part for part in _loads(scene))
        if not any(part.any() for part in loads):
            return None
        step = dataclasses.replace(
            solution,
            displacement=solution.displacement[k],
            fluid_pressure=solution.fluid_pressure[k],
            reaction_force=solution.reaction_force[k],
            energy=solution.energy[k],
            iterations=solution.iterations[k],
            status=solution.status[k],
            seconds_per_step=np.array([np.median(solution.seconds_per_step)]),
            scalars={name: values[k] for name, values in solution.scalars.items()},
        )
        return cls(loads, step, scene.environment_pressure)

    def scaled_to(self, scene: Scene) -> Solution | None:
        """The solution of another scene on the same set-up, None where its loads are no multiple of this one's.

        Residuals and times are those of the step that was solved.
        """
        if scene.condition and "condition_estimate" not in self.step.scalars:
            return None
        from fem_reference.loads import multiple_of  # slow to load, and a plan needs none

        share = multiple_of(self.loads, _loads(scene))
        if share is None:
            return None
        factors = share * scene.load_factors
        whole, one = factors[:, None, None], self.step
        return dataclasses.replace(
            one,
            displacement=whole * one.displacement,
            fluid_pressure=factors * (one.fluid_pressure - self.environment_pressure)
            + self.environment_pressure,
            reaction_force=whole * one.reaction_force,
            energy=factors**2 * one.energy,
            iterations=np.repeat(one.iterations, len(factors)),
            status=one.status * len(factors),
            seconds_per_step=np.repeat(one.seconds_per_step, len(factors)),
            scalars={name: np.repeat(values, len(factors)) for name, values in one.scalars.items()},
        )


def _loads(scene: Scene) -> tuple[Array, ...]:
    return scene.contact_pressure, scene.contact_force.ravel(), scene.prescribed.ravel()
