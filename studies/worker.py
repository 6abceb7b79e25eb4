"""What a worker process does: make one mesh, or run cases from their mesh to their files."""

from __future__ import annotations

import dataclasses
import platform
import subprocess
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from . import models
from .case import CaseResult, MetricSeries, ModelResult
from .execute import AGAIN
from .hdf5 import StoreError
from .keys import loads_of
from .meshing.geometry_spec import Geometry
from .meshing.mesh import Mesh
from .meshing.mesh_cache import mesh_from_cache
from .metrics import METRICS, History
from .model_name import REFINED
from .plan import needs_volume
from .processors import processor_name
from .proportional import Answer, Comparisons
from .reference import own_error, refined_levels, require_converged
from .result_cache import read_reference, reference_path, write_reference
from .scene import Scene, build_scene
from .sealed import is_sound
from .setups import let_go, needed_again, next_turn, next_uses, shared, sharing
from .small_strain import small_strain_limits
from .store import read_case, write_case
from .study_file.config import geometry_of
from .study_file.folders import swept_without_folders, without_folders
from .study_file.schema import Study
from .surface_measures import Surface

Task = Mapping[str, Any]
_MOST_BYTES = 1 << 28  # of results that wait in memory for cases to come
PACKAGES = (
    "vdmbench",
    "numpy",
    "scipy",
    "scikit-fem",
    "gmsh",
    "meshio",
    "pyvista",
    "h5py",
    "rslab",
    "cholespy",
    "numba",
    "pyamg",
)


def make_mesh(task: Task) -> None:
    """Put one mesh into the cache."""
    geometry = Geometry(task["shape"], task["mesh_size"], task["parameters"])
    mesh_from_cache(geometry, Path(task["cache"]), volume=task["volume"])


def run_case(task: Task) -> None:
    """Mesh, scene, every model, metrics, one file. What is known already is taken as it is.

    Raises
    ------
    TaskError
        the reference failed, so that there is nothing to compare with.
    """
    group = _group or _Group((task,), at=task["setup"])
    group.reach(task)
    next_turn()
    study, scene = group.scenes.pop(task["id"]) if task["id"] in group.scenes else _built(task)
    mesh, reference = scene.mesh, study.study.reference
    known = _known(task, group)
    group.begin(task)
    levels: list[ModelResult] = []
    if reference is not None:
        levels = _reference_levels(study, scene, task, known, group)
        known[reference] = levels[0]
    results = {
        name: known.get(name) or _result(study, scene, task, name, group) for name in study.study.models
    }
    results = {name: dataclasses.replace(result, key=task["keys"][name]) for name, result in results.items()}
    group.keep(task, results)
    if reference is not None and len(levels) > 1:
        reference += REFINED
        results[reference] = levels[-1]
    metrics = compare(scene, results, reference)
    small_strain = None
    if study.limits is not None:
        with sharing():  # its many loads share their set-ups too
            small_strain = small_strain_limits(study, scene)
    write_case(
        Path(task["path"]),
        CaseResult(
            hash=task["id"],
            label=task["label"],
            swept=swept_without_folders(task["swept"]),
            swept_units=task["swept_units"],
            resolved=without_folders(task["study"]),
            provenance=provenance(mesh)
            | ({"geometry_file_hash": found} if (found := task["file_hash"]) else {}),
            points=mesh.surface_points,
            triangles=mesh.triangles,
            load_factors=scene.load_factors,
            regions=scene.regions,
            models=results,
            metrics=metrics,
            reference=reference,
            reference_error=_reference_error(scene, levels, metrics.get(study.study.reference or "", {})),
            small_strain=small_strain,
            mesh_quality={
                **mesh.quality,
                "tetrahedra": len(mesh.tetrahedra),
                "surface_nodes": len(mesh.surface_nodes),
            },
        ),
    )


