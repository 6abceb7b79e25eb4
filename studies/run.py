"""Runs a plan: meshes first, then cases, those that share work in one worker; then the tables and the report."""

from __future__ import annotations

import dataclasses
import fcntl
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import tomli_w

from .case import Run
from .cluster import Cluster, connected
from .execute import LOG, Group, Outcome, Task, run_tasks
from .explain import beyond_memory, summary
from .files import clear_abandoned
from .hdf5 import StoreError
from .locks import LockedError, lock
from .memory import machine_memory
from .meshing.mesh import MeshError
from .plan import Plan, PlannedCase, PlannedMesh, task_groups, task_of
from .room import without_room
from .run_directory import (
    RESOLVED,
    STUDY,
    case_path,
    failure_path,
    read_plan,
    refuse_foreign,
    refuse_linked,
    rewrite_plan,
    write_failure,
    write_plan,
)
from .server import processor_seconds, start_server
from .store import read_run, write_study
from .study_file.config import geometry_error, resolved
from .study_file.folders import text_without_folders, without_folders
from .study_file.units import shown
from .work import work_of
from .worker import make_mesh, run_case, share

_PATIENCE = 300.0  # s that one other process may take to write the tables and the report


class RunError(ValueError):
    """A run that cannot start."""


@dataclass(frozen=True)
class Event:
    """Something that a watcher of a run may want to show."""

    kind: str  # "mesh", "case": started; "done", "failed": finished; "told": a sentence, in `message`
    label: str
    seconds: float = 0.0
    message: str = ""


@dataclass(frozen=True)
class Options:
    """How to run. `timeout` is per case [s], `memory` per worker [bytes], by default its share of the machine's."""

    jobs: int
    shard: tuple[int, int] = (1, 1)
    timeout: float | None = None
    memory: int | None = None
    fail_fast: bool = False
    scheduler: str | None = None  # address of a Dask scheduler, whose workers run the cases
    insecure_scheduler: bool = False  # also without TLS on another machine


def run_plan(
    plan: Plan, study_text: str, options: Options, watch: Callable[[Event], None]
) -> tuple[Run, Path]:
    """Do what is missing of a plan, then write the tables and the report; returns the run and the report's path.

    Raises
    ------
    RunError
        another run is at work in the directory, or it holds another study.
    ForeignDirectoryError
        the directory holds something else.
    StudyError
        a case needs more memory than this machine can have.
    OSError
        disk full or read-only; a cluster that is not there or does not fit.
    """
    refuse_foreign(plan.directory)
    refuse_linked(plan.directory)
    plan.directory.mkdir(parents=True, exist_ok=True)
    cases = plan.cases_to_run(options.shard)
    here = bool(cases) and options.scheduler is None
    if here or plan.missing_meshes(cases):
        start_server()  # before there are a cluster's threads, and a lock that it would hold on to
    with _cluster(options, watch) as cluster, _locked(plan.directory, options.shard):
        _check_study(plan)
        if here:
            import_module("studies.report.page")  # while the server loads, too
        if cluster is None:
            _check_memory(plan, cases)
        if lines := without_room(plan, cases):
            raise RunError("\n".join(lines))
        _tidy(plan)
        planned = summary(plan, options.jobs if cluster is None else cluster.places())
        texts = {
            STUDY: text_without_folders(study_text).encode(),
            RESOLVED: tomli_w.dumps(without_folders(resolved(plan.study))).encode(),
        }
        planned = write_plan(plan.directory, planned, texts)
        alone = here and options.shard == (1, 1)
        began, used = time.perf_counter(), processor_seconds(start_server()) if alone else 0.0
        _run_missing(plan, options, watch, cluster)
        _tidy(plan)  # a worker may have been killed
        run, report = rebuild(
            plan.directory, lambda text: watch(Event("told", plan.study.study.name, message=text))
        )
        if alone:
            planned["taken"] = {
                "seconds": time.perf_counter() - began,
                "processor_seconds": processor_seconds(start_server()) - used,
                "jobs": options.jobs,
            }
            rewrite_plan(plan.directory, planned)
        return dataclasses.replace(run, plan=planned), report


