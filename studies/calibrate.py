"""Parameters fitted: those of surface models to the reference, Young's modulus to a measurement.

In: a plan and its run, or a study with [[measured]] tables. Out: fits, and their errors on held-out loads.

A parameter of a surface model is fitted as a multiple of what the model's rule gives for the body at hand: so a fit
can be carried to another mesh, tissue or body.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from solver_common.arrays import Array, Mask

from . import models
from .body.mesh import Mesh
from .body.mesh_cache import mesh_from_cache
from .body.surface_measures import Surface, deformations, relative_l2, weighted_norm
from .measures.case import Run
from .measures.measurement import Measurement, Quantity, hold_against
from .measures.metrics import DEFORMATION, VECTOR, full_load_step
from .measures.pushed import Answer
from .measures.uncertainty import reference_bar
from .scene.result import ModelResult
from .scene.scene import Scene, build_scene
from .study.config import with_mesh_size
from .study.errors import InputError
from .study.registry import PARAMETERS, is_surface
from .study.schema import Study
from .verdict.formatting import NOT_MEASURED, NOTHING, percent, quantity
from .work.plan import Plan, PlannedCase, needs_volume

FINER = 0.75  # mesh size of the second mesh over that of the study
WIDEST = 1e5  # of a ratio of two moduli over that of their rules, and of a modulus over its rule
FACTOR = 4.0  # how far from the study's a measured Young's modulus is looked for, either way
MODULI = {  # parameters that can be fitted -> the one whose rule gives the scale where it has none of its own
    "bulk_modulus": "",
    "connectivity_modulus": "",
    "foundation": "",
    "surface_tension": "",
    "stretch_stiffness": "surface_tension",
    "shear_modulus": "",
}
_STEP = 1e-4  # of a logarithm, for slopes
_SAME = 1e-6  # of a displacement: less is rounding, and that of solvers that iterate


class CalibrationError(InputError):
    """A study that nothing can be fitted on; the message says why."""


# --- The loads of a study ---


@dataclass(frozen=True)
class Sample:
    """One load of one body: the scene with its full load alone, and what the reference answers to that.

    Attributes
    ----------
    reference : (N, 3) [m]
    bars : metric -> the reference's own error, NaN where not measured
    place : of the load among the study's, from 0
    bodies : model -> key of its set-up; none where all loads share one
    """

    label: str
    scene: Scene
    reference: Array
    bars: Mapping[str, float]
    place: int
    bodies: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def surface(self) -> Surface:
        """The undeformed surface."""
        return Surface(self.scene.mesh.surface_points, self.scene.mesh.triangles)


@dataclass(frozen=True)
class Body:
    """A study that has been run: its loads on the study's mesh, and on a finer mesh where it has one.

    Attributes
    ----------
    asked : parameters to fit; None for those that the rules set
    lost : study -> labels of its loads that failed
    """

    name: str
    models: tuple[str, ...]
    asked: tuple[str, ...] | None
    training: tuple[Sample, ...]
    held_out: tuple[Sample, ...]
    finer_training: tuple[Sample, ...] = ()
    finer_held_out: tuple[Sample, ...] = ()
    lost: Mapping[str, Sequence[str]] = field(default_factory=dict)


def check(plan: Plan) -> None:
    """Raise CalibrationError where nothing could be fitted, or tried, whatever a run gives."""
    study = plan.study
    if study.study.reference is None:
        raise CalibrationError("a calibration needs study.reference, the model to fit to")
    if not any(map(is_surface, study.study.models)):
        raise CalibrationError(f"{study.study.name} has no surface model whose parameters could be fitted")
    count_of_training(plan)


def check_fit(plan: Plan) -> None:
    """Raise CalibrationError where `check` does, or where the study leaves a surface model nothing to fit."""
    check(plan)
    study = plan.cases[0].study  # which has what is swept, as all cases have
    for name in filter(is_surface, study.study.models):
        to_fit(name, study.vdm_parameters(), study.model_parameters(), _asked(study))


def finer_study(plan: Plan) -> Study | None:
    """The study on a finer mesh; None where its tetrahedra are used as they are, or where it sweeps mesh_size."""
    own = any(mesh.geometry.has_own_tetrahedra for mesh in plan.meshes.values())
    return None if own else with_mesh_size(plan.study, FINER)


def loads_of(plan: Plan) -> dict[str, PlannedCase]:
    """The loads of a study by their case's hash, in the study's order, each once."""
    return {case.hash: case for case in plan.cases}


def count_of_training(plan: Plan) -> int:
    """How many of a study's loads train, the first ones; by default half of them.

    Raises
    ------
    CalibrationError
        nothing would be left on one side.
    """
    loads, asked = len(loads_of(plan)), plan.study.calibration
    count = (loads + 1) // 2 if asked is None or asked.training is None else asked.training
    if not 0 < count < loads:
        raise CalibrationError(
            f"a calibration needs training loads and others held out: {count} of {loads} would train; "
            "sweep more loads, or set calibration.training"
        )
    return count


def samples_of(plan: Plan, run: Run) -> tuple[tuple[Sample, ...], tuple[Sample, ...]]:
    """(training, held out): the finished loads of a run.

    A load is on its side wherever others failed, so that none trains that was to be held out.

    Raises
    ------
    CalibrationError
        no finished load with a reference on one side.
    """
    planned, count = loads_of(plan), count_of_training(plan)
    places = {key: place for place, key in enumerate(planned)}
    samples = []
    for case in run.cases:
        if case.reference is None or case.reached != case.full_load:
            continue
        found = planned[case.hash]
        mesh = mesh_from_cache(found.study.geometry, plan.cache, volume=needs_volume(found.study))
        step = full_load_step(case.load_factors)
        samples.append(
            Sample(
                case.label,
                dataclasses.replace(build_scene(found.study, mesh), load_factors=case.load_factors[[step]]),
                case.models[case.reference].displacement[step],
                {metric: reference_bar(case.reference_error, metric) for metric in (VECTOR, DEFORMATION)},
                places[case.hash],
                {want.name: want.body for want in found.wanted if not want.level},
            )
        )
    training = tuple(sample for sample in samples if sample.place < count)
    held_out = tuple(sample for sample in samples if sample.place >= count)
    for side, name in ((training, f"first {count} loads, which train,"), (held_out, "loads held out")):
        if not side:
            raise CalibrationError(f"none of the {name} is finished: put right what failed, or sweep others")
    return training, held_out


def body(plan: Plan, run: Run, finer: tuple[Plan, Run] | None = None) -> Body:
    """A study's loads. A finer mesh that leaves a side without a finished load is left out.

    Raises
    ------
    CalibrationError
        see `check` and `samples_of`.
    """
    check(plan)
    name, study = plan.study.study.name, plan.study
    there: tuple[tuple[Sample, ...], tuple[Sample, ...]] = (), ()
    runs = {name: run}
    if finer is not None:
        runs[f"{name}, finer mesh"] = finer[1]
        with suppress(CalibrationError):
            there = samples_of(*finer)
    lost = {where: [failure["label"] for failure in found.failed] for where, found in runs.items()}
    return Body(
        name,
        tuple(filter(is_surface, study.study.models)),
        _asked(study),
        *samples_of(plan, run),
        *there,
        {where: labels for where, labels in lost.items() if labels},
    )


def _asked(study: Study) -> tuple[str, ...] | None:
    return study.calibration.parameters if study.calibration is not None else None


# --- One model on some loads ---


@dataclass(frozen=True)
class Errors:
    """Relative L2 errors over a set of loads: mean and worst; bars: the reference's own error, its largest."""

    vector: float
    vector_worst: float
    deformation: float
    deformation_worst: float
    bar: float
    bar_deformation: float


