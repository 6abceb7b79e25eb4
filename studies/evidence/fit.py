"""Fits the parameters of the surface models to the reference on training loads, and tries them on others.

A parameter is fitted as a multiple of what the model's rule gives for the body at hand, so that a fit can be
carried to another mesh, tissue or body.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from solver_common.arrays import Array

from .. import models
from ..body.mesh_cache import mesh_from_cache
from ..body.surface_measures import Surface, relative_l2, rigid_motion_removed, weighted_norm
from ..measures.case import Run
from ..measures.metrics import DEFORMATION, VECTOR, full_load_step
from ..measures.uncertainty import reference_bar
from ..scene.result import ModelResult
from ..scene.scene import Scene, build_scene
from ..study.config import geometry_of
from ..study.registry import is_surface
from ..work.plan import Plan, PlannedCase, needs_volume
from .search import CalibrationError, Least, least

MODULI = {  # parameters that can be fitted -> the one whose rule gives the scale where it has none of its own
    "bulk_modulus": "",
    "connectivity_modulus": "",
    "foundation": "",
    "surface_tension": "",
    "stretch_stiffness": "surface_tension",
    "shear_modulus": "",
}
_SAME = 1e-6  # of a displacement: less is rounding, and that of solvers that iterate
_SAME_RULE = 1e-3  # of a parameter


@dataclass(frozen=True)
class Sample:
    """One load of one body: the scene with its full load alone, and what the reference answers to that."""

    label: str
    scene: Scene
    reference: Array  # (N, 3) m
    bars: Mapping[str, float]  # metric -> the reference's own error, NaN where not measured
    place: int  # of the load among the study's, from 0
    bodies: Mapping[str, str] = field(
        default_factory=dict
    )  # model -> key of its set-up; none where all share one

    @cached_property
    def surface(self) -> Surface:
        """The undeformed surface."""
        return Surface(self.scene.mesh.surface_points, self.scene.mesh.triangles)


@dataclass(frozen=True)
class Errors:
    """Relative L2 errors over a set of loads: mean and worst; bars: the reference's own error, its largest."""

    vector: float
    vector_worst: float
    deformation: float
    deformation_worst: float
    bar: float
    bar_deformation: float


@dataclass(frozen=True)
class Fit:
    """The fitted parameters of one model on one body."""

    model: str
    multiples: Mapping[str, float]  # parameter -> multiple of the rule's value
    parameters: Mapping[str, float]  # parameter -> value [SI] on body, tissue and mesh of the load `where`
    by_rule: Errors  # on the loads held out, before
    training: Errors
    held_out: Errors
    kept: str = ""  # which multiples are the rule's own because no load tells them; "" where none is
    where: str = ""  # label of the first training load
    # parameter whose rule differs between the loads -> its largest value over its least
    spread: Mapping[str, float] = field(default_factory=dict)


def samples_of(plan: Plan, run: Run) -> list[Sample]:
    """The finished cases of a run as samples, in the study's order.

    Raises
    ------
    CalibrationError
        no finished case with a reference.
    """
    planned = loads_of(plan)
    places = {key: place for place, key in enumerate(planned)}
    samples = []
    for case in run.cases:
        if case.reference is None:
            continue
        found = planned[case.hash]
        study = found.study
        mesh = mesh_from_cache(geometry_of(study), plan.cache, volume=needs_volume(study))
        step = full_load_step(case.load_factors)
        samples.append(
            Sample(
                case.label,
                dataclasses.replace(build_scene(study, mesh), load_factors=case.load_factors[[step]]),
                case.models[case.reference].displacement[step],
                {metric: reference_bar(case.reference_error, metric) for metric in (VECTOR, DEFORMATION)},
                places[case.hash],
                {want.name: want.body for want in found.wanted if not want.level},
            )
        )
    if not samples:
        raise CalibrationError("no case of this study is finished, so there is nothing to fit to")
    return samples


def loads_of(plan: Plan) -> dict[str, PlannedCase]:
    """The loads of a study by their case's hash, in the study's order, each once."""
    return {case.hash: case for case in plan.cases}


def split(samples: Sequence[Sample], loads: int, training: int | None) -> tuple[list[Sample], list[Sample]]:
    """(training, held out): of the first `training` of a study's loads and of the others; by default half of them.

    A load is on its side wherever others failed, so that none trains that was to be held out.

    Raises
    ------
    CalibrationError
        nothing would be left on one side.
    """
    count = count_of_training(loads, training)
    sides = [s for s in samples if s.place < count], [s for s in samples if s.place >= count]
    names = f"the first {count} loads, which train,", "the loads held out"
    for side, name in zip(sides, names, strict=True):
        if not side:
            raise CalibrationError(f"none of {name} is finished: put right what failed, or sweep others")
    return sides


