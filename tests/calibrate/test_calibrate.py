"""Fits of surface-model parameters: known answers are recovered, of moved regions too, by training loads alone."""

import dataclasses
import json
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path

import meshio
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.command import strict_json, vdmbench
from tests.in_process import do_cases
from tests.report.runs import icosphere
from vdmbench.body.mesh_cache import mesh_from_cache
from vdmbench.calibrate import (
    Body,
    CalibrationError,
    Errors,
    Sample,
    Trial,
    as_toml,
    body,
    calibrate,
    fit,
    least_error,
    table,
)
from vdmbench.measures.case import Run
from vdmbench.measures.metrics import DEFORMATION, VECTOR
from vdmbench.scene.scene import build_scene
from vdmbench.store.cases import read_case
from vdmbench.study.config import expand, load_study
from vdmbench.work.plan import Plan, make_plan

pytestmark = pytest.mark.usefixtures("read_here")

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
    mesh = mesh_from_cache(cases[0].study.geometry, directory, volume=False)
    return [
        Sample(
            case.label,
            build_scene(case.study, mesh),
            np.zeros((len(mesh.surface_nodes), 3)),
            NOWHERE,
        )
        for case in cases
    ]


def answered(samples: list[Sample], model: str, multiples: list[float], asked: list[str]) -> list[Sample]:
    """The loads with a model's own answer as the reference."""
    answers = Trial(model, samples, asked).answers(np.array(multiples))
    return [dataclasses.replace(s, reference=u) for s, u in zip(samples, answers, strict=True)]


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
    soft = Body("soft", ("vdm-vector",), tuple(known[:2]), tuple(known[2:]))
    other = Body("stiff", ("vdm-vector", "vdm-paper"), tuple(stiff[:2]), tuple(stiff[2:]))
    told: list[str] = []
    (entry,) = calibrate(soft, [other], told.append)
    assert told == ["fitting vdm-vector"]
    assert_allclose(entry.transfer["stiff"].vector, 0.0, rtol=0, atol=1e-9)
    (row,) = table([entry])
    assert row["times its rule"] == "1.3"
    assert "on stiff" in row
    assert row["on stiff"] != "–"
    # a body that has no such model leaves its place in the table empty
    lacking = Body("else", ("vdm-paper",), tuple(stiff[:2]), tuple(stiff[2:]))
    both = Body("soft", ("vdm-vector", "vdm-paper"), soft.training, soft.held_out)
    rows = table(calibrate(both, [lacking]))
    assert [list(row) for row in rows] == [list(rows[0])] * 2
    assert rows[0]["on else"] == "–" != rows[1]["on else"]
    written = tomllib.loads(as_toml([entry]))
    assert_allclose(written["vdm"]["surface_tension"], entry.parameters["surface_tension"], rtol=1e-5, atol=0)


def finished(text: str, directory: Path) -> tuple[Run, Plan]:
    """A study's run and plan, all its cases done here."""
    (directory / "study.toml").write_text(text)
    study = load_study(directory / "study.toml")
    plan = make_plan(study, directory / "run", directory / "cache")
    do_cases(plan)
    cases = [read_case(plan.case_file(case)) for case in plan.cases]
    return Run(study, "", cases, [], [], {}), plan


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
    text = STUDY.replace('"fem-linear"', '"vdm-consistent"')
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
        for name in ("fit-ball", "mine")
    }
    assert shapes == {"fit-ball": "file", "mine": "ellipsoid"}
    commands = {name: json.loads((runs / name / "plan.json").read_text())["command"] for name in shapes}
    assert commands["mine"] == ["run", "mine.toml"]
    assert commands["fit-ball"] == ["run", *words[1:4]]


def test_a_history_that_does_not_end_at_factor_one_gives_the_same_fit(tmp_path: Path) -> None:
    fits = []
    for history in ("[1.0]", "[0.5]", "[2.0, 0.25]"):
        name = f"history-{len(fits)}"
        text = STUDY.replace('"fem-linear"', '"vdm-consistent"').replace('"fit"', f'"{name}"')
        (tmp_path / name).mkdir()
        run, plan = finished(f"{text}[load]\nfactors = {history}\n", tmp_path / name)
        found = body(plan, run)
        fits.append(fit("vdm-vector", found.training, found.held_out))
    for other in fits[1:]:
        # all models are linear: the same body under more or less of the same load
        assert_allclose(
            other.multiples["surface_tension"], fits[0].multiples["surface_tension"], rtol=1e-9, atol=0
        )
        assert_allclose(other.held_out.vector, fits[0].held_out.vector, rtol=1e-9, atol=0)