def to_fit(
    name: str,
    parameters: Mapping[str, object],
    overrides: Mapping[str, Mapping[str, object]],
    asked: Sequence[str] | None,
) -> tuple[str, ...]:
    """Which parameters of a model are fitted.

    Parameters
    ----------
    parameters, overrides : what the study sets, for all models and for single ones by their full name
    asked : parameters to fit, of which the model takes those that it reads; by default those that its rule sets
        and the study leaves to it

    Raises
    ------
    CalibrationError
        none.
    """
    if asked is not None:
        names = [key for key in asked if key in models.reads(name)]
        why = f"it reads none of {', '.join(asked)}"
    else:
        given = {*parameters, *overrides.get(name, {})}
        names = [key for key in models.find(name)[0].by_rule if key not in given]
        why = "the study sets all of them"
    if not names:
        raise CalibrationError(f"{name} has no parameter left to fit: {why}")
    return tuple(names)


class Trial:
    """One model on some loads: which of its parameters are fitted, and what their rule gives on each load's scene.

    Parameters
    ----------
    asked : parameters to fit, see `to_fit`

    Raises
    ------
    CalibrationError
        nothing to fit, or a load that the model cannot solve.
    """

    def __init__(self, name: str, samples: Sequence[Sample], asked: Sequence[str] | None = None) -> None:
        self.name = name
        self.samples = tuple(samples)
        first = samples[0].scene
        self.names = to_fit(name, first.parameters, first.overrides, asked)
        alike: dict[str, list[int]] = {}  # places of the loads on one body
        for place, sample in enumerate(self.samples):
            alike.setdefault(sample.bodies.get(name, ""), []).append(place)
        self._bodies = list(alike.values())
        self.rules = [self._rule(result) for result in self._run(None)]

    def values(self, multiples: Array) -> dict[str, float]:
        """Parameters [SI] on the first load's scene."""
        return dict(zip(self.names, (self.rules[0] * multiples).tolist(), strict=True))

    def answers(self, multiples: Array) -> list[Array]:
        """The model's (N, 3) displacement for each load [m]; loads on one body share a set-up."""
        results = self._run([rule * multiples for rule in self.rules])
        return [result.displacement[-1] for result in results]

    def errors(self, multiples: Array) -> Errors:
        """How far the model is off with these multiples of its rule."""
        vectors, shapes = [], []
        for sample, u in zip(self.samples, self.answers(multiples), strict=True):
            surface = sample.surface
            vectors.append(relative_l2(u, sample.reference, surface.areas))
            u, r = deformations(surface.points, np.stack([u, sample.reference]), surface.areas)
            shapes.append(relative_l2(u, r, surface.areas))
        return Errors(
            float(np.mean(vectors)),
            max(vectors),
            float(np.mean(shapes)),
            max(shapes),
            max(sample.bars[VECTOR] for sample in self.samples),
            max(sample.bars[DEFORMATION] for sample in self.samples),
        )

    def _rule(self, result: ModelResult) -> Array:
        by_rule = result.parameters
        return np.array([float(by_rule.get(key, by_rule.get(MODULI[key], 0.0))) for key in self.names])

    def _run(self, values: Sequence[Array] | None) -> list[ModelResult]:
        """The result of each load with these parameters [SI], or with those of the rule."""
        found: dict[int, ModelResult] = {}
        for places in self._bodies:
            # on one body the rule is one
            given = {} if values is None else dict(zip(self.names, values[places[0]].tolist(), strict=True))
            scene = self.samples[places[0]].scene
            own = {**scene.overrides.get(self.name, {}), **given}
            scene = dataclasses.replace(scene, overrides={**scene.overrides, self.name: own})
            set_up = models.Prepared(scene, self.name, len(places))
            for place in places:  # each a load path of its own
                sample = self.samples[place]
                result = set_up.answer(sample.scene.loads)
                failed = next((status for status in result.status if not status.ok), None)
                if failed is not None:
                    raise CalibrationError(
                        f"{self.name} in case {sample.label!r}: {failed.message}; {failed.remedy}"
                    )
                found[place] = result
        return [found[place] for place in range(len(self.samples))]


