"""Calibrations of whole studies: fits, their errors on loads held out, on a finer mesh and on other bodies."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..measures.case import Run
from ..study.config import with_mesh_size
from ..study.schema import Study
from ..study.units import shown
from ..work.plan import Plan
from .fit import (
    Errors,
    Fit,
    Sample,
    Trial,
    count_of_training,
    fit,
    loads_of,
    repeats,
    samples_of,
    split,
    surface_models,
    to_fit,
)
from .search import CalibrationError

FINER = 0.75  # mesh size of the second mesh over that of the study


@dataclass(frozen=True)
class Body:
    """A study that has been run: its loads on the study's mesh and on a finer mesh, or why there are none."""

    name: str
    models: tuple[str, ...]
    asked: tuple[str, ...] | None  # parameters to fit
    training: tuple[Sample, ...]
    held_out: tuple[Sample, ...]
    finer_training: tuple[Sample, ...] = ()
    finer_held_out: tuple[Sample, ...] = ()
    lost: Mapping[str, Sequence[str]] = field(default_factory=dict)  # of which mesh -> loads that failed
    no_finer: str = ""


@dataclass(frozen=True)
class Calibration:
    """One model fitted on one body, and what the fit is worth elsewhere.

    `finer` are the multiples of the rule that a finer mesh gives; `on_finer` the errors there of those of the
    study's own mesh; `transfer` the errors of these on the held-out loads of other bodies, by study; `repeated` the
    labels of held-out loads that are training loads again but for a factor; `lost` those of loads that failed and
    are in no figure here, by study; `no_finer` says why `finer` and `on_finer` are not there.
    """

    fit: Fit
    finer: Mapping[str, float] | None
    on_finer: Errors | None
    transfer: Mapping[str, Errors]
    repeated: Sequence[str] = ()
    lost: Mapping[str, Sequence[str]] = field(default_factory=dict)
    no_finer: str = ""


def check(plan: Plan) -> None:
    """Raise CalibrationError where nothing could be fitted, or tried, whatever a run gives."""
    study = plan.study
    if study.study.reference is None:
        raise CalibrationError("a calibration needs study.reference, the model to fit to")
    if not surface_models(study.study.models):
        raise CalibrationError(f"{study.study.name} has no surface model whose parameters could be fitted")
    count_of_training(len(loads_of(plan)), _training(study))


def check_fit(plan: Plan) -> None:
    """Raise CalibrationError where `check` does, or where the study leaves a surface model nothing to fit."""
    check(plan)
    study = plan.cases[0].study  # which has what is swept, as all cases have
    for name in surface_models(study.study.models):
        to_fit(name, study.vdm_parameters(), study.model_parameters(), _asked(study))


def finer_study(plan: Plan) -> tuple[Study | None, str]:
    """The study on a finer mesh; or none, and why."""
    own = [mesh.geometry.path.name for mesh in plan.meshes.values() if mesh.geometry.has_own_tetrahedra]
    if own:
        return None, f"the tetrahedra of {shown(own[0])} are used as they are"
    finer = with_mesh_size(plan.study, FINER)
    return finer, "" if finer is not None else "the study sweeps geometry.mesh_size"


def _asked(study: Study) -> tuple[str, ...] | None:
    return study.calibration.parameters if study.calibration is not None else None


def _training(study: Study) -> int | None:
    return study.calibration.training if study.calibration is not None else None


def body(plan: Plan, run: Run, finer: tuple[Plan, Run] | None = None, no_finer: str = "") -> Body:
    """A study's loads, split into training and held-out ones; `no_finer` says why it has no finer mesh.

    Raises
    ------
    CalibrationError
        no reference, no surface model, or too few finished cases.
    """
    check(plan)
    study, count, loads = plan.study, _training(plan.study), len(loads_of(plan))
    models = surface_models(study.study.models)
    training, held_out = split(samples_of(plan, run), loads, count)
    there: tuple[list[Sample], list[Sample]] = [], []
    if finer is not None:
        try:
            there = split(samples_of(*finer), loads, count)
        except CalibrationError as error:
            no_finer = f"on the finer mesh {error}"
    name = study.study.name
    runs = {name: run} if finer is None else {name: run, f"{name}, finer mesh": finer[1]}
    lost = {where: [failure["label"] for failure in found.failed] for where, found in runs.items()}
    return Body(
        name,
        tuple(models),
        _asked(study),
        tuple(training),
        tuple(held_out),
        tuple(there[0]),
        tuple(there[1]),
        {where: labels for where, labels in lost.items() if labels},
        no_finer,
    )


def calibrate(body: Body, others: Sequence[Body] = ()) -> list[Calibration]:
    """Fit every surface model of a body and try the fits elsewhere."""
    return [_calibration(body, name, others) for name in body.models]