def rebuild(directory: Path, tell: Callable[[str], None]) -> tuple[Run, Path]:
    """Write the tables and the report from the stored results alone; returns the run and the report's path.

    `tell` is told who is waited for, where another process writes them. Raises RunError where that takes too long.
    """
    from .report.page import write_report  # plotting is slow to load, and who only plans draws nothing

    read_plan(directory)  # nothing is left in a directory that is none of ours
    report = directory / "report.html"
    with _report_lock(directory, tell):  # the last of several shards sees all
        run = read_run(directory, damaged=True)
        write_study(directory, run)
        write_report(run, report)
    return run, report


def lost_cases(plan: Plan, shard: tuple[int, int], run: Run) -> list[str]:
    """Labels of the cases of a shard that a finished run should have, done or failed, and that are not there."""
    there = {case.hash for case in run.cases} | {failure["hash"] for failure in run.failed}
    return [case.label or plan.study.study.name for case in plan.in_shard(shard) if case.hash not in there]


def _check_study(plan: Plan) -> None:
    """Raises RunError where the directory holds another study, whose tables and report would be lost."""
    name = plan.study.study.name
    with suppress(StoreError):  # nothing there, or nothing that can be read
        other = read_plan(plan.directory)["study"]["name"]
        if other != name:
            raise RunError(
                f"{plan.directory}: holds the study {shown(other)}, not {shown(name)}; choose another --out"
            )


def _check_memory(plan: Plan, cases: Sequence[PlannedCase]) -> None:
    """Raises StudyError where this machine cannot have the memory that a case needs."""
    for key, sentence in beyond_memory(plan, work_of(plan, cases)).items():
        own = plan.meshes[key].geometry.has_own_tetrahedra
        raise geometry_error(plan.study, MeshError(sentence, "path" if own else "mesh_size"))


def _tidy(plan: Plan) -> None:
    """Clear away what runs that were killed left half-written, here and in the shared cache."""
    directories = (plan.directory, plan.directory / "cases", plan.directory / "failed")
    for directory in (*directories, plan.cache / "meshes", plan.cache / "references"):
        clear_abandoned(directory)
    clear_abandoned(plan.directory / "failed", LOG)


@contextmanager
def _cluster(options: Options, watch: Callable[[Event], None]) -> Iterator[Cluster | None]:
    """The cluster that the cases run on, or None for this machine."""
    if options.scheduler is None:
        yield None
        return
    with connected(options.scheduler, insecure=options.insecure_scheduler) as cluster:
        if warning := cluster.warning():
            watch(Event("told", options.scheduler, message=f"warning: {warning}"))
        yield cluster


def _run_missing(
    plan: Plan, options: Options, watch: Callable[[Event], None], cluster: Cluster | None
) -> None:
    cases = plan.cases_to_run(options.shard)
    logs = plan.directory / "failed"
    meshes = [[_mesh_task(mesh, plan)] for mesh in plan.missing_meshes(cases)]
    broken: dict[str, Outcome] = {}
    for outcome in _make_meshes(meshes, logs, options, watch):
        if not outcome.ok:
            broken[outcome.task["id"]] = outcome
    died = [[outcome.task] for outcome in broken.values() if outcome.code == "crashed"]
    # many cases may hang on a mesh: the death of its worker costs a second try only
    if not options.fail_fast:
        for outcome in _make_meshes(died, logs, options, watch):
            if outcome.ok:
                del broken[outcome.task["id"]]
    if broken and options.fail_fast:
        return
    for case in cases:
        if case.mesh in broken:
            failure = dataclasses.replace(broken[case.mesh], task=task_of(case, plan))
            _keep_failure(plan, failure)
            watch(Event("failed", case.label, message=failure.message))
    places = options.jobs
    if cluster is not None:  # whose workers run elsewhere
        plan = dataclasses.replace(plan, directory=plan.directory.absolute(), cache=plan.cache.absolute())
        places = cluster.places()
    groups = task_groups(plan, [case for case in cases if case.mesh not in broken], places)
    how: dict[str, Any] = {"timeout": options.timeout, "fail_fast": options.fail_fast}
    how["started"] = _starts("case", watch)
    if cluster is not None:
        scratch = plan.directory / ".cluster-{}-of-{}".format(*options.shard)
        outcomes = cluster.run_cases(groups, scratch=scratch, memory=options.memory, **how)
    else:
        how["memory"] = _memory(options)
        outcomes = run_tasks(run_case, groups, together=share, jobs=places, log_directory=logs, **how)
    for outcome in _watched(outcomes, watch):
        if outcome.ok:
            failure_path(plan.directory, outcome.task["id"]).unlink(missing_ok=True)
        else:
            _keep_failure(plan, outcome)


