"""What comes from elsewhere steers no terminal."""

from __future__ import annotations

import os
import pty
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.command import SCRIPT, vdmbench_process
from vdmbench.cli.main import _complain_of
from vdmbench.machine import harmless
from vdmbench.store.run_directory import case_path, failure_path, read_plan, write_failure, write_plan

from .processes import RUN


def test_control_characters_become_escapes() -> None:
    assert harmless("a\tb\n\x1b[2J\x07\r\x7f\x9b\u202e\u2069é\N{BULLET}") == (
        "a\tb\n\\x1b[2J\\x07\\x0d\\x7f\\x9b\\u202e\\u2069é\N{BULLET}"
    )


def test_copied_results_do_not_steer_the_terminal(undisturbed: tuple[Path, float], tmp_path: Path) -> None:
    shutil.copytree(undisturbed[0], tmp_path, dirs_exist_ok=True)
    directory = tmp_path / RUN
    plan = read_plan(directory)
    attack = "\x1b]0;owned\x07\x9b2J"
    for case in plan["cases"]:
        case["label"] += attack
    write_plan(directory, plan)
    reason = dict.fromkeys(("hash", "label", "code", "message", "remedy"), attack)
    lost = plan["cases"][0]["hash"]
    case_path(directory, lost).unlink()
    write_failure(failure_path(directory, lost), {**reason, "hash": lost}, attack)
    said = vdmbench_process("report", RUN, cwd=tmp_path)
    text = said.stdout + said.stderr
    assert "\\x1b]0;owned" in text, "it is told, harmlessly"
    assert not {"\x1b", "\x07", "\x9b"} & set(text)


def test_no_argument_steers_the_terminal_that_errors_go_to(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    found = subprocess.run(
        [SCRIPT, "report", "x\x1b[2J"], cwd=tmp_path, stdin=subprocess.DEVNULL, stderr=theirs, check=False
    )
    os.close(theirs)
    said = os.read(ours, 1 << 16)
    os.close(ours)
    assert found.returncode != 0
    assert b"\\x1b[2J" in said
    assert b"\x1b" not in said


def test_a_traceback_does_not_steer_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    assert _complain_of(RuntimeError("\x1b[2J")) == 70
    assert "\x1b" not in capsys.readouterr().err