def count_of_training(loads: int, training: int | None) -> int:
    """How many of a study's loads train; raises CalibrationError as `split` does."""
    count = (loads + 1) // 2 if training is None else training
    if not 0 < count < loads:
        raise CalibrationError(
            f"a calibration needs training loads and others held out: {count} of {loads} would train; "
            "sweep more loads, or set calibration.training"
        )
    return count


def surface_models(names: Sequence[str]) -> list[str]:
    """Those models of a study whose parameters can be fitted."""
    return list(filter(is_surface, names))


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
        names, why = (
            [key for key in asked if key in models.reads(name)],
            f"it reads none of {', '.join(asked)}",
        )
    else:
        given = {*parameters, *overrides.get(name, {})}
        names = [key for key in models.find(name)[0].by_rule if key not in given]
        why = "the study sets all of them"
    if not names:
        raise CalibrationError(f"{name} has no parameter left to fit: {why}")
    return tuple(names)


class Trial:
    """One model on one body: which of its parameters are fitted, and what their rule gives on each load's scene.

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
        vectors, deformations = [], []
        for sample, u in zip(self.samples, self.answers(multiples), strict=True):
            surface = sample.surface
            vectors.append(relative_l2(u, sample.reference, surface.areas))
            u, r = (rigid_motion_removed(surface.points, v, surface.areas) for v in (u, sample.reference))
            deformations.append(relative_l2(u, r, surface.areas))
        return Errors(
            float(np.mean(vectors)),
            max(vectors),
            float(np.mean(deformations)),
            max(deformations),
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


def fit(
    name: str, training: Sequence[Sample], held_out: Sequence[Sample], asked: Sequence[str] | None = None
) -> Fit:
    """Fit one model on training loads by the mean squared relative error of the displacement vector.

    Raises
    ------
    CalibrationError
        see `Trial`.
    """
    trial, unseen = Trial(name, training, asked), Trial(name, held_out, asked)
    found = least_error(trial)
    multiples = found.multiples
    return Fit(
        model=name,
        multiples=dict(zip(trial.names, multiples.tolist(), strict=True)),
        parameters=trial.values(multiples),
        by_rule=unseen.errors(np.ones(len(trial.names))),
        training=trial.errors(multiples),
        held_out=unseen.errors(multiples),
        kept=found.kept,
        where=training[0].label,
        spread=_spread(trial.names, np.array([*trial.rules, *unseen.rules])),
    )


def _spread(names: Sequence[str], rules: Array) -> dict[str, float]:
    """Parameter whose rule differs between (L, K) loads -> its largest value over its least."""
    low, high = rules.min(axis=0), rules.max(axis=0)
    return {
        name: float(most / least_of)
        for name, least_of, most in zip(names, low, high, strict=True)
        if least_of > 0.0 and most > (1.0 + _SAME_RULE) * least_of
    }


# --- the search, and what it found ---


def least_error(trial: Trial) -> Least:
    """The multiples of the rule's moduli with the least mean squared relative error."""
    areas = [sample.surface.areas for sample in trial.samples]
    norms = [
        weighted_norm(sample.reference, of_node) for sample, of_node in zip(trial.samples, areas, strict=True)
    ]

    def in_one(fields: Sequence[Array]) -> Array:
        """Displacements as one vector, whose squared distance from the references' is the error."""
        parts = [
            (np.sqrt(of_node)[:, None] * u / (norm or 1.0)).reshape(-1)
            for u, of_node, norm in zip(fields, areas, norms, strict=True)
        ]
        return np.concatenate(parts) / math.sqrt(len(parts))

    target = in_one([sample.reference for sample in trial.samples])
    return least(trial.name, trial.names, lambda multiples: in_one(trial.answers(multiples)), target)


def repeats(training: Trial, held_out: Trial, multiples: Array) -> list[str]:
    """Labels of loads held out to which reference and model answer a multiple of what they do to a training load.

    Their relative error is that of the training load: neither another size of a load tells a linear model from a
    linear reference, nor another Young's modulus where all loads are forces or all are movements.
    """
    known = list(zip(training.samples, training.answers(multiples), strict=True))
    pairs = zip(held_out.samples, held_out.answers(multiples), strict=True)
    return [
        sample.label
        for sample, u in pairs
        if any(_is_multiple((sample.reference, u), (other.reference, v)) for other, v in known)
    ]


def _is_multiple(pair: tuple[Array, Array], other: tuple[Array, Array]) -> bool:
    """Whether both fields are the same multiple of the other two."""
    (reference, _), (first, _) = pair, other
    if reference.shape != first.shape or not first.any():
        return False
    factor = float(np.vdot(first, reference) / np.vdot(first, first))
    return all(
        float(np.linalg.norm(u - factor * v)) <= _SAME * float(np.linalg.norm(u))
        for u, v in zip(pair, other, strict=True)
    )
