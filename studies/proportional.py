"""What follows for a multiple of a load: a linear model's solution, and metrics of results that are multiples."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from .meshing.mesh import Array, Mesh
from .metrics import METRICS, History, evaluate_all
from .scene import Scene
from .surface_measures import Surface

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


@dataclass
class Comparisons:
    """The metrics of case after case on one mesh: of a multiple only those are measured that do not follow."""

    mesh: Mesh
    _measured: _Measured | None = None  # the latest case that is a multiple of none

    @cached_property
    def surface(self) -> Surface:
        """The mesh's surface; its measures are those of all cases."""
        return Surface(points=self.mesh.surface_points, triangles=self.mesh.triangles)

    def compare(
        self, surface: Surface, models: Mapping[str, History], reference: str | None
    ) -> dict[str, dict[str, Array]]:
        """`evaluate_all` of models on this surface under a contact."""
        case = _Measured(surface, models, reference)
        known = self._measured.metrics_of(case) if self._measured is not None else {}
        case.metrics = evaluate_all(surface, models, reference, known)
        if not known:
            self._measured = case
        return case.metrics


@dataclass
class _Measured:
    """A case's results, and its metrics."""

    surface: Surface
    models: Mapping[str, History]
    reference: str | None
    metrics: Mapping[str, Mapping[str, Array]] = dataclasses.field(default_factory=dict)

    def metrics_of(self, other: _Measured) -> dict[str, dict[str, Array]]:
        """The metrics of another case that follow, if all its results are these times one number; else none."""
        from fem_reference.loads import multiple_of  # slow to load, and a plan needs none

        if not self._is_like(other):
            return {}
        share = multiple_of([*self._arrays()], [*other._arrays()])
        if share is None or share <= 0:
            return {}
        return {
            model: {
                name: share**degree * values
                for name, values in metrics.items()
                if (degree := METRICS[name].degree) is not None
            }
            for model, metrics in self.metrics.items()
        }

    def _is_like(self, other: _Measured) -> bool:
        return (
            self.reference == other.reference
            and list(self.models) == list(other.models)
            and np.array_equal(self.surface.contact, other.surface.contact)
            and all(
                np.array_equal(model.load_factors, other.models[name].load_factors)
                for name, model in self.models.items()
            )
        )

    def _arrays(self) -> Iterator[Array]:
        """All that the metrics are made of."""
        yield self.surface.contact_force
        for model in self.models.values():
            yield model.displacement
            yield model.reaction_force