@dataclass
class _Group:
    """What cases that run one after the other know of each other.

    Attributes
    ----------
    tasks : the cases; those of one volumetric set-up stand together
    at : that set-up's key, of the case that was reached last
    scenes : case -> its study and scene, of cases to come on this set-up
    answers : key of linear elements or of a reference -> what was solved on it, or read from the cache
    stored : keys of those references that the cache holds
    to_come : result key -> how many cases to come have it
    results : result key -> result, of cases done, as long as one to come has it
    written : result key -> case file, of results that there was no room for
    used_again : case and model -> in how many turns its set-up is asked for again, where it is kept for that
    """

    tasks: Sequence[Task]
    at: str = ""
    scenes: dict[str, tuple[Study, Scene]] = field(default_factory=dict)
    answers: dict[str, Answer] = field(default_factory=dict)
    stored: set[str] = field(default_factory=set)
    to_come: Counter[str] = field(default_factory=Counter)
    results: dict[str, ModelResult] = field(default_factory=dict)
    written: dict[str, str] = field(default_factory=dict)
    used_again: dict[tuple[str, str], int] = field(default_factory=dict)

    @classmethod
    def of(cls, tasks: Sequence[Task]) -> _Group:
        """Of tasks that will run in this order."""
        group = cls(tasks, to_come=Counter(key for task in tasks for key in task["keys"].values()))
        for name in tasks[0]["keys"]:
            solved: dict[str, int] = {}  # result key -> the turn that solves it
            for turn, task in enumerate(tasks):
                if name not in {**task["reuse"], **task["twins"]}:
                    solved.setdefault(task["keys"][name], turn)
            turns = list(solved.values())
            for turn, place in zip(turns, next_uses([tasks[k]["setups"][name] for k in turns]), strict=True):
                if place is not None:
                    group.used_again[tasks[turn]["id"], name] = turns[place] - turn
        return group

    def reach(self, task: Task) -> None:
        """Before a case: where it is the first on a volumetric set-up, what linear elements solve for all on it.

        What cannot be done for all, because a scene or a solve fails, each case finds out for itself.
        """
        if task["setup"] == self.at:
            return
        self.at = task["setup"]
        for known in (self.scenes, self.answers, self.stored):
            known.clear()
        let_go()
        with suppress(ValueError):
            _solve_ahead([each for each in self.tasks if each["setup"] == self.at], self)

    def begin(self, task: Task) -> None:
        """Let go of results that only this case had left to wait for."""
        self.to_come.subtract(task["keys"].values())
        self.results = {key: result for key, result in self.results.items() if self.to_come[key] > 0}

    def keep(self, task: Task, results: Mapping[str, ModelResult]) -> None:
        """Remember a case's results for cases to come; beyond `_MOST_BYTES` only where they will be found."""
        for result in results.values():
            if self.to_come[result.key] > 0 and result.key not in self.results:
                size = result.displacement.nbytes + result.reaction_force.nbytes
                if (len(self.results) + 1) * size <= _MOST_BYTES:
                    self.results[result.key] = result
                else:
                    self.written[result.key] = task["path"]


_group: _Group | None = None  # inside `share`


@contextmanager
def share(tasks: Sequence[Task]) -> Iterator[Callable[[Task], None]]:
    """Around cases on one body: one set-up each, of those on one volumetric set-up one solve of all their loads.

    Gives what to call before each of them, which does what it and those after it share.
    """
    global _group
    _group = _Group.of(tasks)
    try:
        with sharing():
            yield _group.reach
    finally:
        _group = None


def _solve_ahead(tasks: Sequence[Task], group: _Group) -> None:
    """What linear elements have to solve for the cases: of loads that are multiples of each other the first."""
    study = tasks[0]["study"]["study"]
    for name in filter(models.solves_together, study["models"]):
        is_reference = name == study.get("reference")
        first: dict[str, Task] = {}
        for task in tasks:
            if is_reference:
                first.setdefault(task["reference_key"], task)
            elif name not in {**task["reuse"], **task["twins"]}:
                first.setdefault(task["elements"][name], task)
        missing = {k: task for k, task in first.items() if not (is_reference and _reference_is_there(task))}
        if len(missing) > 1:
            _solve_together(name, missing, group, is_reference=is_reference)


