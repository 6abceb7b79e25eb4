"""How far a run is: on a terminal, and in a pipe that has heard nothing for long."""

import contextlib
import os
import pty

import pytest

from vdmbench.cli.studies import SILENCE, Progress
from vdmbench.work.run import Event

PLACE = "load step 2 of 5 at 35 %, iteration 3, residual 1.0e-04"


def test_a_pipe_hears_of_what_is_done_and_after_a_silence_where_the_run_is(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with Progress("ball", quiet=False) as progress:
        progress.show(Event("begun", "ball", count=4))
        progress.show(Event("done", "mesh of sphere", 1.25))
        progress.show(Event("at", "fem, 2 N", message=PLACE))
        progress.spoke -= SILENCE
        progress.show(Event("at", "fem, 2 N", message=PLACE))
    assert capsys.readouterr().err.splitlines() == [
        "done mesh of sphere (1.2 s)",
        f"at fem, 2 N: {PLACE}, 1 of 4 done",
    ]


def test_a_terminal_sees_what_is_done_and_where_the_run_is(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = pty.openpty()
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setenv("TERM", "xterm")
    with os.fdopen(theirs, "w") as terminal:
        monkeypatch.setattr("sys.stderr", terminal)
        with Progress("ball", quiet=False) as progress:
            progress.show(Event("begun", "ball", count=4))
            progress.show(Event("done", "mesh"))
            progress.show(Event("at", "fem, 2 N", message=PLACE))
    written = b""
    with os.fdopen(ours, "rb", buffering=0) as other_end, contextlib.suppress(OSError):  # EIO at the end
        while part := other_end.read(65536):  # comes in pieces
            written += part
    *_, last, cleared = written.decode().split("\r\x1b[K")
    assert last == f"1/4, 0 s, fem, 2 N: {PLACE}"
    assert cleared == ""


def test_a_quiet_run_says_sentences_alone(capsys: pytest.CaptureFixture[str]) -> None:
    with Progress("ball", quiet=True) as progress:
        progress.show(Event("begun", "ball", count=4))
        progress.show(Event("done", "mesh"))
        progress.show(Event("told", "ball", message="warning: a sentence"))
    assert capsys.readouterr().err == "vdmbench: warning: a sentence\n"
