"""What the nodes of a graph do, each a pure function of files under their keys, and how a process does one."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from solver_common.arrays import Array

from ..body.mesh import Mesh
from ..body.mesh_cache import mesh_from_cache, mesh_path, read_level, read_mesh, write_level
from ..body.refine import Hierarchy, refine, refined
from ..body.surface_measures import Surface
from ..machine.memory import OUT_OF_MEMORY, memory_limits
from ..machine.safe_open import open_regular
from ..measures.case import CaseResult, MetricSeries, SmallStrainLimits
from ..measures.input_spread import InputSpread
from ..measures.measurement import Measurement, hold_against, step_rms
from ..measures.metrics import METRICS, History, evaluate_all, full_load_step
from ..measures.reference import level_scene, own_error, require_converged, restricted
from ..models import Prepared, find
from ..scene.result import ModelResult
from ..scene.scene import Scene, build_scene
from ..store.cases import write_case
from ..study.config import geometry_of
from ..study.errors import InputError
from ..study.folders import swept_without_folders, without_folders
from ..study.model_name import REFINED
from ..study.schema import Study
from .answers import answer_path, combined, one_step, stored_answer, write_answer
from .keys import Wanted, level_key
from .nodes import limits_path
from .provenance import provenance
from .small_strain import read_limits, small_strain_limits, write_limits
from .varied import Varied

ATTEMPTS = 3  # of a node whose process dies

Payload = Mapping[str, Any]


@dataclass(frozen=True)
class Said:
    """What became of one piece of work. `code` is "done", "input" (the user's), "error", "crashed" or "timeout"."""

    id: str
    code: str
    seconds: float
    message: str = ""
    remedy: str = ""
    log: str = ""
    processor: float = 0.0  # seconds of all threads


def more_memory() -> str:
    """What to do where memory ran out."""
    limits = memory_limits()
    told = f"; this run may take no more than its shell allows: {limits}" if limits else ""
    return f"use a coarser mesh, fewer --jobs, or allow more with --memory{told}"


def run_node(text: str) -> str:
    """Do a node, given as JSON; what became of it, or of each of its items, as JSON."""
    node = json.loads(text)
    do = _KINDS[node["kind"]]
    with _output_to(Path(node["log"])):
        said = list(do(node["payload"], node["id"]))
    return json.dumps([asdict(one) for one in said])


# --- the kinds of nodes ---


def _mesh(payload: Payload, node: str) -> Iterator[Said]:
    """Put one mesh into the cache."""
    yield _attempt(node, lambda: mesh_from_cache(*_geometry(payload), volume=payload["volume"]))


def _level(payload: Payload, node: str) -> Iterator[Said]:
    """Put the refinement of a mesh into the cache."""

    def make() -> None:
        cache = Path(payload["cache"])
        coarse = _meshes(payload, payload["level"] - 1).finest
        write_level(mesh_path(cache, level_key(payload["mesh"], payload["level"])), *refine(coarse))

    yield _attempt(node, make)


def _answers(payload: Payload, node: str) -> Iterator[Said]:
    """One set-up and all loads that are asked of it, each answer a file."""

    def solve() -> None:
        cache, level, name = Path(payload["cache"]), payload["level"], payload["name"]
        meshes = _meshes(payload, level)
        scenes = _scenes(payload["asked"], meshes)
        asked = [one for one in payload["asked"] if one["key"] in scenes]
        first = scenes[asked[0]["key"]]
        prepared = Prepared(first, name, sum(len(one["factors"]) for one in asked))
        for of_one in _by_modulus(asked, scenes):
            scene = scenes[of_one[0]["key"]]
            same = scene.tissue.youngs_modulus == first.tissue.youngs_modulus
            own = prepared if same else prepared.of_modulus(scene, name)
            steps = [scenes[one["key"]].load(factor) for one in of_one for factor in one["factors"]]
            result = own.answer(steps)
            if level:
                result = restricted(result, meshes)
            for place, one in enumerate(of_one):  # of several each is one step
                answer = result if len(of_one) == 1 else one_step(result, place)
                write_answer(answer_path(cache, one["key"]), answer, payload["run"])

    yield _attempt(node, solve)


def _by_modulus(asked: Sequence[Payload], scenes: Mapping[str, Scene]) -> list[list[Payload]]:
    """What is asked, by the Young's modulus of its tissue."""
    found: dict[float, list[Payload]] = {}
    for one in asked:
        found.setdefault(scenes[one["key"]].tissue.youngs_modulus, []).append(one)
    return list(found.values())


def _scenes(asked: Sequence[Payload], meshes: Hierarchy) -> dict[str, Scene]:
    """Key -> scene; one that cannot be built costs its own cases alone. Raises InputError where none can."""
    scenes: dict[str, Scene] = {}
    for one in asked:
        try:
            scenes[one["key"]] = level_scene(Study.model_validate(one["study"]), meshes)
        except InputError:
            if one is asked[-1] and not scenes:
                raise
    return scenes


def _limits(payload: Payload, node: str) -> Iterator[Said]:
    """The small-strain limits of one case."""

    def search() -> None:
        study = Study.model_validate(payload["study"])
        found = small_strain_limits(study, build_scene(study, _meshes(payload, 0).finest))
        write_limits(limits_path(Path(payload["cache"]), payload["limits"]), found)

    yield _attempt(node, search)


def _cases(payload: Payload, _: str) -> Iterator[Said]:
    """Some cases on one mesh: results from answers, metrics, one file each."""
    block: list[_Block] = []  # made by the first case, whose failure it is if it fails

    def work(item: Payload) -> None:
        if not block:
            block.append(_Block(_meshes(payload, 0).finest))
        _case({**payload, **item}, block[0])

    for item in payload["items"]:
        yield _attempt(item["id"], partial(work, item))


_KINDS: dict[str, Callable[[Payload, str], Iterator[Said]]] = {
    "mesh": _mesh,
    "level": _level,
    "answers": _answers,
    "limits": _limits,
    "cases": _cases,
}


def _geometry(payload: Payload) -> tuple[Any, Path]:
    return geometry_of(Study.model_validate(payload["study"])), Path(payload["cache"])


def _meshes(payload: Payload, level: int) -> Hierarchy:
    """The case's mesh and its refinements up to a level; made again where the cache has lost them."""
    found = _stored_meshes(payload["cache"], payload["mesh"], level)
    if found is None:
        _stored_meshes.cache_clear()
        found = refined(mesh_from_cache(*_geometry(payload), volume=payload["volume"]), level)
    return found


@lru_cache(maxsize=4)  # by content keys: a process reads a mesh once, with what is remembered on it
def _stored_meshes(cache: str, key: str, level: int) -> Hierarchy | None:
    if level == 0:
        mesh = read_mesh(mesh_path(Path(cache), key))
        return Hierarchy((mesh,)) if mesh is not None else None
    coarser = _stored_meshes(cache, key, level - 1)
    found = read_level(mesh_path(Path(cache), level_key(key, level)))
    if coarser is None or found is None:
        return None
    return Hierarchy((*coarser.meshes, found[0]), (*coarser.parents, found[1]))


class _Block:
    """What cases on one mesh read and measure once."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.plain = Surface(points=mesh.surface_points, triangles=mesh.triangles)
        self.answers: dict[str, ModelResult] = {}

    def surface(self, scene: Scene) -> Surface:
        """The surface under a scene's loads."""
        return self.plain.under(scene.contact, scene.contact_force, weighs=bool(scene.gravity.any()))


def _case(payload: Payload, block: _Block) -> None:
    """One case from the answers of its models.

    Raises
    ------
    FailedReferenceError
        the reference failed, so that there is nothing to compare with.
    """
    study = Study.model_validate(payload["study"])
    mesh = block.mesh
    scene, reference = build_scene(study, mesh), study.study.reference
    surface = block.surface(scene)
    results: dict[str, ModelResult] = {}
    levels: list[ModelResult] = []
    for wanted in (Wanted(**entry) for entry in payload["wanted"]):
        result = _result(wanted, scene, payload, block.answers)
        if wanted.level == 0:
            results[wanted.name] = result
        if wanted.name == reference:
            require_converged(
                wanted.name if wanted.level == 0 else f"{wanted.name} on the refined mesh", result
            )
            levels.append(result)
    if reference is not None and len(levels) > 1:
        reference += REFINED
        results[reference] = levels[-1]
    varied = Varied(payload, study, results)
    spread = varied.spread(surface, full_load_step(scene.load_factors))
    measurement = _measurement(payload, study, mesh, results, levels, varied)
    metrics = compare(surface, results, scene.load_factors, reference, measurement, spread)
    found = payload["file_hash"]
    write_case(
        Path(payload["path"]),
        CaseResult(
            hash=payload["id"],
            label=payload["label"],
            swept=swept_without_folders(payload["swept"]),
            swept_units=payload["swept_units"],
            resolved=without_folders(payload["study"]),
            provenance=provenance(mesh) | ({"geometry_file_hash": found} if found else {}),
            points=mesh.surface_points,
            triangles=mesh.triangles,
            load_factors=scene.load_factors,
            regions=scene.regions,
            models=results,
            metrics=metrics,
            reference=reference,
            reference_error=_reference_error(
                surface, scene, levels, metrics.get(study.study.reference or "", {})
            ),
            small_strain=_small_strain(payload),
            measurement=measurement,
            inputs=spread,
            mesh_quality={
                **mesh.quality,
                "tetrahedra": len(mesh.tetrahedra),
                "surface_nodes": len(mesh.surface_nodes),
            },
        ),
    )


def _result(wanted: Wanted, scene: Scene, payload: Payload, known: dict[str, ModelResult]) -> ModelResult:
    """A model's result in a case. Raises OSError where an answer is gone that was there."""
    for key in wanted.answers:
        if key not in known:
            known[key] = stored_answer(Path(payload["cache"]), key, payload["run"])
    answers = [known[key] for key in wanted.answers]
    if not wanted.scales:
        return answers[0]
    volumetric = find(wanted.name)[0].volumetric
    datum = 0.0 if volumetric else scene.environment_pressure
    return combined(answers, wanted.scales, scene.mesh, datum)


def _measurement(
    payload: Payload,
    study: Study,
    mesh: Mesh,
    results: Mapping[str, ModelResult],
    levels: list[ModelResult],
    varied: Varied,
) -> Measurement | None:
    """The case's models, and its reference level by level, against what was measured on it."""
    names = {id(result): name for name, result in results.items()}
    return hold_against(
        study,
        mesh,
        payload["swept"],
        payload["swept_units"],
        {name: varied.answer(name, result) for name, result in results.items()},
        [(names.get(id(level), ""), varied.answer(str(study.study.reference), level)) for level in levels],
        varied.rules(),
    )


def _small_strain(payload: Payload) -> SmallStrainLimits | None:
    if payload["limits"] is None:
        return None
    return read_limits(limits_path(Path(payload["cache"]), payload["limits"]))


def compare(
    surface: Surface,
    results: Mapping[str, ModelResult],
    load_factors: Array,
    reference: str | None,
    measurement: Measurement | None = None,
    spread: InputSpread | None = None,
) -> dict[str, dict[str, MetricSeries]]:
    """Every metric of every model; the reference itself gets those that need no comparison."""
    histories = {
        name: History(
            result.displacement,
            result.reaction_force,
            load_factors,
            volume=result.volume,
            measurement=step_rms(measurement, name, len(load_factors)) if measurement else None,
            inputs=(spread.models[name].displacement, spread.models[name].deformation) if spread else None,
        )
        for name, result in results.items()
    }
    return {
        name: {
            metric: MetricSeries(
                values, METRICS[metric].unit, METRICS[metric].definition, METRICS[metric].version
            )
            for metric, values in series.items()
        }
        for name, series in evaluate_all(surface, histories, reference).items()
    }


def _reference_error(
    surface: Surface, scene: Scene, levels: list[ModelResult], coarsest: Mapping[str, MetricSeries]
) -> dict[str, float]:
    """The reference's own error from its levels, coarse first; `coarsest` are the metrics of the first."""
    if len(levels) < 2:
        return {}
    is_pair = len(levels) == 2 and len(scene.load_factors) == 1  # compared already
    found = {name: series.values for name, series in coarsest.items()} if is_pair and coarsest else None
    return own_error(surface, levels[::-1], scene.load_factors, found)


# --- one piece of work ---


def _attempt(name: str, work: Callable[[], object]) -> Said:
    """What became of a piece of work; an error is told, never raised."""
    start, used = time.perf_counter(), time.process_time()
    code, message, remedy = _outcome(work)
    if OUT_OF_MEMORY.search(message):
        message, remedy = "out of memory", more_memory()
    seconds, processor = time.perf_counter() - start, time.process_time() - used
    return Said(name, code, seconds, message, remedy, processor=processor)


def _outcome(work: Callable[[], object]) -> tuple[str, str, str]:
    try:
        work()
    except MemoryError:
        traceback.print_exc()
        return "error", "out of memory", more_memory()
    except OSError as error:
        return "error", f"{error}", "check free space and permissions"
    except InputError as error:
        return "input", f"{error}", ""
    except ValueError as error:
        traceback.print_exc()
        return "error", f"{error}", getattr(error, "remedy", "")
    except Exception as error:  # noqa: BLE001  a worker must answer, whatever happens in it
        traceback.print_exc()
        remedy = "this is a bug: please report it with the log in the failed/ folder"
        return "error", f"{type(error).__name__}: {error}", remedy
    return "done", "", ""


@contextlib.contextmanager
def _output_to(log: Path) -> Iterator[None]:
    """What the work prints, C libraries included, goes to a file, for the run to read where the work fails."""
    descriptor = open_regular(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    fcntl.flock(descriptor, fcntl.LOCK_SH)  # as long as it is written, see `clear_abandoned`
    os.ftruncate(descriptor, 0)
    kept = [os.dup(number) for number in (1, 2)]
    try:
        for number in (1, 2):
            os.dup2(descriptor, number)
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:  # the run was started without
                with contextlib.suppress(OSError, ValueError):
                    stream.flush()
        for number, old in zip((1, 2), kept, strict=True):
            os.dup2(old, number)
            os.close(old)
        os.close(descriptor)
