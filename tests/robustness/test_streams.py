"""Standard streams that are closed, full or of another encoding change neither what is done nor the exit code."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.command import SCRIPT, write_study

LABEL = "größe ± λ"
NOTICE = "vdmbench: standard output: No space left on device; what was to be shown there is incomplete\n"


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A directory with a small study, which has letters that ASCII lacks in what it prints."""
    write_study(tmp_path, title=("A small sphere", f"{LABEL}: a small sphere"))
    return tmp_path


def _shell(
    command: str, redirections: str, directory: Path, **environment: str
) -> subprocess.CompletedProcess[str]:
    """A command as a shell runs it; the exit code is that of `vdmbench`, also in a pipe."""
    return subprocess.run(
        ["bash", "-c", f"'{SCRIPT}' {command} {redirections}; exit ${{PIPESTATUS[0]}}"],
        cwd=directory,
        env={**os.environ, "OMP_NUM_THREADS": "1", **environment},
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
        timeout=300,
    )


HELP, WRONG = ("--help", 0), ("check none.toml", 2)


@pytest.mark.parametrize(
    ("command", "code", "redirections"),
    [
        (*HELP, ">&-"),
        (*WRONG, "2>/dev/full"),
        (*WRONG, "<&- >&- 2>&-"),
    ],
)
def test_an_exit_code_does_not_depend_on_the_streams(
    place: Path, command: str, code: int, redirections: str
) -> None:
    result = _shell(command, redirections, place)
    assert result.returncode == code
    assert "Traceback" not in result.stderr


def test_output_that_is_lost_is_told(place: Path) -> None:
    full = _shell("list --json", ">/dev/full", place)
    assert (full.returncode, full.stderr) == (0, NOTICE)
    piped = _shell("list", "| true", place)
    assert (piped.returncode, piped.stderr) == (0, ""), "nobody wants it: that is no fault"


def test_a_terminal_of_another_encoding_shows_what_it_can(place: Path) -> None:
    shown = _shell("plan small.toml", "", place, PYTHONIOENCODING="ascii")
    assert (shown.returncode, shown.stderr) == (0, "")
    assert "gr\\xf6\\xdfe \\xb1 \\u03bb" in shown.stdout
