"""Fits of surface-model parameters: known answers are recovered, held-out loads are not looked at."""

from __future__ import annotations

import dataclasses
import json
import math
import re
import tomllib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.command import strict_json, vdmbench
from tests.in_process import do_cases
from tests.unit.report_runs import icosphere
from vdmbench import models
from vdmbench.body.mesh_cache import mesh_from_cache
from vdmbench.evidence.calibrate import Body, Calibration, as_json, as_toml, body, calibrate, worse_than_rule
from vdmbench.evidence.calibration_table import table
from vdmbench.evidence.fit import Errors, Fit, Sample, Trial, fit, least_error, samples_of, split
from vdmbench.evidence.search import CalibrationError
from vdmbench.measures.case import Run
from vdmbench.models import run_model
from vdmbench.scene.scene import build_scene
from vdmbench.store.cases import read_case
from vdmbench.study.config import expand, geometry_of, load_study, with_mesh_size
from vdmbench.work.plan import Plan, make_plan

STUDY = """
[study]
name = "fit"
models = ["vdm-paper", "vdm-vector", "fem-linear"]
reference = "fem-linear"
[geometry]
shape = "ellipsoid"
semi_axes = ["40 mm", "30 mm", "25 mm"]
mesh_size = "16 mm"
[tissue]
youngs_modulus = "5 kPa"
poisson_ratio = 0.49
[regions]
base.below = { axis = "z", fraction = 0.2 }
tip.cap = { direction = [0, 0, 1], angle = "40 deg" }
[[constraints]]
kind = "fixed"
region = "base"
[[constraints]]
name = "tip"
kind = "contact"
region = "tip"
pressure = "40 Pa"
[calibration]
training = 3
[sweep]
"regions.tip.cap.direction.0" = [0.0, 0.4, -0.5, 0.8]
"""
NOWHERE = {"relative_l2_displacement_error": np.nan, "relative_l2_deformation_error": np.nan}


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> list[Sample]:
    """Four loads without an answer yet."""
    directory = tmp_path_factory.mktemp("fit")
    (directory / "study.toml").write_text(STUDY)
    cases = expand(load_study(directory / "study.toml"))
    mesh = mesh_from_cache(geometry_of(cases[0].study), directory, volume=False)
    return [
        Sample(
            case.label,
            build_scene(case.study, mesh),
            np.zeros((len(mesh.surface_nodes), 3)),
            NOWHERE,
            place,
        )
        for place, case in enumerate(cases)
    ]


def answered(samples: list[Sample], model: str, multiples: list[float], asked: list[str]) -> list[Sample]:
    """The loads with a model's own answer as the reference."""
    answers = Trial(model, samples, asked).answers(np.array(multiples))
    return [dataclasses.replace(s, reference=u) for s, u in zip(samples, answers, strict=True)]


@pytest.mark.parametrize(
    ("model", "asked", "multiples"),
    [
        ("vdm-vector", ["surface_tension"], [1.7]),
        ("bem", ["shear_modulus"], [0.4]),
        ("vdm-paper", ["bulk_modulus", "connectivity_modulus"], [0.3, 2.5]),
        ("vdm-consistent", ["foundation", "surface_tension"], [3.0, 0.6]),
        ("vdm-vector", ["surface_tension", "stretch_stiffness"], [0.8, 0.5]),
        ("vdm-vector", ["foundation", "surface_tension", "stretch_stiffness"], [0.5, 1.2, 0.3]),
        ("vdm-vector:nonlinear", ["surface_tension"], [1.7]),
    ],
)
def test_the_parameters_behind_an_answer_are_found(
    samples: list[Sample], model: str, asked: list[str], multiples: list[float]
) -> None:
    if "foundation" in asked and model.startswith("vdm-vector"):
        samples = [
            dataclasses.replace(s, scene=dataclasses.replace(s.scene, parameters={"foundation": 5e4}))
            for s in samples
        ]
    known = answered(samples[:2], model, multiples, asked)
    found = least_error(Trial(model, known, asked)).multiples
    # three moduli are searched by a simplex, which stops at 1e-4 of a logarithm per ratio
    assert_allclose(found, multiples, rtol=5e-3 if len(asked) > 2 else 5e-4, atol=0)


