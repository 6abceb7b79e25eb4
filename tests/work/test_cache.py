"""Answers on disk: read back as they were."""

import dataclasses
from pathlib import Path

import numpy as np

from solver_common.solution import CONVERGED, Status
from vdmbench.scene.result import ModelResult
from vdmbench.work.cache import read_answer, write_answer


def test_an_answer_is_read_back_as_it_was(tmp_path: Path) -> None:
    vectors, numbers = np.arange(12.0).reshape(2, 2, 3), np.array([1.0, np.nan])
    stored = ModelResult(
        displacement=vectors,
        fluid_pressure=numbers,
        reaction_force=-vectors,
        energy=numbers,
        volume=numbers,
        iterations=np.array([3, 0]),
        status=(CONVERGED, Status("stopped", "too soft", "stiffen it")),
        seconds_setup=np.nan,
        seconds_per_step=numbers,
        peak_bytes=7,
        version="2",
        parameters={"penalty": 1e3, "rotation": "none"},
        scalars={"load_factor": numbers},
        part_of_node=np.array([0, 1]),
    )
    write_answer(tmp_path / "a.npz", stored)
    found = read_answer(tmp_path / "a.npz")
    for name, value in dataclasses.asdict(stored).items():
        np.testing.assert_equal(dataclasses.asdict(found)[name], value, err_msg=name)
