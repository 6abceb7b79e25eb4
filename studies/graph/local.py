"""Places on this machine: worker processes of pebble's pool, with a limit of memory each and of time for each node.

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
from collections.abc import Iterator
from concurrent.futures import Future, TimeoutError
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import resource_tracker
from multiprocessing.forkserver import ensure_running
from pathlib import Path

from pebble import ProcessExpired, ProcessPool

from ..machine.memory import OUT_OF_MEMORY, limit_memory, machine_memory
from ..machine.processors import usable_processors
from .work import Said, more_memory, run_node

_OF_A_TERMINAL = (signal.SIGINT, signal.SIGHUP)
_PRELOADED = (
    "vdmbench.graph.work",
    "numpy.ma",
    "scipy.sparse.linalg",
    "skfem",
    "vdm",
    "fem_reference.linear",
)


class LocalPlaces:
    """`jobs` worker processes, each with its share of the cores and of the memory."""

    def __init__(self, jobs: int, memory: int | None = None) -> None:
        self.count = jobs
        self._memory = memory or machine_memory() // jobs
        self._pool = self._started()

    def _started(self) -> ProcessPool:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(list(_PRELOADED))
        threads = max(1, usable_processors() // self.count)
        pool = ProcessPool(
            max_workers=self.count,
            context=context,
            initializer=begin_worker,
            initargs=(threads, self._memory),
        )
        environment = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "RAYON_NUM_THREADS": str(threads)}
        try:
            with _environment(**environment):
                with _deaf():
                    resource_tracker.ensure_running()  # which lets Ctrl-C through again
                with _deaf():
                    ensure_running()
                    _ = pool.active  # starts it
        except BaseException:  # Ctrl-C meanwhile: nobody else knows of the pool
            _stop(pool)
            raise
        return pool

    def submit(self, node: str, log: Path, seconds: float | None) -> Future[str]:  # noqa: ARG002
        """See `Places`."""
        if not self._pool.active:  # a worker died in a way that broke it
            self.close()
            self._pool = self._started()
        future: Future[str] = self._pool.schedule(run_node, args=[node], timeout=seconds)
        return future

    def failure(self, error: BaseException, log: str) -> Said:
        """See `Places`."""
        return told(error, log)

    def close(self) -> None:
        """Stop the workers, at work or not."""
        _stop(self._pool)


def _stop(pool: ProcessPool) -> None:
    pool.stop()  # type: ignore[no-untyped-call]
    pool.join()


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
    """What is started inside never hears what a terminal sends to all: its starter stops it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _OF_A_TERMINAL)
    try:
        yield
    finally:  # what came meanwhile comes now
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


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


class HerePlaces:
    """One place in this process itself: nothing is started, and nothing stops what does not end or crashes."""

    count = 1

    def submit(self, node: str, log: Path, seconds: float | None) -> Future[str]:  # noqa: ARG002
        """See `Places`."""
        future: Future[str] = Future()
        future.set_result(run_node(node))
        return future

    def failure(self, error: BaseException, log: str) -> Said:
        """See `Places`."""
        return told(error, log)