def _solve_together(name: str, tasks: Mapping[str, Task], group: _Group, *, is_reference: bool) -> None:
    """The answers by their keys, to the loads of one case each; none but the reference's where a step fails."""
    group.scenes |= {task["id"]: _built(task) for task in tasks.values() if task["id"] not in group.scenes}
    studies, scenes = zip(*(group.scenes[task["id"]] for task in tasks.values()), strict=True)
    results = models.run_together(scenes, name)
    levels = [[result] for result in results]
    if is_reference:
        for result in results:
            require_converged(name, result)
        finer = refined_levels(studies, scenes, name, [_n_levels(study) for study in studies])
        levels = [[result, *others] for result, others in zip(results, finer, strict=True)]
    elif not all(status.ok for result in results for status in result.status):
        return
    for key, study, scene, found in zip(tasks, studies, scenes, levels, strict=True):
        group.answers[key] = Answer(found, loads_of(study), scene.load_factors)


def _built(task: Task) -> tuple[Study, Scene]:
    """A task's study, and its scene on its mesh."""
    study = Study.model_validate(task["study"])
    return study, build_scene(study, _mesh(study, task))


def _result(study: Study, scene: Scene, task: Task, name: str, group: _Group) -> ModelResult:
    """A model's result: of linear elements a multiple of what was solved before, if it is one, else solved now."""
    key, loads = task["elements"].get(name, ""), loads_of(study)
    found = group.answers[key].under(loads, scene) if key in group.answers else None
    if found is not None:
        return found[0]
    with needed_again(group.used_again.get((task["id"], name), 0)):
        result = models.run_model(scene, name)
    if key and all(status.ok for status in result.status):
        group.answers[key] = Answer([result], loads, scene.load_factors)
    return result


def _reference_levels(
    study: Study, scene: Scene, task: Task, known: Mapping[str, ModelResult], group: _Group
) -> list[ModelResult]:
    """The reference on each mesh level: solved before, here or in another run, a multiple of it, or solved now."""
    name, key, loads = study.study.reference or "", task["reference_key"], loads_of(study)
    if key not in group.answers and _may_read_reference(task):
        stored = next(filter(None, map(read_reference, _reference_paths(task))), None)
        if stored is not None:
            levels = [_marked(level, "") for level in stored.levels[: _n_levels(study)]]
            group.answers[key] = dataclasses.replace(stored, levels=levels)
            group.stored.add(key)
    found = group.answers[key].under(loads, scene) if key in group.answers else None
    if found is None:
        if name in known and _n_levels(study) == 1:
            require_converged(name, known[name])
            return [known[name]]
        with needed_again(group.used_again.get((task["id"], name), 0)):
            coarse = models.run_model(scene, name)
            require_converged(name, coarse)
            found = [coarse, *refined_levels([study], [scene], name, [_n_levels(study)])[0]]
        group.answers[key] = Answer(found, loads, scene.load_factors)
        group.stored.discard(key)
    if key not in group.stored:
        answer = group.answers[key]
        # the cache may be copied to another machine
        located = [_located(level, processor_name()) for level in answer.levels]
        write_reference(_reference_paths(task)[0], dataclasses.replace(answer, levels=located))
        group.stored.add(key)
    return found


def _reference_error(
    scene: Scene, levels: Sequence[ModelResult], coarsest: Mapping[str, MetricSeries]
) -> dict[str, float]:
    """The reference's own error from its levels, coarse first; `coarsest` are the metrics of the first."""
    if len(levels) < 2:
        return {}
    is_pair = len(levels) == 2 and len(scene.load_factors) == 1  # compared already
    found = {name: series.values for name, series in coarsest.items()} if is_pair and coarsest else None
    return own_error(_surface(scene), levels[::-1], scene.load_factors, found)


def _may_read_reference(task: Task) -> bool:
    """Not what another worker of this run has written meanwhile: no number hangs on which of them is faster.

    A worker that has died is no other: what it has written need not be solved again.
    """
    return bool(task["reference_stored"] or (task.get(AGAIN) and not task["fresh"]))


def _reference_is_there(task: Task) -> bool:
    return _may_read_reference(task) and any(map(is_sound, _reference_paths(task)))


