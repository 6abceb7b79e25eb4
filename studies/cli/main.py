"""The command `vdmbench`: its exit codes. It handles Ctrl-C before it loads the rest."""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Sequence

# objects between two garbage collections, which at the default take a quarter of the time of imports
_OBJECTS = 200_000


class _Interrupt:
    """Handler of Ctrl-C, SIGTERM and SIGHUP: stops the verb, and does nothing once it has stopped.

    During an import the exception can surface as another error, as of a library or a file that cannot be loaded.
    """

    def __init__(self) -> None:
        self.received = self.stopped = False

    def __call__(self, *_: object) -> None:
        if not self.stopped:
            self.received = True
            raise KeyboardInterrupt


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of `vdmbench`: ends the process with the exit code of the verb."""
    interrupt = _Interrupt()
    for number in (signal.SIGINT, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:  # ignored in a script's background, or under nohup
            signal.signal(number, interrupt)
    signal.signal(signal.SIGTERM, interrupt)
    gc.set_threshold(_OBJECTS)
    # pydantic would look for plugins in every installed package
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    try:
        from ..machine import require_memory

        if hasattr(sys.stdout, "reconfigure"):
            # characters that the encoding lacks become escapes; output errors are reported at the end
            sys.stdout.reconfigure(errors="backslashreplace", write_through=False)
        require_memory()
        from .arguments import parse

        options = parse(arguments)
        code = options.verb(options)
        interrupt.stopped = True
    except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001 -- reported, whatever it is
        interrupt.stopped = True
        if interrupt.received or isinstance(error, KeyboardInterrupt):
            from .output import INTERRUPTED, complain

            code = complain("interrupted; what is complete is kept: give the same command again", INTERRUPTED)
        else:
            code = _complain_of(error)
    _flush_output()
    gc.freeze()  # no garbage collection at the end
    sys.exit(code)


def _flush_output() -> None:
    """Report output that could not be written, unless its reader is gone; the exit code stays: all work is done."""
    from .output import OK, complain

    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # so that Python's own flush at exit succeeds
        if not isinstance(error, BrokenPipeError):
            complain(f"standard output: {error.strerror}; what was to be shown there is incomplete", OK)


def _complain_of(error: BaseException) -> int:
    """Report an error and return its exit code; a ValueError of ours always has a sentence."""
    from ..study.errors import install_line
    from .output import BUG, DAMAGED, INTERRUPTED, MACHINE, USAGE, complain, tell

    if line := install_line(error):
        return complain(f"{error}; install it: {line}", MACHINE)
    match error:
        case BrokenPipeError():  # the reader is gone
            return INTERRUPTED
        case MemoryError():
            return complain(str(error) or "out of memory", MACHINE)
        case ImportError():
            return complain(str(error), MACHINE)
        case FileExistsError(filename=name):  # where a directory was to be made
            return complain(f"{name}: is not a directory; remove it, or choose another", MACHINE)
        case OSError(filename=name, strerror=words):
            return complain(f"{name}: {words}" if name else str(words or error), MACHINE)
        case ValueError():
            from ..store.plain import StoreError

            return complain(str(error), DAMAGED if isinstance(error, StoreError) else USAGE)
    import traceback

    for line in "".join(traceback.format_exception(error)).splitlines():
        tell(line)
    return complain(f"this is a bug: {error!r}; please report it with the lines above", BUG)
