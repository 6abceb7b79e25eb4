"""What follows from a benchmark, on numbers chosen by hand; the spheres of the growth."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vdmbench import bench
from vdmbench.bench import (
    Bench,
    Entry,
    rows,
    spread,
)
from vdmbench.cli.verbs_of_trials import bodies_to_measure
from vdmbench.study.config import load_study
from vdmbench.study.errors import InputError


def entry(model: str, recut: float, frame: float, error: float, **changes: Any) -> Entry:
    one = np.array([np.nan, 1.0, 1.0])
    given = {
        "body": "ball",
        "model": model,
        "nodes": 100,
        "tetrahedra": 300,
        "frame_all": one,
        "columns": np.nan * one,
        "setup": recut * one,
        "recut": recut * one,
        "frame_local": frame * one,
        "ratio_setup": one,
        "ratio_frame": one,
        "peak_bytes": 1e6,
        "error": error,
        "deformation_error": error,
        "bar": 0.01,
        "iterations": 0.0,
    }
    return Entry(**(given | changes))


VECTOR = entry("vdm-vector", 0.01, 1e-3, 0.2)


def test_a_round_that_was_left_out_counts_nothing() -> None:
    (row,) = rows(Bench({}, [VECTOR]))
    assert row["re-cut"] == "10 ms [10 ms, 10 ms]"
    assert row["error"] == "20 % ± 1 %"
    (row,) = rows(Bench({}, [replace(VECTOR, bar=0.04)]))
    assert row["error"] == "~20 % ± 4 %", "more than a tenth is not resolved"
    assert row["columns"] == "–", "none were needed"


def test_how_far_rounds_are_off_their_median() -> None:
    """By the middle half of them: one round in which the machine did something else weighs nothing."""
    even, uneven = np.array([2.0, 2.0, 2.0, 2.0, 1e4]), np.array([2.0, 4.0, 5.0, 6.0, 1e4])
    assert spread(uneven) == (4.0, 6.0)
    assert all(math.isnan(part) for part in spread(even * np.nan))


STUDY = """
[study]
name = "ball"
models = ["vdm-consistent", "fem-linear"]
condition = true

[geometry]
shape = "sphere"
radius = "50 mm"
mesh_size = "{size} mm"

[tissue]
youngs_modulus = "5 kPa"
poisson_ratio = 0.45

[regions.base]
below = {{ axis = "z", fraction = 0.3 }}

[regions.finger]
above = {{ axis = "z", fraction = {fraction} }}

[[constraints]]
kind = "fixed"
region = "base"

[[constraints]]
kind = "contact"
region = "finger"
pressure = "100 Pa"
"""


def test_a_size_that_the_author_never_wrote_and_nothing_stands_is_left_out(tmp_path: Path) -> None:
    """A ball of 100 mm has no mesh with edges of 76 or 99 mm."""
    path = tmp_path / "ball.toml"
    path.write_text(STUDY.format(size=38, fraction=0.7))
    told: list[str] = []
    found = bench.measure(
        {"ball": load_study(path)}, tmp_path, sizes=(2.6, 2.0, 1.0), rounds=1, watch=told.append
    )
    (mesh,) = found.meshes()
    assert all(entry.status == "converged" for entry in found.entries)
    left_out = found.machine["left out"]
    assert left_out.count("times its mesh_size: ") == 2
    assert left_out.startswith("ball at 2.6 times its mesh_size: ")
    assert f"left out {left_out.split('; ball')[0]}" in told
    assert f"measuring ball, {mesh[1]} nodes, mesh 3 of 3" in told
    # nothing else is to be had: the study as it is
    alone = bench.measure({"ball": load_study(path)}, tmp_path, sizes=(2.6,), rounds=1, watch=told.append)
    assert alone.meshes() == [mesh]


def test_a_surface_called_like_a_built_in_body_is_measured_beside_it() -> None:
    built_in = bodies_to_measure(None, None)
    for name in ("sphere.stl", "organ.ply", "liver.stl"):
        bodies = bodies_to_measure(None, Path(name))
        assert bodies.items() > built_in.items()
        assert [path for _, path in bodies.values() if path is not None] == [Path(name)]
    assert set(bodies_to_measure(None, Path("liver.stl"))) == {"sphere", "organ", "liver"}


def test_a_study_that_cannot_be_measured_at_all_says_why(tmp_path: Path) -> None:
    path = tmp_path / "ball.toml"
    path.write_text(STUDY.format(size=38, fraction=0.999))
    with pytest.raises(InputError, match="enlarge its region"):
        bench.measure({"ball": load_study(path)}, tmp_path, sizes=(2.0,), rounds=1, watch=str)
