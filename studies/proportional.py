"""What follows for a multiple of a load: a linear model's solution, and metrics of results that are multiples."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from .case import ModelResult
from .meshing.mesh import Array, Mesh
from .metrics import METRICS, History, evaluate_all
from .scene import Scene
from .surface_measures import Surface, enclosed_volumes

if TYPE_CHECKING:
    from vdm.solution import Solution


Result = TypeVar("Result", "Solution", ModelResult)
_PER_STEP = ("displacement", "fluid_pressure", "reaction_force", "energy", "iterations")


def largest_step(result: Result, load_factors: Array) -> tuple[float, Result]:
    """The largest of S load factors and the result of that step, S = 1, with the median time of all steps."""
    largest = int(np.abs(load_factors).argmax())
    k = slice(largest, largest + 1)
    step = dataclasses.replace(
        result,
        **{name: getattr(result, name)[k] for name in _PER_STEP},
        status=result.status[k],
        seconds_per_step=np.array([np.median(result.seconds_per_step)]),
        scalars={name: values[k] for name, values in result.scalars.items()},
    )
    return float(load_factors[largest]), step


def times(factors: Array, one: Result, environment_pressure: float = 0.0) -> Result:
    """What one step, S = 1, is under (S,) times its loads. Residuals and times are those of the step."""
    whole = factors[:, None, None]
    return dataclasses.replace(
        one,
        displacement=whole * one.displacement,
        fluid_pressure=factors * (one.fluid_pressure - environment_pressure) + environment_pressure,
        reaction_force=whole * one.reaction_force,
        energy=factors**2 * one.energy,
        iterations=np.repeat(one.iterations, len(factors)),
        status=one.status * len(factors),
        seconds_per_step=np.repeat(one.seconds_per_step, len(factors)),
        scalars={name: np.repeat(values, len(factors)) for name, values in one.scalars.items()},
    )


@dataclass(frozen=True)
class Solved:
    """One load step that was solved, of a model that is linear in contact and prescribed displacement together.

    Attributes
    ----------
    loads : contact pressure, contact force and prescribed displacement of the step, each flat
    step : its solution, S = 1
    environment_pressure : datum of its fluid pressure [Pa]
    """

    loads: tuple[Array, ...]
    step: Solution
    environment_pressure: float

    @classmethod
    def largest_step(cls, scene: Scene, solution: Solution) -> Solved:
        """Of a solved history its largest step."""
        factor, step = largest_step(solution, scene.load_factors)
        loads = tuple(factor * part for part in _loads(scene))
        return cls(loads, step, scene.environment_pressure)

    def scaled_to(self, scene: Scene) -> Solution | None:
        """The solution of another scene on the same set-up, None where its loads are no multiple of this one's."""
        if scene.condition and "condition_estimate" not in self.step.scalars:
            return None
        share = _share(self.loads, _loads(scene))
        if share is None:
            return None
        return times(share * scene.load_factors, self.step, self.environment_pressure)


def _loads(scene: Scene) -> tuple[Array, ...]:
    return scene.contact_pressure, scene.contact_force.ravel(), scene.prescribed.ravel()


def _share(loads: Sequence[Array], others: Sequence[Array]) -> float | None:
    """How many times the loads the others are; None if they are no multiple, or one whose energy is no number."""
    from fem_reference.loads import multiple_of  # slow to load, and a plan needs none

    share = multiple_of(loads, others)
    return None if share is None or (share and not 1e-50 < abs(share) < 1e50) else share


@dataclass(frozen=True)
class Answer:
    """What a model answers on its mesh levels, coarse first, and to which loads.

    Attributes
    ----------
    levels : a result of S steps each
    loads : load of size 1 -> how much of it acts at load factor 1 (`studies.keys.loads_of`)
    load_factors : (S,)
    """

    levels: Sequence[ModelResult]
    loads: Mapping[str, float]
    load_factors: Array

    def under(self, loads: Mapping[str, float], scene: Scene) -> list[ModelResult] | None:
        """The levels of a scene with other loads of the same key; None where they are no multiple of these."""
        if loads == self.loads and np.array_equal(scene.load_factors, self.load_factors):
            return list(self.levels)
        share = None
        if loads.keys() == self.loads.keys() and self.load_factors.any():
            share = _share(*([np.array([part[unit]]) for unit in self.loads] for part in (self.loads, loads)))
        return None if share is None else [self._multiple(level, share, scene) for level in self.levels]

    def _multiple(self, level: ModelResult, share: float, scene: Scene) -> ModelResult:
        factor, step = largest_step(level, self.load_factors)
        result = times(share / factor * scene.load_factors, step)
        return dataclasses.replace(
            result,
            volume=enclosed_volumes(scene.mesh.surface_points + result.displacement, scene.mesh.triangles),
            parameters={**result.parameters, "setup_shared": "yes", "steps_scaled": "yes"},
        )


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
        if not self._is_like(other):
            return {}
        share = _share([*self._arrays()], [*other._arrays()])
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
            and self.surface.weighs == other.surface.weighs
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
