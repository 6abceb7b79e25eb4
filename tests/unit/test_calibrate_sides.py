"""Which loads train, which test, and whose bars are told: every side has a reference and bars of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose

from vdmbench.evidence.calibrate import Body, calibrate
from vdmbench.evidence.fit import Errors, Sample, samples_of
from vdmbench.measures.metrics import DEFORMATION, VECTOR

from . import test_calibrate
from .test_calibrate import STUDY, answered, finished

four_loads = test_calibrate.samples  # the fixture
MULTIPLE = 1.3


def side(known: Sequence[Sample], share: float) -> tuple[Sample, ...]:
    """Two loads whose reference is so many times the answer of the fitted model, with bars that differ."""
    bars = ({VECTOR: 0.1 * share, DEFORMATION: 0.4 * share}, {VECTOR: 0.3 * share, DEFORMATION: 0.2 * share})
    return tuple(
        dataclasses.replace(sample, reference=share * sample.reference, bars=bar)
        for sample, bar in zip(known, bars, strict=True)
    )


def assert_errors(found: Errors | None, share: float) -> None:
    """Of the fitted model against a reference `share` times its answer; of the bars the larger ones."""
    assert found is not None
    off = 1.0 - 1.0 / share
    expected = [off, off, off, off, 0.3 * share, 0.4 * share]
    assert_allclose(dataclasses.astuple(found), expected, rtol=1e-9, atol=1e-9)


def test_errors_are_those_on_the_held_out_loads_of_each_body_and_mesh(four_loads: list[Sample]) -> None:
    known = answered(four_loads, "vdm-vector", [MULTIPLE], ["surface_tension"])
    first, second = known[:2], known[2:]
    own = Body(
        "own", ("vdm-vector",), None, side(first, 1.0), side(second, 2.0), side(first, 4.0), side(second, 5.0)
    )
    other = Body("other", ("vdm-vector",), None, side(first, 8.0), side(second, 10.0))
    (entry,) = calibrate(own, [other])
    assert_allclose(entry.fit.multiples["surface_tension"], MULTIPLE, rtol=1e-9, atol=0)
    assert_errors(entry.fit.training, 1.0)
    assert_errors(entry.fit.held_out, 2.0)
    # the rule's answer is 1.3 times the fitted one
    assert_allclose(entry.fit.by_rule.vector, 1.0 - MULTIPLE / 2.0, rtol=1e-9, atol=0)
    assert_errors(entry.on_finer, 5.0)
    assert_errors(entry.transfer["other"], 10.0)
    assert entry.finer is not None, "fitted to the finer mesh's own training loads: four times as soft"
    assert_allclose(entry.finer["surface_tension"], MULTIPLE / 4.0, rtol=1e-9, atol=0)


def test_a_load_has_the_bars_of_both_measures(tmp_path: Path) -> None:
    text = STUDY.replace('["vdm-paper", "vdm-vector", "fem-linear"]', '["vdm-vector", "vdm-paper"]')
    run, plan = finished(text.replace('"fem-linear"', '"vdm-paper"'), tmp_path)
    measured = [
        dataclasses.replace(case, reference_error={f"gci:{VECTOR}": 0.01 * k, f"gci:{DEFORMATION}": 0.1 * k})
        for k, case in enumerate(run.cases)
    ]
    bars = [sample.bars for sample in samples_of(plan, dataclasses.replace(run, cases=measured))]
    assert bars == [{VECTOR: 0.01 * k, DEFORMATION: 0.1 * k} for k in range(4)]
    assert all(np.isnan([*sample.bars.values()]).all() for sample in samples_of(plan, run))
