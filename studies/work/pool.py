"""The pool: does tasks, each as soon as its needs are met, in processes here or on a cluster.

If a task fails, only tasks that need it fail too. If a process dies, its task is tried again, `ATTEMPTS` times in
all.

Locally a thread for each worker process sends it one task after the other through a pipe. The workers are forked
from a clean server process that has loaded the libraries, and end with the program that started them. Pebble's
pool (5.2.3) is not used: it waits forever for a task whose worker exits with code 0, or dies before it reports
that it began.
"""

from __future__ import annotations

import contextlib
import heapq
import json
import multiprocessing
import os
import re
import signal
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor
from concurrent.futures import wait as wait_for_one
from dataclasses import replace
from graphlib import TopologicalSorter
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Protocol

from ..machine import limit_memory, machine_memory, usable_processors
from .tasks import Task
from .worker import MORE_MEMORY, OUT_OF_MEMORY, WHERE, Said, do_task

ATTEMPTS = 3  # of a task whose process dies
_LOOK = 1.0  # s between looks at the progress of running tasks
_OF_A_TERMINAL = (signal.SIGINT, signal.SIGHUP)
_PRELOADED = (
    "vdmbench.work.worker",
    "numpy.ma",
    "scipy.sparse.linalg",
    "skfem",
    "vdm.model",
    "fem_reference.linear",
)


class Pool(Protocol):
    """A place to do tasks: `LocalPool` here, `vdmbench.work.cluster.Cluster` elsewhere."""

    @property
    def count(self) -> int:
        """Number of tasks at once."""

    def submit(self, task: str, log: Path, seconds: float | None) -> Future[str]:
        """Do a task, given as JSON, in at most `seconds`; the future gives its `Said` as JSON, for any outcome.

        "crashed" means that its process died and it may be tried again. The future raises errors that end the run.
        """


def run_tasks(
    tasks: Sequence[Task],
    pool: Pool,
    logs: Path,
    *,
    timeout: float | None = None,
    started: Callable[[Task], None] = lambda _: None,
    where: Callable[[Task, str], None] = lambda *_: None,
) -> Iterator[tuple[Task, Said]]:
    """Do all tasks, yielding the outcome of each when it is there.

    Parameters
    ----------
    logs : directory for the output of tasks, kept only for failures
    timeout : seconds for one task
    where : called with a running task and its latest progress
    """
    order = {task.id: place for place, task in enumerate(tasks)}
    sorter = TopologicalSorter({task.id: task.needs & order.keys() for task in tasks})
    sorter.prepare()
    ready: list[int] = []  # a heap of indices in `tasks`
    failed: dict[str, Said] = {}
    at_work: dict[Future[str], Task] = {}
    attempts: Counter[str] = Counter()
    heard: dict[str, str] = {}
    logs.mkdir(parents=True, exist_ok=True)

    def log_of(task: Task) -> Path:
        return logs / f".{task.id.replace(' ', '-')[:120]}.log"

    while sorter.is_active():
        for identity in sorter.get_ready():
            heapq.heappush(ready, order[identity])
        ended: list[tuple[Task, Said]] = []
        while ready and len(at_work) < pool.count:
            task = tasks[heapq.heappop(ready)]
            cause = next((failed[need] for need in sorted(task.needs) if need in failed), None)
            if cause is not None:
                ended.append((task, cause))
                continue
            started(task)
            attempts[task.id] += 1
            log = log_of(task)
            text = json.dumps({"kind": task.kind, "payload": task.payload, "log": str(log)})
            at_work[pool.submit(text, log, timeout)] = task
        if not ended:
            finished, working = wait_for_one(at_work, _LOOK, return_when=FIRST_COMPLETED)
            for future in working:
                task = at_work[future]
                line = _last_place(log_of(task))
                if line != heard.get(task.id, ""):
                    heard[task.id] = line
                    where(task, line)
            for future in finished:
                task = at_work.pop(future)
                said = _said(future, log_of(task))
                if said.code == "crashed" and attempts[task.id] < ATTEMPTS:
                    heapq.heappush(ready, order[task.id])
                else:
                    ended.append((task, said))
        for task, said in ended:
            if not said.ok:
                failed[task.id] = said
            yield task, said
            sorter.done(task.id)


def _said(future: Future[str], log: Path) -> Said:
    """The outcome of a task; its log is removed."""
    printed = _read(log)
    log.unlink(missing_ok=True)
    said = Said(**json.loads(future.result()))
    return said if said.ok else replace(said, log=printed)


def _read(log: Path) -> str:
    try:
        return log.read_text(errors="replace")
    except OSError:
        return ""


def _last_place(log: Path) -> str:
    """The latest progress of a running task; "" without any."""
    lines = re.findall(f"{WHERE}(.*)\n", _read(log))
    return lines[-1] if lines else ""


# --- processes of this machine ---