# --- The fit ---


@dataclass(frozen=True)
class Fit:
    """The fitted parameters of one model on one body.

    Attributes
    ----------
    multiples : parameter -> multiple of the rule's value
    parameters : parameter -> value [SI] on body, tissue and mesh of the first training load, whose label is `where`
    by_rule, held_out : errors of the rule and of the fit on the loads held out
    training : of the fit on the others
    """

    model: str
    multiples: Mapping[str, float]
    parameters: Mapping[str, float]
    by_rule: Errors
    training: Errors
    held_out: Errors
    where: str = ""


@dataclass(frozen=True)
class Calibration:
    """One model fitted on one body, and what the fit is worth elsewhere.

    Attributes
    ----------
    finer : multiples of the rule that a finer mesh gives; None without one
    on_finer : errors there of the multiples of the study's own mesh
    transfer : study -> errors of these on its held-out loads
    repeated : labels of held-out loads that are multiples of training loads, and so test nothing
    lost : study -> labels of loads that failed and are in no figure here
    """

    fit: Fit
    finer: Mapping[str, float] | None
    on_finer: Errors | None
    transfer: Mapping[str, Errors]
    repeated: Sequence[str] = ()
    lost: Mapping[str, Sequence[str]] = field(default_factory=dict)


def calibrate(body: Body, others: Sequence[Body] = ()) -> list[Calibration]:
    """Fit every surface model of a body and try the fits elsewhere."""
    return [_calibration(body, name, others) for name in body.models]


def _calibration(body: Body, name: str, others: Sequence[Body]) -> Calibration:
    found = fit(name, body.training, body.held_out, body.asked)
    finer, on_finer = None, None
    if body.finer_training:
        trial = Trial(name, body.finer_training, body.asked)
        finer = dict(zip(trial.names, least_error(trial).tolist(), strict=True))
        on_finer = _errors(name, body.finer_held_out, found)
    transfer = {other.name: _errors(name, other.held_out, found) for other in others if name in other.models}
    tried = [body, *(other for other in others if other.name in transfer)]
    lost = {where: labels for each in tried for where, labels in each.lost.items()}
    return Calibration(found, finer, on_finer, transfer, repeats(body.training, body.held_out), lost)


