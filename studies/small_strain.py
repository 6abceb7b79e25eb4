"""The small-strain limits of one case: every model along a rising load, against finite strain."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from . import models
from .case import ModelLimits, ModelResult, SmallStrainLimits
from .limits import SMALL, Change, LoadPath, LoadPoint, model_limits, with_bars
from .meshing.mesh import Array, Mask, Mesh
from .meshing.refine import inherit, refine
from .metrics import mean_indentation
from .scene import Scene, build_scene
from .study_file.config import raised, value_and_unit
from .study_file.schema import Study
from .surface_measures import Surface, relative_l2

STRAIN = "max_principal_strain"


def small_strain_limits(study: Study, scene: Scene) -> SmallStrainLimits:
    """Structural error and growth limits of every compared model of a study with [limits].

    Where the study has [uncertainty], a small load and one amid each model's limits are solved again with every
    tetrahedron split into eight. The changes of a departure, and of the reference's indentation and strain there,
    each its grid convergence index for two levels and second order, give the bars of the model's limits.
    """
    asked, reference = study.limits, study.study.reference
    if asked is None or reference is None:
        raise ValueError("a search for small-strain limits needs [limits] and a reference")
    names = [name for name in study.study.models if name != reference]
    start, unit = value_and_unit(study, asked.along)
    evaluator = _Evaluator(study, asked.along, scene, reference, names)
    path = LoadPath(evaluator.point, start)
    found = {name: model_limits(path, name, asked.thresholds) for name in names}
    if study.uncertainty is not None:
        amid = {name: factor for name, entry in found.items() if (factor := _amid(entry, path.start))}
        if amid:
            changes = evaluator.changes(path, amid)
            found = {name: with_bars(entry, path, name, changes[name]) for name, entry in found.items()}
    return SmallStrainLimits(asked.along, unit, found)


def _amid(entry: ModelLimits, start: float) -> float | None:
    """A factor amid the limits that were found: of few, so that models with limits close by share a solve."""
    found = [math.log2(limit.load / start) for limit in entry.limits if limit.state == "found"]
    return 2.0 ** (0.5 * round(2.0 * sum(found) / len(found))) if found else None


class _Evaluator:
    """Runs the models of one case at one value of the raised key."""

    def __init__(self, study: Study, along: str, scene: Scene, reference: str, names: Sequence[str]) -> None:
        self._study, self._along, self._scene = study, along, scene
        self._reference, self._names = reference, names
        self._surface = Surface(
            scene.mesh.surface_points, scene.mesh.triangles, scene.contact, scene.contact_force
        )

    def point(self, load: float) -> LoadPoint | None:
        """Every model at one load, None where the reference has no solution there."""
        scene = self._at(load, self._scene, self._scene.regions)
        reference = models.run_model(scene, self._reference)
        if not _solved(reference):
            return None
        results = {name: models.run_model(scene, name) for name in self._names}
        return self._point(load, reference, results)

    def changes(self, path: LoadPath, amid: Mapping[str, float]) -> dict[str, Change]:
        """What a refined mesh changes at `amid` times the study's load, by model; NaN where it has no solution."""
        mesh, parents = refine(self._scene.mesh)
        regions = {
            name: inherit(mask, self._scene.mesh, parents) for name, mask in self._scene.regions.items()
        }

        def refined(factor: float, names: Sequence[str]) -> LoadPoint | None:
            load = factor * path.start
            fine = self._at(load, self._scene, regions, mesh)
            coarse = self._at(load, self._scene, self._scene.regions)
            reference = models.run_model(fine, self._reference)
            if not _solved(reference):
                return None
            results = {
                name: models.run_model(fine if models.find(name)[0].volumetric else coarse, name)
                for name in names
            }
            return self._point(load, reference, results)

        small = refined(SMALL, self._names)
        if small is None:
            return dict.fromkeys(self._names, Change(*[math.nan] * 4))
        e0 = {name: abs(small.error[name] - path.structural_error(name)) for name in self._names}
        changes = {name: Change(e0[name], *[math.nan] * 3) for name in self._names}
        for factor in sorted(set(amid.values())):
            names = [name for name in amid if amid[name] == factor]
            large, own = refined(factor, names), path.at(factor)
            if large is None or own is None:
                continue
            for name in names:
                changes[name] = Change(
                    e0[name],
                    _change(large.error[name] - small.error[name], path.departure(name, factor)),
                    _change(large.indentation, own.indentation),
                    _change(large.strain, own.strain),
                )
        return changes

    def _point(self, load: float, reference: ModelResult, results: Mapping[str, ModelResult]) -> LoadPoint:
        """What was found, on the nodes of the case's own mesh, which come first on a refined one."""
        truth = reference.displacement[-1, : len(self._surface.points)]
        return LoadPoint(
            load,
            self._errors(results, truth),
            float(mean_indentation(self._surface, truth[None])[0]),
            float(reference.scalars[STRAIN][-1]) if STRAIN in reference.scalars else math.nan,
        )

    def _at(self, load: float, scene: Scene, regions: Mapping[str, Mask], mesh: Mesh | None = None) -> Scene:
        return build_scene(raised(self._study, self._along, load), mesh or scene.mesh, regions)

    def _errors(self, results: Mapping[str, ModelResult], reference: Array) -> dict[str, float]:
        n_nodes = len(self._surface.points)
        return {
            name: relative_l2(result.displacement[-1, :n_nodes], reference, self._surface.areas)
            if _solved(result)
            else math.nan
            for name, result in results.items()
        }


def _change(fine: float, coarse: float) -> float:
    """Relative change of a number; NaN of zero."""
    return abs(fine - coarse) / abs(coarse) if coarse else math.nan


def _solved(result: ModelResult) -> bool:
    return all(status.ok for status in result.status) and bool(np.isfinite(result.displacement[-1]).all())
