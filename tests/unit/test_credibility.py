"""What a run shows of its credibility: each category from what is stored, and folded away on the page."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from tests.unit.typed_study import asked
from vdmbench.measures.case import CaseResult
from vdmbench.measures.measurement import Measurement, Quantity
from vdmbench.report.page import page_html
from vdmbench.report.section_credibility import evidence
from vdmbench.verdict.credibility import NOT, PARTLY, SHOWN, Evidence, credibility
from vdmbench.verdict.digest import Digest

from .report_runs import REFERENCE, make_case, make_run
from .test_inputs import known

CODE, CALCULATION, INPUTS, CALIBRATION, MEASURED, APPLICABLE = (
    "Code verification",
    "Calculation verification",
    "Input uncertainty",
    "Calibration",
    "Comparison with measurement",
    "Applicability",
)
TWO_LEVELS = {"difference_01": 0.02, "levels": 2.0}
THREE_LEVELS = {"difference_01": 0.01, "difference_12": 0.04, "levels": 3.0}


def found(*cases: CaseResult) -> dict[str, Evidence]:
    return {one.name: one for one in credibility(Digest(make_run(cases)))}


def measured(error: float, *, with_inputs: bool) -> Measurement:
    inputs = {REFERENCE: np.array([1e-5])} if with_inputs else {}
    rows = [Quantity("tips", "tip", "z", 0, 1e-3, 1e-4, 0.0)]
    nothing = {REFERENCE: np.array([np.nan])}
    return Measurement(rows, {REFERENCE: np.array([1e-3 + error])}, nothing, {"tips": "a ruler"}, (), inputs)


def case(**changes: Any) -> CaseResult:
    levels = changes.pop("levels", {})
    return dataclasses.replace(make_case({"vdm-paper": 0.1}, steps=(1.0,), reference_error=levels), **changes)


def test_a_bare_run_shows_little() -> None:
    words = {name: one.word for name, one in found(case()).items()}
    assert words == {
        CODE: PARTLY,
        CALCULATION: NOT,
        INPUTS: NOT,
        CALIBRATION: NOT,
        MEASURED: NOT,
        APPLICABLE: NOT,
    }
    assert credibility(Digest(make_run([]))) == []
    alone = make_case({"vdm-paper": 0.1}, reference=None)
    assert found(alone)[CODE].word == NOT


@pytest.mark.parametrize(
    ("cases", "word", "why"),
    [
        ([case(levels=TWO_LEVELS)], PARTLY, "an order was observed in 0"),
        ([case(levels=THREE_LEVELS)], SHOWN, "0.42 % (GCI, median), in 1 of 1 case, with an observed order"),
        ([case(levels=THREE_LEVELS), case(label="b")], PARTLY, "in 1 of 2 cases"),
    ],
)
def test_mesh_levels_verify_the_calculation(cases: list[CaseResult], word: str, why: str) -> None:
    one = found(*cases)[CALCULATION]
    assert one.word == word
    assert why in one.why


def test_a_model_that_stopped_is_no_verified_calculation() -> None:
    stopped = make_case(
        {"vdm-paper": 0.1}, steps=(0.5, 1.0), reference_error=THREE_LEVELS, stopped={"vdm-paper": 1}
    )
    one = found(stopped)[CALCULATION]
    assert one.word == PARTLY
    assert "1 result stopped at some load" in one.why


def test_inputs_count_where_every_case_has_them() -> None:
    with_them = case(inputs=known(0.05))
    assert found(with_them)[INPUTS].word == SHOWN
    assert "tissue.youngs_modulus and tissue.poisson_ratio by sensitivities" in found(with_them)[INPUTS].why
    assert found(with_them, case(label="b"))[INPUTS].word == PARTLY
    assert found(case(inputs=known(np.nan)))[INPUTS].word == PARTLY
    assert "an answer bends" in found(case(inputs=known(0.05, 0.5)))[INPUTS].why
    assert found(case(inputs=known(0.05, 0.5)))[INPUTS].word == PARTLY


@pytest.mark.parametrize(
    ("measurement", "word", "why"),
    [
        (measured(5e-5, with_inputs=True), SHOWN, "in 1 of 1 value (a ruler)"),
        (measured(5e-4, with_inputs=True), PARTLY, "in 0 of 1 value (a ruler)"),
        (measured(5e-5, with_inputs=False), PARTLY, "which has no part of the inputs"),
        (measured(np.nan, with_inputs=True), NOT, "has no answer where something was measured"),
    ],
)
def test_a_measurement_validates_where_the_reference_is_within(
    measurement: Measurement, word: str, why: str
) -> None:
    one = found(case(measurement=measurement))
    assert one[MEASURED].word == word
    assert why in one[MEASURED].why
    assert one[APPLICABLE].word == PARTLY
    assert (
        "measured were 1 of 2 cases" in found(case(measurement=measurement), case(label="b"))[APPLICABLE].why
    )


def test_parameters_of_the_study_are_told_as_calibrated() -> None:
    given = asked(case(), vdm={"surface_tension": 3.0, "rotation": "none"})
    one = found(given)[CALIBRATION]
    assert one.word == PARTLY
    assert one.why.startswith("surface_tension given by the study")


def test_a_changed_source_tree_is_told() -> None:
    dirty = case(provenance={"commit": "abc-dirty"})
    assert "from a changed source tree" in found(dirty)[CODE].why


def test_the_section_is_folded() -> None:
    run = make_run([case(levels=THREE_LEVELS)])
    section = evidence(Digest(run))
    assert section is not None
    facts = section.blocks[-1]
    assert facts.summary == "Evidence: 1 partly, 1 shown, 4 not"
    page = page_html(run, stills=False)
    start = page.index('id="credibility"')
    assert page.index("<details", start) < page.index("Calculation verification", start)
