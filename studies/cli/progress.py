"""How far a run is, and where: a bar on a terminal, lines in a pipe; on standard error, so output can be piped."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Any

from .output import OK, complain, tell

if TYPE_CHECKING:
    from ..work.run import Event

SILENCE = 30.0  # s between two lines in which a pipe hears where the run is


class Progress:
    """Pieces done of all, and what was heard of last.

    Parameters
    ----------
    name : of the study, for the case of a study of one
    quiet : whether to show sentences alone
    """

    def __init__(self, name: str, *, quiet: bool) -> None:
        self.name = name
        self.quiet = quiet
        self.bar: Any = None
        self.done = self.total = 0
        self.spoke = time.monotonic()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.stop()

    def show(self, event: Event) -> None:
        """Show one event of the run; a sentence also where progress is not wanted."""
        if event.kind == "told":
            complain(event.message, OK)
            return
        if event.kind == "begun":
            self.total = event.count
        ended = event.kind in ("done", "failed", "stopped")
        self.done += ended
        if self.quiet:
            return
        place = ": ".join(filter(None, [event.label or self.name, event.message]))
        if sys.stderr.isatty():
            # not sooner: it is a thread, and workers are forked from a process that has no other
            self.bar = self.bar or _bar()
            self.bar.update(self.bar.task_ids[0], description=place, completed=self.done, total=self.total)
        elif ended and event.kind != "stopped":
            self._say(f"{event.kind} {place} ({event.seconds:.1f} s)")
        elif time.monotonic() - self.spoke >= SILENCE:
            self._say(f"at {place}, {self.done} of {self.total} done")

    def _say(self, text: str) -> None:
        self.spoke = time.monotonic()
        tell(text)


def _bar() -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (BarColumn(20), MofNCompleteColumn(), TimeRemainingColumn(elapsed_when_finished=True))
    what = TextColumn("{task.description}", markup=False)
    bar = Progress(*columns, what, console=Console(stderr=True), transient=True)
    bar.start()
    bar.add_task("starting", total=None)
    return bar