def _calibration(body: Body, name: str, others: Sequence[Body]) -> Calibration:
    found = fit(name, body.training, body.held_out, body.asked)
    finer, on_finer, no_finer = None, None, body.no_finer
    if body.finer_training:
        try:
            finer = fit(name, body.finer_training, body.finer_held_out, body.asked).multiples
            on_finer = _errors(name, body.finer_held_out, found)
        except CalibrationError as error:
            finer, no_finer = None, f"on the finer mesh {error}"
    transfer = {other.name: _errors(name, other.held_out, found) for other in others if name in other.models}
    training, held_out = (Trial(name, samples, body.asked) for samples in (body.training, body.held_out))
    repeated = repeats(training, held_out, np.array(list(found.multiples.values())))
    tried = [body, *(other for other in others if other.name in transfer)]
    lost = {where: labels for each in tried for where, labels in each.lost.items()}
    return Calibration(found, finer, on_finer, transfer, repeated, lost, no_finer)


def _errors(name: str, samples: Sequence[Sample], found: Fit) -> Errors:
    return Trial(name, samples, tuple(found.multiples)).errors(np.array(list(found.multiples.values())))


def worse_than_rule(by_rule: Errors, fitted: Errors) -> str:
    """In which measures a fit does worse than the rule, by more than the reference's own error; "" in none.

    Nor is it worse by less than the figures show.
    """
    pairs = {
        "displacement": (by_rule.vector, fitted.vector, fitted.bar),
        "deformation": (by_rule.deformation, fitted.deformation, fitted.bar_deformation),
    }
    told = {
        what: (f"{100 * after:.3g}", f"{100 * before:.3g}")
        for what, (before, after, bar) in pairs.items()
        if after - before > (bar if math.isfinite(bar) else 0.0)
    }
    return ", ".join(
        f"{what} {after} against {before} %" for what, (after, before) in told.items() if after != before
    )


def no_test(entry: Calibration) -> str:
    """That held-out loads are training loads again, where any is, and what to do; else ""."""
    if not entry.repeated:
        return ""
    return (
        f"of the loads held out {len(entry.repeated)} are multiples of training loads, by load or by tissue, "
        "and test nothing: vary place, size or profile"
    )


def one_place(fit: Fit) -> str:
    """For which load alone the values are, where the rule differs between the loads; else ""."""
    if not fit.spread:
        return ""
    rules = ", ".join(f"{name} {ratio:.3g} times" for name, ratio in fit.spread.items())
    multiples = ", ".join(f"{fit.multiples[name]:.3g}" for name in fit.spread)
    return (
        f"the values hold for {shown(fit.where)} alone: between the loads the rule differs, {rules}; "
        f"the errors are those of {multiples} times the rule of each load; "
        "to paste values calibrate one tissue, body, support and mesh at a time"
    )


def not_measured(entry: Calibration) -> str:
    """That, and why, nothing is known of a finer mesh; "" where it is."""
    return f"mesh independence: not measured, because {entry.no_finer}" if entry.no_finer else ""


def left_out(entry: Calibration) -> str:
    """How many loads failed and are in no figure of a calibration; "" where none is."""
    return ", ".join(f"{len(labels)} of {study}" for study, labels in entry.lost.items())


def as_json(entries: Sequence[Calibration]) -> dict[str, dict[str, object]]:
    """Model -> its calibration as plain data."""
    return {entry.fit.model: dataclasses.asdict(entry) for entry in entries}


def as_toml(entries: Sequence[Calibration]) -> str:
    """Tables to paste into a study file: [vdm] for one model, a [models."NAME"] table each for several.

    Comments say which loads failed, why nothing is known of a finer mesh, what the loads do not tell, where the
    values hold for one load alone, where a fit does worse than the rule on the loads held out, and where these test
    nothing.
    """
    blocks = []
    for entry in entries:
        title = "vdm" if len(entries) == 1 else f'models."{entry.fit.model}"'
        lines = [f"{key} = {value:.6g}" for key, value in entry.fit.parameters.items()]
        warning = [f"# loads that failed are left out: {told}"] if (told := left_out(entry)) else []
        remarks = not_measured(entry), no_test(entry), entry.fit.kept, one_place(entry.fit)
        warning += [f"# {told}" for told in remarks if told]
        worse = worse_than_rule(entry.fit.by_rule, entry.fit.held_out)
        if worse:
            warning += [f"# worse than the rule on the loads held out: {worse}; the rule may serve better"]
        blocks.append("\n".join([*warning, f"[{title}]", *lines]))
    return "\n\n".join(blocks) + "\n"