def test_a_fit_is_carried_to_another_body_as_a_multiple_of_its_rule(samples: list[Sample]) -> None:
    known = answered(samples, "vdm-vector", [1.3], ["surface_tension"])
    stiff = [
        dataclasses.replace(
            s,
            scene=dataclasses.replace(
                s.scene, tissue=s.scene.tissue.model_copy(update={"youngs_modulus": 20000.0})
            ),
            reference=s.reference / 4.0,
        )
        for s in known
    ]
    body = Body(
        "soft", ("vdm-vector",), None, tuple(known[:2]), tuple(known[2:]), tuple(stiff[:2]), tuple(stiff[2:])
    )
    other = Body("stiff", ("vdm-vector", "vdm-paper"), None, tuple(stiff[:2]), tuple(stiff[2:]))
    (entry,) = calibrate(body, [other])
    assert entry.on_finer is not None
    assert_allclose([entry.transfer["stiff"].vector, entry.on_finer.vector], 0.0, rtol=0, atol=1e-9)
    (row,) = table([entry])
    assert row["times its rule"] == "1.3"
    assert "on stiff" in row
    assert row["on stiff"] != "–"
    # a body that has no such model leaves its place in the table empty
    lacking = Body("else", ("vdm-paper",), None, tuple(stiff[:2]), tuple(stiff[2:]))
    both = Body("soft", ("vdm-vector", "vdm-paper"), None, body.training, body.held_out)
    rows = table(calibrate(both, [lacking]))
    assert [list(row) for row in rows] == [list(rows[0])] * 2
    assert rows[0]["on else"] == "–" != rows[1]["on else"]
    written = tomllib.loads(as_toml([entry]))
    assert_allclose(
        written["vdm"]["surface_tension"], entry.fit.parameters["surface_tension"], rtol=1e-5, atol=0
    )


def test_the_loads_of_a_body_share_their_set_ups(
    samples: list[Sample], monkeypatch: pytest.MonkeyPatch
) -> None:
    known = answered(samples, "vdm-vector", [1.3], ["surface_tension"])
    counts: Counter[str] = Counter()
    start, answer = models.Prepared.__init__, models.Prepared.answer

    def counted_start(self: models.Prepared, *arguments: Any, **options: Any) -> None:
        counts["set-ups"] += 1
        start(self, *arguments, **options)

    def counted_answer(self: models.Prepared, *arguments: Any) -> Any:
        counts["answers"] += 1
        return answer(self, *arguments)

    monkeypatch.setattr(models.Prepared, "__init__", counted_start)
    monkeypatch.setattr(models.Prepared, "answer", counted_answer)
    entry = fit("vdm-vector", known[:3], known)
    assert counts["answers"] >= 3 * counts["set-ups"], "three loads or more to a set-up"
    trial = Trial("vdm-vector", known, ["surface_tension"])
    together = trial.answers(np.array([1.1]))
    for sample, found in zip(known, together, strict=True):  # the long way: each load set up by itself
        alone = Trial("vdm-vector", [sample], ["surface_tension"]).answers(np.array([1.1]))[0]
        assert_allclose(found, alone, rtol=0, atol=1e-13 * np.abs(alone).max())
    assert_allclose(list(entry.multiples.values()), 1.3, rtol=1e-3, atol=0)


