"""The shipped calibrations come out again, and their documents say what they hold."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest
from numpy.testing import assert_allclose

from tools.calibrations import (
    DOCUMENT,
    FLAT,
    POISSON_RATIOS,
    ROOT,
    STIFFENED,
    STIFFER,
    STUDIES,
    TABLES,
    TISSUE,
    document,
    in_tissue,
    rule,
)
from vdmbench.evidence.calibrate import as_json, body, calibrate
from vdmbench.report.rebuild import rebuild
from vdmbench.study.config import expand, load_study
from vdmbench.work.keys import direction, load_steps
from vdmbench.work.plan import make_plan
from vdmbench.work.run import Options, run_plan

SAME = 0.02  # of a multiple: a modulus moves the body in proportion, so 2 % of it is 2 % of the displacement
POINTS = 5e-3  # of a relative error


def stored(study: str) -> dict[str, Any]:
    """Model -> its shipped calibration."""
    found: dict[str, Any] = json.loads((TABLES / f"{study}.json").read_text())[study]
    return found


def tissues() -> dict[str, Any]:
    """Study -> E or nu -> model -> the multiples fitted in that tissue."""
    found: dict[str, Any] = json.loads(TISSUE.read_text())
    return found


@pytest.mark.slow
@pytest.mark.parametrize("study", STUDIES)
def test_a_shipped_calibration_comes_out_again(study: str, tmp_path: Path) -> None:
    loaded = load_study(ROOT / "studies" / "cases" / f"{study}.toml")
    plan = make_plan(loaded, expand(loaded), tmp_path / "run", tmp_path / "cache")
    text = (ROOT / "studies" / "cases" / f"{study}.toml").read_text()
    run, _ = run_plan(plan, text, Options(jobs=2), lambda _: None, rebuild)
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


@pytest.mark.slow
@pytest.mark.parametrize("tissue", [{"poisson_ratio": "0.3"}, {"youngs_modulus": f'"{STIFFER}"'}])
def test_a_fit_in_another_tissue_comes_out_again(tissue: dict[str, str], tmp_path: Path) -> None:
    (name,) = (value.strip('"') for value in tissue.values())
    again, shipped = in_tissue(STIFFENED, tmp_path, **tissue), tissues()[STIFFENED][name]
    assert again.keys() == shipped.keys()
    for model, multiples in shipped.items():
        for key, value in multiples.items():
            assert_allclose(again[model][key], value, rtol=SAME, atol=FLAT, err_msg=f"{model}: {key}")


def test_the_fits_follow_youngs_modulus_and_know_every_poisson_ratio() -> None:
    for study, found in tissues().items():
        assert set(found) == {*POISSON_RATIOS, *([STIFFER] if study == STIFFENED else [])}
    for model, multiples in tissues()[STIFFENED][STIFFER].items():
        here = tissues()[STIFFENED][POISSON_RATIOS[-1]][model]
        # the search for a ratio ends at 1e-4 of its logarithm
        assert_allclose([multiples[key] for key in here], list(here.values()), rtol=1e-4, atol=0)


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
    loads = {repr(direction(load_steps(case.study)[-1])[0]) for case in cases}
    assert len(loads) == len(cases) == 12


def test_the_document_shows_the_stored_fits() -> None:
    assert DOCUMENT.read_text() == document({study: stored(study) for study in STUDIES}, tissues())


def test_a_fit_that_ends_with_the_search_is_no_part_of_the_spread() -> None:
    multiples = {"calibrate-a": {"x": 1e-5, "y": 1.0}, "calibrate-b": {"x": 2.0, "y": 1.0}}
    told = rule({**multiples, "calibrate-c": {"x": 0.5, "y": 1.0}})
    assert "`x` 1 times its rule, 4 between the extremes (without the a, where it does not matter" in told
    assert told.endswith("`y` 1 times its rule, 1 between the extremes.")


def test_a_body_without_a_finer_mesh_is_told_in_the_document() -> None:
    found = {study: stored(study) for study in STUDIES}
    assert "mesh independence" not in document(found, tissues())
    for entry in found[STIFFENED].values():
        entry |= {"finer": None, "on_finer": None, "no_finer": "the study sweeps geometry.mesh_size"}
    told = "\nbox: mesh independence not measured, because the study sweeps geometry.mesh_size.\n"
    assert document(found, tissues()).count(told) == len(found[STIFFENED])
