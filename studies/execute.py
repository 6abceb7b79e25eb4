"""Runs tasks in worker processes, in groups that share work, so that a failure still costs its task only.

A failure is an error, a crash, a timeout or a kill for want of memory. Workers are forked from a server process
that has the slow imports done (`studies.server`); each gets its share of the cores for the sparse factors, and
one thread for dense algebra, whose threads would spin between small products. A worker does the tasks of one
group after the other and answers after each. Where it dies, the tasks that it had finished stay finished, the one
that it was at is tried once more alone, and the rest goes to a new worker; where it dies of what some share, each
half of these does.

Tasks are plain JSON with an "id"; those of a group that follow each other with the same "setup" share what is done
before the first of them. Where a worker has died, they have `AGAIN`.
"""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import json
import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkProcess
from pathlib import Path
from typing import Any

from .memory import OUT_OF_MEMORY, limit_memory, memory_limits
from .meshing.mesh import InputError
from .processors import usable_processors
from .safe_open import open_regular, read_regular
from .server import CONTEXT, start_server

Task = Mapping[str, Any]
Group = Sequence[Task]
Together = Callable[[Group], AbstractContextManager[Callable[[Task], None]]]
AGAIN = "again"  # in a task that another worker was given before
LOG = ".log"  # ends the hidden names of workers' logs
_GRACE = 5.0  # s between asking a worker to stop and killing it


@dataclass(frozen=True)
class Outcome:
    """What became of one task. `code` is "done", "input" (the user's), "error", "crashed" or "timeout"."""

    task: Task
    code: str
    seconds: float
    message: str = ""
    remedy: str = ""
    log: str = ""

    @property
    def ok(self) -> bool:
        """Whether the task did its work."""
        return self.code == "done"


class TaskError(ValueError):
    """A task that fails for a reason that its user can mend: message and remedy, no traceback."""

    def __init__(self, message: str, remedy: str = "") -> None:
        super().__init__(message)
        self.remedy = remedy


@dataclass
class _Running:
    tasks: list[Task]  # not finished yet; the first is at work once `begun`
    process: ForkProcess
    answer: Any  # the reading end of its pipe
    log: Path
    since: float  # of the stretch of work that it is at
    shared: bool  # whether it was given more than one task
    announced: Task  # the latest that was
    begun: bool = False  # False: still at what the next tasks share

    @property
    def share(self) -> int:
        """How many tasks' time the present stretch may take."""
        setup = self.tasks[0].get("setup") if self.tasks else None
        alike = itertools.takewhile(lambda task: task.get("setup") == setup, self.tasks)
        return 1 if self.begun else max(1, len(list(alike)))


def run_tasks(
    work: Callable[[Task], None],
    groups: Sequence[Group],
    *,
    together: Together | None = None,
    jobs: int,
    log_directory: Path,
    timeout: float | None = None,
    memory: int | None = None,
    fail_fast: bool = False,
    started: Callable[[Task], None],
) -> Iterator[Outcome]:
    """Run `work(task)` for each task of each group, at most `jobs` groups at once, yielding outcomes as they come.

    `work` must be a module-level function. Leaving the iterator early, Ctrl-C
    included, stops the workers. Outcomes of failed tasks carry the worker's output.

    Parameters
    ----------
    together : entered around the tasks of a group of more than one; gives what to call before each of them, which
        does what it and those after it share
    memory : bytes that one worker may take, so that no case can take another's or the machine's
    timeout : seconds that one task may take; what some share may take as much as they together
    """
    queue = [list(group) for group in groups if group]
    if not queue:
        return
    log_directory.mkdir(parents=True, exist_ok=True)
    how = (work, together, queue, jobs, log_directory, timeout, memory, fail_fast)
    with closing(start_server().ask(_in_workers, *how)) as events:
        for event in events:
            if isinstance(event, Outcome):
                yield event
            else:
                started(event)


