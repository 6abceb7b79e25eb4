"""How far a run is: the stage and the time left on a terminal, a line in a pipe that has heard nothing for long."""

from __future__ import annotations

import contextlib
import os
import pty
import time

import pytest

from vdmbench.cli.progress import Progress
from vdmbench.work.run import Event


def test_a_pipe_hears_of_what_is_done_and_after_a_silence_where_the_run_is(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with Progress("ball", quiet=False, silence=0.1) as progress:
        progress.show(Event("begun", "ball", 300.0, count=4))
        progress.show(Event("started", "fem-linear refined"))
        progress.show(Event("done", "mesh of sphere", 1.25))
        heard, until = "", time.monotonic() + 5.0
        while "refined" not in heard and time.monotonic() < until:
            time.sleep(0.02)
            heard += capsys.readouterr().err
    first, second = heard.splitlines()[:2]
    assert first == "done mesh of sphere (1.2 s)"
    assert second.startswith("at fem-linear refined, 1 of 4 done")


def test_the_time_left_is_the_estimate_first_and_then_that_of_what_is_done() -> None:
    progress = Progress("ball", quiet=True)
    assert progress.left() == ""
    progress.show(Event("begun", "ball", 400.0, count=10))
    progress.began -= 100.0
    assert progress.left() == "about 5 min left"
    progress.show(Event("done", "mesh"))
    assert progress.left() == "about 5 min left", "one of ten tells little"
    for _ in range(4):
        progress.show(Event("done", "a case"))
    assert progress.left() in {"about 100 s left", "about 2 min left"}
    progress.expected, progress.done = 1.0, 0
    assert progress.left() == "", "it takes longer than expected, nobody knows how much"


def test_a_terminal_sees_stage_and_time_left(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = pty.openpty()
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setenv("TERM", "xterm")
    with os.fdopen(theirs, "w") as terminal:
        monkeypatch.setattr("sys.stderr", terminal)
        with Progress("ball", quiet=False) as progress:
            progress.show(Event("begun", "ball", 300.0, count=4))
            progress.show(Event("started", "fem-linear refined"))
            progress.bar.refresh()
    written = b""
    with os.fdopen(ours, "rb", buffering=0) as other_end, contextlib.suppress(OSError):  # EIO at the end
        while part := other_end.read(65536):  # comes in pieces
            written += part
    seen = written.decode()
    assert "fem-linear refined" in seen
    assert "0/4" in seen
    assert "about 5 min left" in seen


def test_a_quiet_run_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with Progress("ball", quiet=True, silence=0.01) as progress:
        progress.show(Event("begun", "ball", 300.0, count=4))
        progress.show(Event("done", "mesh"))
        time.sleep(0.05)
    assert capsys.readouterr().err == ""
