"""A model set up and asked: what it answers, measured."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from solver_common.solution import Status

from ..body.surface_measures import enclosed_volumes
from ..machine.memory import peak_bytes_since, reset_peak
from ..scene.result import REFUSED, ModelResult
from ..scene.scene import Scene, SurfaceLoad
from ..study.registry import lacks
from .model import Model, SetUp, find

if TYPE_CHECKING:
    from .model import Solution


class Prepared:
    """A model set up on the body of a scene, with what its set-up took; it answers load steps as results.

    A model that cannot be set up answers with NaN and the reason in its status: other models are not affected.
    """

    def __init__(self, scene: Scene, name: str, n_loads: int = 1, *, onward: bool = False) -> None:
        self.model, solver = find(name)
        self._scene = scene = _as_declared(scene, self.model, name)
        self._resident = reset_peak()
        self.set_up: SetUp | None = None
        prepare = (self.model.continues if onward else None) or self.model.prepare
        try:
            if scene.anisotropy is not None and not self.model.fibres:
                raise ValueError(f"{self.model.name} is isotropic; use another model for fibres")
            if lacking := lacks(name, scene.extras):
                raise ValueError(lacking[0])
            self.set_up = prepare(scene, solver, name, n_loads)
        except (
            ValueError
        ) as error:  # the sentence of a surface, parameter, support or solver that does not work
            self._refusal = _refusal(error)

    def of_modulus(self, scene: Scene, name: str) -> Prepared:
        """The same for a scene that differs in Young's modulus alone, on the same factor."""
        other = copy.copy(self)
        other._scene = _as_declared(scene, self.model, name)
        if self.set_up is not None:
            assert self.set_up.of_modulus is not None  # the model declares it
            other.set_up = self.set_up.of_modulus(scene.tissue.youngs_modulus)
        return other

    def answer(self, loads: Sequence[SurfaceLoad]) -> ModelResult:
        """The result of some load steps: one load path, or independent of each other where the model superposes."""
        if self.set_up is None:
            return _failed(self._scene, self.model, self._refusal, len(loads))
        try:
            solution = self.set_up.solve(loads)
        except ValueError as error:
            return _failed(self._scene, self.model, _refusal(error), len(loads))
        return _result(self._scene, solution, peak_bytes_since(self._resident), self.model)


def run_model(scene: Scene, name: str) -> ModelResult:
    """Solve one scene with one model and measure what it took."""
    return Prepared(scene, name, len(scene.load_factors)).answer(scene.loads)


def _as_declared(scene: Scene, model: Model, name: str) -> Scene:
    """The scene with what the model declares to read, and nothing else: its answers are shared by that."""
    given = {**scene.parameters, **scene.overrides.get(name, {})}
    if name in scene.homogeneous:
        scene = dataclasses.replace(scene, inclusions=(), extras=scene.extras - {"inclusions"})
    return dataclasses.replace(
        scene,
        parameters={key: value for key, value in given.items() if key in model.parameters},
        overrides={},
        environment_pressure=0.0 if model.volumetric else scene.environment_pressure,
    )


def _refusal(error: ValueError) -> Status:
    status = getattr(error, "status", None)
    message, remedy = (status.message, status.remedy) if status else (f"{error}", "")
    return Status(REFUSED, message, remedy)


def _result(scene: Scene, solution: Solution, peak_bytes: int, model: Model) -> ModelResult:
    usable = np.array([status.ok for status in solution.status])
    displacement = np.where(usable[:, None, None], solution.displacement, np.nan)
    points, triangles = scene.mesh.surface_points, scene.mesh.triangles
    return ModelResult(
        displacement=displacement,
        fluid_pressure=np.where(usable, solution.fluid_pressure, np.nan),
        reaction_force=np.where(usable[:, None, None], solution.reaction_force, np.nan),
        energy=np.where(usable, solution.energy, np.nan),
        volume=enclosed_volumes(points + displacement, triangles),
        iterations=solution.iterations,
        status=solution.status,
        seconds_setup=solution.seconds_setup,
        seconds_per_step=solution.seconds_per_step,
        peak_bytes=peak_bytes,
        version=model.version,
        parameters=solution.parameters,
        scalars=solution.scalars,
    )


def _failed(scene: Scene, model: Model, reason: Status, n_steps: int) -> ModelResult:
    vectors = np.full((n_steps, len(scene.fixed), 3), np.nan)
    numbers = np.full(n_steps, np.nan)
    return ModelResult(
        displacement=vectors,
        fluid_pressure=numbers,
        reaction_force=vectors,
        energy=numbers,
        volume=numbers,
        iterations=np.zeros(n_steps, dtype=np.int64),
        status=(reason,) * n_steps,
        seconds_setup=np.nan,
        seconds_per_step=numbers,
        peak_bytes=0,
        version=model.version,
    )
