"""Runs tasks in worker processes: one process per task, so that a failure costs that task only.

A failure is an error, a crash, a timeout or a kill for want of memory. Workers are forked from a server process
that has the slow imports done; each gets its share of the cores.
"""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import signal
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing.connection import wait
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any

from .files import write_atomically
from .mesh import InputError

Task = Mapping[str, Any]
# imported once, before the workers are forked: what every case needs, and no case should be timed with
PRELOAD = ["studies.worker", "vdm.model", "fem_reference.linear"]
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
    task: Task
    process: ForkServerProcess
    answer: Any  # the reading end of its pipe
    log: Path
    began: float


def run_tasks(
    work: Callable[[Task], None],
    tasks: Sequence[Task],
    *,
    jobs: int,
    log_directory: Path,
    timeout: float | None = None,
    fail_fast: bool = False,
    started: Callable[[Task], None],
) -> Iterator[Outcome]:
    """Run `work(task)` for each task, at most `jobs` at once, yielding outcomes as they come.

    `work` must be a module-level function; tasks are plain JSON with an "id". Leaving the iterator early, Ctrl-C
    included, stops the workers. Outcomes of failed tasks carry the worker's output.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOAD)
    log_directory.mkdir(parents=True, exist_ok=True)
    threads = max(1, (os.cpu_count() or 1) // jobs)
    queue = list(tasks)[::-1]
    running: list[_Running] = []
    try:
        while queue or running:
            while queue and len(running) < jobs:
                task = queue.pop()
                started(task)
                running.append(_start(context, work, task, threads, log_directory))
            wait([r.process.sentinel for r in running], timeout=0.2 if timeout else None)
            for r in list(running):
                late = timeout is not None and time.monotonic() - r.began > timeout
                if r.process.is_alive() and not late:
                    continue
                running.remove(r)
                outcome = _finish(r, timeout if late else None)
                yield outcome
                if fail_fast and not outcome.ok:
                    return
    finally:
        for r in running:
            _stop(r.process)
            r.log.unlink(missing_ok=True)


def _start(context: Any, work: Callable[[Task], None], task: Task, threads: int, logs: Path) -> _Running:
    reader, writer = context.Pipe(duplex=False)
    log = logs / f".{task['id']}.{os.getpid()}.log"
    process = context.Process(target=_main, args=(work, task, threads, writer, str(log)), daemon=True)
    process.start()
    writer.close()
    return _Running(task, process, reader, log, time.monotonic())


def _finish(r: _Running, timeout: float | None) -> Outcome:
    seconds = time.monotonic() - r.began
    if timeout is not None and r.process.is_alive():
        _stop(r.process)
    r.process.join()
    answer: dict[str, str] | None = None
    with contextlib.suppress(EOFError, OSError):
        if r.answer.poll():
            answer = json.loads(r.answer.recv_bytes())
    r.answer.close()
    log = r.log.read_text(errors="replace") if r.log.exists() else ""
    r.log.unlink(missing_ok=True)
    if answer is not None:
        return Outcome(r.task, answer["code"], seconds, answer["message"], answer["remedy"], log)
    if timeout is not None:
        remedy = "allow more with --timeout, or use a coarser mesh"
        return Outcome(r.task, "timeout", seconds, f"stopped after {timeout:g} s", remedy, log)
    code = r.process.exitcode or 0
    if code == -signal.SIGKILL:
        message, remedy = (
            "killed by the system, most likely out of memory",
            "use a coarser mesh or fewer --jobs",
        )
    elif code < 0:
        message = f"the worker crashed with signal {signal.Signals(-code).name}"
        remedy = "see the log in the run directory's failed/ folder; other cases are not affected"
    else:
        message, remedy = f"the worker ended with exit code {code}", "see the log in the failed/ folder"
    return Outcome(r.task, "crashed", seconds, message, remedy, log)


def _stop(process: ForkServerProcess) -> None:
    process.terminate()
    process.join(_GRACE)
    if process.is_alive():
        process.kill()
        process.join()


def _main(work: Callable[[Task], None], task: Task, threads: int, answer: Any, log: str) -> None:
    """The worker process: output goes to the log, the outcome through the pipe."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    os.environ["RAYON_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = str(threads)
    descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)
    from threadpoolctl import threadpool_limits

    code, message, remedy = "done", "", ""
    with threadpool_limits(threads):
        try:
            work(task)
        except MemoryError:
            code, message, remedy = "error", "out of memory", "use a coarser mesh or fewer --jobs"
        except OSError as error:
            code, message, remedy = "error", f"{error}", "check free space and permissions"
        except InputError as error:
            code, message = "input", f"{error}"
        except ValueError as error:
            code, message, remedy = "error", f"{error}", getattr(error, "remedy", "")
            traceback.print_exc()
        except Exception as error:  # noqa: BLE001  a worker must answer, whatever happens in it
            code, message = "error", f"{type(error).__name__}: {error}"
            remedy = "this is a bug: please report it with the log in the failed/ folder"
            traceback.print_exc()
    answer.send_bytes(json.dumps({"code": code, "message": message, "remedy": remedy}).encode())
    answer.close()


def write_failure(path: Path, outcome: Outcome, label: str) -> None:
    """Keep the reason and the log of a failed task beside the results."""
    record = {
        "hash": outcome.task["id"],
        "label": label,
        "code": outcome.code,
        "message": outcome.message,
        "remedy": outcome.remedy,
    }
    write_atomically(path, json.dumps(record, indent=1).encode())
    write_atomically(path.with_suffix(".log"), outcome.log.encode())
