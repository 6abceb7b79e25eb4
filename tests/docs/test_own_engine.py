"""The example's engine of twenty lines: what it reads from an export and writes is `fem-p1`'s answer."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.command import SMALL_STUDY, do
from vdmbench import models
from vdmbench.body.mesh_cache import mesh_from_cache
from vdmbench.cli.arguments import parse
from vdmbench.measures.foreign import read_foreign
from vdmbench.scene.scene import build_scene
from vdmbench.study.config import expand, load_study

ENGINE = Path(__file__).parents[2] / "docs" / "examples" / "twenty_lines.py"
TOOL = """
[[constraints]]
kind = "constrained"
region = "side"
displacement = ["0 mm", "1 mm", "0 mm"]
[regions.side]
above = { axis = "x", fraction = 0.9 }
[gravity]
acceleration = [0, 0, -9.81]
"""


def test_it_has_twenty_lines_and_says_what_ours_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    *_, solving = ENGINE.read_text().split("\n\n", 3)
    assert len(solving.splitlines()) <= 22, "twenty, and two that write"
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text(SMALL_STUDY + TOOL)
    assert do(parse(["export", "small.toml", "--to", "out", "--cache", "cache", "--json"])) == 0
    runpy.run_path(str(ENGINE))
    (case,) = expand(load_study(Path("small.toml")))
    mesh = mesh_from_cache(case.study.geometry, Path("cache"))
    theirs = read_foreign(Path("theirs.csv"), mesh)
    ours = models.run_model(build_scene(case.study, mesh), "fem-p1").displacement[-1]
    assert theirs.exact == 1.0
    # both are direct solves of the same system
    assert_allclose(theirs.displacement, ours, rtol=0, atol=1e-9 * np.abs(ours).max())
