"""Models: registration, set-up, solving, and checks of their answers.

A model may come from another package. An error in it costs its own answer alone, and the message has its name.
"""

from __future__ import annotations

import dataclasses
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from solver_common.solution import Solution, Status

from ..body.surface_measures import enclosed_volumes
from ..machine import peak_bytes_since, reset_peak
from ..scene.result import REFUSED, STEPS, ModelResult, answered, unanswered
from ..scene.scene import Scene, SurfaceLoad
from ..study.errors import InputError, listed
from ..study.registry import MODELS, Model, find, lacks, own_parameters, reads
from ..study.schema import Tissue, VdmTable
from ..study.units import DIMENSIONS

if TYPE_CHECKING:
    from fem_reference.condensed import CondensedProblem
    from fem_reference.linear import LinearProblem
    from vdm.solvers.linear import LinearSolver

    PressureProblem = LinearSolver | LinearProblem | CondensedProblem


BROKEN = "broken-model"  # status of a model that raised no ValueError, or whose answer has a wrong form


@dataclass(frozen=True)
class SetUp:
    """A model that is ready to solve on one body: its operators and factors.

    Attributes
    ----------
    solve : load steps -> Solution. The steps are independent if the model superposes, else one load path
    problem : the linear problem whose columns answer contact pressures; None if there is none
    """

    solve: Callable[[Sequence[SurfaceLoad]], Solution]
    problem: PressureProblem | None = None


def register(model: Model) -> None:
    """Register a model.

    Raises
    ------
    InputError
        the name is taken, the declaration contradicts itself or another model's, or it names unknown keys.
    """
    if model.name in MODELS:
        raise InputError(f"a model {model.name!r} is registered already")
    if not model.version or not model.solvers:
        raise InputError(f"{model.name}: a model declares its version and its solvers")
    if unknown := {*model.tissue} - Tissue.model_fields.keys():  # else different cases would share one answer
        raise InputError(f"{model.name} reads keys of [tissue] that there are none of: {listed(unknown)}")
    for key, parameter in model.own.items():
        if key in VdmTable.model_fields or own_parameters().get(key, parameter) != parameter:
            raise InputError(f"{model.name}: {key} is declared already, as something else")
        if parameter.unit not in DIMENSIONS:
            raise InputError(f"{model.name}: {key} has none of the units {', '.join(DIMENSIONS)}")
    MODELS[model.name] = model


class Prepared:
    """A model, set up on the body of a scene, that answers load steps.

    If the set-up fails, the answers are NaN and their status has the reason. Other models are not affected.

    Parameters
    ----------
    scene : body, supports, tissue and loads
    name : of the model, with its solver: `fem-linear:plain`
    n_loads : how many loads the set-up should expect
    onward : take the set-up that continues from earlier answers, if the model has one
    """

    def __init__(self, scene: Scene, name: str, n_loads: int = 1, *, onward: bool = False) -> None:
        self.model, solver = find(name)
        self._scene = scene = _as_declared(scene, self.model, name)
        self._resident = reset_peak()
        self.set_up: SetUp | None = None
        prepare = (self.model.continues if onward else None) or self.model.prepare
        try:
            if lacking := lacks(name, scene.extras):
                raise ValueError(lacking[0])
            self.set_up = prepare(scene, solver, name, n_loads)
        except (Exception, SystemExit) as error:  # noqa: BLE001  a model of another package
            self._refusal = _refusal(error, name)

    def answer(self, loads: Sequence[SurfaceLoad], *, ends: bool = False) -> ModelResult:
        """The result of some load steps: independent steps if the model superposes, else one load path.

        A failed step holds NaN. With `ends` it holds the last equilibrium before the failure, if the model keeps
        it.
        """
        model, n_nodes = self.model, len(self._scene.fixed)
        if self.set_up is None:
            return unanswered([self._refusal] * len(loads), n_nodes, model.version)
        try:
            solution = self.set_up.solve(loads)
            _check(solution, model.name, len(loads), n_nodes)
        except (Exception, SystemExit) as error:  # noqa: BLE001
            return unanswered([_refusal(error, model.name)] * len(loads), n_nodes, model.version)
        result = _result(self._scene, solution, peak_bytes_since(self._resident), model)
        return result if ends else answered(result)


