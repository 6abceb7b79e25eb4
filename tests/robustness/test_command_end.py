"""How a command ends where its verb raises: a line per problem, and an exit code that tells whose fault it is."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.command import vdmbench


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        ("ImportError('no such library')", 4, ["no such library; see what is missing with: vdmbench doctor"]),
        (
            "FileExistsError(17, 'File exists', 'x')",
            4,
            ["x: is not a directory; remove it, or choose another"],
        ),
        ("OSError(28, 'No space left on device', 'x')", 4, ["x: No space left on device"]),
        ("OSError(28, 'No space left on device')", 4, ["No space left on device"]),
        ("OSError('it is too late')", 4, ["it is too late"]),
        ("hdf5.StoreError('x.h5 is damaged')", 5, ["x.h5 is damaged"]),
        ("hdf5.OlderSchemaError('x.h5 is old')", 5, ["x.h5 is old"]),
        ("cli_output.UsageError('no such thing')", 2, ["no such thing"]),
        (
            "problems.StudyError(problems.Problem('s.toml', line, 'a.b', 'is bad') for line in (3, 5))",
            2,
            ["s.toml:3: a.b: is bad", "s.toml:5: a.b: is bad"],
        ),
    ],
)
def test_what_an_error_means_to_the_shell(error: str, code: int, said: list[str]) -> None:
    program = (
        "from vdmbench.cli import main as cli, output as cli_output, verb_doctor\n"
        "from vdmbench.store import hdf5\n"
        "from vdmbench.study import problems\n"
        f"def verb(options): raise {error}\n"
        "verb_doctor.run = verb\n"
        "cli.main(['doctor'])"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert result.returncode == code
    assert result.stderr.splitlines() == [f"vdmbench: {line}" for line in said]


def test_a_bug_is_told_from_a_regression(tmp_path: Path) -> None:
    program = (
        "from vdmbench.cli import main as cli, verb_doctor\n"
        "verb_doctor.run = lambda options: {}['on mine']\n"
        "cli.main(['doctor'])"
    )
    result = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert result.returncode == 70
    *trace, told = result.stderr.splitlines()
    assert told == "vdmbench: this is a bug: KeyError('on mine'); please report it with the lines above"
    assert trace[0].startswith("Traceback")


def test_a_call_in_the_process_of_the_tests_leaves_their_signals_as_they_were(tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGINT), sys.unraisablehook
    assert vdmbench("list", cwd=tmp_path).returncode == 0
    assert (signal.getsignal(signal.SIGINT), sys.unraisablehook) == before