def test_what_cannot_be_fitted_says_why(samples: list[Sample]) -> None:
    given = [
        dataclasses.replace(s, scene=dataclasses.replace(s.scene, parameters={"surface_tension": 9.0}))
        for s in samples
    ]
    with pytest.raises(CalibrationError, match="sets all of them"):
        Trial("vdm-vector", given)
    answers = Trial("vdm-vector", samples).answers(np.ones(1))
    upside_down = [dataclasses.replace(s, reference=-u) for s, u in zip(samples, answers, strict=True)]
    with pytest.raises(CalibrationError, match="its error falls as long as its moduli grow"):
        least_error(Trial("vdm-vector", upside_down))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["none.toml"], "needs study.reference"),
        (["one.toml"], "3 of 1 would train; sweep more loads"),
        (["set.toml"], "vdm-vector has no parameter left to fit: the study sets all of them"),
        (["fit.toml", "--transfer", "one.toml"], "3 of 1 would train; sweep more loads"),
    ],
)
def test_mistakes_of_the_command_are_told_before_anything_is_run(
    tmp_path: Path, words: list[str], said: str
) -> None:
    (tmp_path / "fit.toml").write_text(STUDY)
    (tmp_path / "none.toml").write_text(STUDY.replace('reference = "fem-linear"', ""))
    (tmp_path / "one.toml").write_text(STUDY.partition("[sweep]")[0])
    (tmp_path / "set.toml").write_text(STUDY + "[vdm]\nsurface_tension = 20.0\n")
    result = vdmbench("calibrate", *words, cwd=tmp_path)
    assert result.returncode == 2
    (line,) = result.stderr.splitlines()
    assert said in line
    assert not (tmp_path / "results").exists()


def test_a_load_that_fails_moves_no_other_to_the_other_side(tmp_path: Path) -> None:
    text = STUDY.replace("0.4, -0.5, 0.8", "0.4, 400.0, -0.5, 0.8")  # the third is on the support
    (tmp_path / "fit.toml").write_text(text.replace('"vdm-paper", ', ""))
    result = vdmbench("calibrate", "fit.toml", "--json", cwd=tmp_path)
    assert result.returncode == 3, result.stderr
    label = "direction x = 400"
    assert f"vdmbench: failed: {label}: " in result.stderr
    entry = json.loads(result.stdout)["fit"]["vdm-vector"]
    # the first two loads train, those behind the one that failed do not
    text = STUDY.replace("training = 3", "training = 2").replace('"vdm-paper", ', "")
    (tmp_path / "two.toml").write_text(text.replace('"fit"', '"two"'))
    two = vdmbench("calibrate", "two.toml", "--json", cwd=tmp_path)
    assert two.returncode == 0, two.stderr
    other = json.loads(two.stdout)["two"]["vdm-vector"]
    for part in ("multiples", "training", "held_out"):
        found, expected = (list(e["fit"][part].values()) for e in (entry, other))
        assert_allclose(np.array(found, float), np.array(expected, float), rtol=1e-9, atol=0)


def side(known: Sequence[Sample], share: float) -> tuple[Sample, ...]:
    """Two loads whose reference is so many times the answer of the fitted model, with bars that differ."""
    bars = ({VECTOR: 0.1 * share, DEFORMATION: 0.4 * share}, {VECTOR: 0.3 * share, DEFORMATION: 0.2 * share})
    return tuple(
        dataclasses.replace(sample, reference=share * sample.reference, bars=bar)
        for sample, bar in zip(known, bars, strict=True)
    )


def assert_errors(found: Errors | None, share: float) -> None:
    """Of the fitted model against a reference `share` times its answer; of the bars the larger ones."""
    off = 1.0 - 1.0 / share
    expected = [off, off, 0.3 * share, 0.4 * share]
    # the rotation taken out is finite: change of shape goes with the load to first order only
    assert_allclose(dataclasses.astuple(found), expected, rtol=1e-4, atol=1e-4)
    assert_allclose(found.vector, off, rtol=1e-9, atol=1e-9)


def test_errors_are_those_on_the_held_out_loads_of_each_body(samples: list[Sample]) -> None:
    known = answered(samples, "vdm-vector", [1.3], ["surface_tension"])
    first, second = known[:2], known[2:]
    own = Body("own", ("vdm-vector",), side(first, 1.0), side(second, 2.0))
    other = Body("other", ("vdm-vector",), side(first, 8.0), side(second, 10.0))
    (entry,) = calibrate(own, [other])
    assert_allclose(entry.multiples["surface_tension"], 1.3, rtol=1e-9, atol=0)
    assert_errors(entry.training, 1.0)
    assert_errors(entry.held_out, 2.0)
    assert_allclose(entry.by_rule.vector, 1.0 - 1.3 / 2.0, rtol=1e-9, atol=0)
    assert_errors(entry.transfer["other"], 10.0)


