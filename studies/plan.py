"""From a study to the work it needs: cases, the meshes they share, and what is already there."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from . import models
from .keys import (
    answer_key,
    case_hash,
    load_key,
    model_setups,
    reference_keys,
    result_keys,
    setup_key,
    surface_setup_key,
)
from .meshing.geometry_spec import (
    DISTORTIONS,
    MAX_NODES,
    Geometry,
    area_and_volume,
    check_node_budget,
    expected_size,
    extents,
    file_digest,
    geometry_key,
)
from .meshing.mesh import Array, Mesh, MeshError
from .meshing.mesh_cache import mesh_path
from .model_name import split
from .result_cache import reference_path
from .run_directory import CASE_SUFFIX, case_path
from .sealed import is_sound
from .store import case_state
from .store import result_keys as stored_keys
from .study_file.config import ResolvedCase, geometry_error, geometry_of, resolved
from .study_file.schema import Study

SPLIT_FROM = 4  # cases: a group of fewer is not worth a second set-up
_DENSE = (
    "fem-condensed",
    "vdm-boundary",
    "mass-spring",
)  # whose set-ups are a large matrix each, dearest first


@dataclass(frozen=True)
class PlannedCase:
    """One case and what it needs. Cases with the same hash are the same work, done once."""

    hash: str
    label: str
    swept: Mapping[str, float | str]
    swept_units: Mapping[str, str]
    study: Study
    mesh: str  # key of its mesh
    body: str  # key of what cases must have in common to share any set-up
    setup: str  # key of what it shares with cases that differ in loads and VDM parameters only
    setups: Mapping[str, str]  # model -> key of its set-up
    load: str  # key of its loads up to a factor
    results: Mapping[str, str]  # model -> key of its result
    reference: str | None  # key of its reference on all mesh levels, of linear elements up to a factor
    finer: tuple[str, ...]  # keys of the same on more levels
    elements: Mapping[str, str]  # other linear elements -> key of their result up to a factor


@dataclass(frozen=True)
class Expected:
    """A mesh's surface nodes and tetrahedra, its body's box (3,) (3,) [m], and how far it may reach beyond [m]."""

    nodes: float
    tetrahedra: float
    low: Array
    high: Array
    reach: float

    @classmethod
    def of_mesh(cls, mesh: Mesh, *, volume: bool = True) -> Expected:
        """Of a mesh that is there; distortions move a node by an edge at most."""
        points = mesh.surface_points
        corners = points[mesh.triangles]
        reach = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
        size = float(len(points)), float(len(mesh.tetrahedra) if volume else 0)
        return cls(*size, points.min(axis=0), points.max(axis=0), float(reach))


@dataclass(frozen=True)
class PlannedMesh:
    """A mesh that one or more cases need."""

    key: str
    geometry: Geometry
    volume: bool
    file_hash: str = ""  # SHA-256 of the file that the body is from; "" of a built-in shape

    @property
    def label(self) -> str:
        """What to call it: by its file or shape, and the size of its elements where it is made to one."""
        geometry = self.geometry
        name = geometry.path.name if geometry.shape == "file" else geometry.shape
        if not geometry.has_own_tetrahedra:
            return f"mesh of {name} at {geometry.mesh_size * 1e3:.3g} mm"
        return f"mesh of {name}" + ("" if set(DISTORTIONS) & geometry.parameters.keys() else " as it is")

    @cached_property
    def expected(self) -> Expected:
        """What it will be, about; a file is read for it, and checked on the way.

        Raises
        ------
        MeshError
            a file that cannot be used.
        """
        geometry = self.geometry
        if geometry.shape != "file":
            area, inside = area_and_volume(geometry)
            high = np.array(extents(geometry)) / 2.0
        else:
            from .meshing.imported import (  # readers are slow to load
                imported_surface,
                imported_tetrahedra,
                named,
            )

            with named(geometry):
                if geometry.has_own_tetrahedra:
                    mesh = imported_tetrahedra(geometry, max_nodes=MAX_NODES)
                    return Expected.of_mesh(mesh, volume=self.volume)
                surface = imported_surface(geometry, volume=self.volume, max_nodes=MAX_NODES)
            area, inside = surface.area, surface.volume
            high = surface.points.max(axis=0)
        size = expected_size(area, inside if self.volume else 0.0, geometry.mesh_size)
        return Expected(*size, -high, high, geometry.mesh_size)


@dataclass(frozen=True)
class Plan:
    """All the work of a study; `fresh`: every case runs, and nothing that is stored is used, the meshes apart."""

    study: Study
    cases: tuple[PlannedCase, ...]
    meshes: Mapping[str, PlannedMesh]
    directory: Path
    cache: Path
    command: tuple[str, ...] = ()  # of vdmbench, that runs it again; () where none was given
    fresh: bool = False

    @cached_property
    def state(self) -> dict[str, str]:
        """Case hash -> "done", "stale", "failed", "damaged" or "missing"."""
        return {case.hash: case_state(self.directory, case.hash) for case in self.cases}

    @cached_property
    def in_order(self) -> list[PlannedCase]:
        """Each hash once; cases that share a set-up stand together, of these those that share a model's own.

        The models with the dearest set-ups come first in this. Of cases that share all those stand together whose
        loads are multiples of each other. Where the tissues of cases on one body differ in what surface models do
        not read, the first cases of these tissues decide in the same way which come after each other.
        """
        unique = list({case.hash: case for case in self.cases}.values())
        dense = {name: place for place, name in enumerate(_DENSE)}
        names = sorted(self.study.study.models, key=lambda name: dense.get(split(name)[0], len(dense)))
        surface = [name for name in names if not models.find(name)[0].volumetric]
        first = {case.setup: case for case in reversed(unique)}
        kinds = [
            [
                case.body,
                *(first[case.setup].setups[name] for name in surface),
                first[case.setup].load,
                case.setup,
                *(case.setups[name] for name in names),
                case.load,
            ]
            for case in unique
        ]
        ranks = [
            {key: rank for rank, key in enumerate(dict.fromkeys(column))}
            for column in zip(*kinds, strict=True)
        ]
        order = [[rank[key] for rank, key in zip(ranks, kind, strict=True)] for kind in kinds]
        return [unique[place] for place in sorted(range(len(unique)), key=order.__getitem__)]

    def is_done(self, case: PlannedCase) -> bool:
        """Whether a case's file is there, and its results may be used."""
        return not self.fresh and self.state[case.hash] == "done"

    def cases_to_run(self, shard: tuple[int, int] = (1, 1)) -> list[PlannedCase]:
        """The cases of a shard that are not done."""
        return [case for case in self.in_shard(shard) if not self.is_done(case)]

    def in_shard(self, shard: tuple[int, int]) -> list[PlannedCase]:
        """The cases in the i-th of n parts of equal size, by `shard` (i, n)."""
        number, parts = shard
        first, end = (len(self.in_order) * k // parts for k in (number - 1, number))
        return self.in_order[first:end]

    def groups(self, cases: Sequence[PlannedCase], jobs: int) -> list[list[PlannedCase]]:
        """The cases, in order, in groups that share set-ups, each for a worker that knows nothing of the others.

        Cases on one body stay together up to the share that each of `jobs` workers has of all; where they are
        more, they are divided between tissues. The largest are halved until each worker has a group.
        """
        share = -(-len(cases) // jobs)
        groups: list[list[PlannedCase]] = []
        for _, on_body in groupby(cases, key=lambda case: case.body):
            shares: dict[int, list[PlannedCase]] = {}
            before = 0
            for _, cases_of_tissue in groupby(on_body, key=lambda case: case.setup):
                part = list(cases_of_tissue)
                shares.setdefault(before // share, []).extend(part)
                before += len(part)
            groups += shares.values()
        while len(groups) < min(jobs, len(cases)):
            largest = max(range(len(groups)), key=lambda place: len(groups[place]))
            if len(groups[largest]) < SPLIT_FROM:
                break
            group = groups.pop(largest)
            groups += [group[: len(group) // 2], group[len(group) // 2 :]]
        return groups

    @cached_property
    def stored_results(self) -> dict[str, Path]:
        """Result key -> a case file of an earlier plan, or a stale one, that holds it."""
        if self.fresh:
            return {}
        kept = {case_path(self.directory, hash) for hash, state in self.state.items() if state == "done"}
        files = sorted((self.directory / "cases").glob(f"*{CASE_SUFFIX}"))
        return {key: path for path in files if path not in kept for key in stored_keys(path).values() if key}

    def reused(self, case: PlannedCase) -> dict[str, Path]:
        """Model -> the case file that its result is taken from."""
        found = {name: self.stored_results.get(key) for name, key in case.results.items()}
        return {name: path for name, path in found.items() if path is not None}

    def twins(self, case: PlannedCase) -> dict[str, PlannedCase]:
        """Model -> another case that is done, with the same result.

        They differ in what the model does not read, such as Poisson's ratio.
        """
        found = {name: self._done.get(key) for name, key in case.results.items()}
        return {name: twin for name, twin in found.items() if twin is not None and twin.hash != case.hash}

    @cached_property
    def _done(self) -> dict[str, PlannedCase]:
        """Result key -> the first case that is done and has it."""
        done = [case for case in self.in_order if self.is_done(case)]
        return {key: case for case in reversed(done) for key in case.results.values()}

    @cached_property
    def _is_sound(self) -> Callable[[Path], bool]:
        """`is_sound`, which reads a file, of each file once: many cases share one, and a plan is of one moment."""
        return cache(is_sound)

    def reference_cached(self, case: PlannedCase) -> bool:
        """Whether the cache holds the case's reference, maybe on more levels than it asks for."""
        keys = (case.reference, *case.finer) if case.reference is not None else ()
        return not self.fresh and any(self._is_sound(reference_path(self.cache, key)) for key in keys)

    def missing_meshes(self, cases: Sequence[PlannedCase]) -> list[PlannedMesh]:
        """The meshes that these cases need and the cache does not hold."""
        keys = dict.fromkeys(case.mesh for case in cases)
        return [self.meshes[key] for key in keys if not self._is_sound(mesh_path(self.cache, key))]

    def case_file(self, case: PlannedCase) -> Path:
        """Where the case is kept once it is done."""
        return case_path(self.directory, case.hash)


def make_plan(
    study: Study,
    cases: Sequence[ResolvedCase],
    directory: Path,
    cache: Path,
    command: tuple[str, ...] = (),
    *,
    fresh: bool = False,
) -> Plan:
    """Work out what a study needs. Meshes nothing.

    Raises
    ------
    StudyError
        a geometry that cannot be meshed as asked, found without meshing.
    """
    found: dict[str, PlannedMesh] = {}  # by what is asked for: a file is read for its key, once for all cases
    planned = []
    for case in cases:
        geometry, volume = geometry_of(case.study), needs_volume(case.study)
        asked = f"{geometry!r} {volume}"
        if asked not in found:
            try:
                found[asked] = _planned_mesh(geometry, volume)
            except MeshError as error:
                raise geometry_error(study, error) from error
        planned.append(_planned(case, found[asked].key))
    meshes = {mesh.key: mesh for mesh in found.values()}
    return Plan(study, tuple(planned), meshes, directory, cache, command, fresh)


def _planned_mesh(geometry: Geometry, volume: bool) -> PlannedMesh:
    if geometry.shape != "file":  # whose size is known only once it is read
        area, inside = area_and_volume(geometry)
        check_node_budget(area, inside if volume else 0.0, geometry.mesh_size, MAX_NODES)
    file_hash = file_digest(geometry.path) if geometry.shape == "file" else ""
    return PlannedMesh(geometry_key(geometry, volume=volume), geometry, volume, file_hash)


def needs_volume(study: Study) -> bool:
    """Whether any model of a study needs tetrahedra."""
    return any(models.find(name)[0].volumetric for name in study.study.models)


def _planned(case: ResolvedCase, mesh_key: str) -> PlannedCase:
    study = case.study
    results = result_keys(study, mesh_key)
    references = reference_keys(study, mesh_key)
    setup = setup_key(study, mesh_key)
    volumetric_only = all(models.find(name)[0].volumetric for name in study.study.models)
    return PlannedCase(
        hash=case_hash(study, mesh_key),
        label=case.label,
        swept=case.swept,
        swept_units=case.swept_units,
        study=study,
        mesh=mesh_key,
        body=setup if volumetric_only else surface_setup_key(study, mesh_key),
        setup=setup,
        setups=model_setups(study, mesh_key),
        load=load_key(study),
        results=results,
        reference=references[0] if references else None,
        finer=tuple(references[1:]),
        elements={
            other: answer_key(study, mesh_key, other)
            for other in study.study.models
            if other != study.study.reference and models.solves_together(other)
        },
    )


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
        "mesh": case.mesh,
        "setup": case.setup,
        "keys": dict(case.results),
        "setups": dict(case.setups),
        "reference_key": case.reference,
        "finer_keys": list(case.finer),
        "elements": dict(case.elements),
        "reference_stored": plan.reference_cached(case),
        "reuse": {name: str(path) for name, path in plan.reused(case).items()},
        "twins": {name: str(plan.case_file(twin)) for name, twin in plan.twins(case).items()},
        "file_hash": plan.meshes[case.mesh].file_hash,
        "fresh": plan.fresh,
    }


def task_groups(plan: Plan, cases: Sequence[PlannedCase], jobs: int) -> list[list[dict[str, Any]]]:
    """What each group's worker is given; the tasks have the number of their group."""
    groups = plan.groups(cases, jobs)
    return [[{**task_of(c, plan), "group": number} for c in group] for number, group in enumerate(groups)]
