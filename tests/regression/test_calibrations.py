"""The shipped calibrations come out again, and their documents say what they hold; see `make calibrations`."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest
from numpy.testing import assert_allclose

from studies.calibration.calibrate import as_json, body, calibrate
from studies.keys import load_key
from studies.plan import make_plan
from studies.run import Options, run_plan
from studies.study_file.config import expand, load_study
from tests.docs.calibrations import DOCUMENT, ROOT, STUDIES, TABLES, document

SAME = 0.02  # of a multiple: a modulus moves the body in proportion, so 2 % of it is 2 % of the displacement
POINTS = 5e-3  # of a relative error
FLAT = 1e-3  # a modulus at a thousandth of its rule no longer matters, and the fit leaves it anywhere below


def stored(study: str) -> dict[str, Any]:
    """Model -> its shipped calibration."""
    found: dict[str, Any] = json.loads((TABLES / f"{study}.json").read_text())[study]
    return found


@pytest.mark.slow
@pytest.mark.parametrize("study", STUDIES)
def test_a_shipped_calibration_comes_out_again(study: str, tmp_path: Path) -> None:
    loaded = load_study(ROOT / "studies" / "cases" / f"{study}.toml")
    plan = make_plan(loaded, expand(loaded), tmp_path / "run", tmp_path / "cache")
    text = (ROOT / "studies" / "cases" / f"{study}.toml").read_text()
    run, _ = run_plan(plan, text, Options(jobs=2), lambda event: None)  # noqa: ARG005
    again = as_json(calibrate(body(plan, run, None)))
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
def test_the_table_to_paste_holds_the_fit(study: str) -> None:
    text = (TABLES / f"{study}.toml").read_text()
    tables = tomllib.loads(text)["models"]
    for model, entry in stored(study).items():
        for key, value in entry["fit"]["parameters"].items():
            assert_allclose(tables[model][key], value, rtol=1e-5, atol=0)
        before = text[: text.index(f'[models."{model}"]')].rstrip("\n").rpartition("\n")[2]
        rule, fit = entry["fit"]["by_rule"], entry["fit"]["held_out"]
        worse = fit["vector"] > rule["vector"] + fit["bar"]
        worse |= fit["deformation"] > rule["deformation"] + fit["bar_deformation"]
        assert before.startswith("# worse than the rule on the loads held out") is worse, model


@pytest.mark.parametrize("study", STUDIES)
def test_no_load_of_a_shipped_calibration_is_a_multiple_of_another(study: str) -> None:
    cases = expand(load_study(ROOT / "studies" / "cases" / f"{study}.toml"))
    assert len({load_key(case.study) for case in cases}) == len(cases) == 12


def test_the_document_shows_the_stored_fits() -> None:
    assert DOCUMENT.read_text() == document({study: stored(study) for study in STUDIES})