def _errors(name: str, samples: Sequence[Sample], found: Fit) -> Errors:
    return Trial(name, samples, tuple(found.multiples)).errors(np.array(list(found.multiples.values())))


def fit(
    name: str, training: Sequence[Sample], held_out: Sequence[Sample], asked: Sequence[str] | None = None
) -> Fit:
    """Fit one model on training loads by the mean squared relative error of the displacement vector.

    Raises
    ------
    CalibrationError
        see `Trial` and `least_error`.
    """
    trial, unseen = Trial(name, training, asked), Trial(name, held_out, asked)
    multiples = least_error(trial)
    return Fit(
        model=name,
        multiples=dict(zip(trial.names, multiples.tolist(), strict=True)),
        parameters=trial.values(multiples),
        by_rule=unseen.errors(np.ones(len(trial.names))),
        training=trial.errors(multiples),
        held_out=unseen.errors(multiples),
        where=training[0].label,
    )


def least_error(trial: Trial) -> Array:
    """(K,) multiples of the rule's moduli with the least mean squared relative error.

    Raises
    ------
    CalibrationError
        an error that falls as long as the moduli grow or shrink.
    """
    areas = [sample.surface.areas for sample in trial.samples]
    norms = [weighted_norm(s.reference, of_node) for s, of_node in zip(trial.samples, areas, strict=True)]

    def in_one(fields: Sequence[Array]) -> Array:
        """Displacements as one vector, whose squared distance from the references' is the error."""
        parts = [
            (np.sqrt(of_node)[:, None] * u / (norm or 1.0)).reshape(-1)
            for u, of_node, norm in zip(fields, areas, norms, strict=True)
        ]
        return np.concatenate(parts) / math.sqrt(len(parts))

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
    starts at the rule or, where that is nearer, at the best of some ratios, each with the common factor that serves
    forces best: a modulus may not matter to a body, and then the error has a flat end far from the rule. What the
    loads do not tell stays where the search began.
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
        told = np.linalg.norm(slopes, axis=0) > _SAME * np.linalg.norm(target)  # less is rounding
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


def repeats(training: Sequence[Sample], held_out: Sequence[Sample]) -> list[str]:
    """Labels of held-out loads to which the reference answers a multiple of what it does to a training load.

    Neither another size of a load nor another Young's modulus tells a linear model from a linear reference.
    """

    def is_multiple(u: Array, v: Array) -> bool:
        if u.shape != v.shape or not v.any():
            return False
        rest = u - float(np.vdot(v, u) / np.vdot(v, v)) * v
        return float(np.linalg.norm(rest)) <= _SAME * float(np.linalg.norm(u))

    return [s.label for s in held_out if any(is_multiple(s.reference, t.reference) for t in training)]


# --- What is printed ---


