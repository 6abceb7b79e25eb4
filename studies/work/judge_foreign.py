"""Judges a result of another program like a model of the study, with the same measures and page."""

from __future__ import annotations

import dataclasses

from solver_common.solution import CONVERGED, Status

from ..body.mesh import Mesh
from ..body.surface_measures import enclosed_volumes
from ..measures.case import CaseResult, Run
from ..measures.foreign import Foreign
from ..measures.measurement import hold_against
from ..measures.pushed import Answer
from ..scene.result import ModelResult, unanswered
from ..scene.scene import build_scene
from ..study.schema import Study
from .case import compare

NO_STEP = Status("not-given", "the file holds the largest load only", "")


def judged(run: Run, study: Study, mesh: Mesh, name: str, foreign: Foreign) -> Run:
    """A run of one case, with another program's result at the largest load beside its models.

    Parameters
    ----------
    study : of the case
    mesh : its mesh
    name : of the program, unlike any model of the run
    """
    (case,) = run.cases
    result = _as_result(case, mesh, foreign)
    scene = build_scene(study, mesh)
    results = {name: result}
    if case.reference is not None:
        results[case.reference] = case.models[case.reference]
    own = hold_against(study, mesh, {name: Answer(result.displacement, result.reaction_force)})
    measurement = case.measurement
    if own is not None and measurement is not None:
        measurement = dataclasses.replace(
            measurement,
            simulated={name: own.simulated[name], **measurement.simulated},
            numerical={name: own.numerical[name], **measurement.numerical},
        )
    metrics = compare(scene.surface, results, scene.load_factors, case.reference)[name]
    if own is not None:  # the reference is compared with the measurement already
        metrics = compare(scene.surface, {name: result}, scene.load_factors, None, own)[name] | metrics
    with_it = dataclasses.replace(
        case,
        models={name: result, **case.models},
        metrics={name: metrics, **case.metrics},
        measurement=measurement,
    )
    about = run.study.study.model_copy(update={"models": (name, *run.study.study.models)})
    study = run.study.model_copy(update={"study": about})
    return dataclasses.replace(run, study=study, cases=[with_it], told=None)  # it lacks the other program


def _as_result(case: CaseResult, mesh: Mesh, foreign: Foreign) -> ModelResult:
    """The file's state as a load history with only the largest load solved, at unknown cost."""
    status = [NO_STEP] * len(case.load_factors)
    status[case.full_load] = CONVERGED
    result = unanswered(status, len(mesh.surface_points), "")
    result.displacement[case.full_load] = foreign.displacement
    return dataclasses.replace(
        result,
        volume=enclosed_volumes(mesh.surface_points + result.displacement, mesh.triangles),
        parameters={
            "exact_nodes": foreign.exact,
            "mapping_distance": foreign.distance,
            "mapping_error": foreign.bend,
        },
    )
