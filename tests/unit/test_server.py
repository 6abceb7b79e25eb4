"""The process that workers are forked from: it is asked, it answers, and it ends when nobody listens."""

from __future__ import annotations

import gc
import os
import signal
import time
from collections.abc import Generator, Iterator
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import pytest

from studies.server import Server, ServerError, start_server


def _manners(_: Connection) -> Generator[Any, None, None]:
    yield os.getpid(), os.getppid(), os.getcwd()
    yield signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    yield signal.pthread_sigmask(signal.SIG_BLOCK, ())
    yield gc.isenabled(), gc.get_threshold()


def _killed(_: Connection) -> Generator[Any, None, None]:
    yield 1
    os.kill(os.getpid(), signal.SIGKILL)


def _fails(_: Connection) -> Generator[Any, None, None]:
    yield 1
    raise OSError(28, "No space left on device")


def _until_nobody_listens(line: Connection, path: str) -> Generator[Any, None, None]:
    try:
        yield "begun"
        wait([line])
    finally:
        time.sleep(0.1)
        Path(path).write_text("tidied up")


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server()
    yield server
    server.close()


def test_it_is_a_process_that_leaves_ctrl_c_to_the_program_and_collects_its_garbage(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # after it was started
    threshold = gc.get_threshold()
    gc.set_threshold(200_000)
    try:
        later = Server()
    finally:
        gc.set_threshold(*threshold)
    for one in (server, later):
        (process, parent, place), handlers, blocked, collector = one.ask(_manners)
        assert process != parent == os.getpid()
        assert place == str(tmp_path)
        assert handlers == (signal.SIG_IGN, signal.SIG_DFL)
        assert blocked == set()
        assert collector == (True, (700, 10, 10))
    later.close()


def test_what_goes_wrong_in_it_is_raised_here(server: Server) -> None:
    said = server.ask(_fails)
    assert next(said) == 1
    with pytest.raises(OSError, match="No space left on device"):
        next(said)


def test_a_server_that_is_killed_is_told_and_replaced() -> None:
    server = start_server()
    assert start_server() is server
    with pytest.raises(ServerError, match="was killed; run the same again"):
        list(server.ask(_killed))
    assert not server.alive
    after = start_server()
    assert after is not server
    assert len(list(after.ask(_manners))) == 4


def test_it_tidies_up_where_nobody_listens_any_more(server: Server, tmp_path: Path) -> None:
    said = server.ask(_until_nobody_listens, str(tmp_path / "note"))
    assert next(said) == "begun"
    said.close()
    assert (tmp_path / "note").read_text() == "tidied up", "it was waited for"
    assert not server.alive
