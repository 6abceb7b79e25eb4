"""Parameters of surface models, fitted to the reference.

In: a plan and its run. Out: fits, and their errors on held-out loads, also of other studies.

A parameter of a surface model is fitted as a multiple of the value that the model's rule gives for the body. A
fit thus carries over to another mesh, tissue or body.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from solver_common.arrays import Array

from . import models
from .body.mesh_cache import mesh_from_cache
from .body.surface_measures import deformations, relative_l2, weighted_norm
from .measures.case import CaseResult, Run
from .measures.metrics import DEFORMATION, VECTOR, full_load_step
from .measures.uncertainty import reference_bar
from .scene.result import ModelResult
from .scene.scene import Scene, build_scene
from .study.errors import InputError
from .study.registry import is_surface
from .study.schema import VdmTable
from .verdict.formatting import NOT_MEASURED, NOTHING, percent, quantity
from .work.plan import Plan, PlannedCase

WIDEST = 1e5  # largest ratio of two moduli over that of their rules, and of a modulus over its rule
_STEP = 1e-4  # of a logarithm, for finite differences
_SAME = 1e-6  # relative change of a displacement that counts as rounding, also of iterative solvers


class CalibrationError(InputError):
    """A study on which nothing can be fitted; the message says why."""


# --- The loads of a study ---


@dataclass(frozen=True)
class Sample:
    """One load of one body: the scene with its full load alone, and the reference's answer.

    Attributes
    ----------
    reference : (N, 3) [m]
    bars : metric -> the reference's own error, NaN where not measured
    bodies : model -> key of its set-up; none where all loads share one
    """

    label: str
    scene: Scene
    reference: Array
    bars: Mapping[str, float]
    bodies: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Body:
    """A finished study, with its finished loads."""

    name: str
    models: tuple[str, ...]
    training: tuple[Sample, ...]
    held_out: tuple[Sample, ...]


def check(plan: Plan, *, fit: bool = False) -> tuple[list[PlannedCase], list[PlannedCase]]:
    """The training loads of a study, the first ones, by default half of them, and those held out.

    Raises
    ------
    CalibrationError
        if no run could be used for a trial, or with `fit` for a fit.
    """
    study, loads = plan.study, plan.in_order
    if study.study.reference is None:
        raise CalibrationError("a calibration needs study.reference, the model to fit to")
    names = list(filter(is_surface, study.study.models))
    if not names:
        raise CalibrationError(f"{study.study.name} has no surface model whose parameters could be fitted")
    asked = study.calibration.training if study.calibration is not None else None
    count = (len(loads) + 1) // 2 if asked is None else asked
    if not 0 < count < len(loads):
        raise CalibrationError(
            f"a calibration needs training loads and others held out: {count} of {len(loads)} would train; "
            "sweep more loads, or set calibration.training"
        )
    first = plan.cases[0].study  # has the swept keys, like all cases
    for name in names if fit else ():
        to_fit(name, first.vdm.given(), first.model_parameters())
    return loads[:count], loads[count:]


def body(plan: Plan, run: Run) -> Body:
    """The finished loads of a study.

    A load is training or held out whether or not others failed, so that none trains that was to be held out.

    Raises
    ------
    CalibrationError
        see `check`; no finished load with a reference for training, or none held out.
    """
    finished = {
        case.hash: case for case in run.cases if case.reference is not None and case.reached == case.full_load
    }
    sides = []
    for loads, name in zip(check(plan), ("loads that train", "loads held out"), strict=True):
        sides.append(tuple(_sample(plan, one, finished[one.hash]) for one in loads if one.hash in finished))
        if not sides[-1]:
            raise CalibrationError(f"none of the {name} is finished: put right what failed, or sweep others")
    about = plan.study.study
    return Body(about.name, tuple(filter(is_surface, about.models)), *sides)


def _sample(plan: Plan, planned: PlannedCase, case: CaseResult) -> Sample:
    mesh = mesh_from_cache(planned.study.geometry, plan.cache, volume=plan.meshes[planned.mesh].volume)
    step = full_load_step(case.load_factors)
    return Sample(
        case.label,
        dataclasses.replace(build_scene(planned.study, mesh), load_factors=case.load_factors[[step]]),
        case.models[str(case.reference)].displacement[step],
        {metric: reference_bar(case.reference_error, metric) for metric in (VECTOR, DEFORMATION)},
        {want.name: want.body for want in planned.wanted if not want.level},
    )


# --- One model on some loads ---


@dataclass(frozen=True)
class Errors:
    """Means of relative L2 errors over a set of loads; for the bars, the reference's own error, the largest."""

    vector: float
    deformation: float
    bar: float
    bar_deformation: float


