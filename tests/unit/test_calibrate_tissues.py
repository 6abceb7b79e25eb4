"""Studies that sweep what changes a rule: for which load the values are, and which loads held out test nothing."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from vdmbench.evidence.calibrate import as_toml, body, calibrate
from vdmbench.evidence.calibration_table import table
from vdmbench.evidence.fit import Sample, Trial, repeats

from . import test_calibrate
from .test_calibrate import STUDY, answered, finished
from .test_calibrate_moved import moved

four_loads = test_calibrate.samples  # the fixture
TEXT = STUDY.replace('"fem-linear"', '"bem"').replace('"vdm-paper", ', "")
PLACES = '"regions.tip.cap.direction.0" = [0.0, 0.4, -0.5, 0.8]'
STIFFER = 4.0


def test_values_of_one_tissue_are_not_given_for_others(tmp_path: Path) -> None:
    places = 'mode = "zip"\n' + PLACES
    run, plan = finished(
        TEXT.replace(PLACES, f'{places}\n"tissue.youngs_modulus" = ["2 kPa", "4 kPa", "8 kPa", "16 kPa"]'),
        tmp_path,
    )
    entry = calibrate(body(plan, run))[0]
    multiple = entry.fit.multiples["surface_tension"]
    assert_allclose(entry.fit.spread["surface_tension"], 8.0, rtol=1e-9, atol=0)
    assert entry.fit.where == run.cases[0].label
    assert entry.repeated == [], "every load has its own place"
    told = next(line for line in as_toml([entry]).splitlines() if line.startswith("# the values hold for "))
    assert f'"{run.cases[0].label}" alone' in told
    assert (
        f"surface_tension 8 times; the errors are those of {multiple:.3g} times the rule of each load" in told
    )
    # which the values are, on that load
    by_rule = run.cases[0].models["vdm-vector"].parameters["surface_tension"]
    written = tomllib.loads(as_toml([entry]))["vdm"]["surface_tension"]
    assert_allclose(written, multiple * float(by_rule), rtol=1e-5, atol=0)


def test_values_of_one_tissue_and_body_have_no_such_line(tmp_path: Path) -> None:
    run, plan = finished(TEXT, tmp_path)
    entry = calibrate(body(plan, run))[0]
    assert entry.fit.spread == {}
    assert "the values hold for" not in as_toml([entry])


def test_loads_held_out_in_another_tissue_alone_test_nothing(tmp_path: Path) -> None:
    swept = '"tissue.youngs_modulus" = ["2 kPa", "4 kPa", "8 kPa", "16 kPa"]'
    run, plan = finished(
        TEXT.replace(PLACES, swept).replace("training = 3", "training = 2"),
        tmp_path,
    )
    entry = calibrate(body(plan, run))[0]
    assert entry.repeated == [case.label for case in run.cases[2:]]
    assert_allclose(entry.fit.held_out.vector, entry.fit.training.vector, rtol=1e-9, atol=0)
    note = "# of the loads held out 2 are multiples of training loads, by load or by tissue, and test nothing"
    assert any(line.startswith(note) for line in as_toml([entry]).splitlines())
    (row,) = table([entry])
    assert row["held out, fitted"].endswith(", 2 no test")


@pytest.mark.parametrize(
    ("movement", "force", "repeated"), [(False, 1.0, True), (True, 0.0, True), (True, 5.0, False)]
)
def test_another_tissue_is_a_test_where_movements_and_forces_act_together(
    four_loads: list[Sample], movement: bool, force: float, repeated: bool
) -> None:
    loads = moved(four_loads[:1], force=force) if movement else four_loads[:1]
    stiffer = [
        dataclasses.replace(
            s,
            label="stiffer",
            scene=dataclasses.replace(
                s.scene,
                tissue=s.scene.tissue.model_copy(
                    update={"youngs_modulus": STIFFER * s.scene.tissue.youngs_modulus}
                ),
            ),
        )
        for s in loads
    ]
    trials = [
        Trial("vdm-vector", answered(side, "bem", [1.0], ["shear_modulus"])) for side in (loads, stiffer)
    ]
    assert repeats(trials[0], trials[1], np.array([1.3])) == (["stiffer"] if repeated else [])