def test_a_fit_that_is_worse_than_the_rule_says_so() -> None:
    def errors(vector: float, deformation: float, bar: float = 0.02) -> Errors:
        return Errors(vector, vector, deformation, deformation, bar, bar)

    assert worse_than_rule(errors(0.3, 0.9), errors(0.2, 0.91)) == "", "within the reference's own error"
    assert worse_than_rule(errors(0.3, 0.9), errors(0.2, 3.7)) == "deformation 370 against 90 %"
    alike = worse_than_rule(errors(0.55801, 0.47701), errors(0.55803, 0.478, math.nan))
    assert alike == "deformation 47.8 against 47.7 %", "55.8 and 55.8 % look alike"
    both = "displacement 30.1 against 30 %, deformation 90.1 against 90 %"
    assert worse_than_rule(errors(0.3, 0.9), errors(0.301, 0.901, math.nan)) == both
    fitted = Fit("vdm-paper", {}, {"bulk_modulus": 7.0}, errors(0.3, 0.9), errors(0.2, 0.8), errors(0.2, 3.7))
    assert as_toml([Calibration(fitted, None, None, {})]) == (
        "# worse than the rule on the loads held out: deformation 370 against 90 %; the rule may serve better\n"
        "[vdm]\nbulk_modulus = 7\n"
    )


@pytest.mark.parametrize(
    ("reference", "models", "told"),
    [
        (
            "bem",
            ("vdm-vector", "vdm-vector:nonlinear"),
            {"vdm-vector": 1, "vdm-vector:nonlinear": 0},
        ),
        ("bem:nonlinear", ("vdm-vector",), {"vdm-vector": 0}),
    ],
)
def test_held_out_multiples_of_training_loads_are_told(
    reference: str, models: tuple[str, ...], told: Mapping[str, int], tmp_path: Path
) -> None:
    text = STUDY.replace("training = 3", "training = 2").replace(
        '"regions.tip.cap.direction.0" = [0.0, 0.4, -0.5, 0.8]',
        'mode = "zip"\n"regions.tip.cap.direction.0" = [0.0, 0.4, 0.4, 0.8]\n'
        '"constraints.tip.pressure" = [40.0, 20.0, 80.0, 20.0]',
    )
    text = text.replace('["vdm-paper", "vdm-vector", "fem-linear"]', json.dumps([*models, reference]))
    run, plan = finished(text.replace('reference = "fem-linear"', f'reference = "{reference}"'), tmp_path)
    entries = {entry.fit.model: entry for entry in calibrate(body(plan, run, None))}
    assert {name: len(entries[name].repeated) for name in models} == told
    for entry in (entries[name] for name in models):
        (row,) = table([entry])
        repeated = bool(told[entry.fit.model])
        assert ("1 no test" in row["held out, fitted"]) is repeated
        note = "# of the loads held out 1 are multiples of training loads, by load or by tissue, and test nothing"
        assert as_toml([entry]).startswith(note) is repeated
    if "vdm-vector" in models and reference == "bem":
        (label,) = as_json([entries["vdm-vector"]])["vdm-vector"]["repeated"]  # type: ignore[misc]
        assert "80 Pa" in label


def finished(text: str, directory: Path) -> tuple[Run, Plan]:
    """A study's run and plan, all its cases done here."""
    (directory / "study.toml").write_text(text)
    study = load_study(directory / "study.toml")
    plan = make_plan(study, expand(study), directory / "run", directory / "cache")
    do_cases(plan)
    cases = [read_case(plan.case_file(case)) for case in plan.cases]
    return Run(study, "", cases, [], [], {}), plan


def test_each_model_fits_what_it_reads_of_what_is_asked(samples: list[Sample]) -> None:
    asked = ["stretch_stiffness", "connectivity_modulus", "surface_tension"]
    names = {
        name: Trial(name, samples, asked).names for name in ("vdm-paper", "vdm-consistent", "vdm-vector")
    }
    assert names == {
        "vdm-paper": ("connectivity_modulus",),
        "vdm-consistent": ("surface_tension",),
        "vdm-vector": ("stretch_stiffness", "surface_tension"),
    }