def to_fit(
    name: str, parameters: Mapping[str, object], overrides: Mapping[str, Mapping[str, object]]
) -> tuple[str, ...]:
    """The parameters of a model to fit: those that its rule sets and the study leaves open.

    Parameters
    ----------
    parameters, overrides : values that the study sets, for all models and for single ones by their full name

    Raises
    ------
    CalibrationError
        no such parameter.
    """
    given = {*parameters, *overrides.get(name, {})}
    names = tuple(key for key in models.find(name)[0].by_rule if key not in given)
    if not names:
        raise CalibrationError(f"{name} has no parameter left to fit: the study sets all of them")
    return names


class Trial:
    """One model on some loads: its fitted parameters, and their values by the rule on each load's scene.

    Parameters
    ----------
    names : of the parameters; by default those of `to_fit`

    Raises
    ------
    CalibrationError
        nothing to fit, or a load that the model cannot solve.
    """

    def __init__(self, name: str, samples: Sequence[Sample], names: Sequence[str] | None = None) -> None:
        self.name = name
        self.samples = tuple(samples)
        first = samples[0].scene
        self.names = tuple(names or to_fit(name, first.parameters, first.overrides))
        self.rules = [
            np.array([float(result.parameters[key]) for key in self.names]) for result in self._run(None)
        ]

    def answers(self, multiples: Array) -> list[Array]:
        """The model's (N, 3) displacement for each load [m]; loads on one body share a set-up."""
        return [result.displacement[-1] for result in self._run(multiples)]

    def errors(self, multiples: Array) -> Errors:
        """The model's errors with these multiples of its rule."""
        vectors, shapes = [], []
        for sample, u in zip(self.samples, self.answers(multiples), strict=True):
            surface = sample.scene.surface
            vectors.append(relative_l2(u, sample.reference, surface.areas))
            u, r = deformations(surface.points, np.stack([u, sample.reference]), surface.areas)
            shapes.append(relative_l2(u, r, surface.areas))
        return Errors(
            float(np.mean(vectors)),
            float(np.mean(shapes)),
            max(sample.bars[VECTOR] for sample in self.samples),
            max(sample.bars[DEFORMATION] for sample in self.samples),
        )

    def _run(self, multiples: Array | None) -> list[ModelResult]:
        """The result of each load with these multiples of its rule, or with the rule."""
        found: dict[int, ModelResult] = {}
        keys = [sample.bodies.get(self.name, "") for sample in self.samples]
        for key in dict.fromkeys(keys):
            places = [place for place, own in enumerate(keys) if own == key]
            scene = self.samples[places[0]].scene
            own = dict(scene.overrides.get(self.name, {}))
            if multiples is not None:  # all loads of a body have the same rule
                own |= zip(self.names, (self.rules[places[0]] * multiples).tolist(), strict=True)
            scene = dataclasses.replace(scene, overrides={**scene.overrides, self.name: own})
            set_up = models.Prepared(scene, self.name, len(places))
            for place in places:  # each load is a path of its own
                sample = self.samples[place]
                found[place] = set_up.answer(sample.scene.loads)
                failed = next((status for status in found[place].status if not status.ok), None)
                if failed is not None:
                    told = f"{failed.message}; {failed.remedy}"
                    raise CalibrationError(f"{self.name} in case {sample.label!r}: {told}")
        return [found[place] for place in range(len(keys))]


