"""Ladders: one parameter of a study raised alone, and for each solver where on it the numbers stop being right."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np

from solver_common.arrays import Array

from ..measures.case import CaseResult
from ..measures.frame import series
from ..scene.result import ModelResult
from ..study.registry import is_linear, split
from .digest import Digest, failed_steps
from .formatting import short_percent, swept_value

RESIDUAL = 1e-6  # relative; more is no solution of the system
SINGLE_RESIDUAL = 1e-3  # the same where 32 bits were asked for: they leave 1e-4 at 10,000 nodes
DIFFERENT = 1e-3  # of the largest displacement; more is another answer than the trusted solver's
BEYOND_LINEAR = 0.05  # of the volume, which linear terms keep and the displacement that they give does not
LEFT = 1e-3  # of the largest displacement, left after all loads are taken away


@dataclass(frozen=True)
class Reading:
    """What one model made of one case, over all its load history.

    Attributes
    ----------
    code : "converged", the status of the first step that failed, "wrong": called converged and is not right, or
        "step-too-long": the quasi-linear solver's volume is that of the last step by its definition (33), an error
        of second order in the step that no status of one step can tell; or "beyond-linear": a linear answer, right
        as such, at a load that its assumptions do not reach
    message : what happened
    """

    code: str
    message: str = ""

    @property
    def ok(self) -> bool:
        """Whether every step is right as far as can be told."""
        return self.code == "converged"

    @property
    def silent(self) -> bool:
        """Whether the model calls a step converged that is not right."""
        return self.code == "wrong"


@dataclass(frozen=True)
class Ladder:
    """One parameter alone: its values in ascending order and what each model made of them."""

    key: str
    unit: str
    values: tuple[float, ...]
    base: float | None  # the study's own value, None where it has none
    readings: dict[str, tuple[Reading | None, ...]]  # model -> one per value; None: not run

    def text(self, value: float) -> str:
        """A value with its unit, in as many digits as tell it from the others."""
        texts = Counter(swept_value(other, self.unit) for other in self.values)
        short = swept_value(value, self.unit)
        return short if texts[short] <= 1 or self.unit != "1" else f"{value:.12g}"

    def sound_range(self, model: str) -> tuple[int, int] | None:
        """First and last place of the values at which a model is right: around the base, else the longest run."""
        runs: list[tuple[int, int]] = []
        for place, reading in enumerate(self.readings[model]):
            if reading is None or not reading.ok:
                continue
            if runs and runs[-1][1] == place - 1:
                runs[-1] = (runs[-1][0], place)
            else:
                runs.append((place, place))
        at_base = [run for run in runs if self.base in self.values[run[0] : run[1] + 1]]
        return max(at_base or runs, key=lambda run: run[1] - run[0], default=None)

    def breakdowns(self, model: str) -> list[tuple[float, Reading]]:
        """The values next to the sound range at which a model is not right, at most one on each side."""
        readings = self.readings[model]
        sound = self.sound_range(model)
        places = (sound[0] - 1, sound[1] + 1) if sound else (0,)
        found = [(place, readings[place]) for place in places if 0 <= place < len(readings)]
        return [(self.values[place], reading) for place, reading in found if reading is not None]


def ladders(digest: Digest) -> list[Ladder]:
    """Every swept number of which cases differ in that alone, in the order in which the cases name them."""
    keys = list(dict.fromkeys(key for case in digest.cases for key in case.swept))
    base = {key: Counter(case.swept.get(key) for case in digest.cases).most_common(1)[0][0] for key in keys}
    found = []
    for key in keys:
        on_it: dict[float, CaseResult] = {}
        for case in digest.cases:
            value = case.swept.get(key)
            alone = all(case.swept.get(other) == base[other] for other in keys if other != key)
            if alone and isinstance(value, int | float):
                on_it[float(value)] = case
        if len(on_it) > 1:
            found.append(
                _ladder(digest, key, dict(sorted(on_it.items())), base[key] if len(keys) > 1 else None)
            )
    return found


def _ladder(digest: Digest, key: str, cases: dict[float, CaseResult], base: float | str | None) -> Ladder:
    own = key.removeprefix("models.").rpartition(".")[0] if key.startswith("models.") else None
    models = [name for name in digest.models if own in (None, name)]
    return Ladder(
        key=key,
        unit=next(iter(cases.values())).swept_units.get(key, "1"),
        values=tuple(cases),
        base=float(base) if isinstance(base, int | float) else None,
        readings={name: tuple(reading(case, name) for case in cases.values()) for name in models},
    )


def trusted(case: CaseResult, model: str) -> str | None:
    """The solver of the same linear system whose answer is taken as right: refined, else the direct one."""
    if not is_linear(model):
        return None
    name, _ = split(model)
    candidates = (f"{name}:refined", name, f"{name}:linear")
    return next((other for other in candidates if other in case.models and other != model), None)


def reading(case: CaseResult, model: str) -> Reading | None:
    """What came out of one model in one case, None where it was not run."""
    result = case.models.get(model)
    if result is None:
        return None
    if failed := failed_steps(result):
        status = result.status[failed[0]]
        where = f" at load factor {case.load_factors[failed[0]]:.3g}" if len(result.status) > 1 else ""
        return Reading(status.code, f"{status.message}{where}")
    residual, left = _largest(result.scalars.get("relative_residual")), _left(case, result)
    stays = f"{left:.1e} of the displacement stays without load"
    if model.endswith(":quasi-linear") and left > LEFT:
        return Reading("step-too-long", f"the volume lags a step behind: {stays}")
    if residual > (SINGLE_RESIDUAL if model.endswith(":single") else RESIDUAL):
        return Reading("wrong", f"called converged with a relative residual of {residual:.1e}")
    if (difference := _difference(case, model)) > DIFFERENT:
        return Reading("wrong", f"called converged and {difference:.1e} away from {trusted(case, model)}")
    if left > LEFT:
        return Reading("wrong", f"called converged and {stays}")
    if (second := _second_order(case, model)) > BEYOND_LINEAR:
        told = f"second order is {short_percent(second)} of the volume"
        return Reading("beyond-linear", f"the load is beyond small displacements: {told}")
    return Reading("converged")


def _largest(values: Array | None) -> float:
    """Largest size of what is finite, NaN where nothing is; an infinite value counts as infinite."""
    known = np.abs(values[~np.isnan(values)]) if values is not None else np.zeros(0)
    return float(known.max()) if len(known) else math.nan


def _difference(case: CaseResult, model: str) -> float:
    other = trusted(case, model)
    if other is None:
        return math.nan
    u, v = case.models[model].displacement, case.models[other].displacement
    both = np.isfinite(u).all(axis=(1, 2)) & np.isfinite(v).all(axis=(1, 2))
    size = float(np.linalg.norm(v[both], axis=(1, 2)).max()) if both.any() else 0.0
    if size == 0.0:
        return math.nan
    return float(np.linalg.norm(u[both] - v[both], axis=(1, 2)).max()) / size


def _second_order(case: CaseResult, model: str) -> float:
    """Largest change of volume of a linear model that its own first order does not have, over the volume."""
    names = ("volume_drift", "mean_strain_x", "mean_strain_y", "mean_strain_z")
    known = [values for name in names if (values := series(case, model, name)) is not None]
    if not is_linear(model) or len(known) < len(names):
        return math.nan
    drift, *strains = known
    return _largest(drift - sum(strains))


def _left(case: CaseResult, result: ModelResult) -> float:
    factors, u = case.load_factors, result.displacement
    if len(factors) < 2 or factors[-1] != 0.0 or not np.any(factors):
        return math.nan
    largest = _largest(np.linalg.norm(u, axis=2).max(axis=1))
    if not largest > 0.0:
        return math.nan
    return float(np.linalg.norm(u[-1], axis=1).max()) / largest