class LocalPool:
    """`jobs` worker processes, each with its share of the cores and of the memory [bytes]."""

    def __init__(self, jobs: int, memory: int | None = None) -> None:
        self.count = jobs
        self._share = max(1, usable_processors() // jobs), memory or machine_memory() // jobs
        self._threads = ThreadPoolExecutor(jobs)
        self._own = threading.local()  # the worker of each thread
        self._workers: set[_Worker] = set()
        self._changes = threading.Lock()  # one process starts or ends at a time: multiprocessing looks at all
        self._closed = False

    def submit(self, task: str, log: Path, seconds: float | None) -> Future[str]:
        """See `Pool`."""
        return self._threads.submit(self._do, task, log, seconds)

    def _do(self, task: str, log: Path, seconds: float | None) -> str:
        worker: _Worker | None = getattr(self._own, "worker", None)
        try:
            if worker is None:
                worker = self._own.worker = self._start()
                worker.answer(None)  # it reports that it is ready
            return worker.ask(task, seconds)
        except (EOFError, OSError) as error:
            self._own.worker = None
            code = self._end(worker) if worker is not None else None
            if isinstance(error, TimeoutError) and seconds is not None:
                remedy = "allow more with --timeout, or use a coarser mesh"
                return Said("timeout", seconds, f"stopped after {seconds:g} s", remedy).as_json()
            return _died(code, _read(log)).as_json()

    def _start(self) -> _Worker:
        with self._changes:
            if self._closed:
                raise OSError("the workers are stopped")
            worker = _Worker(do_task, *self._share)
            self._workers.add(worker)
            return worker

    def _end(self, worker: _Worker) -> int | None:
        with self._changes:
            self._workers.discard(worker)
            return worker.end()

    def close(self) -> None:
        """Stop the workers, idle or not."""
        with self._changes:
            self._closed = True
            for worker in self._workers:
                worker.process.kill()
        self._threads.shutdown(cancel_futures=True)
        for worker in list(self._workers):
            self._end(worker)


@contextlib.contextmanager
def local_pool(jobs: int, memory: int | None = None) -> Iterator[LocalPool]:
    """Workers on this machine, stopped at the end of the block."""
    pool = LocalPool(jobs, memory)
    try:
        yield pool
    finally:
        pool.close()


class _Worker:
    """A process and the pipe for its tasks. Raises OSError or EOFError if it cannot start."""

    def __init__(self, do: Callable[[str], str], threads: int, memory: int) -> None:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(list(_PRELOADED))
        self.pipe, theirs = context.Pipe()
        self.process: ForkServerProcess = context.Process(target=serve, args=(theirs, do, threads, memory))
        libraries = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "RAYON_NUM_THREADS": str(threads)}
        with theirs, _environment(PYTHONSAFEPATH="1", **libraries):  # no imports from the working directory
            resource_tracker.ensure_running()  # it unblocks Ctrl-C, so start it before
            signal.pthread_sigmask(signal.SIG_BLOCK, _OF_A_TERMINAL)  # here and in processes of this thread
            try:
                self.process.start()
            except (ConnectionError, EOFError):  # the server was killed, and may still be exiting
                # waits for its end, so that the next start begins a new one
                forkserver._forkserver._stop()  # type: ignore[attr-defined]
                self.process.start()

    def ask(self, task: str, seconds: float | None) -> str:
        """Its answer to a task. Raises TimeoutError after `seconds`, EOFError or OSError where it died."""
        self.pipe.send(task)
        return self.answer(seconds)

    def answer(self, seconds: float | None) -> str:
        """Its next message. Raises like `ask`."""
        if not wait([self.pipe, self.process.sentinel], seconds):
            self.process.kill()
            raise TimeoutError("stopped", seconds)
        if not self.pipe.poll():
            raise EOFError
        answer: str = self.pipe.recv()
        return answer

    def end(self) -> int | None:
        """Stop it if it still runs; returns its exit code."""
        self.process.join(1.0)
        self.process.kill()
        self.process.join()
        code = self.process.exitcode
        self.process.close()
        self.pipe.close()
        return code


def serve(pipe: Connection, do: Callable[[str], str], threads: int, memory: int) -> None:
    """Loop of a worker process: one task after the other, until the pipe closes."""
    os.environ["RAYON_NUM_THREADS"], os.environ["OMP_NUM_THREADS"] = str(threads), "1"
    threading.Thread(target=_end_with_starter, daemon=True).start()
    limit_memory(memory)
    with contextlib.suppress(EOFError, OSError):
        pipe.send("")
        while True:
            pipe.send(do(pipe.recv()))


def _end_with_starter() -> None:
    starter = multiprocessing.parent_process()
    assert starter is not None
    starter.join()
    os._exit(1)


def _died(code: int | None, log: str) -> Said:
    """The outcome for a worker that ended without an answer, by its exit code; None if it could not start."""
    if OUT_OF_MEMORY.search(log):
        return Said("crashed", 0.0, "out of memory", MORE_MEMORY)
    if code in (None, -signal.SIGKILL):
        how = "could not start" if code is None else "was killed by the system"
        return Said("crashed", 0.0, f"the worker {how}, most likely out of memory", MORE_MEMORY)
    how = f"crashed with signal {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
    remedy = "see the log in the run directory's failed/ folder; other cases are not affected"
    return Said("crashed", 0.0, f"the worker {how}", remedy)


@contextlib.contextmanager
def _environment(**values: str) -> Iterator[None]:
    """Environment variables for processes that are started inside the block."""
    before = dict(os.environ)
    os.environ.update(values)
    try:
        yield
    finally:
        for name in values:
            if name in before:
                os.environ[name] = before[name]
            else:
                del os.environ[name]
