"""Places on this machine: worker processes of pebble, with a limit of memory each and of time for each node.

The workers are forked from a clean server process that has loaded the libraries. They end with the program that
started them, however that ends.
"""

from __future__ import annotations

import contextlib
import fcntl
import multiprocessing
import os
import select
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Future, TimeoutError
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import resource_tracker
from multiprocessing.context import ForkServerContext, ForkServerProcess
from multiprocessing.forkserver import ensure_running
from pathlib import Path
from typing import Any

from pebble import ProcessExpired, ProcessPool

from ..machine.memory import OUT_OF_MEMORY, limit_memory, machine_memory
from ..machine.processors import usable_processors
from .work import ATTEMPTS, Said, more_memory, run_node

_OF_A_TERMINAL = (signal.SIGINT, signal.SIGHUP)
_HANDLED = (*_OF_A_TERMINAL, signal.SIGTERM, signal.SIGALRM)
_PRELOADED = (
    "vdmbench.graph.work",
    "numpy.ma",
    "scipy.sparse.linalg",
    "skfem",
    "vdm.model",
    "fem_reference.linear",
)


class LocalPlaces:
    """`jobs` worker processes, each with its share of the cores and of the memory."""

    def __init__(self, jobs: int, memory: int | None = None) -> None:
        self.count = jobs
        threads = max(1, usable_processors() // jobs)
        self._places = [_Place(threads, memory or machine_memory() // jobs) for _ in range(jobs)]
        try:
            for place in self._places:
                place.start()
        except BaseException:  # Ctrl-C meanwhile: nobody else knows of them
            self.close()
            raise

    def submit(self, node: str, log: Path, seconds: float | None) -> Future[str]:  # noqa: ARG002
        """See `Places`."""
        return next(place for place in self._places if place.is_free).submit(node, seconds)

    def look(self) -> None:
        """See `Places`."""
        for place in self._places:
            place.look()

    def failure(self, error: BaseException, log: str) -> Said:
        """See `Places`."""
        return told(error, log)

    def close(self) -> None:
        """Stop the workers, at work or not."""
        for place in self._places:
            place.stop()
        for place in self._places:
            place.join()


class _Place:
    """One worker process, a pool of its own: in one of several, a death may lose the task of another."""

    def __init__(self, threads: int, memory: int) -> None:
        self._threads, self._memory = threads, memory
        self._pool: ProcessPool | None = None
        self._context = _Context()
        self._future: Future[str] | None = None

    @property
    def is_free(self) -> bool:
        """Whether it has nothing to do."""
        return self._future is None or self._future.done()

    def start(self) -> ProcessPool:
        """The pool with its worker, a new one where the last broke."""
        if self._pool is not None and self._pool.active:
            return self._pool
        self.stop()
        self.join()
        self._context = context = _Context()
        context.set_forkserver_preload(list(_PRELOADED))
        self._pool = ProcessPool(
            max_workers=1, context=context, initializer=begin_worker, initargs=(self._threads, self._memory)
        )
        threads = str(self._threads)
        with _environment(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", RAYON_NUM_THREADS=threads):
            with _deaf():
                resource_tracker.ensure_running()  # which lets Ctrl-C through again
            with _deaf():
                ensure_running()
                _ = self._pool.active  # starts it
        return self._pool

    def submit(self, node: str, seconds: float | None) -> Future[str]:
        """Do a node."""
        error = None if self._future is None else self._future.exception()
        if error is not None and not isinstance(error, TimeoutError):
            self.stop()  # its worker died: perhaps with a lock in its hand
        for _ in range(ATTEMPTS):
            with contextlib.suppress(RuntimeError):  # it broke since it was started
                future: Future[str] = self.start().schedule(run_node, args=[node], timeout=seconds)
                self._future = future
                return future
        broken: Future[str] = Future()
        broken.set_exception(BrokenProcessPool("the workers die before they begin"))
        return broken

    def look(self) -> None:
        """End the wait for a node that a broken pool has lost: its worker died before it said that it began."""
        if self._future is None or self._future.done() or self._pool is None or self._pool.active:
            return
        self.stop()
        self.join()
        if not self._future.done():
            self._future.set_exception(BrokenProcessPool("the worker died before it began"))

    def stop(self) -> None:
        """Stop the worker, without waiting for it."""
        if self._pool is not None:
            self._pool.stop()  # type: ignore[no-untyped-call]
            self._context.stop()  # before the pool takes its locks away, which the worker may be about to open

    def join(self) -> None:
        """Wait until the worker is gone."""
        if self._pool is not None:
            self._pool.join()
            self._pool = None


class _Context(ForkServerContext):
    """Starts a worker, and knows what it has started."""

    def __init__(self) -> None:
        super().__init__()
        self._started: list[ForkServerProcess] = []
        self._stopped = False

    def Process(self, *arguments: Any, **named: Any) -> ForkServerProcess:  # type: ignore[override]
        """A worker to be started. Raises OSError once all are stopped."""
        if self._stopped:
            raise OSError("the workers are stopped")
        self._started.append(ForkServerProcess(*arguments, **named))
        return self._started[-1]

    def stop(self) -> None:
        """Stop them all, and start no more."""
        self._stopped = True
        for worker in self._started:
            if worker.is_alive():
                worker.kill()


def told(error: BaseException, log: str) -> Said:
    """What an error of a pool's future means."""
    if isinstance(error, TimeoutError):
        seconds = float(error.args[1]) if len(error.args) > 1 else 0.0
        remedy = "allow more with --timeout, or use a coarser mesh"
        return Said("", "timeout", seconds, f"stopped after {seconds:g} s", remedy, log)
    if isinstance(error, ProcessExpired):
        return Said("", "crashed", 0.0, *_death(error.exitcode or 0, log), log)
    if isinstance(error, BrokenProcessPool):
        return Said("", "crashed", 0.0, "the workers died", "see the log in the failed/ folder", log)
    return Said("", "error", 0.0, f"{type(error).__name__}: {error}", "this is a bug: please report it", log)


def _death(code: int, log: str) -> tuple[str, str]:
    """What an exit code of a worker that died means, and what to do."""
    if OUT_OF_MEMORY.search(log):
        return "out of memory", more_memory()
    if code == -signal.SIGKILL:
        return "killed by the system, most likely out of memory", more_memory()
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
    _end_with_starter()
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)  # for good: more of them at the end might find no memory, and wait for it
    limit_memory(memory)


def _end_with_starter() -> None:
    """Have the system end this process with its starter: by SIGIO, once nobody holds the other end of their pipe.

    A thread that waits for it would wait for the interpreter too, which a library may hold for long.
    """
    starter = multiprocessing.parent_process()
    if starter is not None:
        signal.signal(signal.SIGIO, signal.SIG_DFL)
        fcntl.fcntl(starter.sentinel, fcntl.F_SETOWN, os.getpid())
        flags = fcntl.fcntl(starter.sentinel, fcntl.F_GETFL)
        fcntl.fcntl(starter.sentinel, fcntl.F_SETFL, flags | os.O_ASYNC)
        if select.select([starter.sentinel], [], [], 0)[0]:  # it has ended already
            os._exit(1)


@contextlib.contextmanager
def _deaf() -> Iterator[None]:
    """What is started inside never hears what a terminal sends to all: its starter stops it.

    No signal ends the block in its middle either: a worker that is started by halves is nobody's to stop.
    """
    came: list[int] = []
    is_main = threading.current_thread() is threading.main_thread()  # the only one that handles signals
    handlers = {number: signal.getsignal(number) for number in _HANDLED if is_main}
    handlers = {number: handler for number, handler in handlers.items() if callable(handler)}
    for number in handlers:  # which another thread lets through, whatever the mask of this one
        signal.signal(number, lambda number, _: came.append(number))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _OF_A_TERMINAL)
    try:
        yield
    finally:  # what came meanwhile comes now
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if came:
            signal.raise_signal(came[0])


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
