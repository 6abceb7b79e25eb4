"""From a study to the work it needs: cases, the meshes they share, and what is already there."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from . import models
from .config import ResolvedCase, case_inputs, geometry_of, resolved
from .geometry_spec import MAX_NODES, Geometry, area_and_volume, check_node_budget, geometry_key
from .mesh_cache import mesh_path
from .schema import Study
from .store import case_path, case_state


@dataclass(frozen=True)
class PlannedCase:
    """One case and what it needs. Cases with the same hash are the same work, done once."""

    hash: str
    label: str
    swept: Mapping[str, float | str]
    swept_units: Mapping[str, str]
    study: Study
    mesh: str  # key of its mesh


@dataclass(frozen=True)
class PlannedMesh:
    """A mesh that one or more cases need."""

    key: str
    geometry: Geometry
    volume: bool


@dataclass(frozen=True)
class Plan:
    """All the work of a study."""

    study: Study
    cases: tuple[PlannedCase, ...]
    meshes: Mapping[str, PlannedMesh]
    directory: Path
    cache: Path

    @cached_property
    def state(self) -> dict[str, str]:
        """Case hash -> "done", "failed", "damaged" or "missing"."""
        return {case.hash: case_state(self.directory, case.hash) for case in self.cases}

    def cases_to_run(self, shard: tuple[int, int] = (1, 1), *, fresh: bool = False) -> list[PlannedCase]:
        """The cases not done (`fresh`: all), each hash once; of `shard` (i, n) every n-th from the i-th."""
        unique = list({case.hash: case for case in self.cases}.values())
        mine = unique[shard[0] - 1 :: shard[1]]
        return [case for case in mine if fresh or self.state[case.hash] != "done"]

    def missing_meshes(self, cases: Sequence[PlannedCase]) -> list[PlannedMesh]:
        """The meshes that these cases need and the cache does not hold."""
        keys = dict.fromkeys(case.mesh for case in cases)
        return [self.meshes[key] for key in keys if not mesh_path(self.cache, key).exists()]

    def summary(self) -> dict[str, Any]:
        """The plan as plain data: `plan.json`, and what `vdmbench plan` prints."""
        missing = self.cases_to_run()
        skipped = []
        if not needs_volume(self.study):
            skipped.append("tetrahedra: no model of this study needs the inside")
        if len(self.cases) > len(self.state):
            skipped.append(f"{len(self.cases) - len(self.state)} cases that repeat another one of the sweep")
        if len(self.meshes) < len(self.state):
            skipped.append(f"{len(self.state) - len(self.meshes)} meshes: shared by cases")
        done = sum(state == "done" for state in self.state.values())
        if done:
            skipped.append(f"{done} cases: already in {self.directory}")
        cached = len(self.meshes) - len(self.missing_meshes(self.cases))
        if cached:
            skipped.append(f"{cached} meshes: already in the cache")
        return {
            "study": {
                "name": self.study.study.name,
                "title": self.study.study.title,
                "models": list(self.study.study.models),
                "reference": self.study.study.reference,
                "claims": list(self.study.study.claims),
            },
            "cases": [
                {
                    "hash": case.hash,
                    "label": case.label,
                    "swept": dict(case.swept),
                    "swept_units": dict(case.swept_units),
                    "state": self.state[case.hash],
                    "mesh": case.mesh,
                }
                for case in self.cases
            ],
            "meshes": len(self.meshes),
            "meshes_to_make": len(self.missing_meshes(missing)),
            "cases_to_run": len(missing),
            "skipped": skipped,
        }


def make_plan(study: Study, cases: Sequence[ResolvedCase], directory: Path, cache: Path) -> Plan:
    """Work out what a study needs. Meshes nothing.

    Raises
    ------
    MeshError
        a geometry that cannot be meshed as asked, found without meshing.
    """
    meshes: dict[str, PlannedMesh] = {}
    planned = []
    for case in cases:
        geometry, volume = geometry_of(case.study), needs_volume(case.study)
        if geometry.shape != "file":  # whose size is known only once it is read
            area, inside = area_and_volume(geometry)
            check_node_budget(area, inside if volume else 0.0, geometry.mesh_size, MAX_NODES)
        key = geometry_key(geometry, volume=volume)
        meshes[key] = PlannedMesh(key, geometry, volume)
        planned.append(
            PlannedCase(
                hash=case_hash(case.study, key),
                label=case.label,
                swept=case.swept,
                swept_units=case.swept_units,
                study=case.study,
                mesh=key,
            )
        )
    return Plan(study, tuple(planned), meshes, directory, cache)


def needs_volume(study: Study) -> bool:
    """Whether any model of a study needs tetrahedra."""
    return any(models.find(name)[0].volumetric for name in study.study.models)


def case_hash(study: Study, mesh_key: str) -> str:
    """SHA-256 (hex) over what decides a case's numbers: inputs, mesh, and each model's declared version."""
    content = {
        "inputs": {name: value for name, value in case_inputs(study).items() if name != "geometry"},
        "mesh": mesh_key,
        "models": {name: models.find(name)[0].version for name in study.study.models},
        "reference": study.study.reference,
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def task_of(case: PlannedCase, plan: Plan) -> dict[str, Any]:
    """What a worker is given, as plain JSON."""
    return {
        "id": case.hash,
        "label": case.label,
        "swept": dict(case.swept),
        "swept_units": dict(case.swept_units),
        "study": resolved(case.study),
        "path": str(case_path(plan.directory, case.hash)),
        "cache": str(plan.cache),
    }
