"""Who holds a lock is named, waited for in the open, and not for ever."""

from __future__ import annotations

import fcntl
import os
import threading
import time
from pathlib import Path

import pytest

from vdmbench.machine.locks import LockedError, lock
from vdmbench.report import rebuild

EX = fcntl.LOCK_EX


@pytest.fixture
def held(tmp_path: Path) -> int:
    """A lock file that another user's process has locked."""
    (tmp_path / "lock").write_text("4711")
    handle = os.open(tmp_path / "lock", os.O_RDWR)
    fcntl.flock(handle, fcntl.LOCK_EX)
    return handle


def test_whoever_waits_says_for_whom_and_stops(tmp_path: Path, held: int) -> None:
    told: list[str] = []
    place = tmp_path / "lock"
    with pytest.raises(LockedError, match=r"^process 4711$"), lock(place, EX, patience=0.3, tell=told.append):
        pass
    assert told == [f"waiting for process 4711, which has locked {tmp_path / 'lock'}"]
    os.pwrite(held, b"\x1b]2;", 0)
    with pytest.raises(LockedError, match=r"^an unknown process$"), lock(place, fcntl.LOCK_SH):
        pass
    os.close(held)


def test_a_lock_that_is_let_go_is_taken(tmp_path: Path, held: int) -> None:
    threading.Timer(0.3, os.close, [held]).start()
    with lock(tmp_path / "lock", fcntl.LOCK_EX, patience=60.0):
        assert (tmp_path / "lock").read_text() == str(os.getpid())


def test_patience_begins_anew_with_another_holder(tmp_path: Path, held: int) -> None:
    """As where many parts of a run write the report, one after the other."""
    told: list[str] = []
    threading.Timer(0.6, os.pwrite, [held, b"4712", 0]).start()
    began = time.monotonic()
    place = tmp_path / "lock"
    with pytest.raises(LockedError, match=r"^process 4712$"), lock(place, EX, patience=1.0, tell=told.append):
        pass
    assert time.monotonic() - began >= 1.6
    assert len(told) == 2
    os.close(held)


def test_a_report_does_not_wait_in_silence_nor_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rebuild, "_PATIENCE", 0.3)
    monkeypatch.setattr(rebuild, "read_plan", lambda _: {})
    told: list[str] = []
    with (tmp_path / ".lock-report").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(
            rebuild.ReportError, match=r"an unknown process has locked the report .* the results are kept"
        ):
            rebuild.rebuild(tmp_path, told.append)
    assert len(told) == 1