def _in_workers(
    line: Connection,
    work: Callable[[Task], None],
    together: Together | None,
    groups: list[list[Task]],
    jobs: int,
    log_directory: Path,
    timeout: float | None,
    memory: int | None,
    fail_fast: bool,
) -> Generator[Task | Outcome, None, None]:
    """The server's part of `run_tasks`: each task as it is started, each outcome as it comes."""
    threads = max(1, usable_processors() // jobs)
    queue = groups[::-1]
    running: list[_Running] = []
    try:
        while queue or running:
            while queue and len(running) < jobs:
                tasks = queue.pop()
                yield tasks[0]
                running.append(_start(work, together, tasks, threads, memory, log_directory))
            parts = [part for r in running for part in (r.answer, r.process.sentinel)]
            if line in wait([*parts, line], timeout=0.2 if timeout else None):
                return  # nobody listens any more
            for r in list(running):
                alive = r.process.is_alive()  # asked before the answers are read: a dead worker sends no more
                for event in _answers(r):
                    yield event
                    if fail_fast and isinstance(event, Outcome) and not event.ok:
                        return
                late = timeout is not None and time.monotonic() - r.since > timeout * r.share
                if not r.tasks or not alive or late:
                    running.remove(r)
                    failure, again = _finish(r, timeout if alive and late else None)
                    queue += again
                    if failure is not None:
                        yield failure
                        if fail_fast:
                            return
    finally:
        for r in running:
            _stop(r.process)
            r.log.unlink(missing_ok=True)


def _start(
    work: Callable[[Task], None],
    together: Together | None,
    tasks: list[Task],
    threads: int,
    memory: int | None,
    logs: Path,
) -> _Running:
    reader, writer = CONTEXT.Pipe(duplex=False)
    log = logs / f".{tasks[0]['id']}.{os.getpid()}{LOG}"
    arguments = (work, together if len(tasks) > 1 else None, tasks, threads, memory, writer, str(log))
    process = CONTEXT.Process(target=_main, args=arguments, daemon=True)
    process.start()
    writer.close()
    return _Running(tasks, process, reader, log, time.monotonic(), len(tasks) > 1, tasks[0])


def _answers(r: _Running) -> Iterator[Task | Outcome]:
    """What a worker has said since it was last asked: the start and the end of each of its tasks."""
    while r.tasks and r.answer.poll():
        try:
            answer = json.loads(r.answer.recv_bytes())
        except (EOFError, OSError):
            return  # it died: its exit code says why
        now = time.monotonic()
        if answer is None:
            if r.announced is not r.tasks[0]:
                yield r.tasks[0]
            r.since, r.begun, r.announced = now, True, r.tasks[0]
        else:
            yield Outcome(r.tasks.pop(0), seconds=now - r.since, **answer)
            r.since, r.begun = now, False


def _finish(r: _Running, timeout: float | None) -> tuple[Outcome | None, list[list[Task]]]:
    """Let go of a worker: the failure of the task that it was at, if that is final, and the groups to do again."""
    if r.process.is_alive() and r.tasks:
        _stop(r.process)
    r.process.join()
    r.answer.close()
    try:
        log = read_regular(r.log).decode(errors="replace")
    except OSError:  # it died before it had one
        log = ""
    r.log.unlink(missing_ok=True)
    if not r.tasks:
        return None, []
    again: list[Task] = [{**task, AGAIN: True} for task in r.tasks]
    culprit, rest = r.tasks[0], again[1:]
    alone = not r.shared
    seconds = time.monotonic() - r.since
    if timeout is not None and (alone or r.begun):
        remedy = "allow more with --timeout, or use a coarser mesh"
        outcome = Outcome(culprit, "timeout", seconds, f"stopped after {timeout:g} s", remedy, log)
        return outcome, [rest] if rest else []
    if not alone:
        # at what some share it may be any one's fault: half of them may do without; else the rest goes on together
        half = max(1, r.share // 2)
        return None, [part for part in (again[:half], again[half : r.share], again[r.share :]) if part]
    return Outcome(culprit, "crashed", seconds, *_death(r.process.exitcode or 0, log), log), []


def _more_memory() -> str:
    limits = memory_limits()
    told = f"; this run may take no more than its shell allows: {limits}" if limits else ""
    return f"use a coarser mesh, fewer --jobs, or allow more with --memory{told}"


def _death(code: int, log: str) -> tuple[str, str]:
    """What an exit code of a worker that died means, and what to do."""
    if OUT_OF_MEMORY.search(log):
        return "out of memory", _more_memory()
    if code == -signal.SIGKILL:
        return "killed by the system, most likely out of memory", _more_memory()
    if code < 0:
        return (
            f"the worker crashed with signal {signal.Signals(-code).name}",
            "see the log in the run directory's failed/ folder; other cases are not affected",
        )
    return f"the worker ended with exit code {code}", "see the log in the failed/ folder"


def _stop(process: ForkProcess) -> None:
    process.terminate()
    process.join(_GRACE)
    if process.is_alive():
        process.kill()
        process.join()


def _main(
    work: Callable[[Task], None],
    together: Together | None,
    tasks: Group,
    threads: int,
    memory: int | None,
    answer: Any,
    log: str,
) -> None:
    """The worker process: output goes to the log, outcomes through the pipe."""
    os.environ["RAYON_NUM_THREADS"], os.environ["OMP_NUM_THREADS"] = str(threads), "1"
    descriptor = open_regular(Path(log), os.O_RDWR | os.O_CREAT | os.O_APPEND)
    fcntl.flock(descriptor, fcntl.LOCK_EX)  # in use, as long as this process lives
    os.ftruncate(descriptor, 0)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)
    sys.stdout, sys.stderr = (open(number, "w", buffering=1, closefd=False) for number in (1, 2))  # noqa: SIM115
    threading.Thread(target=_end_with_parent, daemon=True).start()
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)  # for good: more of them at the end might find no memory, and wait for it
    if memory is not None:
        limit_memory(memory)
    with together(tasks) if together else contextlib.nullcontext(_nothing) as prepare:
        for task in tasks:
            prepare(task)
            os.ftruncate(descriptor, 0)  # the log is that of the task at work
            answer.send_bytes(json.dumps(None).encode())
            code, message, remedy = _attempt(work, task, alone=len(tasks) == 1)
            if OUT_OF_MEMORY.search(message):
                message, remedy = "out of memory", _more_memory()
            sys.stdout.flush()
            sys.stderr.flush()
            size = os.fstat(descriptor).st_size
            text = "" if code == "done" else os.pread(descriptor, size, 0).decode(errors="replace")
            said = {"code": code, "message": message, "remedy": remedy, "log": text}
            answer.send_bytes(json.dumps(said).encode())
    answer.close()


def _nothing(_: Task) -> None:
    """What a task does first that shares nothing."""


def _end_with_parent() -> None:
    """A worker whose server has ended works for nobody, and must not stand in the next run's way."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _attempt(work: Callable[[Task], None], task: Task, *, alone: bool) -> tuple[str, str, str]:
    """Code, message and remedy of one task. Memory that ran out in company is no answer: the worker dies of it."""
    try:
        work(task)
    except MemoryError:
        if not alone:
            os._exit(1)
        return "error", "out of memory", _more_memory()
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
