"""The shipped calibrations come out again, and their documents say what they hold."""

import json
from pathlib import Path
from typing import Any

import pytest
from numpy.testing import assert_allclose

from tools.documents import ROOT, rows_shown
from tools.evidence import EVIDENCE, STORED, calibration_rows
from vdmbench.calibrate import as_json, body, calibrate
from vdmbench.report.rebuild import rebuild
from vdmbench.study.config import case_inputs, expand, load_study
from vdmbench.work.keys import direction, load_steps
from vdmbench.work.plan import make_plan
from vdmbench.work.run import Options, run_plan

STUDIES: list[str] = EVIDENCE["calibrations"]["studies"]
SAME = 1e-3  # of a multiple: the search ends at 1e-9 of a logarithm, where one is told
FLAT = 1e-3  # a modulus at a thousandth of its rule no longer matters, and the fit leaves it anywhere below
POINTS = 1e-4  # of a relative error


def stored(study: str) -> dict[str, Any]:
    """Model -> its shipped calibration."""
    found: dict[str, Any] = json.loads((STORED / f"{study}.json").read_text())[study]
    return found


@pytest.mark.slow
@pytest.mark.parametrize("study", STUDIES)
def test_a_shipped_calibration_comes_out_again(study: str, tmp_path: Path) -> None:
    path = ROOT / "studies" / "cases" / f"{study}.toml"
    loaded = load_study(path)
    plan = make_plan(loaded, tmp_path / "run", tmp_path / "cache")
    run, _ = run_plan(plan, Options(jobs=2), lambda _: None, rebuild)
    again = as_json(calibrate(body(plan, run)))
    assert again.keys() == stored(study).keys()
    for model, entry in stored(study).items():
        found: Any = again[model]["fit"]
        assert found["multiples"].keys() == entry["fit"]["multiples"].keys(), model
        for key, value in entry["fit"]["multiples"].items():
            assert_allclose(found["multiples"][key], value, rtol=SAME, atol=FLAT, err_msg=f"{model}: {key}")
        for kind in ("training", "by_rule", "held_out"):
            for measure, value in entry["fit"][kind].items():
                assert_allclose(
                    found[kind][measure], value, rtol=SAME, atol=POINTS, err_msg=f"{model}: {kind}"
                )


@pytest.mark.parametrize("study", STUDIES)
def test_no_load_of_a_shipped_calibration_is_a_multiple_of_another(study: str) -> None:
    cases = expand(load_study(ROOT / "studies" / "cases" / f"{study}.toml"))
    loads = {repr(direction(load_steps(case.study, case_inputs(case.study))[-1])[0]) for case in cases}
    assert len(loads) == len(cases) == 12


def test_the_document_shows_the_stored_fits() -> None:
    rows = calibration_rows({study: stored(study) for study in STUDIES})
    assert rows_shown(ROOT / EVIDENCE["calibrations"]["document"], "calibrations") == list(rows)