# --- The fit ---


@dataclass(frozen=True)
class Fit:
    """The fitted parameters of one model on one body.

    Attributes
    ----------
    multiples : parameter -> multiple of the rule's value
    parameters : parameter -> value [SI] on body, tissue and mesh of the first training load, whose label is `where`
    by_rule, held_out : errors of the rule and of the fit on the held-out loads
    training : errors of the fit on the training loads
    transfer : study -> errors of these multiples on its held-out loads
    """

    model: str
    multiples: Mapping[str, float]
    parameters: Mapping[str, float]
    by_rule: Errors
    training: Errors
    held_out: Errors
    where: str = ""
    transfer: Mapping[str, Errors] = field(default_factory=dict)


def calibrate(
    body: Body, others: Sequence[Body] = (), watch: Callable[[str], None] = lambda _: None
) -> list[Fit]:
    """Fit every surface model of a body and evaluate the fits on others; `watch` gets each model's name."""
    found = []
    for name in body.models:
        watch(f"fitting {name}")
        found.append(fit(name, body.training, body.held_out, [one for one in others if name in one.models]))
    return found


def fit(
    name: str, training: Sequence[Sample], held_out: Sequence[Sample], others: Sequence[Body] = ()
) -> Fit:
    """Fit one model on training loads by the mean squared relative error of the displacement vector.

    Raises
    ------
    CalibrationError
        see `Trial` and `least_error`.
    """
    trial, unseen = Trial(name, training), Trial(name, held_out)
    multiples = least_error(trial)
    return Fit(
        model=name,
        multiples=dict(zip(trial.names, multiples.tolist(), strict=True)),
        parameters=dict(zip(trial.names, (trial.rules[0] * multiples).tolist(), strict=True)),
        by_rule=unseen.errors(np.ones(len(trial.names))),
        training=trial.errors(multiples),
        held_out=unseen.errors(multiples),
        where=training[0].label,
        transfer={one.name: Trial(name, one.held_out, trial.names).errors(multiples) for one in others},
    )


def least_error(trial: Trial) -> Array:
    """(K,) multiples of the rule's moduli with the least mean squared relative error.

    Raises
    ------
    CalibrationError
        an error that keeps falling as the moduli grow or shrink.
    """
    areas = [sample.scene.surface.areas for sample in trial.samples]
    sizes = [weighted_norm(s.reference, own) or 1.0 for s, own in zip(trial.samples, areas, strict=True)]

    def in_one(fields: Sequence[Array]) -> Array:
        """Weighted displacements as one vector; its squared distance from the references' is the error."""
        parts = [np.sqrt(own)[:, None] * u / size for u, own, size in zip(fields, areas, sizes, strict=True)]
        return np.concatenate(parts).ravel() / math.sqrt(len(parts))

    target = in_one([sample.reference for sample in trial.samples])
    found = least_squares_of_moduli(lambda m: in_one(trial.answers(m)), target, len(trial.names))
    if not 1.0 / WIDEST < found.max() < WIDEST:
        raise CalibrationError(
            f"{trial.name} has no fit: on the training loads its error falls as long as its moduli "
            f"{'grow' if found.max() > 1.0 else 'shrink'}"
        )
    return found


