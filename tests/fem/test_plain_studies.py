"""The fast path against the plain one on every scene that is shipped, on coarse meshes: `fem-linear` and `fem`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest

from tests.fem.shapes import FIELDS
from tests.study.test_shipped_studies import NAMES, shipped
from vdmbench import models
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh import Mesh
from vdmbench.scene.result import ModelResult
from vdmbench.scene.scene import Scene, build_scene
from vdmbench.study.config import expand
from vdmbench.study.errors import InputError
from vdmbench.study.registry import split
from vdmbench.study.schema import Study

TOLERANCE = 1e-8
# Where slivers or fibres take ten digits, both paths are left with a residual of some 1e-10: 2e-7 was seen.
FLAT, STIFF, TOLERANCE_AT_EXTREMES = 1e5, 1e8, 1e-6
COARSENINGS = (2.0, 1.5, 1.0)  # of the largest mesh size of a study: the first on which its regions exist
QUICK = ("locking",)
PARTS = ("geometry", "tissue", "regions", "constraints", "gravity", "anisotropy", "inclusions")


def scenes(name: str) -> Iterator[tuple[str, Scene, tuple[str, ...], float]]:
    """Label, scene, volumetric models and tolerance of all cases of a study that differ there, at full load."""
    cases = expand(shipped(name))
    size = max(case.study.geometry.mesh_size for case in cases)
    meshes: dict[str, Mesh] = {}
    seen: set[str] = set()
    for case in cases:
        asked = {split(model)[0] for model in case.study.study.models}
        volumetric = tuple(model for model in ("fem-linear", "fem") if model in asked) or ("fem-linear",)
        scene = coarse_scene(case.study, size, meshes)
        told = repr([getattr(case.study, part) for part in PARTS])
        if told not in seen:
            seen.add(told)
            fibres = case.study.anisotropy
            extreme = (case.study.geometry.slivers or 0.0) >= FLAT or (fibres and fibres.contrast >= STIFF)
            yield case.label, scene, volumetric, TOLERANCE_AT_EXTREMES if extreme else TOLERANCE


def coarse_scene(study: Study, size: float, meshes: dict[str, Mesh]) -> Scene:
    """The study's scene on a coarse mesh, its history cut to its last load."""
    for factor in COARSENINGS:
        geometry = study.geometry.model_copy(update={"mesh_size": factor * size})
        coarse = study.model_copy(update={"geometry": geometry})
        try:
            if repr(geometry) not in meshes:
                meshes[repr(geometry)] = build_mesh(coarse.geometry)
            scene = build_scene(coarse, meshes[repr(geometry)])
        except InputError:  # too coarse for the body, or a region selects no node
            continue
        return dataclasses.replace(scene, load_factors=scene.load_factors[-1:])
    raise AssertionError(f"{study.study.name} has no scene")


def difference(plain: ModelResult, fast: ModelResult) -> float:
    """The largest of displacement, reactions, mean pressure and energy, each of its largest value."""
    found = []
    for name in FIELDS:
        ours, theirs = getattr(fast, name), getattr(plain, name)
        largest = np.abs(theirs).max()
        found.append(np.abs(ours - theirs).max() / largest if largest else np.abs(ours).max())
    return float(max(found))


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[] if n in QUICK else pytest.mark.slow) for n in NAMES]
)
def test_a_shipped_study_is_the_same_on_the_plain_path(name: str) -> None:
    compared = 0
    for label, scene, volumetric, tolerance in scenes(name):
        for model in volumetric:
            fast, plain = (models.run_model(scene, full) for full in (model, f"{model}:{models.PLAIN}"))
            assert plain.status[0].ok == fast.status[0].ok, f"{model}, {label}: {plain.status} {fast.status}"
            if fast.status[0].ok:
                assert difference(plain, fast) <= tolerance, f"{model}, {label}"
                compared += 1
    assert compared
