"""The page on the phantoms: every model of both studies is in its tables, and a table says what a run holds."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from tests.report.runs import make_case, make_run
from tests.unit.example_case import example_measurement
from tools.marked import cells, shown
from tools.measured import DOCUMENT, HEAD, STUDIES, fits, table, with_peers
from vdmbench.study import registry
from vdmbench.study.config import load_study
from vdmbench.study.files import study_path


@pytest.mark.parametrize("name", STUDIES)
def test_the_tables_have_every_model_of_the_study(name: str) -> None:
    study = load_study(study_path(name)).study
    head, *rows = cells(shown(DOCUMENT, name))
    assert head == HEAD
    models = [row[0] for row in rows]
    assert set(study.models) | {f"{study.reference} refined"} <= set(models)
    assert ("COMSOL" in models) == (name == "phantom-beam")
    fitted = [row[0] for row in cells(shown(DOCUMENT, f"{name}-fit"))[1:]]
    assert fitted == list(study.models)


def test_a_table_says_what_a_run_holds() -> None:
    case = make_case({"vdm-paper": 0.05}, steps=(0.25, 0.5, 1.0), reference="fem:direct")
    text = table(make_run([dataclasses.replace(case, measurement=example_measurement())]))
    rows = {row[0]: row[1:] for row in cells(text)[1:]}
    assert rows["vdm-paper"] == [
        *("1 of 2", "50.0 µm", "0.77 %"),
        *("200 µm", "100 µm", "1.00 mm", "400 µs", "20.0 ms"),
    ]
    assert rows["COMSOL"][-2:] == ["–", "–"]


def test_a_fit_without_a_number_is_told() -> None:
    lost = dict.fromkeys(("modulus", "uncertainty", "trained", "held_out", "as_given"))
    found = {
        "model": "b",
        "modulus": 8e3,
        "uncertainty": 80.0,
        "trained": 1e-3,
        "held_out": 2e-3,
        "as_given": 3e-3,
    }
    assert cells(fits([{"model": "a", **lost}, found]))[1:] == [
        ["a", "none in range", "–", "–", "–", "–"],
        ["b", "8.00 kPa", "1.00 %", "1.00 mm", "2.00 mm", "3.00 mm"],
    ]


def test_engines_of_others_run_beside_the_models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    theirs = dataclasses.replace(registry.all_models()["bem"], name="ngsolve-p2p1")
    monkeypatch.setitem(registry.MODELS, "ngsolve-p2p1", theirs)
    monkeypatch.delitem(registry.MODELS, "mujoco-flex", raising=False)
    path = with_peers("phantom-beam", tmp_path / "new")
    found, own = load_study(path), load_study(study_path("phantom-beam"))
    beside = ("bem:nonlinear", "ngsolve-p2p1:nonlinear")
    assert found.study.models == (*own.study.models, *beside), "all but the one whose wheel is not there"
    assert found.measured == own.measured