def _keep_failure(plan: Plan, outcome: Outcome) -> None:
    """A failure takes the place of whatever result the case had before."""
    path = case_path(plan.directory, outcome.task["id"])
    if not path.is_dir():  # which is no result, and may be why the case failed
        path.unlink(missing_ok=True)
    reason = {"hash": outcome.task["id"], "label": outcome.task["label"]}
    reason |= {name: getattr(outcome, name) for name in ("code", "message", "remedy")}
    write_failure(failure_path(plan.directory, outcome.task["id"]), reason, outcome.log)


def _make_meshes(
    meshes: Sequence[Group], logs: Path, options: Options, watch: Callable[[Event], None]
) -> Iterator[Outcome]:
    outcomes = run_tasks(
        make_mesh,
        meshes,
        jobs=options.jobs,
        log_directory=logs,
        timeout=options.timeout,
        memory=_memory(options),
        fail_fast=options.fail_fast,
        started=_starts("mesh", watch),
    )
    return _watched(outcomes, watch)


def _memory(options: Options) -> int:
    return options.memory or machine_memory() // options.jobs


def _starts(kind: str, watch: Callable[[Event], None]) -> Callable[[Task], None]:
    return lambda task: watch(Event(kind, task["label"]))


def _watched(outcomes: Iterator[Outcome], watch: Callable[[Event], None]) -> Iterator[Outcome]:
    for outcome in outcomes:
        ended = "done" if outcome.ok else "failed"
        watch(Event(ended, outcome.task["label"], outcome.seconds, outcome.message))
        yield outcome


def _mesh_task(mesh: PlannedMesh, plan: Plan) -> dict[str, Any]:
    geometry = mesh.geometry
    return {
        "id": mesh.key,
        "label": mesh.label,
        "shape": geometry.shape,
        "mesh_size": geometry.mesh_size,
        "parameters": dict(geometry.parameters),
        "volume": mesh.volume,
        "cache": str(plan.cache),
    }


@contextmanager
def _locked(directory: Path, shard: tuple[int, int]) -> Iterator[None]:
    """Hold the directory, or one shard's place in it, against another run; the locks go with the process.

    Shards share the directory with each other, not with a run of the whole study.
    """
    with ExitStack() as held:
        whole = shard == (1, 1)
        held.enter_context(_lock(directory, ".lock", fcntl.LOCK_EX if whole else fcntl.LOCK_SH))
        if not whole:
            held.enter_context(_lock(directory, f".lock-{shard[0]}-of-{shard[1]}", fcntl.LOCK_EX))
        yield


@contextmanager
def _lock(directory: Path, name: str, kind: int) -> Iterator[None]:
    with ExitStack() as held:
        try:
            held.enter_context(lock(directory / name, kind))
        except LockedError as error:
            raise RunError(
                f"{directory}: another run is at work here ({error}); wait for it or choose another --out"
            ) from None
        yield


@contextmanager
def _report_lock(directory: Path, tell: Callable[[str], None]) -> Iterator[None]:
    with ExitStack() as held:
        try:
            held.enter_context(lock(directory / ".lock-report", fcntl.LOCK_EX, patience=_PATIENCE, tell=tell))
        except LockedError as error:
            raise RunError(
                f"{directory}: {error} has locked the report for more than {_PATIENCE:g} s; the results are kept, "
                f"vdmbench report {directory} writes it later"
            ) from None
        yield
