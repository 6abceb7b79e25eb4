"""The process that workers are forked from: all that they need is loaded in it, once.

It is forked itself where it can be, from the program that asks it, so that what both need (numpy, HDF5, the schema
of study files) is loaded once too. A fork has no thread but the one that made it, and who waits for another waits
for ever: `start_server` is to be called before this program starts threads and loads libraries that have some. If
it has, as a notebook does, the server is a fresh process. It has one thread itself.
"""

from __future__ import annotations

import atexit
import gc
import multiprocessing
import os
import resource
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Generator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from importlib import import_module
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from .memory import MemoryLimitError, heed_limits, is_lack_of_memory, memory_limits, require_room

Events = Generator[Any, None, None]

# what the program needs later too, to estimate and to plot: loaded before the fork, it is loaded once
_SHARED = ("fem_reference.costs", "numpy.ma", "unittest")
# what every case needs, and no case should be timed with
_MODULES = ("studies.worker", "vdm.model", "fem_reference.linear", "scipy.spatial")
_SIGNALS = {signal.SIGINT, signal.SIGHUP, signal.SIGTERM}
_COLLECT = (700, 10, 10)  # Python's own: a program may look for garbage less often, but workers run for hours

CONTEXT = multiprocessing.get_context("fork")
_FRESH = multiprocessing.get_context("spawn")
# where these are loaded, libraries may have started threads and do not know when they are forked (numpy's does)
_WITH_THREADS = ("fem_reference.factorisation", "vdm.solvers", "vtkmodules", "gmsh")


class ServerError(OSError):
    """The server of workers is gone, or busy."""


class Server:
    """A process that does what it is asked and says what comes of it: forked where that is safe, else fresh."""

    def __init__(self) -> None:
        alone = threading.active_count() == 1 and not any(name in sys.modules for name in _WITH_THREADS)
        self._owner = os.getpid()
        self._asked = self._busy = False
        self._line, theirs = CONTEXT.Pipe()
        self._process: BaseProcess
        if alone:
            self._process = CONTEXT.Process(target=_serve, args=(theirs, self._line))
        else:
            resource_tracker.ensure_running()  # first, because it lets signals in again
            self._process = _FRESH.Process(target=_serve, args=(theirs, None))
        # until the server has its own answer to them
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()

    @property
    def alive(self) -> bool:
        """Whether it can be asked; by the process that started it, not by a fork of that."""
        return self._owner == os.getpid() and not self._line.closed and self._process.is_alive()

    def ask(self, function: Callable[..., Events], *arguments: Any) -> Events:
        """What `function(line, *arguments)` yields in the server: a module's function, and plain data.

        It has to return when its `line` can be read from: then nobody listens any more, as after this iterator is
        left early. Raises an OSError that the function raises, RuntimeError with the server's traceback for any
        other exception, ServerError where the server was killed or is at work on another question.
        """
        if self._busy:
            raise ServerError("a run is at work in this process already: wait for it")
        self._asked = self._busy = True
        try:
            self._line.send((os.getcwd(), function, arguments))
            while (said := self._line.recv()) is not None:
                if isinstance(said, _Failure):
                    raise said.error or RuntimeError(said.text)
                yield said.said
        except (EOFError, BrokenPipeError, ConnectionResetError):
            self.close()
            raise ServerError("the process that starts the workers was killed; run the same again") from None
        except BaseException:
            self.close()
            raise
        finally:
            self._busy = False

    def close(self) -> None:
        """Let it stop what it is at and end; waits for that."""
        if self._owner != os.getpid():
            return
        self._line.close()
        if not self._asked:  # it may still be loading what nobody wants any more
            self._process.terminate()
        self._process.join()


@dataclass(frozen=True)
class _Said:
    said: Any


@dataclass(frozen=True)
class _Failure:
    text: str
    error: OSError | None  # whose kind says what is to be done; other exceptions may not survive the way


_running: list[Server] = []  # one at most


def start_server() -> Server:
    """The server, started now unless it is there; it loads its libraries while this program goes on.

    Of this program's surroundings only the working directory follows later: its environment, its modules and its
    models are what they were when the server was started.
    """
    if not (_running and _running[0].alive):
        for name in _SHARED:
            import_module(name)
        if not _running:
            atexit.register(_close_running)
        _running[:] = [Server()]
    return _running[0]


def processor_seconds(server: Server) -> float:
    """What this process, the server and those of its workers that have ended have had of processors [s]."""
    (there,) = server.ask(_had)
    return time.process_time() + float(there)


def _had(_: Connection) -> Events:
    workers = resource.getrusage(resource.RUSAGE_CHILDREN)
    yield time.process_time() + workers.ru_utime + workers.ru_stime


def _close_running() -> None:
    for server in _running:  # none where the start was interrupted
        server.close()


def load() -> None:
    """The slow imports.

    The garbage collector looks at all that is loaded again and again, which takes a fifth of the time of the
    imports; and where it looks in a worker, the pages that the workers share are copied (see the documentation of
    `gc.freeze`). What cannot be loaded is left out: workers say what is missing. Raises MemoryLimitError.
    """
    gc.disable()
    heed_limits()
    require_room()
    for name in _MODULES:
        try:
            import_module(name)
        except (ImportError, MemoryError) as error:
            if is_lack_of_memory(error):
                raise MemoryLimitError(memory_limits() or str(error)) from error
    gc.freeze()
    gc.set_threshold(*_COLLECT)
    gc.enable()
    require_room()  # still, for workers: some libraries set aside all that they get


def _serve(line: Connection, other_end: Connection | None) -> None:
    if other_end is not None:  # of a fork
        other_end.close()  # so that the line ends with the program there
    for number in (signal.SIGINT, signal.SIGHUP):  # a terminal sends them to all: the program's to handle
        signal.signal(number, signal.SIG_IGN)  # in workers too
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
    try:
        load()
    except MemoryLimitError as error:
        with suppress(BrokenPipeError, ConnectionResetError):
            line.send(_Failure("", OSError(str(error))))
        return
    # the program has ended, or does not listen
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            place, function, arguments = line.recv()
            for answer in _answers(line, place, function, arguments):
                line.send(answer)


def _answers(
    line: Connection, place: str, function: Callable[..., Events], arguments: Sequence[Any]
) -> Generator[_Said | _Failure | None, None, None]:
    """What is said to one question; None ends it."""
    try:
        os.chdir(place)
        with closing(function(line, *arguments)) as saying:
            for said in saying:
                yield _Said(said)
    except Exception as error:  # noqa: BLE001  the program's to raise
        yield _Failure(traceback.format_exc(), _plain(error))
        return
    yield None


def _plain(error: Exception) -> OSError | None:
    if not isinstance(error, OSError):
        return None
    if error.errno is None:
        return OSError(str(error))
    return OSError(error.errno, error.strerror, error.filename)
