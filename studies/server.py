"""The process that workers are forked from: all that they need is loaded in it, once.

It is forked itself, from the program that asks it, so that what both need (numpy, HDF5, the schema of study files)
is loaded once too. A fork is safe where the process has one thread: `start_server` is to be called before this
program starts others, and the server never has more.
"""

from __future__ import annotations

import atexit
import gc
import multiprocessing
import os
import signal
from collections.abc import Callable, Generator
from contextlib import closing, suppress
from importlib import import_module
from multiprocessing.connection import Connection
from typing import Any

Events = Generator[Any, None, None]

# what the program needs later too, to estimate and to plot: loaded before the fork, it is loaded once
_SHARED = ("fem_reference.costs", "numpy.ma", "unittest")
# what every case needs, and no case should be timed with
_MODULES = ("studies.worker", "vdm.model", "fem_reference.linear", "scipy.spatial")
_SIGNALS = {signal.SIGINT, signal.SIGTERM}
_COLLECT = (700, 10, 10)  # Python's own: a program may look for garbage less often, but workers run for hours

CONTEXT = multiprocessing.get_context("fork")


class ServerError(OSError):
    """The server of workers is gone."""


class Server:
    """A forked process that does what it is asked and says what comes of it."""

    def __init__(self) -> None:
        self._line, theirs = CONTEXT.Pipe()
        self._process = CONTEXT.Process(target=_serve, args=(theirs, self._line))
        # until the server has its own answer to them
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()

    @property
    def alive(self) -> bool:
        """Whether it can be asked."""
        return not self._line.closed and self._process.is_alive()

    def ask(self, function: Callable[..., Events], *arguments: Any) -> Events:
        """What `function(line, *arguments)` yields in the server: a module's function, and plain data.

        It has to return when its `line` can be read from: then nobody listens any more, as after this iterator is
        left early. Raises what the function raises, and ServerError where the server was killed.
        """
        try:
            self._line.send((os.getcwd(), function, arguments))
            while (said := self._line.recv()) is not None:
                if isinstance(said, Exception):
                    raise said
                yield said
        except (EOFError, BrokenPipeError, ConnectionResetError):
            self.close()
            raise ServerError("the process that starts the workers was killed; run the same again") from None
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Let it stop what it is at and end; waits for that."""
        self._line.close()
        self._process.join()


_running: list[Server] = []  # one at most


def start_server() -> Server:
    """The server, forked now unless it is there; it loads its libraries while this program goes on."""
    if not (_running and _running[0].alive):
        for name in _SHARED:
            import_module(name)
        _running[:] = [Server()]
        atexit.register(_running[0].close)
    return _running[0]


def load() -> None:
    """The slow imports.

    The garbage collector looks at all that is loaded again and again, which takes a fifth of the time of the
    imports; and where it looks in a worker, the pages that the workers share are copied (see the documentation of
    `gc.freeze`). What cannot be loaded is left out: workers say what is missing.
    """
    gc.disable()
    with suppress(ImportError):
        for name in _MODULES:
            import_module(name)
        gc.freeze()
    gc.set_threshold(*_COLLECT)
    gc.enable()


def _serve(line: Connection, other_end: Connection) -> None:
    other_end.close()  # so that the line ends with the program at the other end
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the program's to handle, in workers too
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
    load()
    while True:
        try:
            place, function, arguments = line.recv()
        except EOFError:
            return
        try:
            os.chdir(place)
            with closing(function(line, *arguments)) as saying:
                for said in saying:
                    line.send(said)
            line.send(None)
        except (BrokenPipeError, ConnectionResetError):
            return  # nobody listens any more
        except Exception as error:  # noqa: BLE001  the program's to raise
            line.send(error)
