"""Young's modulus fitted to a measurement, and tried on the loads that were not fitted."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from solver_common.arrays import Array, Mask

from .. import models
from ..body.mesh import Mesh
from ..measures.measurement import Measurement, Quantity, hold_against
from ..measures.pushed import Answer
from ..scene.result import ModelResult
from ..scene.scene import build_scene
from ..study.schema import Study

FACTOR = 4.0  # how far from the study's modulus one is looked for, either way
_FOUND = 1e-3  # of the modulus
_STEP = 0.02  # of the modulus, for the slope of the answers


class NothingMeasuredError(ValueError):
    """A study without a measurement to fit, or to try the fit on."""


@dataclass(frozen=True)
class Fit:
    """One model's modulus, from the first load that was measured.

    Attributes
    ----------
    model : its name
    modulus : of least squares over u_D [Pa]; NaN where the model has no answer, or where the range ends
    uncertainty : standard, of the modulus, from u_D alone [Pa]
    trained, held_out : root mean square of E over the fitted quantities and over the others [m]
    as_given : that over the others with the study's own modulus [m]
    size : root mean square of D over the others [m]; 0 where all are distances
    """

    model: str
    modulus: float
    uncertainty: float
    trained: float
    held_out: float
    as_given: float
    size: float


def training(found: Measurement) -> Mask:
    """(Q,) the quantities to fit: those of the first table's first load; the others are held out.

    Raises
    ------
    NothingMeasuredError
        nothing is left to try the fit on.
    """
    first = found.quantities[0]

    def load_of(one: Quantity) -> tuple[object, ...]:
        return one.table, one.step, "" if math.isnan(one.depth) else one.depth

    mine = [load_of(one) == load_of(first) for one in found.quantities]
    if all(mine):
        raise NothingMeasuredError(
            "one load of one table was measured, so that a fit could be tried on nothing; measure another load"
        )
    return np.array(mine)


def fit_modulus(study: Study, mesh: Mesh, name: str) -> Fit:
    """Fit one model of a study of one case, on the study's own mesh.

    Raises
    ------
    NothingMeasuredError
        nothing was measured, or nothing would be held out.
    """

    def answer(modulus: float) -> Measurement:
        tissue = study.tissue.model_copy(update={"youngs_modulus": modulus})
        scene = build_scene(study.model_copy(update={"tissue": tissue}), mesh)
        found = hold_against(study, mesh, {}, {}, {name: _answer(models.run_model(scene, name), name)})
        if found is None:
            raise NothingMeasuredError("the study has no [[measured]] table of its case")
        return found

    return fit(answer, study.tissue.youngs_modulus, name)


def _answer(result: ModelResult, name: str) -> Answer:
    return Answer(result.displacement, result.reaction_force, models.superposes(name))


def fit(answer: Callable[[float], Measurement], given: float, name: str) -> Fit:
    """The same of a model that answers to a modulus [Pa]."""
    start = answer(given)
    mine = training(start)
    weights = 1.0 / np.maximum([one.uncertainty for one in start.quantities], 1e-9)[mine]

    def lack(log: float) -> float:
        errors = answer(given * math.exp(log)).error(name)[mine] * weights
        return float(errors @ errors) if np.isfinite(errors).all() else 1e30

    lost = Fit(name, *(math.nan,) * 5, _rms(start.values[~mine]))
    if not np.isfinite(start.error(name)).all():
        return lost
    reach = math.log(FACTOR)
    log = float(minimize_scalar(lack, bounds=(-reach, reach), method="bounded", options={"xatol": _FOUND}).x)
    if abs(log) > reach - 2 * _FOUND:
        return dataclasses.replace(lost, as_given=_rms(start.error(name)[~mine]))
    modulus = given * math.exp(log)
    best, beside = (answer(modulus * (1 + step)).simulated[name] for step in (0.0, _STEP))
    slope = (beside - best)[mine] * weights / _STEP
    errors = best - start.values
    return Fit(
        name,
        modulus,
        modulus / float(np.linalg.norm(slope)),
        _rms(errors[mine]),
        _rms(errors[~mine]),
        _rms(start.error(name)[~mine]),
        _rms(start.values[~mine]),
    )


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))
