"""How far a run is: on a terminal, and in a pipe that has heard nothing for long."""

from __future__ import annotations

import contextlib
import os
import pty
import time

import pytest

from vdmbench.cli.progress import Progress
from vdmbench.work.run import Event

PLACE = "load step 2 of 5 at 35 %, iteration 3, residual 1.0e-04"


def test_a_pipe_hears_of_what_is_done_and_after_a_silence_where_the_run_is(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with Progress("ball", quiet=False, silence=0.1) as progress:
        progress.show(Event("begun", "ball", count=4))
        progress.show(Event("started", "fem, 2 N"))
        progress.show(Event("at", "fem, 2 N", message=PLACE))
        progress.show(Event("done", "mesh of sphere", 1.25))
        heard, until = "", time.monotonic() + 5.0
        while "fem" not in heard and time.monotonic() < until:
            time.sleep(0.02)
            heard += capsys.readouterr().err
    first, second = heard.splitlines()[:2]
    assert first == "done mesh of sphere (1.2 s)"
    assert second.startswith(f"at fem, 2 N: {PLACE}, 1 of 4 done")


def test_the_time_left_counts_down_and_says_why_where_it_grows() -> None:
    progress = Progress("ball", quiet=True)
    progress.show(Event("begun", "ball", count=10))
    progress.show(Event("started", "fem, 2 N"))
    progress.began -= 100.0
    progress.show(Event("done", "mesh"))
    assert progress.left() == "", "one of ten tells little"
    progress.show(Event("done", "vdm-paper"))
    assert progress.left() == "about 7 min left"
    progress._over -= 390.0  # which pass
    assert progress.left() == "about 10 s left", "it does not grow while nothing is done"
    progress._over -= 20.0
    begun, place = progress.at_work["fem, 2 N"]
    progress.at_work["fem, 2 N"] = begun - 400.0, place
    assert progress.left() == "longer than expected: fem, 2 N takes 7 min so far"
    progress.began -= 410.0
    progress.show(Event("done", "fem, 2 N", 400.0))
    assert progress.left() == "about 20 min left, more than before, as fem, 2 N took 400 s"
    for _ in range(7):
        progress.show(Event("done", "a case"))
    assert progress.left() == ""


def test_a_terminal_sees_what_is_at_work_where_it_is_and_the_time_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ours, theirs = pty.openpty()
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setenv("TERM", "xterm")
    with os.fdopen(theirs, "w") as terminal:
        monkeypatch.setattr("sys.stderr", terminal)
        with Progress("ball", quiet=False) as progress:
            progress.show(Event("begun", "ball", count=4))
            progress.began -= 100.0
            progress.show(Event("done", "mesh"))
            progress.show(Event("started", "fem, 2 N"))
            progress.show(Event("at", "fem, 2 N", message=PLACE))
            progress.bar.refresh()
    written = b""
    with os.fdopen(ours, "rb", buffering=0) as other_end, contextlib.suppress(OSError):  # EIO at the end
        while part := other_end.read(65536):  # comes in pieces
            written += part
    seen = written.decode()
    for text in ("fem, 2 N", "1/4", "about 5 min left", PLACE):
        assert text in seen


def test_a_quiet_run_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with Progress("ball", quiet=True, silence=0.01) as progress:
        progress.show(Event("begun", "ball", count=4))
        progress.show(Event("done", "mesh"))
        time.sleep(0.05)
    assert capsys.readouterr().err == ""
