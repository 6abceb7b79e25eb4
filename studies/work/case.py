"""One case from the answers of its models: results, metrics, error bars and what was measured, in one file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from solver_common.arrays import Array

from ..body.refine import Hierarchy
from ..body.surface_measures import Surface
from ..measures.case import CaseResult
from ..measures.measurement import Measurement, hold_against, input_spread, step_rms
from ..measures.metrics import History, evaluate_all, full_load_step
from ..measures.pushed import Answer
from ..measures.reference import own_error
from ..models import find
from ..scene.result import ModelResult, answered, steps_of
from ..scene.scene import Scene, build_scene
from ..store.cases import write_case
from ..store.plain import typed
from ..study.files import without_folders
from ..study.registry import REFINED
from ..study.schema import Study
from .cache import combined, stored_answer
from .keys import Wanted
from .plan import PlannedCase
from .provenance import provenance
from .reached import at_what_was_reached
from .small_strain import small_strain_limits

Payload = Mapping[str, Any]
Stored = Callable[[str], ModelResult]  # key -> answer


@lru_cache(maxsize=64)  # per worker: cases of one body share answers
def _stored(cache: Path, key: str) -> ModelResult:
    return stored_answer(cache, key)


def make_case(payload: Payload, meshes: Callable[[int], Hierarchy]) -> None:
    """Write one case, from a payload of `vdmbench.work.tasks.case_payload`.

    Parameters
    ----------
    meshes : gives its mesh and the refinements up to a level

    Raises
    ------
    OSError
        an answer that existed is gone; disk full or read-only.
    """
    case = typed(PlannedCase, payload["case"])
    study, mesh = case.study, meshes(0).finest
    scene = build_scene(study, mesh)
    surface = scene.surface
    stored = partial(_stored, Path(payload["cache"]))
    found = [(want, _result(want, scene, stored)) for want in case.wanted]
    coarse = reference = study.study.reference
    places, found = at_what_was_reached(study, scene, found, meshes)
    factors, asked = scene.factors_at(places), np.flatnonzero(places % 1.0 == 0.0)
    results = {want.name: result for want, result in found if want.level == 0}
    levels = [result for want, result in found if want.name == reference]
    if reference is not None and len(levels) > 1:
        reference += REFINED
        results[reference] = levels[-1]

    linear = {want.name for want in case.wanted if want.scales}
    answers = {
        name: Answer.of(steps_of(result, asked), linear=name.removesuffix(REFINED) in linear)
        for name, result in results.items()
    }
    names = {id(result): name for name, result in results.items()}
    of_levels = [
        (names.get(id(one), ""), Answer.of(steps_of(one, asked), linear=coarse in linear)) for one in levels
    ]
    varied, spread, varied_of = partial(_varied, case, scene, stored), None, {}
    if study.inputs is not None:
        step = full_load_step(scene.load_factors)
        own = {name: one.displacement[step] for name, one in answers.items()}
        spread = input_spread(
            study, surface, own, lambda name: [one.displacement[step] for one in varied(name)]
        )
        varied_of = {name: partial(varied, name) for name in results}
    measurement = hold_against(study, mesh, answers, of_levels, varied_of)
    if measurement is not None:
        of_asked = [replace(one, step=int(asked[one.step])) for one in measurement.quantities]
        measurement = replace(measurement, quantities=of_asked)
    metrics = compare(surface, results, factors, reference, measurement)
    file_hash = payload["file_hash"]
    write_case(
        Path(payload["path"]),
        CaseResult(
            hash=case.hash,
            label=case.label,
            swept=without_folders(case.swept),
            swept_units=case.swept_units,
            study=Study.model_validate(without_folders(payload["case"]["study"])),
            provenance=provenance(mesh) | ({"geometry_file_hash": file_hash} if file_hash else {}),
            points=mesh.surface_points,
            triangles=mesh.triangles,
            load_factors=factors,
            regions=scene.regions,
            models=results,
            metrics=metrics,
            reference=reference,
            # of mesh levels, finest first
            reference_error=own_error(surface, levels[::-1], factors) if len(levels) > 1 else {},
            small_strain=small_strain_limits(study, mesh) if study.limits is not None else None,
            measurement=measurement,
            inputs=spread,
            moved=mesh.moved,
            mesh_quality={
                **mesh.quality,
                "tetrahedra": len(mesh.tetrahedra),
                "surface_nodes": len(mesh.surface_nodes),
            },
        ),
    )


def _result(wanted: Wanted, scene: Scene, stored: Stored) -> ModelResult:
    answers = [stored(key) for key in wanted.answers]
    if not wanted.scales:
        return answers[0]
    datum = 0.0 if find(wanted.name)[0].volumetric else scene.environment_pressure
    return combined(answers, wanted.scales, scene.mesh, datum)


def _varied(case: PlannedCase, scene: Scene, stored: Stored, name: str) -> list[Answer]:
    """A model's answers to the variations of the inputs; the refined reference answers on the case's own mesh."""
    found = []
    for part in case.variations:
        want = part.want(name.removesuffix(REFINED))
        result = answered(_result(want, scene, stored))
        found.append(Answer.of(result, linear=bool(want.scales), values=part.values))
    return found


def compare(
    surface: Surface,
    results: Mapping[str, ModelResult],
    load_factors: Array,
    reference: str | None,
    measurement: Measurement | None = None,
) -> dict[str, dict[str, Array]]:
    """Every metric of every model; the reference itself has those without comparison."""
    histories = {
        name: History(
            result.displacement,
            result.reaction_force,
            load_factors,
            volume=result.volume,
            measurement=step_rms(measurement, name, len(load_factors)) if measurement else None,
        )
        for name, result in results.items()
    }
    return evaluate_all(surface, histories, reference)