def test_what_cannot_be_fitted_says_why(samples: list[Sample]) -> None:
    with pytest.raises(CalibrationError, match="sweep more loads"):
        split(samples[:1], 1, None)
    with pytest.raises(CalibrationError, match="4 of 4 would train"):
        split(samples, 4, 4)
    with pytest.raises(CalibrationError, match="none of the first 2 loads, which train, is finished"):
        split(samples[2:], 4, None)
    with pytest.raises(CalibrationError, match="none of the loads held out is finished"):
        split(samples[:2], 4, 2)
    with pytest.raises(CalibrationError, match="it reads none of foundation"):
        Trial("vdm-paper", samples, ["foundation"])
    given = [
        dataclasses.replace(s, scene=dataclasses.replace(s.scene, parameters={"surface_tension": 9.0}))
        for s in samples
    ]
    with pytest.raises(CalibrationError, match="sets all of them"):
        Trial("vdm-vector", given)
    upside_down = [
        dataclasses.replace(s, reference=-u)
        for s, u in zip(samples, Trial("vdm-vector", samples).answers(np.ones(1)), strict=True)
    ]
    with pytest.raises(CalibrationError, match="against the reference"):
        least_error(Trial("vdm-vector", upside_down))


def test_a_load_that_fails_moves_no_other_to_the_other_side(tmp_path: Path) -> None:
    text = STUDY.replace("0.4, -0.5, 0.8", "0.4, 400.0, -0.5, 0.8")  # the third is on the support
    (tmp_path / "fit.toml").write_text(text.replace('"vdm-paper", ', ""))
    result = vdmbench("calibrate", "fit.toml", "--json", cwd=tmp_path)
    assert result.returncode == 3, result.stderr
    label = "direction x = 400"
    assert f"vdmbench: failed: {label}: " in result.stderr
    entry = json.loads(result.stdout)["fit"]["vdm-vector"]
    assert entry["lost"] == {"fit": [label], "fit, finer mesh": [label]}
    toml = (tmp_path / "results/runs/fit/calibration.toml").read_text()
    assert toml.startswith("# loads that failed are left out: 1 of fit, 1 of fit, finer mesh\n[vdm]\n")
    # the first two loads train, those behind the one that failed do not
    (tmp_path / "two.toml").write_text(
        STUDY.replace('"fit"', '"two"').replace("training = 3", "training = 2").replace('"vdm-paper", ', "")
    )
    two = vdmbench("calibrate", "two.toml", "--json", cwd=tmp_path)
    assert two.returncode == 0, two.stderr
    other = json.loads(two.stdout)["two"]["vdm-vector"]
    assert other["lost"] == {}
    for part in ("multiples", "training", "held_out"):
        found, expected = (list(e["fit"][part].values()) for e in (entry, other))
        assert_allclose(np.array(found, float), np.array(expected, float), rtol=1e-9, atol=0)
    assert_allclose(entry["on_finer"]["vector"], other["on_finer"]["vector"], rtol=1e-9, atol=0)


