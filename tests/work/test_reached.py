"""A reference that fails on the way to a load: what it reached is compared, and is never taken for the load."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from solver_common.substeps import LEAST_STEP
from tests.command import vdmbench, write_study
from vdmbench.body.geometry import build_mesh
from vdmbench.body.refine import Hierarchy
from vdmbench.measures.case import CaseResult
from vdmbench.models.model import Prepared, run_model
from vdmbench.report.headline import summary
from vdmbench.scene.scene import build_scene
from vdmbench.store.cases import read_run
from vdmbench.study.config import load_study
from vdmbench.verdict.digest import digest_of
from vdmbench.work.keys import Wanted
from vdmbench.work.reached import at_what_was_reached

SOFT = """
[study]
name = "soft"
title = "A soft block under its weight and a plate"
models = ["vdm-vector", "fem"]
reference = "fem"
[geometry]
shape = "box"
size = ["60 mm", "60 mm", "60 mm"]
mesh_size = "30 mm"
[tissue]
youngs_modulus = "1 kPa"
poisson_ratio = 0.4999
density = "1060 kg/m^3"
[regions.bottom]
below = { axis = "z", fraction = 0.05 }
[regions.top]
above = { axis = "z", fraction = 0.95 }
[[constraints]]
kind = "fixed"
region = "bottom"
[[constraints]]
kind = "contact"
region = "top"
pressure = "800 Pa"
[gravity]
acceleration = [0, 0, GRAVITY]
[load]
factors = FACTORS
"""


def _written(folder: Path, factors: list[float], levels: int = 1, weight: float = 1.0) -> Path:
    text = SOFT + (f"[uncertainty]\nlevels = {levels}\n" if levels > 1 else "")
    for name, value in {"FACTORS": factors, "GRAVITY": -9.81 * weight}.items():
        text = text.replace(name, str(value))
    (folder / "soft.toml").write_text(text)
    return folder / "soft.toml"


def _run(folder: Path, factors: list[float], levels: int, weight: float = 1.0, code: int = 0) -> CaseResult:
    folder.mkdir()
    _written(folder, factors, levels, weight)
    result = vdmbench("run", "soft.toml", "--out", "out", "--cache", folder / "cache", cwd=folder)
    assert result.returncode == code, result.stdout + result.stderr
    (case,) = read_run(folder / "out").cases
    return case


@pytest.mark.parametrize(("before", "levels"), [pytest.param([], 2, marks=pytest.mark.slow), ([0.1], 1)])
def test_the_load_that_was_reached_is_compared_and_is_not_the_full_load(
    tmp_path: Path, before: list[float], levels: int
) -> None:
    case = _run(tmp_path / "whole", [*before, 1.0], levels, code=3)
    *kept, reached, full = case.load_factors.tolist()
    assert kept == before
    assert full == 1.0
    assert case.full_load == len(before) + 1
    assert case.reached == len(before)
    for name in {"fem", str(case.reference)}:
        status = case.models[name].status
        assert [one.ok for one in status] == [*(True for _ in before), True, False]
        if levels == 1:  # the state that it ended in is its answer
            start = sum(before)
            assert f"beyond {(reached - start) / (1.0 - start):.4g} of load step" in status[-1].message
    assert case.models["vdm-vector"].status[-1].ok
    errors = case.metrics["vdm-vector"]["relative_l2_displacement_error"]
    assert np.isnan(errors[-1])

    # the same load by itself; to the first step the weight grows as well
    alone = _run(tmp_path / "part", [*before, reached], levels, weight=1.0 if before else reached)
    for name, metrics in alone.metrics.items():
        for metric, series in metrics.items():
            found = case.metrics[name][metric]
            assert_allclose(found[: len(before)], series[:-1], rtol=1e-6, atol=1e-9, err_msg=metric)
            if np.isfinite(found[-2]):  # distances are of the full load
                assert_allclose(found[-2], series[-1], rtol=1e-6, atol=1e-9, err_msg=metric)
    own = "relative_l2"
    assert (own in alone.reference_error) == (levels > 1)
    for key, value in alone.reference_error.items():
        if "distance" not in key:
            assert_allclose(case.reference_error[key], value, rtol=1e-4, atol=1e-9, err_msg=key)

    told = summary(read_run(tmp_path / "whole" / "out"))
    assert {verdict["word"] for verdict in told["verdicts"].values()} == {"not judged"}
    assert told["judgement"]["unreached"][0]["share"] == reached
    page = (tmp_path / "whole" / "out" / "report.html").read_text()
    assert f"at {reached:.3g}" in page


def test_boundary_elements_and_their_reference_are_compared_where_either_ends(tmp_path: Path) -> None:
    study = load_study(_written(tmp_path, [0.1, 1.0], weight=0.7))
    mesh = build_mesh(study.geometry)
    scene, names = build_scene(study, mesh), ("bem:nonlinear", "fem")
    wanted = [Wanted(name, 0, "", (), ()) for name in names]
    found = [(want, Prepared(scene, want.name, 2).answer(scene.loads, ends=True)) for want in wanted]
    places, merged = at_what_was_reached(study, scene, found, lambda _: Hierarchy((mesh,)))
    first, boundary, reference, last = places.tolist()
    assert (first, last) == (1.0, 2.0)
    assert 1.0 < boundary < reference < 2.0
    assert [1.0 + result.scalars["load_factor"][1] for _, result in found] == [boundary, reference]
    answered = {want.name: [status.ok for status in result.status] for want, result in merged}
    assert answered == {"bem:nonlinear": [True, True, False, False], "fem": [True, True, True, False]}
    for place, end in ((1, boundary), (2, reference)):
        (factor,) = scene.factors_at(np.array([end]))
        way = build_scene(load_study(_written(tmp_path, [0.1, float(factor)], weight=0.7)), mesh)
        for name, (_, result) in zip(names, merged, strict=True):
            if answered[name][place]:
                alone = run_model(way, name).displacement[1]
                largest = np.abs(alone).max()
                assert_allclose(result.displacement[place], alone, rtol=0, atol=1e-6 * largest, err_msg=name)


def test_a_body_in_parts_ends_at_its_limit_point_by_whatever_steps(tmp_path: Path) -> None:
    """Corrections find balances beyond it too, which are not stable."""
    ends = []
    for factors in ([0.1, 1.0], [0.1, 0.2, 0.3, 1.0]):
        study = load_study(_written(tmp_path, factors, weight=0.7))
        scene = build_scene(study, build_mesh(study.geometry))
        found = Prepared(scene, "bem:nonlinear", len(factors)).answer(scene.loads, ends=True)
        assert [status.ok for status in found.status] == [*(True for _ in factors[1:]), False]
        assert "of its least stiffness without forces" in found.status[-1].message
        ends.append(np.interp(found.scalars["load_factor"][-1], [0.0, 1.0], factors[-2:]))
    assert ends[0] == pytest.approx(ends[1], abs=2.0 * LEAST_STEP)


def test_a_case_that_no_model_answers_to_its_full_load_is_not_all_done(tmp_path: Path) -> None:
    text = _written(tmp_path, [1.0]).read_text()
    text = text.replace('"vdm-vector", "fem"', '"bem:nonlinear"').replace('reference = "fem"', "")
    (tmp_path / "soft.toml").write_text(text)
    result = vdmbench("run", "soft.toml", "--out", "out", "--cache", tmp_path / "cache", cwd=tmp_path)
    assert result.returncode == 3, result.stdout + result.stderr
    assert "the nonlinear balance was not found beyond 0." in result.stdout.replace("\n  ", " ")
    assert vdmbench("report", "out", cwd=tmp_path).returncode == 3


def test_a_reference_without_any_answer_stops_alone(tmp_path: Path) -> None:
    write_study(tmp_path, small=('"0.1 N"', '"1e-18 N"'), coarse=('"16 mm"', '"30 mm"'),
                finite=("fem-linear", "fem"), levels=("[load]", "[uncertainty]\nlevels = 2\n[load]"))  # fmt: skip
    result = vdmbench("run", "small.toml", "--out", "out", "--cache", tmp_path / "cache", cwd=tmp_path)
    assert result.returncode == 3, result.stderr
    run = read_run(tmp_path / "out")
    (case,) = run.cases
    assert (case.reference, case.reached, case.reference_error) == ("fem refined", -1, {})
    why = "rounding of its coordinates"
    assert why in case.models["fem refined"].status[0].message
    assert np.isfinite(case.models["vdm-paper"].displacement).all()
    assert np.isnan(case.metrics["vdm-paper"]["relative_l2_displacement_error"]).all()
    told = summary(run)
    assert {verdict["word"] for verdict in told["verdicts"].values()} == {"not judged"}
    assert told["judgement"]["unreached"][0]["share"] == 0.0
    assert "vdm-paper" not in {one["model"] for one in told["stopped"]}
    assert digest_of(run).focus == "vdm-paper"
    assert why in (tmp_path / "out" / "report.html").read_text()


def test_a_refined_reference_without_an_answer_leaves_that_of_the_mesh(tmp_path: Path) -> None:
    study = load_study(_written(tmp_path, [1.0], weight=0.1))
    mesh = build_mesh(study.geometry)
    scene = build_scene(study, mesh)
    nothing_held = dataclasses.replace(scene, fixed=np.zeros_like(scene.fixed))
    answer, refused = run_model(scene, "fem"), run_model(nothing_held, "fem")
    found = [(Wanted("fem", level, "", (), ()), one) for level, one in enumerate((answer, refused))]
    places, merged = at_what_was_reached(study, scene, found, lambda _: Hierarchy((mesh,)))
    assert places.tolist() == [1.0]
    assert [result.status for _, result in merged] == [answer.status, refused.status]
    assert not refused.status[0].ok
    assert_allclose(merged[0][1].displacement, answer.displacement)
