"""From a study to the work that it needs: cases, shared meshes, and existing files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from .. import models
from ..body.mesh_cache import mesh_path, read_mesh
from ..machine import cache_directory, is_sound, plain, results_directory
from ..study.config import ResolvedCase, expand, geometry_error, resolved
from ..study.errors import MeshError
from ..study.registry import Size
from ..study.schema import Study
from ..study.shapes import (
    FileBody,
    Geometry,
    Shape,
    check_node_budget,
    expected_size,
    file_digest,
    geometry_key,
)
from ..study.sweep import variations
from .keys import Wanted, case_hash, wanted


@dataclass(frozen=True, kw_only=True)
class PlannedCase(ResolvedCase):
    """One case and its needs, which are computed on demand. Cases with equal hashes are the same work."""

    hash: str
    mesh: str  # key of its mesh
    values: Mapping[str, float] = field(default_factory=dict)  # inputs of a variation: key -> value

    def as_json(self) -> dict[str, Any]:
        """The case as plain JSON for a worker; `vdmbench.store.plain.typed` reads it back."""
        return plain(self, without=("study",)) | {"study": resolved(self.study)}

    @cached_property
    def wanted(self) -> tuple[Wanted, ...]:
        """The needed answers of every model, and of the reference on every level."""
        return tuple(wanted(self.study, self.mesh))

    @cached_property
    def variations(self) -> tuple[PlannedCase, ...]:
        """The case with other values of its uncertain inputs, if any."""
        if self.study.inputs is None or self.values:
            return ()
        found = []
        for varied in variations(self.study)[0]:
            label = ", ".join(filter(None, (self.label, varied.label)))
            values = {key: float(value) for key, value in varied.swept.items()}
            found.append(replace(self, hash="", label=label, study=varied.study, values=values))
        return tuple(found)

    @property
    def parts(self) -> list[PlannedCase]:
        """The case and its variations."""
        return [self, *self.variations]

    def want(self, name: str) -> Wanted:
        """The needed answers of one model on its own mesh."""
        return next(want for want in self.wanted if (want.name, want.level) == (name, 0))


@dataclass(frozen=True)
class PlannedMesh:
    """A mesh that one or more cases need."""

    key: str
    geometry: Geometry
    volume: bool
    path: Path  # in the cache
    file_hash: str = ""  # SHA-256 of the body's file; "" for a built-in shape

    @property
    def label(self) -> str:
        """A name for messages: file or shape, and the element size if it is meshed to one."""
        geometry = self.geometry
        name = geometry.path.name if isinstance(geometry, FileBody) else geometry.shape
        if not geometry.has_own_tetrahedra:
            return f"mesh of {name} at {(geometry.mesh_size or 0.0) * 1e3:.3g} mm"
        return f"mesh of {name}" + ("" if geometry.slivers or geometry.perturbation else " as it is")

    @cached_property
    def size(self) -> Size:
        """Its size, or the expected one; a body's file is read and checked for it.

        Raises
        ------
        MeshError
            an unusable file.
        """
        geometry = self.geometry
        mesh = read_mesh(self.path)
        if mesh is None and isinstance(geometry, Shape):
            area, inside = geometry.area_and_volume()
        elif mesh is None:
            assert isinstance(geometry, FileBody)
            from ..body.imported import imported_surface, imported_tetrahedra, named

            with named(geometry):
                if geometry.has_own_tetrahedra:
                    mesh = imported_tetrahedra(geometry)
                else:
                    surface, _ = imported_surface(geometry, volume=self.volume)
                    area, inside = surface.area, surface.volume
        if mesh is not None:
            return Size(float(len(mesh.surface_points)), float(len(mesh.tetrahedra) if self.volume else 0))
        return Size(*expected_size(area, inside if self.volume else 0.0, geometry.mesh_size or 0.0))


@dataclass(frozen=True)
class Plan:
    """All the work of a study; if `fresh`, every case runs, and only meshes are used from the cache."""

    study: Study
    cases: tuple[PlannedCase, ...]
    meshes: Mapping[str, PlannedMesh]
    directory: Path
    cache: Path
    command: tuple[str, ...] = ()  # arguments of vdmbench that repeat it; () if unknown
    fresh: bool = False

    @cached_property
    def state(self) -> dict[str, str]:
        """Case hash -> "done", "failed", "damaged" or "missing"."""
        from ..store.cases import case_state  # HDF5 is slow to load, and not needed for a check

        return {case.hash: case_state(self.directory, case.hash, case.label) for case in self.cases}

    @cached_property
    def in_order(self) -> list[PlannedCase]:
        """The cases, each hash once."""
        return list({case.hash: case for case in self.cases}.values())

    def is_done(self, case: PlannedCase) -> bool:
        """Whether a case's file exists and may be used."""
        return not self.fresh and self.state[case.hash] == "done"

    def cases_to_run(self, shard: tuple[int, int] = (1, 1)) -> list[PlannedCase]:
        """The unfinished cases; of `shard` (i, n) those in the i-th of n equal parts."""
        return [case for case in self.in_shard(shard) if not self.is_done(case)]

    def in_shard(self, shard: tuple[int, int]) -> list[PlannedCase]:
        """The cases in the i-th of n equal parts, by `shard` (i, n)."""
        number, parts = shard
        first, end = (len(self.in_order) * k // parts for k in (number - 1, number))
        return self.in_order[first:end]

    def has(self, path: Path) -> bool:
        """Whether a file is in the cache and may be used."""
        return not self.fresh and self.is_sound(path)

    @cached_property
    def is_sound(self) -> Callable[[Path], bool]:
        """`is_sound` with its results remembered: many cases share a file, and a plan is of one moment."""
        return cache(is_sound)

    def missing_meshes(self, cases: Sequence[PlannedCase]) -> list[PlannedMesh]:
        """The meshes that these cases need and the cache lacks."""
        keys = dict.fromkeys(case.mesh for case in cases)
        return [self.meshes[key] for key in keys if not self.is_sound(self.meshes[key].path)]

    def case_file(self, case: PlannedCase) -> Path:
        """Path of the finished case."""
        from ..store.run_directory import case_path

        return case_path(self.directory, case.hash, case.label)


def make_plan(
    study: Study,
    directory: Path | None = None,
    cache: Path | None = None,
    command: tuple[str, ...] = (),
    *,
    fresh: bool = False,
) -> Plan:
    """Work out the needs of all cases of a study, by default in results/runs/NAME, without meshing.

    Raises
    ------
    StudyError
        a geometry that cannot be meshed as asked, as far as is known without meshing.
    """
    directory = directory or results_directory() / "runs" / study.study.name
    cache = cache or cache_directory()
    found: dict[str, PlannedMesh] = {}  # by geometry: a file is read once for the key of all cases
    planned = []
    for case in expand(study):
        geometry, volume = case.study.geometry, needs_volume(case.study)
        asked = f"{geometry!r} {volume}"
        if asked not in found:
            try:
                found[asked] = _planned_mesh(geometry, volume, cache)
            except MeshError as error:
                raise geometry_error(study, error) from error
        mesh = found[asked].key
        planned.append(PlannedCase(**vars(case), hash=case_hash(case.study, mesh), mesh=mesh))
    meshes = {mesh.key: mesh for mesh in found.values()}
    return Plan(study, tuple(planned), meshes, directory, cache, command, fresh)


def _planned_mesh(geometry: Geometry, volume: bool, cache: Path) -> PlannedMesh:
    if isinstance(geometry, Shape):  # the size of a file is not known before reading it
        area, inside = geometry.area_and_volume()
        check_node_budget(area, inside if volume else 0.0, geometry.mesh_size)
    file_hash = file_digest(geometry.path) if isinstance(geometry, FileBody) else ""
    key = geometry_key(geometry, volume=volume)
    return PlannedMesh(key, geometry, volume, mesh_path(cache, key), file_hash)


def needs_volume(study: Study) -> bool:
    """Whether any model of a study needs tetrahedra, or an inclusion does."""
    found = {name: models.find(name)[0] for name in study.study.models}
    knowing = study.inclusions and {
        name for name, model in found.items() if "inclusions" in model.takes
    }.difference(study.study.homogeneous)
    return bool(knowing) or any(model.volumetric for model in found.values())
