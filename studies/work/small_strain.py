"""The small-strain limits of one case: every model along a rising load, against finite strain."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from solver_common.arrays import Array

from .. import models
from ..body.mesh import Mesh
from ..body.refine import Hierarchy, refined
from ..body.surface_measures import relative_l2
from ..measures.case import ModelLimits
from ..measures.limits import SMALL, LoadPath, LoadPoint, model_limits, on_finer_mesh
from ..measures.metrics import mean_indentation
from ..measures.reference import level_scene
from ..scene.result import ModelResult
from ..scene.scene import Scene, build_scene
from ..study.schema import Study

STRAIN, LARGEST_STRAIN = "p95_principal_strain", "max_principal_strain"
EXPECTED_LOADS = 30  # of a search


def small_strain_limits(study: Study, mesh: Mesh) -> dict[str, ModelLimits]:
    """Structural error and growth limits of every compared model of a study with [limits].

    If the study has [uncertainty], a small load and that of each limit are solved again with every tetrahedron
    split into eight. The limits are then those of the refined mesh, and the change gives their bars. Surface
    models stay on the case's mesh.
    """
    asked, reference = study.limits, study.study.reference
    if asked is None or reference is None:
        raise ValueError("a search for small-strain limits needs [limits] and a reference")
    names = [name for name in study.study.models if name != reference]
    path = LoadPath(_Evaluator(study, Hierarchy((mesh,)), reference))
    found = {name: model_limits(path, name, asked.thresholds) for name in names}
    if study.uncertainty is not None:
        fine = LoadPath(_Evaluator(study, refined(mesh, 1), reference))
        limits = [limit for entry in found.values() for limit in entry.limits if limit.state == "found"]
        for factor in sorted({SMALL, *(limit.load for limit in limits)}):
            fine.at(factor)  # rising, so that the reference continues from each to the next
        found = {name: on_finer_mesh(entry, path, fine, name) for name, entry in found.items()}
    return found


class _Evaluator:
    """Runs the reference of one case at a factor of its loads, on the finest mesh, and the other models."""

    def __init__(self, study: Study, meshes: Hierarchy, reference: str) -> None:
        self._reference = reference
        self._own = build_scene(study, meshes.meshes[0])
        self._inside = level_scene(study, meshes) if meshes.parents else self._own
        self._set_up: dict[str, models.Prepared] = {}
        self._areas = self._own.surface.areas

    def __call__(self, factor: float) -> LoadPoint | None:
        """Every model at one load, volumetric ones on the finest mesh; None where the reference has no solution."""
        own, inside = (scene.raised(factor) for scene in (self._own, self._inside))
        reference = self._answer(inside, self._reference)
        if not _solved(reference):
            return None
        return LoadPoint(
            _Errors(partial(self._error, own, inside, reference.displacement[-1])),
            float(mean_indentation(inside.surface, reference.displacement[-1:])[0]),
            *(float(reference.scalars.get(name, [math.nan])[-1]) for name in (STRAIN, LARGEST_STRAIN)),
        )

    def _error(self, own: Scene, inside: Scene, reference: Array, name: str) -> float:
        """Error on the nodes of the case's own mesh, which come first on a refined one."""
        result = self._answer(inside if models.find(name)[0].volumetric else own, name)
        if not _solved(result):
            return math.nan
        n_nodes = len(self._areas)
        return relative_l2(result.displacement[-1, :n_nodes], reference[:n_nodes], self._areas)

    def _answer(self, scene: Scene, name: str) -> ModelResult:
        """One set-up answers all loads that superpose or lie on one rising path; else each load has its own."""
        model, solver = models.find(name)
        weighs = scene.gravity.any() and not model.volumetric  # a surface model's set-up includes the weight
        if weighs or (solver not in model.superposes and model.continues is None):
            return models.run_model(scene, name)
        if name not in self._set_up:
            self._set_up[name] = models.Prepared(scene, name, EXPECTED_LOADS, onward=True)
        return self._set_up[name].answer(scene.loads)


class _Errors(dict[str, float]):
    """Errors of models at one load, each computed at its first use: no search needs all at every load."""

    def __init__(self, run: Callable[[str], float]) -> None:
        self._run = run

    def __missing__(self, name: str) -> float:
        self[name] = self._run(name)
        return self[name]


def _solved(result: ModelResult) -> bool:
    return all(status.ok for status in result.status) and bool(np.isfinite(result.displacement[-1]).all())