def _reference_paths(task: Task) -> list[Path]:
    """Where the cache keeps what the reference answers on the study's mesh levels, and on more."""
    return [reference_path(Path(task["cache"]), key) for key in (task["reference_key"], *task["finer_keys"])]


def _known(task: Task, group: _Group) -> dict[str, ModelResult]:
    """Results that need not be solved again: of cases of the group, and of case files of this run and others."""
    keys: Mapping[str, str] = task["keys"]
    known = {name: group.results[key] for name, key in keys.items() if key in group.results}
    written = {name: group.written[key] for name, key in keys.items() if key in group.written}
    for files, is_earlier in ((task["reuse"], True), ({**task["twins"], **written}, False)):
        for path in sorted({path for name, path in files.items() if name not in known}):
            with suppress(StoreError):
                case = read_case(Path(path))
                processor = str(case.provenance.get("processor", ""))
                for name, result in case.models.items():
                    refused = any(status.code == models.REFUSED for status in result.status)
                    if result.key and result.key == keys.get(name) and not refused:
                        known.setdefault(name, _marked(result, processor) if is_earlier else result)
    return known


def _marked(result: ModelResult, processor: str) -> ModelResult:
    """A result whose times and memory were measured in an earlier run, on this processor unless it says itself."""
    found = _located(result, processor)
    parameters = {**found.parameters, "measured_earlier": "yes"}
    if parameters["measured_on"] in ("", processor_name()):
        del parameters["measured_on"]
    return dataclasses.replace(found, parameters=parameters)


def _located(result: ModelResult, processor: str) -> ModelResult:
    """A result that says which processor its times were measured on."""
    return dataclasses.replace(result, parameters={"measured_on": processor, **result.parameters})


def _n_levels(study: Study) -> int:
    return study.uncertainty.levels if study.uncertainty is not None else 1


def _mesh(study: Study, task: Task) -> Mesh:
    """The case's mesh; cases of one set-up have one."""
    if task["mesh"] not in _meshes:
        _meshes.clear()
        mesh = mesh_from_cache(geometry_of(study), Path(task["cache"]), volume=needs_volume(study))
        _meshes[task["mesh"]] = mesh
    return _meshes[task["mesh"]]


_meshes: dict[str, Mesh] = {}


def compare(
    scene: Scene, results: Mapping[str, ModelResult], reference: str | None
) -> dict[str, dict[str, MetricSeries]]:
    """Every metric of every model; the reference itself gets those that need no comparison."""
    histories = {
        name: History(result.displacement, result.reaction_force, scene.load_factors, volume=result.volume)
        for name, result in results.items()
    }
    found = shared(Comparisons, mesh=scene.mesh).compare(_surface(scene), histories, reference)
    return {
        name: {
            metric: MetricSeries(
                values, METRICS[metric].unit, METRICS[metric].definition, METRICS[metric].version
            )
            for metric, values in series.items()
        }
        for name, series in found.items()
    }


def _surface(scene: Scene) -> Surface:
    """The scene's surface under its loads."""
    plain = shared(Comparisons, mesh=scene.mesh).surface
    return plain.under(scene.contact, scene.contact_force, weighs=bool(scene.gravity.any()))


def provenance(mesh: Mesh) -> dict[str, str]:
    """Where a case comes from: packages, platform, mesh, time."""
    return {
        **_machine(),
        "mesh_hash": mesh.content_hash,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }


@cache
def _machine() -> dict[str, str]:
    return {
        **{f"package.{name}": _version(name) for name in PACKAGES},
        "commit": _commit(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processor": processor_name(),
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:  # one that can be done without
        return "not installed"


def _commit() -> str:
    """Of the source tree that the program runs from, "-dirty" where it was changed since."""
    root = Path(__file__).parents[1]
    if not (root / ".git").exists():
        return "not a source tree"
    try:
        asked = ["git", "-C", str(root), "describe", "--always", "--abbrev=40", "--dirty", "--exclude=*"]
        return subprocess.run(asked, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):  # no git, or one that does not trust whose tree it is
        return "unknown"
