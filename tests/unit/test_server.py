"""The process that workers are forked from: it is asked, it answers, and it ends when nobody listens."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import closing
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import pytest
from scipy.sparse import csc_array, diags_array

from studies.server import Server, ServerError, start_server

ROOT = Path(__file__).parents[2]


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


class _Unpicklable(Exception):
    def __init__(self, one: int, other: int) -> None:
        super().__init__(f"{one} and {other}")


def _is_wrong(_: Connection) -> Generator[Any, None, None]:
    yield 1
    raise _Unpicklable(2, 3)


def _says_much(_: Connection) -> Generator[Any, None, None]:
    yield from range(100)


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
    with closing(later):
        for one in (server, later):
            (process, parent, place), handlers, blocked, collector = one.ask(_manners)
            assert process != parent == os.getpid()
            assert place == str(tmp_path)
            assert handlers == (signal.SIG_IGN, signal.SIG_DFL)
            assert blocked == set()
            assert collector == (True, (700, 10, 10))


def factorise(_: Mapping[str, Any]) -> None:
    """By the library of the elements, whose threads a fork would wait for in vain once they have been started."""
    from fem_reference.factorisation import analyse

    analyse(csc_array(diags_array([2.0, 0.5], offsets=[0, -1], shape=(500, 500))))


_PROGRAM = """
import sys, threading, time
from pathlib import Path
from tests.unit.test_server import factorise
from studies.execute import run_tasks
from studies.server import start_server

def main(before):
    if before == "solve":
        factorise({})
    if before == "thread":
        threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
    print(type(start_server()._process).__name__)
    logs = Path(sys.argv[2])
    for outcome in run_tasks(factorise, [[{"id": "a"}]], jobs=1, log_directory=logs, started=lambda _: None):
        print(outcome.code)

if __name__ == "__main__":
    main(sys.argv[1])
"""


@pytest.mark.parametrize(
    ("before", "process"), [("nothing", "ForkProcess"), ("solve", "SpawnProcess"), ("thread", "SpawnProcess")]
)
def test_a_program_with_threads_is_not_forked(before: str, process: str, tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(_PROGRAM)
    result = subprocess.run(
        [sys.executable, program, before, tmp_path],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert result.stdout.split() == [process, "done"], result.stderr


_INTERRUPTED = """
from contextlib import suppress
from studies import server

def interrupted():
    raise KeyboardInterrupt

server.Server = interrupted
with suppress(KeyboardInterrupt):
    server.start_server()
"""


def test_a_start_that_is_interrupted_leaves_nothing_to_close() -> None:
    result = subprocess.run(
        [sys.executable, "-c", _INTERRUPTED],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert result.stderr == ""


def test_what_goes_wrong_in_it_is_raised_here(server: Server) -> None:
    said = server.ask(_fails)
    assert next(said) == 1
    with pytest.raises(OSError, match="No space left on device"):
        next(said)


def test_a_bug_in_it_is_raised_here_with_its_traceback(server: Server) -> None:
    said = server.ask(_is_wrong)
    assert next(said) == 1
    with pytest.raises(RuntimeError, match=r"in _is_wrong[\s\S]*_Unpicklable: 2 and 3"):
        next(said)


def test_it_has_one_question_at_a_time(server: Server) -> None:
    said = server.ask(_says_much)
    assert next(said) == 0
    with pytest.raises(ServerError, match="at work in this process already"):
        next(server.ask(_manners))
    assert list(said) == list(range(1, 100)), "the first is not disturbed"
    assert len(list(server.ask(_manners))) == 4


def test_what_was_said_and_not_heard_is_no_fault(server: Server, capfd: pytest.CaptureFixture[str]) -> None:
    said = server.ask(_says_much)
    assert next(said) == 0
    said.close()
    assert server._process.exitcode == 0
    assert capfd.readouterr().err == ""


def test_a_server_that_was_asked_nothing_is_not_waited_for() -> None:
    server = Server()
    server.close()
    assert server._process.exitcode in (0, -signal.SIGTERM)


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
