"""Runs the `vdmbench` command: in this process, or as a user would, the installed script."""

import argparse
import contextlib
import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

from tests.in_process import HerePool
from vdmbench.cli.main import main

SCRIPT = Path(sys.executable).parent / "vdmbench"


def strict_json(text: str) -> Any:
    """JSON as programs read it that know neither NaN nor Infinity. Raises ValueError."""

    def refuse(word: str) -> None:
        raise ValueError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)


def wait_for(what: Callable[[], Any], seconds: float = 300.0) -> Any:
    """What a call gives once it gives something; a test that waits in vain fails."""
    end = time.monotonic() + seconds
    while not (found := what()):
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)
    return found


def heed_ctrl_c() -> None:
    """Run in a child before its program: in the background of a script it is born deaf to SIGINT, or to SIGHUP."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


SMALL_STUDY = """
[study]
name = "small"
title = "A small sphere under a finger"
models = ["vdm-paper", "fem-linear"]
reference = "fem-linear"

[geometry]
shape = "sphere"
radius = "50 mm"
mesh_size = "16 mm"

[tissue]
youngs_modulus = "5 kPa"
poisson_ratio = 0.49

[regions.base]
below = { axis = "z", fraction = 0.2 }
[regions.finger]
cap = { direction = [0, 0, 1], angle = "30 deg" }

[[constraints]]
kind = "fixed"
region = "base"
[[constraints]]
name = "finger"
kind = "contact"
region = "finger"
force = "0.1 N"
profile = "hertz"

[load]
factors = [0.5, 1.0]
"""


def do(options: argparse.Namespace) -> int:
    """What a verb answers, where its errors are to be caught."""
    code: int = options.verb(options)
    return code


def vdmbench(
    *arguments: str | Path, cwd: Path, times: bool = False, **environment: str
) -> subprocess.CompletedProcess[str]:
    """One call in this process, its nodes too, which saves a second of imports and more; never a traceback.

    What processes do, as signals, limits, `--jobs`, a cluster and bytes of a stream, `vdmbench_process` shows.
    """
    words = [*map(str, arguments)]
    assert "--scheduler" not in words
    output, complaints = io.StringIO(), io.StringIO()
    with (
        own_signals(),  # of a fixture of a session or a module those of the test come too late
        contextlib.chdir(cwd),
        contextlib.redirect_stdout(output),
        contextlib.redirect_stderr(complaints),
        mock.patch.dict(os.environ, environment),
        mock.patch("vdmbench.work.run._pool", pool_here),
        mock.patch("gc.freeze"),  # this process goes on
        # two thirds of a small run: tests of `times` and of the report show them
        contextlib.nullcontext() if times else mock.patch("vdmbench.work.run._time_frames"),
        mock.patch("vdmbench.report.plots.svg_of", return_value="<svg></svg>"),
        mock.patch("vdmbench.report.section_scene.scene_svg", return_value="<svg></svg>"),
        mock.patch("vdmbench.report.section_view.labelled", return_value=b""),
    ):
        try:
            main(words)
        except SystemExit as ended:
            code = ended.code
    assert isinstance(code, int), words
    return _harmless(subprocess.CompletedProcess(words, code, output.getvalue(), complaints.getvalue()))


@contextlib.contextmanager
def own_signals() -> Iterator[None]:
    """The command leaves its own answers to signals: those of before."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, answer in before.items():
            signal.signal(number, answer)


@contextlib.contextmanager
def pool_here(*_: object) -> Iterator[HerePool]:
    """Places without processes."""
    yield HerePool()


def vdmbench_process(
    *arguments: str | Path, cwd: Path, seconds: float = 300, **environment: str
) -> subprocess.CompletedProcess[str]:
    """One call of the installed script; never a traceback, whatever it is asked."""
    result = subprocess.run(
        [SCRIPT, *map(str, arguments)],
        cwd=cwd,
        env={**os.environ, "OMP_NUM_THREADS": "1", **environment},
        capture_output=True,
        text=True,
        timeout=seconds,
        stdin=subprocess.DEVNULL,
    )
    return _harmless(result)


def _harmless(result: subprocess.CompletedProcess[str]) -> subprocess.CompletedProcess[str]:
    assert "Traceback" not in result.stderr + result.stdout, result.stderr
    return result


def write_study(directory: Path, name: str = "small.toml", **replacements: Any) -> Path:
    """The small study with texts replaced: old=new pairs given as keyword values (old, new)."""
    text = SMALL_STUDY
    for old, new in replacements.values():
        assert old in text, old
        text = text.replace(old, new)
    path = directory / name
    path.write_text(text)
    return path
