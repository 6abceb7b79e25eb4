"""The kinds of tasks, pure functions of files under their keys, and the way a process does one."""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import json
import math
import os
import re
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from solver_common.progress import Progress, reported

from ..body.mesh_cache import mesh_from_cache, mesh_path, read_level, read_mesh, write_mesh
from ..body.refine import Hierarchy, refine, refined
from ..machine import processor_name
from ..measures.reference import level_scene, restricted
from ..models import Prepared
from ..scene.result import LEAST_ROUNDS, steps_of
from ..scene.scene import Scene, build_scene
from ..store.plain import typed
from ..store.run_directory import add_times
from ..study.errors import InputError, install_line
from ..study.schema import Study
from .cache import answer_path, write_answer
from .case import make_case
from .keys import level_key
from .plan import PlannedCase

# messages of C++, Rust, the system and its library loader about lack of memory
OUT_OF_MEMORY = re.compile(
    "bad_alloc|memory allocation of|cannot allocate memory|cannot map zero-fill|failed to map segment", re.I
)
MORE_MEMORY = "use a coarser mesh, or fewer --jobs"
WHERE = "where: "  # prefix of a log line with the progress of a solve
_APART = 2.0  # s between such lines
TIMES_BUDGET = 5.0  # s for the times of all meshes, unless every time is requested

Payload = Mapping[str, Any]


@dataclass(frozen=True)
class Said:
    """The outcome of a task. `code` is "done", "input" (the user's mistake), "error", "crashed" or "timeout"."""

    code: str
    seconds: float
    message: str = ""
    remedy: str = ""
    log: str = ""

    @property
    def ok(self) -> bool:
        """Whether it is done."""
        return self.code == "done"

    def as_json(self) -> str:
        """JSON text; `Said(**json.loads(...))` reads it back."""
        return json.dumps(asdict(self))


def do_task(text: str) -> str:
    """Do a task, given as JSON; returns its outcome as JSON. Errors are reported, never raised."""
    task = json.loads(text)
    with _output_to(Path(task["log"])), reported(_tell_log()):
        start = time.perf_counter()
        code, message, remedy = _outcome(lambda: _KINDS[task["kind"]](task["payload"]))
        if OUT_OF_MEMORY.search(message):
            message, remedy = "out of memory", MORE_MEMORY
        seconds = time.perf_counter() - start
    return Said(code, seconds, message, remedy).as_json()


# --- the kinds of tasks ---


def _mesh(payload: Payload) -> None:
    """Put a mesh and its missing refinements into the cache."""
    mesh = mesh_from_cache(*_geometry(payload), volume=payload["volume"])
    for level in range(1, payload["level"] + 1):
        path = mesh_path(Path(payload["cache"]), level_key(payload["case"]["mesh"], level))
        found = read_level(path)
        if found is None:
            found = refine(mesh)
            write_mesh(path, *found)
        mesh = found[0]


def _answers(payload: Payload) -> None:
    """One set-up and all its requested loads, each answer in a file."""
    cache, level, name = Path(payload["cache"]), payload["level"], payload["name"]
    meshes = _meshes(payload, level)
    scenes = _scenes(payload["asked"], meshes)
    asked = [one for one in payload["asked"] if one["key"] in scenes]
    steps = [scenes[one["key"]].load(factor) for one in asked for factor in one["factors"]]
    result = Prepared(scenes[asked[0]["key"]], name, len(steps)).answer(steps, ends=True)
    if level:
        result = restricted(result, meshes)
    for place, one in enumerate(asked):  # each of several is one step
        answer = result if len(asked) == 1 else steps_of(result, [place])
        write_answer(answer_path(cache, one["key"]), answer)


def _scenes(asked: Sequence[Payload], meshes: Hierarchy) -> dict[str, Scene]:
    """Key -> scene; one that cannot be built fails only its own cases. Raises InputError if none can be built."""
    scenes: dict[str, Scene] = {}
    for one in asked:
        try:
            scenes[one["key"]] = level_scene(Study.model_validate(one["study"]), meshes)
        except InputError:
            if one is asked[-1] and not scenes:
                raise
    return scenes


def _case(payload: Payload) -> None:
    """One case: results from answers, limits, metrics, one file."""
    make_case(payload, partial(_meshes, payload))


