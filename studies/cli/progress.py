"""How far a run is: a bar on a terminal, lines in a pipe; on standard error, so that output can be piped."""

from __future__ import annotations

import sys
import threading
import time
from typing import TYPE_CHECKING, Any

from ..machine.streams import harmless
from .output import OK, complain

if TYPE_CHECKING:
    from ..work.run import Event

SILENCE = 30.0  # s after which a pipe hears that the run is still at work
_ENOUGH = 0.2  # of all pieces: from then on the time left is told by those that are done


class Progress:
    """Stage, pieces done of all, and about how long the others take."""

    def __init__(self, name: str, *, quiet: bool, silence: float = SILENCE) -> None:
        self.name = name  # of the study, for the case of a study of one
        self.quiet = quiet
        self.silence = silence
        self.bar: Any = None
        self.stage = ""
        self.done = self.total = 0
        self.expected = 0.0  # s in all
        self.began = self.spoke = time.monotonic()
        self._ended = threading.Event()
        self._beat: threading.Thread | None = None

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self._beat is not None:
            self._beat.join()
        if self.bar is not None:
            self.bar.stop()

    def show(self, event: Event) -> None:
        """Show one event of the run; a sentence also where progress is not wanted."""
        if event.kind == "told":
            complain(event.message, OK)
            return
        label = harmless(event.label or self.name)
        if event.kind == "begun":
            self.total, self.expected, self.began = event.count, event.seconds, time.monotonic()
        elif event.kind == "started":
            self.stage = label
        else:
            self.done += 1
        if self.quiet:
            return
        # not sooner: both are threads, and workers are to be forked from a process that has no other
        if sys.stderr.isatty():
            self.bar = self.bar or _bar(self)
            self.bar.update(
                self.bar.task_ids[0], description=label[:60], completed=self.done, total=self.total
            )
            return
        if self._beat is None:
            self._beat = threading.Thread(target=self._speak_in_silence, daemon=True)
            self._beat.start()
        if event.kind in ("done", "failed"):
            self._say(f"{event.kind} {label} ({event.seconds:.1f} s)")

    def left(self) -> str:
        """About how long the run goes on, in words; "" where nobody knows."""
        spent, share = time.monotonic() - self.began, self.done / self.total if self.total else 0.0
        seconds = spent * (1 - share) / share if share >= _ENOUGH else self.expected - spent
        if seconds <= 0:
            return ""
        return f"about {seconds:.0f} s left" if seconds < 100 else f"about {seconds / 60:.0f} min left"

    def line(self) -> str:
        """Where the run is."""
        told = [f"at {self.stage}" if self.stage else "", f"{self.done} of {self.total} done", self.left()]
        return ", ".join(filter(None, told))

    def _speak_in_silence(self) -> None:
        while not self._ended.wait(max(0.01, self.spoke + self.silence - time.monotonic())):
            if time.monotonic() - self.spoke >= self.silence:
                self._say(self.line())

    def _say(self, text: str) -> None:
        self.spoke = time.monotonic()
        print(text, file=sys.stderr, flush=True)


def _bar(progress: Progress) -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar
    from rich.text import Text

    class Left(TextColumn):
        def render(self, _: Any) -> Text:
            return Text(progress.left())

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn())
    bar = Bar(*columns, TimeElapsedColumn(), Left(""), console=Console(stderr=True), transient=True)
    bar.start()
    bar.add_task("starting", total=progress.total)
    return bar
