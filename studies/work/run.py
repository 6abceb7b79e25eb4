"""Runs a plan: the missing tasks, then the tables and the report."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import tomli_w

from ..machine import LockedError, clear_abandoned, lock, write_atomically
from ..measures.case import Run
from ..store.cases import told_run
from ..store.run_directory import (
    REPORT,
    RESOLVED,
    STUDY,
    failure_path,
    write_failure,
    write_plan,
)
from ..study.config import resolved
from ..study.errors import InputError
from ..study.files import text_without_folders, without_folders
from .explain import beyond_memory, require_own, summary
from .plan import Plan, PlannedCase
from .pool import Pool, local_pool, run_tasks
from .tasks import Task, case_payload, tasks_of
from .times import to_time
from .worker import Said

Finish = Callable[[Path], tuple[Run, Path]]


@dataclass(frozen=True)
class Event:
    """An event of a run, for a watcher."""

    # "begun", with the `count` of tasks to be done, failed or stopped; "started"; "at", with progress in `message`;
    # "done"; "failed" for a case, "stopped" for a task that cases need; "told", with a sentence in `message`
    kind: str
    label: str
    seconds: float = 0.0
    message: str = ""
    count: int = 0


@dataclass(frozen=True)
class Options:
    """How to run.

    Attributes
    ----------
    timeout : of a case [s]
    scheduler : address of a Dask scheduler whose workers do the tasks; `insecure_scheduler` allows another
        machine without TLS
    times : measure frame times of every model on every mesh, as for a verdict that depends on them
    """

    jobs: int
    shard: tuple[int, int] = (1, 1)
    timeout: float | None = None
    scheduler: str | None = None
    insecure_scheduler: bool = False
    times: bool = False


def run_plan(
    plan: Plan, options: Options, watch: Callable[[Event], None], finish: Finish
) -> tuple[Run, Path]:
    """Do the missing part of a plan, then write tables and report; returns the run and the report's path.

    Parameters
    ----------
    finish : writes tables and report of a directory from its stored results (`vdmbench.report.rebuild`)

    Raises
    ------
    InputError
        another run is active in the directory, or it holds another study or other files.
    StudyError
        a case needs more memory than this machine can have.
    OSError
        disk full or read-only; a cluster that is missing or does not fit.
    """
    require_own(plan)
    plan.directory.mkdir(parents=True, exist_ok=True)
    cases = plan.cases_to_run(options.shard)
    with _locked(plan.directory, options.shard):
        tasks = tasks_of(plan, cases)
        if options.scheduler is None:
            _check_memory(plan, tasks, watch)
        _tidy(plan)
        texts = {
            STUDY: text_without_folders(plan.study.text).encode(),
            RESOLVED: tomli_w.dumps(without_folders(resolved(plan.study))).encode(),
        }
        timed = options.times or _decides(plan)
        if not cases and not timed and (done := _as_told(plan, texts)) is not None:
            return done, plan.directory / REPORT
        planned = summary(plan)
        for name, text in texts.items():
            write_atomically(plan.directory / name, text)
        write_plan(plan.directory, planned)
        try:
            if cases or timed:
                with _pool(plan, options) as pool:
                    _run_missing(plan, tasks, options, watch, pool)
                    _time_frames(plan, cases, options, watch, pool)
        finally:  # workers may have been killed while they wrote, also by an interruption
            _tidy(plan)
        run, report = finish(plan.directory)
        return dataclasses.replace(run, plan=planned), report


def _as_told(plan: Plan, texts: Mapping[str, bytes]) -> Run | None:
    """The stored summary of a run if nothing has changed since; else None."""
    run = told_run(plan.directory)
    if run is None:
        return None
    names = [(case["hash"], case["label"]) for case in run.plan["cases"]]
    same = (
        names == [(case.hash, case.label) for case in plan.cases]
        and run.plan["command"] == list(plan.command)
        and all((plan.directory / name).read_bytes() == text for name, text in texts.items())
    )
    return run if same else None


def _check_memory(plan: Plan, tasks: Sequence[Task], watch: Callable[[Event], None]) -> None:
    """Raise StudyError if a case needs far more memory than there is; warn if it may be too much."""
    for _, sentence in beyond_memory(plan, tasks, 1.0):
        watch(Event("told", plan.study.study.name, message=f"warning: {sentence}"))
    if stops := beyond_memory(plan, tasks):
        raise plan.study.error(stops)


def _tidy(plan: Plan) -> None:
    """Remove half-written files of killed runs, here and in the shared cache."""
    directories = (plan.directory, plan.directory / "cases", plan.directory / "failed")
    for directory in (*directories, *(plan.cache / kind for kind in ("meshes", "answers"))):
        clear_abandoned(directory)
    clear_abandoned(plan.directory / "failed", ".log")


def _pool(plan: Plan, options: Options) -> AbstractContextManager[Pool]:
    """The pool for the tasks: processes of this machine, or a cluster."""
    if options.scheduler is None:
        return local_pool(options.jobs)
    from .cluster import cluster_pool

    return cluster_pool(options.scheduler, plan.directory, insecure=options.insecure_scheduler)


def _run_missing(
    plan: Plan,
    tasks: Sequence[Task],
    options: Options,
    watch: Callable[[Event], None],
    pool: Pool,
) -> None:
    """Do the tasks."""
    watch(Event("begun", plan.study.study.name, count=len(tasks)))
    for task, said in run_tasks(
        tasks,
        pool,
        plan.directory.absolute() / "failed",
        timeout=options.timeout,
        started=lambda task: watch(Event("started", task.label)),
        where=lambda task, line: watch(Event("at", task.label, message=line)),
    ):
        what = "done" if said.ok else "failed" if task.case else "stopped"  # its cases give the reason
        watch(Event(what, task.label, said.seconds, said.message))
        if task.case is not None and said.ok:
            failure_path(plan.directory, task.case.hash, task.case.label).unlink(missing_ok=True)
        elif task.case is not None:
            _keep_failure(plan, task.case, said)


def _decides(plan: Plan) -> bool:
    """Whether a verdict depends on times: these are measured in every run."""
    return plan.study.acceptance.frame_time is not None and plan.study.study.reference is not None


def _time_frames(
    plan: Plan,
    cases: Sequence[PlannedCase],
    options: Options,
    watch: Callable[[Event], None],
    pool: Pool,
) -> None:
    """Measure frame times when nothing else of this run is active; a failure loses only the times."""
    every = options.times or _decides(plan)
    asked = plan.in_shard(options.shard) if every else cases
    limit = plan.study.acceptance.frame_time if _decides(plan) and not options.times else None
    chosen = to_time(plan, asked, every=every)
    items = [case_payload(one.case, plan) | {"names": one.names} for one in chosen]
    if not items:
        return
    payload = {"directory": str(plan.directory.absolute()), "every": every, "decides": _decides(plan)}
    payload |= {"limit": limit, "items": items}
    task = Task("times", "times", "times of a frame", payload, frozenset())
    watch(Event("started", task.label))
    for _, said in run_tasks(
        [task],
        pool,
        plan.directory.absolute() / "failed",
        timeout=options.timeout,
        where=lambda task, line: watch(Event("at", task.label, message=line)),
    ):
        if not said.ok:
            told = f"the times of a frame are not measured: {said.message}"
            watch(Event("told", plan.study.study.name, message=told))


def _keep_failure(plan: Plan, case: PlannedCase, said: Said) -> None:
    """Store a failure with its log, in place of any earlier result of the case."""
    path = plan.case_file(case)
    if not path.is_dir():  # a directory is no result, and may be the cause of the failure
        path.unlink(missing_ok=True)
    label = case.label or plan.study.study.name
    reason = {
        "hash": case.hash,
        "label": label,
        "code": said.code,
        "message": said.message,
        "remedy": said.remedy,
    }
    write_failure(failure_path(plan.directory, case.hash, case.label), reason, said.log)


@contextmanager
def _locked(directory: Path, shard: tuple[int, int]) -> Iterator[None]:
    """Lock the directory, or one shard's place in it, against other runs; locks end with the process.

    Shards share the directory with each other, but not with a run of the whole study.
    """
    whole = shard == (1, 1)
    with ExitStack() as held:
        try:
            held.enter_context(lock(directory / ".lock", shared=not whole))
            if not whole:
                held.enter_context(lock(directory / f".lock-{shard[0]}-of-{shard[1]}"))
        except LockedError as error:
            raise InputError(
                f"{directory}: another run is at work here ({error}); wait for it or choose another --out"
            ) from None
        yield