def test_the_command_writes_a_table_to_paste(tmp_path: Path) -> None:
    (tmp_path / "fit.toml").write_text(STUDY)
    result = vdmbench("calibrate", "fit.toml", "--json", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    found = strict_json(result.stdout)["fit"]
    assert strict_json((tmp_path / "results/runs/fit/calibration.json").read_text())["fit"] == found
    assert set(found) == {"vdm-paper", "vdm-vector"}
    assert found["vdm-paper"]["fit"]["training"]["bar"] is None, "the reference's own error was not measured"
    entry = found["vdm-vector"]["fit"]
    assert entry["held_out"]["vector"] < entry["by_rule"]["vector"]
    pasted = tomllib.loads((tmp_path / "results/runs/fit/calibration.toml").read_text())
    assert_allclose(
        pasted["models"]["vdm-vector"]["surface_tension"],
        entry["parameters"]["surface_tension"],
        rtol=1e-5,
        atol=0,
    )
    # pasted into the study, the model's error on the held-out load is what the calibration said
    (tmp_path / "pasted.toml").write_text(
        STUDY.replace('"fit"', '"pasted"') + (tmp_path / "results/runs/fit/calibration.toml").read_text()
    )
    again = vdmbench("run", "pasted.toml", "--json", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    rows = (tmp_path / "results/runs/pasted/metrics.csv").read_text().splitlines()
    last = [
        float(row.split(",")[-3 if rows[0].endswith("reference_error") else -2])
        for row in rows
        if ",vdm-vector," in row and "relative_l2_displacement_error" in row
    ][-1]
    assert_allclose(last, entry["held_out"]["vector"], rtol=1e-4, atol=0)


def test_a_fit_to_another_surface_is_tried_on_the_study_as_it_is(tmp_path: Path) -> None:
    text = STUDY.replace('"fem-linear"', '"bem"')
    (tmp_path / "fit.toml").write_text(text)
    (tmp_path / "mine.toml").write_text(text.replace('"fit"', '"mine"').replace('"vdm-paper", ', ""))
    points, triangles = icosphere(2)
    meshio.Mesh(0.03 * points, [("triangle", triangles)]).write(tmp_path / "ball.obj")
    words = ["calibrate", "fit.toml", "--surface", "ball.obj", "--transfer", "mine.toml"]
    result = vdmbench(*words, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    # a model, and below it what its row has: the table is too wide for a line
    rows = dict(re.findall(r"^(vdm-\S+)\n((?:  .*\n)+)", result.stdout, re.M))
    assert rows["vdm-paper"].endswith(" –\n"), "which the other study does not have"
    assert rows["vdm-vector"].endswith(" %\n")
    runs = tmp_path / "results/runs"
    shapes = {
        name: tomllib.loads((runs / name / "resolved.toml").read_text())["geometry"]["shape"]
        for name in ("fit-ball", "fit-ball/finer", "mine")
    }
    assert shapes == {"fit-ball": "file", "fit-ball/finer": "file", "mine": "ellipsoid"}
    commands = {name: json.loads((runs / name / "plan.json").read_text())["command"] for name in shapes}
    assert commands["mine"] == ["run", "mine.toml"]
    assert commands["fit-ball"] == ["run", *words[1:4]]
    assert commands["fit-ball/finer"] == words[:4]


def test_a_history_that_does_not_end_at_factor_one_gives_the_same_fit(tmp_path: Path) -> None:
    fits = []
    for history in ("[1.0]", "[0.5]", "[2.0, 0.25]"):
        name = f"history-{len(fits)}"
        text = STUDY.replace('"fem-linear"', '"bem"').replace('"fit"', f'"{name}"')
        (tmp_path / name).mkdir()
        run, plan = finished(f"{text}[load]\nfactors = {history}\n", tmp_path / name)
        found = samples_of(plan, run)
        fits.append(fit("vdm-vector", found[:3], found[3:]))
    for other in fits[1:]:
        # all models are linear: the same body under more or less of the same load
        assert_allclose(
            other.multiples["surface_tension"], fits[0].multiples["surface_tension"], rtol=1e-9, atol=0
        )
        assert_allclose(other.held_out.vector, fits[0].held_out.vector, rtol=1e-9, atol=0)


def test_a_finer_study_has_a_finer_mesh_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(STUDY)
    study = load_study(tmp_path / "study.toml")
    finer = with_mesh_size(study, 0.5)
    assert finer is not None
    assert finer.geometry.mesh_size == 0.008
    assert finer.model_copy(update={"geometry": study.geometry}) == study
    (tmp_path / "swept.toml").write_text(STUDY + '"geometry.mesh_size" = ["16 mm", "20 mm"]\n')
    assert with_mesh_size(load_study(tmp_path / "swept.toml"), 0.5) is None


def test_a_tension_of_the_study_is_the_mean_of_one_that_grows_from_the_support(samples: list[Sample]) -> None:
    by_rule = Trial("vdm-vector", samples[:1], ["surface_tension"])
    rule = by_rule.values(np.ones(1))["surface_tension"]
    given = dataclasses.replace(samples[0].scene, parameters={"surface_tension": 2.0 * rule})
    asked = run_model(given, "vdm-vector")
    assert_allclose(asked.parameters["surface_tension"], 2.0 * rule, rtol=1e-12, atol=0)
    half = 0.5 * by_rule.answers(np.ones(1))[0]
    assert_allclose(asked.displacement[-1], half, rtol=1e-9, atol=1e-12 * np.abs(half).max())
