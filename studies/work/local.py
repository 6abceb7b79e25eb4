"""Places on this machine: worker processes, with a limit of memory each and of time for each node.

A thread of each place hands its worker one node after the other, by a pipe of their own. The workers are forked
from a clean server process that has loaded the libraries. They end with the program that started them, however
that ends.

Pebble's pool loses a task whose worker ends with exit code 0, or dies before it said that it began (5.2.3).
"""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerProcess
from pathlib import Path

from ..machine import limit_memory, machine_memory, usable_processors
from .worker import MORE_MEMORY, OUT_OF_MEMORY, Said, run_node

_OF_A_TERMINAL = (signal.SIGINT, signal.SIGHUP)
_PARENT_DEATH_SIGNAL = 1  # prctl(2)
_PRELOADED = (
    "vdmbench.work.worker",
    "numpy.ma",
    "scipy.sparse.linalg",
    "skfem",
    "vdm.model",
    "fem_reference.linear",
)


class WorkerDiedError(Exception):
    """A worker that ended before it answered, with its exit code; None where it could not start."""

    def __init__(self, code: int | None) -> None:
        super().__init__(code)
        self.code = code


class LocalPlaces:
    """`jobs` worker processes, each with its share of the cores and of the memory."""

    def __init__(self, jobs: int, memory: int | None = None) -> None:
        self.count = jobs
        self._share = max(1, usable_processors() // jobs), memory or machine_memory() // jobs
        self._threads = ThreadPoolExecutor(jobs)
        self._own = threading.local()  # the worker of each thread
        self._workers: set[_Worker] = set()
        self._changes = threading.Lock()  # one process starts or ends at a time: multiprocessing looks at all
        self._closed = False

    def submit(self, node: str, log: Path, seconds: float | None) -> Future[str]:  # noqa: ARG002
        """See `Places`."""
        return self._threads.submit(self._do, node, seconds)

    def _do(self, node: str, seconds: float | None) -> str:
        """What a node says. Raises TimeoutError, WorkerDiedError."""
        worker: _Worker | None = getattr(self._own, "worker", None)
        try:
            if worker is None:
                worker = self._own.worker = self._start()
                worker.answer(None)  # that it is ready
            return worker.ask(node, seconds)
        except (EOFError, OSError) as error:
            self._own.worker = None
            code = self._end(worker) if worker is not None else None
            if isinstance(error, TimeoutError):
                raise
            raise WorkerDiedError(code) from error

    def _start(self) -> _Worker:
        with self._changes:
            if self._closed:
                raise OSError("the workers are stopped")
            worker = _Worker(run_node, *self._share)
            self._workers.add(worker)
            return worker

    def _end(self, worker: _Worker) -> int | None:
        with self._changes:
            self._workers.discard(worker)
            return worker.end()

    def failure(self, error: BaseException, log: str) -> Said:
        """See `Places`."""
        return told(error, log)

    def close(self) -> None:
        """Stop the workers, at work or not."""
        with self._changes:
            self._closed = True
            for worker in self._workers:
                worker.process.kill()
        self._threads.shutdown(cancel_futures=True)
        for worker in list(self._workers):
            self._end(worker)


class _Worker:
    """A process, and the pipe by which it gets nodes. Raises OSError, EOFError where it cannot start."""

    def __init__(self, do: Callable[[str], str], threads: int, memory: int) -> None:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(list(_PRELOADED))
        self.pipe, theirs = context.Pipe()
        self.process: ForkServerProcess = context.Process(target=serve, args=(theirs, do, threads, memory))
        libraries = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "RAYON_NUM_THREADS": str(threads)}
        with theirs, _environment(PYTHONSAFEPATH="1", **libraries):  # none imports from the working directory
            resource_tracker.ensure_running()  # which lets Ctrl-C through again
            signal.pthread_sigmask(signal.SIG_BLOCK, _OF_A_TERMINAL)  # here and in what this thread starts
            self.process.start()

    def ask(self, node: str, seconds: float | None) -> str:
        """Its answer to a node. Raises TimeoutError after `seconds`, EOFError or OSError where it died."""
        self.pipe.send(node)
        return self.answer(seconds)

    def answer(self, seconds: float | None) -> str:
        """What it sends next. Raises as `ask` does."""
        if not wait([self.pipe, self.process.sentinel], seconds):
            self.process.kill()
            raise TimeoutError("stopped", seconds)
        if not self.pipe.poll():
            raise EOFError
        answer: str = self.pipe.recv()
        return answer

    def end(self) -> int | None:
        """Stop it, unless it has ended by itself; its exit code."""
        self.process.join(1.0)
        self.process.kill()
        self.process.join()
        code = self.process.exitcode
        self.process.close()
        self.pipe.close()
        return code


def serve(pipe: Connection, do: Callable[[str], str], threads: int, memory: int) -> None:
    """What a worker process does: node after node, until nobody asks any more."""
    begin_worker(threads, memory)
    with contextlib.suppress(EOFError, OSError):
        pipe.send("")
        while True:
            pipe.send(do(pipe.recv()))


def told(error: BaseException, log: str) -> Said:
    """What an error of a place's future means."""
    if isinstance(error, TimeoutError):
        seconds = float(error.args[1]) if len(error.args) > 1 else 0.0
        remedy = "allow more with --timeout, or use a coarser mesh"
        return Said("", "timeout", seconds, f"stopped after {seconds:g} s", remedy, log)
    if isinstance(error, WorkerDiedError):
        return Said("", "crashed", 0.0, *_death(error.code, log), log)
    return Said("", "error", 0.0, f"{type(error).__name__}: {error}", "this is a bug: please report it", log)


def _death(code: int | None, log: str) -> tuple[str, str]:
    """What an exit code of a worker that died means, and what to do."""
    if OUT_OF_MEMORY.search(log):
        return "out of memory", MORE_MEMORY
    if code is None:
        return "the workers die before they begin", MORE_MEMORY
    if code == -signal.SIGKILL:
        return "killed by the system, most likely out of memory", MORE_MEMORY
    if code < 0:
        return (
            f"the worker crashed with signal {signal.Signals(-code).name}",
            "see the log in the run directory's failed/ folder; other cases are not affected",
        )
    return f"the worker ended with exit code {code}", "see the log in the failed/ folder"


@contextlib.contextmanager
def local_places(jobs: int, memory: int | None = None) -> Iterator[LocalPlaces]:
    """Places on this machine, gone when the block is left."""
    places = LocalPlaces(jobs, memory)
    try:
        yield places
    finally:
        places.close()


def begin_worker(threads: int, memory: int) -> None:
    """What a worker process does first."""
    os.environ["RAYON_NUM_THREADS"], os.environ["OMP_NUM_THREADS"] = str(threads), "1"
    with contextlib.suppress(AttributeError):  # of Linux: it ends with its server, and that with its starter
        ctypes.CDLL(None).prctl(_PARENT_DEATH_SIGNAL, signal.SIGKILL)
    limit_memory(memory)


@contextlib.contextmanager
def _environment(**values: str) -> Iterator[None]:
    """Environment variables for processes that are started inside."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name)
            else:
                os.environ[name] = value