def _times(payload: Payload) -> None:
    """Frame times of what `to_time` chose, the models of a case in turns, into one file.

    Unless `every` time is requested, meshes are left out for which no time is left.
    """
    from ..models.frames import frame_times  # loads the solvers, slow

    every, end = payload["every"], time.perf_counter() + TIMES_BUDGET
    rounds, budget = (5, 10.0) if every else (3, 2.0)
    least, limit = LEAST_ROUNDS if payload["decides"] else 1, payload["limit"]
    found: dict[str, dict[str, Any]] = {}
    at = ""

    def begun(what: str) -> None:
        nonlocal at
        at = what
        _say(at)

    for item in payload["items"]:
        if not every and time.perf_counter() > end:
            break
        case = typed(PlannedCase, item["case"])
        about: Any = {"case": case.label, "processor": processor_name()}
        scene = build_scene(case.study, _meshes(item, 0).finest)
        with reported(_tell_log(lambda: f"{at}: ")):
            times = frame_times(scene, item["names"], rounds, budget, least, limit or math.inf, begun)
        told = {name: dataclasses.replace(one, **about) for name, one in times.items()}
        found.setdefault(case.mesh, {}).update(told)
    add_times(Path(payload["directory"]), found)


_KINDS: dict[str, Callable[[Payload], None]] = {
    "mesh": _mesh,
    "answers": _answers,
    "case": _case,
    "times": _times,
}


def _geometry(payload: Payload) -> tuple[Any, Path]:
    return Study.model_validate(payload["case"]["study"]).geometry, Path(payload["cache"])


def _meshes(payload: Payload, level: int) -> Hierarchy:
    """The case's mesh and its refinements up to a level; made again if the cache has lost them."""
    found = _stored_meshes(payload["cache"], payload["case"]["mesh"], level)
    if found is None:
        _stored_meshes.cache_clear()
        found = refined(mesh_from_cache(*_geometry(payload), volume=payload["volume"]), level)
    return found


@lru_cache(maxsize=4)  # by content keys: a process reads a mesh once, and shares what it remembers
def _stored_meshes(cache: str, key: str, level: int) -> Hierarchy | None:
    if level == 0:
        mesh = read_mesh(mesh_path(Path(cache), key))
        return Hierarchy((mesh,)) if mesh is not None else None
    coarser = _stored_meshes(cache, key, level - 1)
    found = read_level(mesh_path(Path(cache), level_key(key, level)))
    if coarser is None or found is None:
        return None
    return Hierarchy((*coarser.meshes, found[0]), (*coarser.parents, found[1]))


# --- one piece of work ---


def _outcome(work: Callable[[], object]) -> tuple[str, str, str]:
    try:
        work()
    except MemoryError:
        traceback.print_exc()
        return "error", "out of memory", MORE_MEMORY
    except OSError as error:
        return "error", f"{error}", install_line(error) or "check free space and permissions"
    except ImportError as error:
        return "error", f"{error}", install_line(error)
    except InputError as error:
        return "input", f"{error}", ""
    except ValueError as error:
        traceback.print_exc()
        return "error", f"{error}", getattr(error, "remedy", "")
    except (Exception, SystemExit) as error:  # noqa: BLE001  a worker must answer in any case
        traceback.print_exc()
        remedy = "this is a bug: please report it with the log in the failed/ folder"
        return "error", f"{type(error).__name__}: {error}", remedy
    return "done", "", ""


def _say(line: str) -> None:
    """Log where a task is, for the run to show, or to keep after a failure."""
    with contextlib.suppress(OSError):  # a full disk does not end a solve
        os.write(1, f"{WHERE}{line}\n".encode())


def _tell_log(of: Callable[[], str] = str) -> Callable[[Progress], None]:
    """Log the progress of a nonlinear solve, after the words `of` what it is, every `_APART` s."""
    told = time.monotonic()

    def tell(at: Progress) -> None:
        nonlocal told
        if time.monotonic() < told + _APART:
            return
        told = time.monotonic()
        of_all = f" of {at.steps}" if at.steps else ""
        step = "load" if at.steps == 1 else f"load step {at.step + 1}{of_all}"
        share, residual = f"{100 * at.share:.3g} %", f"{at.residual:.1e}"
        _say(f"{of()}{step} at {share}, iteration {at.iteration}, residual {residual}")

    return tell


@contextlib.contextmanager
def _output_to(log: Path) -> Iterator[None]:
    """Redirect output, also of C libraries, to a file, which the run reads after a failure."""
    descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
    fcntl.flock(descriptor, fcntl.LOCK_SH)  # while it is written, see `clear_abandoned`
    os.ftruncate(descriptor, 0)
    kept = [os.dup(number) for number in (1, 2)]
    try:
        for number in (1, 2):
            os.dup2(descriptor, number)
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:  # it is None if the run was started without one
                with contextlib.suppress(OSError, ValueError):
                    stream.flush()
        for number, old in zip((1, 2), kept, strict=True):
            os.dup2(old, number)
            os.close(old)
        os.close(descriptor)