def test_a_load_has_the_bars_of_both_measures(tmp_path: Path) -> None:
    text = STUDY.replace('["vdm-paper", "vdm-vector", "fem-linear"]', '["vdm-vector", "vdm-paper"]')
    run, plan = finished(text.replace('"fem-linear"', '"vdm-paper"'), tmp_path)
    measured = [
        dataclasses.replace(case, reference_error={f"gci:{VECTOR}": 0.01 * k, f"gci:{DEFORMATION}": 0.1 * k})
        for k, case in enumerate(run.cases)
    ]
    found = body(plan, dataclasses.replace(run, cases=measured))
    bars = [sample.bars for sample in (*found.training, *found.held_out)]
    assert bars == [{VECTOR: 0.01 * k, DEFORMATION: 0.1 * k} for k in range(4)]


DEPTH = 0.002  # of the movement [m]


def moved(samples: Sequence[Sample], *, force: float = 5.0) -> list[Sample]:
    """The loads with a region beside them moved in, and so many times their force."""
    out = []
    for sample in samples:
        scene = sample.scene
        points = scene.mesh.surface_points
        side = (np.linalg.norm(points - points[points[:, 1].argmax()], axis=1) < 0.012) & ~scene.fixed
        side &= ~scene.contact
        assert side.sum() >= 3, "a region of its own"
        prescribed = np.where(side[:, None], [0.0, -DEPTH, 0.0], 0.0)
        pressure = force * scene.facet_pressure
        scene = dataclasses.replace(scene, constrained=side, prescribed=prescribed, facet_pressure=pressure)
        out.append(dataclasses.replace(sample, scene=scene))
    return out


def loss(trial: Trial, multiples: np.ndarray) -> float:
    """Mean squared relative error, by hand."""
    return float(
        np.mean(
            [
                (s.scene.surface.areas @ ((u - s.reference) ** 2).sum(axis=1))
                / (s.scene.surface.areas @ (s.reference**2).sum(axis=1))
                for s, u in zip(trial.samples, trial.answers(multiples), strict=True)
            ]
        )
    )


@pytest.mark.parametrize(
    ("model", "asked", "multiples", "movement"),
    [
        ("bem", ["shear_modulus"], [0.4], False),
        ("vdm-paper", ["bulk_modulus", "connectivity_modulus"], [0.3, 2.5], False),
        ("vdm-paper", ["bulk_modulus", "connectivity_modulus"], [0.3, 2.5], True),
        ("vdm-vector", ["foundation", "surface_tension"], [0.5, 1.2], False),
        ("vdm-vector", ["surface_tension"], [20.0], True),
        ("vdm-vector:nonlinear", ["surface_tension"], [1.7], True),
    ],
)
def test_the_parameters_behind_an_answer_are_found(
    samples: list[Sample], model: str, asked: list[str], multiples: list[float], movement: bool
) -> None:
    loads = moved(samples[:2]) if movement else samples[:2]
    if "foundation" in asked:
        loads = with_foundation(loads)
    found = least_error(Trial(model, answered(loads, model, multiples, asked), asked))
    assert_allclose(found, multiples, rtol=1e-5, atol=0)


def with_foundation(samples: Sequence[Sample]) -> list[Sample]:
    """The loads on a foundation of 5e4 Pa/m that the study sets."""
    scenes = [dataclasses.replace(s.scene, parameters={"foundation": 5e4}) for s in samples]
    return [dataclasses.replace(s, scene=scene) for s, scene in zip(samples, scenes, strict=True)]


@pytest.mark.parametrize(("model", "movement"), [("vdm-vector", True), ("vdm-vector:nonlinear", False)])
def test_no_multiple_beside_the_fit_has_a_smaller_error(
    samples: list[Sample], model: str, movement: bool
) -> None:
    """Whatever the answer is of the modulus: also nonlinear, or beside one that the study sets."""
    loads = with_foundation(moved(samples[:2]) if movement else samples[:2])
    known = answered(loads, "bem", [1.0], ["shear_modulus"])  # which the vector form cannot match
    trial = Trial(model, known, ["surface_tension"])
    best = least_error(trial)
    assert loss(trial, best) < min(loss(trial, best * 1.003), loss(trial, best / 1.003))
    assert loss(trial, best) <= loss(trial, np.ones(1))


@pytest.mark.parametrize("model", ["vdm-vector", "bem"])
def test_a_modulus_stays_at_its_rule_where_all_loads_are_movements(samples: list[Sample], model: str) -> None:
    known = answered(moved(samples, force=0.0), "vdm-paper", [1.0], ["bulk_modulus"])
    assert_allclose(least_error(Trial(model, known)), 1.0, rtol=1e-5, atol=0)
