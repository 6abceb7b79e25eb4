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
from ..scene.scene import build_scene
from ..study.schema import Study
from ..verdict.formatting import short_percent

FACTOR = 4.0  # how far from the study's modulus one is looked for, either way
_FOUND = 1e-3  # of the modulus
_STEP = 0.02  # of the modulus, for the slope of the answers
RATIO_STEP = 0.01  # of Poisson's ratio, for the same
_STILL = 1e-6  # of u_D: changes as small are rounding
_ALIKE = 0.95  # cosine of two changes from which on they count as one
_OPEN = 0.2  # of the modulus


class NothingMeasuredError(ValueError):
    """A study without a measurement to fit."""


@dataclass(frozen=True)
class Fit:
    """One model's modulus, from the first load that was measured.

    Attributes
    ----------
    model : its name
    modulus : of least squares over u_D [Pa]; NaN where the model has no answer, or where the range ends
    uncertainty : standard, of the modulus, from u_D alone [Pa]
    trained, held_out : root mean square of E over the fitted quantities and over the others of their unit
    as_given : that over the others with the study's own modulus
    size : root mean square of D over the others; 0 where all are distances
    unit : of these, m or N
    untold : what the fitted values do not tell, in sentences
    """

    model: str
    modulus: float
    uncertainty: float
    trained: float
    held_out: float
    as_given: float
    size: float
    unit: str = "m"
    untold: tuple[str, ...] = ()


def training(found: Measurement) -> Mask:
    """(Q,) the quantities to fit: those of the first table's first load; the others of their unit are held out."""
    first = found.quantities[0]

    def load_of(one: Quantity) -> tuple[object, ...]:
        return one.table, one.step, "" if math.isnan(one.depth) else one.depth

    return np.array([load_of(one) == load_of(first) for one in found.quantities])


def fit_modulus(study: Study, mesh: Mesh, name: str) -> Fit:
    """Fit one model of a study of one case, on the study's own mesh.

    Raises
    ------
    NothingMeasuredError
        nothing was measured.
    """

    def answer(modulus: float, ratio: float = study.tissue.poisson_ratio) -> Measurement:
        tissue = study.tissue.model_copy(update={"youngs_modulus": modulus, "poisson_ratio": ratio})
        scene = build_scene(study.model_copy(update={"tissue": tissue}), mesh)
        linear = models.superposes(name) and scene.indenter is None
        result = Answer.of(models.run_model(scene, name), linear=linear)
        found = hold_against(study, mesh, {}, {}, {name: result})
        if found is None:
            raise NothingMeasuredError("the study has no [[measured]] table of its case")
        return found

    def softer(modulus: float) -> Measurement:
        return answer(modulus, study.tissue.poisson_ratio - RATIO_STEP)

    return fit(answer, study.tissue.youngs_modulus, name, softer)


def fit(
    answer: Callable[[float], Measurement],
    given: float,
    name: str,
    other_ratio: Callable[[float], Measurement] | None = None,
) -> Fit:
    """The same of a model that answers to a modulus [Pa]; `other_ratio`: its answers at a lower Poisson ratio."""
    start = answer(given)
    mine = training(start)
    unit = start.quantities[0].unit
    rest = np.array([one.unit == unit for one in start.quantities]) & ~mine
    tried = rest if rest.any() else mine
    weights = 1.0 / np.maximum([one.uncertainty for one in start.quantities], 1e-9)[mine]

    def lack(log: float) -> float:
        errors = answer(given * math.exp(log)).error(name)[mine] * weights
        return float(errors @ errors) if np.isfinite(errors).all() else 1e30

    lost = Fit(name, *(math.nan,) * 5, _rms(start.values[rest]), unit)
    if not np.isfinite(start.error(name)[mine]).all():
        return lost
    moved = (answer(given * (1 + _STEP)).error(name) - start.error(name))[mine] * weights
    if float(np.linalg.norm(moved)) <= _STILL:
        told = (
            "no fitted value changes with the modulus: a prescribed movement does not tell it, a force does"
        )
        return dataclasses.replace(lost, as_given=_rms(start.error(name)[tried]), untold=(told,))
    reach = math.log(FACTOR)
    log = float(minimize_scalar(lack, bounds=(-reach, reach), method="bounded", options={"xatol": _FOUND}).x)
    if abs(log) > reach - 2 * _FOUND:
        return dataclasses.replace(lost, as_given=_rms(start.error(name)[tried]))
    modulus = given * math.exp(log)
    best, beside = (answer(modulus * (1 + step)).simulated[name] for step in (0.0, _STEP))
    slope = (beside - best)[mine] * weights / _STEP
    errors = best - start.values
    uncertainty = modulus / float(np.linalg.norm(slope))
    untold = (
        [f"u_D alone leaves it open by {short_percent(uncertainty / modulus)}"]
        if uncertainty > _OPEN * modulus
        else []
    )
    if other_ratio is not None:
        beside = (other_ratio(modulus).simulated[name] - best)[mine] * weights
        untold += _of_ratio(beside, slope)
    return Fit(
        name,
        modulus,
        uncertainty,
        _rms(errors[mine]),
        _rms(errors[rest]),
        _rms(start.error(name)[tried]),
        _rms(start.values[rest]),
        unit,
        tuple(untold),
    )


def _of_ratio(change: Array, slope: Array) -> list[str]:
    """What the fitted values do not tell of Poisson's ratio.

    Parameters
    ----------
    change : of the values over u_D, of a ratio lower by RATIO_STEP
    slope : by the logarithm of the modulus
    """
    size = float(np.linalg.norm(change))
    if not math.isfinite(size):
        return []
    if size <= _STILL:
        return ["no fitted value changes with Poisson's ratio, which stays as given"]
    alike = abs(float(change @ slope)) / (size * float(np.linalg.norm(slope)))
    if alike < _ALIKE:
        return []
    shift = float(change @ slope) / float(slope @ slope)
    return [
        f"Poisson's ratio cannot be told from it: one lower by {RATIO_STEP:g} acts as a modulus that is "
        f"{short_percent(abs(shift))} {'higher' if shift > 0 else 'lower'}"
    ]


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean())) if len(values) else math.nan
