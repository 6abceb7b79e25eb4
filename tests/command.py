"""Runs the `vdmbench` command as a user would: the installed script, in a directory of its own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

SCRIPT = Path(sys.executable).parent / "vdmbench"


def strict_json(text: str) -> Any:
    """JSON as programs read it that know neither NaN nor Infinity. Raises ValueError."""

    def refuse(word: str) -> None:
        raise ValueError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)


def heed_ctrl_c() -> None:
    """Run in a child before its program: what runs in the background of a script is born deaf to SIGINT."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


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


def vdmbench(
    *arguments: str | Path, cwd: Path, seconds: float = 300, **environment: str
) -> subprocess.CompletedProcess[str]:
    """One call; never a traceback, whatever it is asked."""
    result = subprocess.run(
        [SCRIPT, *map(str, arguments)],
        cwd=cwd,
        env={**os.environ, "OMP_NUM_THREADS": "1", **environment},
        capture_output=True,
        text=True,
        timeout=seconds,
        stdin=subprocess.DEVNULL,
    )
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
