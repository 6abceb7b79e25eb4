"""How far a run is, and where: a bar on a terminal, lines in a pipe; on standard error, so output can be piped."""

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
_ENOUGH = 0.2  # of all pieces: those that are done tell how long the others take


class Progress:
    """What is at work and where it is, pieces done of all, and about how long the others take."""

    def __init__(self, name: str, *, quiet: bool, silence: float = SILENCE) -> None:
        self.name = name  # of the study, for the case of a study of one
        self.quiet = quiet
        self.silence = silence
        self.bar: Any = None
        self.at_work: dict[
            str, tuple[float, str]
        ] = {}  # label -> when it began, where it is; the last told last
        self.done = self.total = 0
        self.began = self.spoke = time.monotonic()
        self._over: float | None = None  # when the run is expected to be
        self._longer = ""  # why that is later than was told before
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
        now = time.monotonic()
        if event.kind == "begun":
            self.total, self.began = event.count, now
        elif event.kind in ("started", "at"):
            begun, _ = self.at_work.get(label, (now, ""))
            self.at_work = self._others(label) | {label: (begun, harmless(event.message))}
        else:
            self.at_work = self._others(label)
            self.done += 1
            self._expect(label, event.seconds, now)
        if self.quiet:
            return
        # not sooner: both are threads, and workers are to be forked from a process that has no other
        if sys.stderr.isatty():
            self.bar = self.bar or _bar(self)
            self.bar.update(
                self.bar.task_ids[0], description=self.stage()[:60], completed=self.done, total=self.total
            )
            return
        if self._beat is None:
            self._beat = threading.Thread(target=self._speak_in_silence, daemon=True)
            self._beat.start()
        if event.kind in ("done", "failed"):
            self._say(f"{event.kind} {label} ({event.seconds:.1f} s)")

    def _others(self, label: str) -> dict[str, tuple[float, str]]:
        """What else is at work: a new table, since threads read the old one."""
        return {name: entry for name, entry in self.at_work.items() if name != label}

    def _expect(self, label: str, seconds: float, now: float) -> None:
        """What a piece that is done, after `seconds`, tells of the others."""
        share = self.done / self.total if self.total else 0.0
        if share < _ENOUGH:
            return
        before, self._over = self._over, now + (now - self.began) * (1 - share) / share
        grown = before is not None and self._over > before + 1.0
        self._longer = f"more than before, as {label} took {seconds:.0f} s" if grown else ""

    def stage(self) -> str:
        """What is at work: of several what has begun, or was heard of, last."""
        return next(reversed(list(self.at_work)), "")

    def where(self) -> str:
        """Where that is, if it says so."""
        return self.at_work.get(self.stage(), (0.0, ""))[1]

    def left(self) -> str:
        """About how long the run goes on, in words; "" where nobody knows."""
        if self._over is None:
            return ""
        now = time.monotonic()
        seconds = self._over - now
        if seconds <= 0 and self.at_work:
            label, (begun, _) = min(self.at_work.items(), key=lambda piece: piece[1][0])
            return f"longer than expected: {label} takes {_duration(now - begun)} so far"
        if seconds <= 0:
            return ""
        return ", ".join(filter(None, [f"about {_duration(seconds)} left", self._longer]))

    def line(self) -> str:
        """Where the run is."""
        at = ": ".join(filter(None, [self.stage(), self.where()]))
        told = [f"at {at}" if at else "", f"{self.done} of {self.total} done", self.left()]
        return ", ".join(filter(None, told))

    def _speak_in_silence(self) -> None:
        while not self._ended.wait(max(0.01, self.spoke + self.silence - time.monotonic())):
            if time.monotonic() - self.spoke >= self.silence:
                self._say(self.line())

    def _say(self, text: str) -> None:
        self.spoke = time.monotonic()
        print(text, file=sys.stderr, flush=True)


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


def _bar(progress: Progress) -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar
    from rich.text import Text

    class Left(TextColumn):
        def render(self, _: Any) -> Text:
            return Text("\n".join(filter(None, [progress.left(), progress.where()])))

    columns = (TextColumn("{task.description}", markup=False), BarColumn(20), MofNCompleteColumn())
    bar = Bar(*columns, TimeElapsedColumn(), Left(""), console=Console(stderr=True), transient=True)
    bar.start()
    bar.add_task("starting", total=progress.total)
    return bar