def run_model(scene: Scene, name: str) -> ModelResult:
    """Set up and solve one scene with one model; the result has its times and memory."""
    return Prepared(scene, name, len(scene.load_factors)).answer(scene.loads)


def _as_declared(scene: Scene, model: Model, name: str) -> Scene:
    """The scene with the parameters that the model declares, and no others: cases share answers by these."""
    given = {**scene.parameters, **scene.overrides.get(name, {})}
    if name in scene.homogeneous:
        scene = dataclasses.replace(scene, inclusions=(), extras=scene.extras - {"inclusions"})
    return dataclasses.replace(
        scene,
        parameters={key: value for key, value in given.items() if key in reads(name)},
        overrides={},
        environment_pressure=0.0 if model.volumetric else scene.environment_pressure,
    )


def _refusal(error: BaseException, name: str) -> Status:
    """The status of an error: a ValueError has a sentence for the user, any other is a mistake in the model."""
    if isinstance(error, MemoryError):
        raise error
    if isinstance(error, ValueError) and "read-only" not in str(error):
        status = getattr(error, "status", None)
        message, remedy = (status.message, status.remedy) if status else (f"{error}", "")
        return Status(REFUSED, message, remedy)
    traceback.print_exception(error)  # into the log
    last = traceback.extract_tb(error.__traceback__)[-1]
    where = f"{Path(last.filename).name}:{last.lineno}"
    if isinstance(error, ValueError):
        remedy = "let the model copy what it changes: all models share the scene"
    else:
        remedy = f"mend {name} and raise its version, or leave it out"
    return Status(BROKEN, f"{name} raised {type(error).__name__}: {error} ({where})", remedy)


def _check(solution: Solution, name: str, n_steps: int, n_nodes: int) -> None:
    """Raises TypeError if an answer has not the shapes and types of `Solution`."""
    steps, vectors = (n_steps,), (n_steps, n_nodes, 3)
    numbers = ("fluid_pressure", "energy", "iterations", "seconds_per_step")
    found = {part: getattr(solution, part, None) for part in ("displacement", "reaction_force", *numbers)}
    found |= {f"scalars {part!r}": values for part, values in getattr(solution, "scalars", {}).items()}
    for part, values in found.items():
        wanted = vectors if part in ("displacement", "reaction_force") else steps
        if np.shape(values) != wanted:  # type: ignore[arg-type]
            raise TypeError(f"the answer of {name} has {part} of shape {np.shape(values)}, not {wanted}")  # type: ignore[arg-type]
        if np.asarray(values).dtype.kind not in "fiub":
            raise TypeError(f"the answer of {name} has {part} that are no real numbers")
    status = getattr(solution, "status", ())
    if len(status) != n_steps or not all(isinstance(one, Status) for one in status):
        raise TypeError(f"the answer of {name} has not one Status for each of {n_steps} load steps")


def _believed(solution: Solution, name: str) -> tuple[Status, ...]:
    """Each step's status; a step that is called converged but has numbers that are not finite becomes BROKEN."""
    finite = np.isfinite(solution.displacement).all(axis=(1, 2)) & np.isfinite(solution.energy)
    finite &= np.isfinite(solution.reaction_force).all(axis=(1, 2)) & np.isfinite(solution.fluid_pressure)
    lie = Status(BROKEN, f"{name} calls a step converged whose numbers are not finite", "take smaller loads")
    return tuple(
        lie if status.ok and not sound else status
        for status, sound in zip(solution.status, finite.tolist(), strict=True)
    )


def _result(scene: Scene, solution: Solution, peak_bytes: int, model: Model) -> ModelResult:
    """The checked solution as a result; a failed step holds the last equilibrium before the failure, or NaN."""
    states = _believed(solution, model.name)
    given: dict[str, Any] = {part.name: getattr(solution, part.name) for part in dataclasses.fields(Solution)}
    given |= {name: np.asarray(given[name]) for name in STEPS if name in given} | {"status": states}
    none = np.zeros(len(states))
    result = ModelResult(**given, volume=none, peak_bytes=peak_bytes, version=model.version)
    result = answered(result, kept=np.nan_to_num(solution.scalars.get("load_factor", none)) > 0.0)
    points = scene.mesh.surface_points + result.displacement
    return dataclasses.replace(result, volume=enclosed_volumes(points, scene.mesh.triangles))