def least_squares_of_moduli(answer: Callable[[Array], Array], target: Array, count: int) -> Array:
    """(K,) multiples of moduli whose answer (M,) is nearest to the target (M,).

    scipy's least squares over the logarithms of a common factor and of the other moduli's ratios to the first. It
    starts at the rule, or at the best of several ratios if that is nearer, each with its best common factor by
    forces. A modulus may not matter to a body; the error then has a flat end far from the rule. Directions that
    the loads do not determine keep their starting value.
    """
    from scipy.optimize import least_squares  # slow to load

    wide = math.log(WIDEST)
    bounds = np.array([2.5 * wide, *[wide] * (count - 1)])

    def multiples(logs: Array) -> Array:
        return np.exp(logs[0] + np.array([0.0, *logs[1:]]))

    def residual(logs: Array) -> Array:
        try:
            return answer(multiples(logs)) - target
        except CalibrationError:  # a nonlinear model that is too soft for its load
            return np.full(len(target), np.inf)

    def jacobian(logs: Array) -> Array:
        sides = [
            (residual(logs + one) - residual(logs - one)) / (2.0 * _STEP) for one in _STEP * np.eye(count)
        ]
        slopes = np.stack(sides, axis=1)
        told = np.linalg.norm(slopes, axis=0) > _SAME * np.linalg.norm(target)  # smaller slopes are rounding
        return np.where(told, slopes, 0.0)

    def square(values: Array) -> float:
        return float(values @ values)

    start = np.zeros(count)
    least = square(residual(start)) * (1.0 - _SAME)
    for ratio in np.linspace(-wide, wide, 13) if count == 2 else [0.0]:
        logs = np.array([0.0, *[ratio] * (count - 1)])
        forces = residual(logs) + target
        factor = (
            float(forces @ target) / square(forces) if np.isfinite(forces).all() and forces.any() else 0.0
        )
        if factor > 0.0:
            logs[0] = min(max(-math.log(factor), -bounds[0]), bounds[0])
            if (tried := square(residual(logs))) < least:
                start, least = logs, tried
    found = least_squares(residual, start, jacobian, (-bounds, bounds), xtol=1e-9, ftol=1e-14, gtol=1e-10)
    return multiples(np.asarray(found.x))


# --- What is printed ---


def table(fits: Sequence[Fit]) -> list[dict[str, str]]:
    """One row per model. Errors are mean displacement / mean deformation over the loads."""
    elsewhere = dict.fromkeys(study for fit in fits for study in fit.transfer)
    rows = []
    for fit in fits:
        values = (f"{key} {quantity(value, VdmTable.unit(key))}" for key, value in fit.parameters.items())
        # other studies may lack some models
        there = {
            f"on {study}": in_percent(fit.transfer[study]) if study in fit.transfer else NOTHING
            for study in elsewhere
        }
        rows.append(
            {
                "model": fit.model,
                "fitted": ", ".join(values),
                "times its rule": ", ".join(f"{value:.3g}" for value in fit.multiples.values()),
                "training loads": in_percent(fit.training),
                "held out, by rule": in_percent(fit.by_rule),
                "held out, fitted": in_percent(fit.held_out),
                "reference's own": bars_in_percent(fit.held_out),
            }
            | there
        )
    return rows


def in_percent(found: Errors) -> str:
    """Mean displacement error / mean deformation error."""
    return f"{percent(found.vector)} / {percent(found.deformation)}"


def bars_in_percent(found: Errors) -> str:
    """The reference's own error for both, the largest over the loads."""
    return (
        NOT_MEASURED
        if math.isnan(found.bar)
        else f"± {percent(found.bar)} / {percent(found.bar_deformation)}"
    )


def as_json(fits: Sequence[Fit]) -> dict[str, dict[str, dict[str, object]]]:
    """Model -> its fit, and its errors elsewhere, as plain data."""
    found = {}
    for one in map(dataclasses.asdict, fits):
        transfer = one.pop("transfer")
        found[str(one["model"])] = {"fit": one, "transfer": transfer}
    return found


def as_toml(fits: Sequence[Fit]) -> str:
    """Tables to paste into a study file: [vdm] for one model, a [models."NAME"] table each for several."""
    blocks = []
    for fit in fits:
        title = "vdm" if len(fits) == 1 else f'models."{fit.model}"'
        told = (
            f"# of the case {fit.where or 'that the study has'}\n"
            f"# held out: by rule {in_percent(fit.by_rule)}, fitted {in_percent(fit.held_out)}; "
            f"reference's own {bars_in_percent(fit.held_out)}\n"
        )
        lines = [f"{key} = {value:.6g}" for key, value in fit.parameters.items()]
        blocks.append(told + "\n".join([f"[{title}]", *lines]))
    return "\n\n".join(blocks) + "\n"