def table(entries: Sequence[Calibration]) -> list[dict[str, str]]:
    """One row per model. Errors are mean displacement / mean deformation over the loads."""
    elsewhere = dict.fromkeys(study for entry in entries for study in entry.transfer)
    rows = []
    for entry in entries:
        fit = entry.fit
        values = (f"{key} {quantity(value, PARAMETERS[key][1])}" for key, value in fit.parameters.items())
        rows.append(
            {
                "model": fit.model,
                "fitted": ", ".join(values),
                "times its rule": _multiples(fit.multiples),
                "training loads": in_percent(fit.training),
                "held out, by rule": in_percent(fit.by_rule),
                "held out, fitted": in_percent(fit.held_out)
                + (f", {len(entry.repeated)} no test" if entry.repeated else ""),
                "reference's own": bars_in_percent(fit.held_out),
                "fit of a finer mesh": _multiples(entry.finer) if entry.finer else NOT_MEASURED,
                "there, this fit": in_percent(entry.on_finer) if entry.on_finer else NOT_MEASURED,
                # other studies need not have all the models
                **{
                    f"on {study}": in_percent(entry.transfer[study]) if study in entry.transfer else NOTHING
                    for study in elsewhere
                },
            }
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


def _multiples(multiples: Mapping[str, float]) -> str:
    return ", ".join(f"{value:.3g}" for value in multiples.values())


def as_json(entries: Sequence[Calibration]) -> dict[str, dict[str, object]]:
    """Model -> its calibration as plain data."""
    return {entry.fit.model: dataclasses.asdict(entry) for entry in entries}


def as_toml(entries: Sequence[Calibration]) -> str:
    """Tables to paste into a study file: [vdm] for one model, a [models."NAME"] table each for several."""
    blocks = []
    for entry in entries:
        fit = entry.fit
        title = "vdm" if len(entries) == 1 else f'models."{fit.model}"'
        told = (
            f"# of the case {fit.where or 'that the study has'}\n"
            f"# held out: by rule {in_percent(fit.by_rule)}, fitted {in_percent(fit.held_out)}; "
            f"reference's own {bars_in_percent(fit.held_out)}\n"
        )
        lines = [f"{key} = {value:.6g}" for key, value in fit.parameters.items()]
        blocks.append(told + "\n".join([f"[{title}]", *lines]))
    return "\n\n".join(blocks) + "\n"


# --- Young's modulus, fitted to a measurement ---


@dataclass(frozen=True)
class MeasuredFit:
    """One model's Young's modulus, from the first load that was measured.

    Attributes
    ----------
    model : its name
    modulus : of least squares over u_D [Pa]; NaN where the model has no answer, where the range ends, or where no
        fitted value changes with it
    uncertainty : standard, of the modulus, from u_D alone [Pa]
    trained, held_out : root mean square of E over the fitted quantities and over the others of their unit
    as_given : that over the others with the study's own modulus; over the fitted ones where there are no others
    size : root mean square of D over the others; 0 where all are distances
    unit : of these, m or N
    """

    model: str
    modulus: float
    uncertainty: float
    trained: float
    held_out: float
    as_given: float
    size: float
    unit: str = "m"


def training(found: Measurement) -> Mask:
    """(Q,) the quantities to fit: those of the first table's first load; the others of their unit are held out."""
    first = found.quantities[0]

    def load_of(one: Quantity) -> tuple[object, ...]:
        return one.table, one.step, "" if math.isnan(one.depth) else one.depth

    return np.array([load_of(one) == load_of(first) for one in found.quantities])


def fit_modulus(study: Study, mesh: Mesh, name: str) -> MeasuredFit:
    """Fit one model of a study of one case, on the study's own mesh.

    Raises
    ------
    InputError
        nothing was measured.
    """

    def answer(modulus: float) -> Measurement:
        tissue = study.tissue.model_copy(update={"youngs_modulus": modulus})
        scene = build_scene(study.model_copy(update={"tissue": tissue}), mesh)
        linear = models.superposes(name) and scene.indenter is None
        result = Answer.of(models.run_model(scene, name), linear=linear)
        found = hold_against(study, mesh, {name: result})
        if found is None:
            raise InputError("the study has no [[measured]] table to fit")
        return found

    return modulus_of(answer, study.tissue.youngs_modulus, name)


def modulus_of(answer: Callable[[float], Measurement], given: float, name: str) -> MeasuredFit:
    """The fit of a model that answers to a Young's modulus [Pa]; `given` is where the search begins."""
    from scipy.optimize import least_squares  # slow to load

    start = answer(given)
    mine, unit = training(start), start.quantities[0].unit
    rest = np.array([one.unit == unit for one in start.quantities]) & ~mine
    as_given = _rms(start.error(name)[rest if rest.any() else mine])
    no = math.nan
    lost = MeasuredFit(name, no, no, no, no, as_given, _rms(start.values[rest]), unit)
    weights = 1.0 / np.maximum([one.uncertainty for one in start.quantities], 1e-9)[mine]

    def residual(multiple: Array) -> Array:
        return np.asarray(answer(given * float(multiple[0])).error(name)[mine] * weights)

    if not np.isfinite(start.error(name)[mine]).all():
        return dataclasses.replace(lost, as_given=math.nan)
    bounds = (1.0 / FACTOR, FACTOR)
    found = least_squares(residual, [1.0], bounds=bounds, jac="3-point", diff_step=[1e-2], xtol=1e-6)
    multiple = float(found.x[0])
    slope = (
        float(np.linalg.norm(np.asarray(found.jac))) * multiple
    )  # of the values over u_D by the logarithm of the modulus
    if slope <= _SAME or not 1.001 * bounds[0] < multiple < 0.999 * bounds[1]:
        return lost
    modulus = given * multiple
    errors = answer(modulus).error(name)
    return dataclasses.replace(
        lost,
        modulus=modulus,
        uncertainty=modulus / slope,
        trained=_rms(errors[mine]),
        held_out=_rms(errors[rest]),
    )


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean())) if len(values) else math.nan
