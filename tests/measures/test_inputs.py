"""How well inputs are known: read from a study, varied as parts of its graph, and what comes of it."""

import copy
import dataclasses
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.command import SMALL_STUDY, vdmbench
from tests.report.runs import make_case, make_run
from tests.work.shared_work import ONE_LOAD, cache, meshes, plan_of, planned_work, run, scene_of
from vdmbench import models
from vdmbench.body.surface_measures import Surface, weighted_norm
from vdmbench.measures.measurement import InputSpread, ModelSpread, hold_against
from vdmbench.measures.pushed import Answer
from vdmbench.report.section_measurement import inputs
from vdmbench.study.config import Study, load_study, resolved
from vdmbench.study.sweep import inputs_of
from vdmbench.verdict.digest import Digest
from vdmbench.work.plan import Plan

from .test_measured import GOOD, STUDY, ball, load

__all__ = ["cache", "meshes"]

E, NU, FORCE = "tissue.youngs_modulus", "tissue.poisson_ratio", "constraints.finger.force"
BASE = "regions.base.below.fraction"
KNOWN: dict[str, Any] = {E: {"sd": 500.0}, NU: {"range": [0.45, 0.49]}, FORCE: {"sd": 0.002}}


def plan(directory: Path, cache: Path, inputs: Any = KNOWN, **changes: Any) -> Plan:
    return plan_of(directory / "run", cache, tables=ONE_LOAD, inputs=copy.deepcopy(inputs), **changes)


def study_of(inputs: Any, **changes: Any) -> Study:
    return Study.model_validate(copy.deepcopy(ONE_LOAD) | {"inputs": inputs, **changes})


# --- what a study says ---


def test_deviations_are_read_in_their_units_and_kept_in_si() -> None:
    study = study_of({"tissue": {"youngs_modulus": {"sd": "0.3 kPa"}}, NU: {"range": [0.45, 0.4999]}})
    of_ratio, of_modulus = inputs_of(study)
    assert (of_modulus.key, of_modulus.unit, of_modulus.deviation) == (E, "Pa", 300.0)
    assert of_modulus.ends == (4700.0, 5300.0)
    assert_allclose(of_ratio.deviation, 0.0499 / np.sqrt(12), rtol=1e-12)
    assert resolved(study)["inputs"] == {
        NU: {"range": [0.45, 0.4999]},
        E: {"sd": 300.0},
    }
    again = Study.model_validate(resolved(study))
    assert inputs_of(again) == inputs_of(study)


def test_check_puts_each_place_of_a_region_on_the_mesh(tmp_path: Path) -> None:
    text = SMALL_STUDY.replace('"hertz"', '"uniform"') + "[inputs]\ntissue.youngs_modulus = { sd = 300 }\n"
    text += '"regions.finger.cap.angle" = { range = ["0.1 deg", "35 deg"] }\n'
    (tmp_path / "small.toml").write_text(text)
    result = vdmbench("check", "small.toml", cwd=tmp_path)
    assert result.returncode == 2
    (line,) = result.stderr.strip().splitlines()
    assert "contact 'finger' loads no facet" in line or "selects no node" in line
    assert "(in the case regions.finger.cap.angle = 0.00174533)" in line


# --- what is computed ---


def test_sensitivities_by_hand(tmp_path: Path, cache: Path) -> None:
    """Half of 1/0.9 less 1/1.1 for the modulus, its own share for the force, two solves for the others."""
    planned = plan(tmp_path, cache)
    assert planned_work(planned, "fem-linear") == {"set-ups": 4, "solves": 4}, "a force comes free"
    assert planned_work(planned, "vdm-vector") == {"set-ups": 3, "solves": 3}, "it reads no Poisson ratio"
    (case,) = run(planned)
    scene = scene_of(planned, planned.cases[0])
    own, other = (
        models.run_model(dataclasses.replace(scene, tissue=tissue), "fem-linear").displacement[0]
        for tissue in (scene.tissue, scene.tissue.model_copy(update={"poisson_ratio": 0.45}))
    )
    areas = Surface(case.points, case.triangles).areas
    by_ratio = weighted_norm(own - other, areas) / np.sqrt(12) / weighted_norm(own, areas)
    expected = np.array([0.002 / 0.1, by_ratio, (1 / 0.9 - 1 / 1.1) / 2])
    found = case.inputs
    assert found.keys == [FORCE, NU, E]
    assert_allclose(found.models["fem-linear"].parts, expected, rtol=1e-5)
    assert_allclose(found.models["vdm-vector"].parts, expected * [1, 0, 1], rtol=1e-9)
    assert_allclose(found.models["fem-linear"].displacement, np.linalg.norm(expected), rtol=1e-5)
    # of the three the modulus bends: the mean of 1/0.9 and 1/1.1 is 1.0101
    assert_allclose(found.models["vdm-vector"].bend, 0.010101 / np.linalg.norm(expected[[0, 2]]), rtol=1e-4)


def test_the_refined_reference_has_the_spread_of_its_own_mesh(tmp_path: Path, cache: Path) -> None:
    inputs = {FORCE: {"sd": 0.002}}
    (case,) = run(plan(tmp_path, cache, inputs, uncertainty={"levels": 2}, load={"factors": [0.5, 1.0]}))
    # the norm of the coarse mesh's slope over that of the refined answer
    coarse, fine = (case.models[name].displacement[1] for name in ("fem-linear", "fem-linear refined"))
    areas = Surface(case.points, case.triangles).areas
    share = 0.02 * weighted_norm(coarse, areas) / weighted_norm(fine, areas)
    assert_allclose(case.inputs.models["fem-linear refined"].displacement, share, rtol=1e-9)
    # as much as that of its own mesh: what a finer mesh changes is no bend of the answer
    bends = [case.inputs.models[name].bend for name in ("fem-linear", "fem-linear refined")]
    assert_allclose(bends[1], bends[0], rtol=1e-9)


# --- what is made of it ---


def test_u_input_joins_the_validation_uncertainty(tmp_path: Path) -> None:
    """Of S = 2.05 mm at 5 % in the modulus, 0.1025 mm and more join u_D = 0.1 and 0.2 mm."""
    study = load(tmp_path, GOOD, STUDY + '[inputs]\n"tissue.youngs_modulus" = { sd = 250 }\n')
    field = np.zeros((2, 162, 3))
    field[:, :, 2] = -2.05e-3
    fields = [Answer(field * 1.05), Answer(field * 0.95)]
    found = hold_against(
        study, ball(), {"a": Answer(field), "b": Answer(field)}, varied={"a": lambda: fields}
    )
    u_input = 0.05 * 2.05e-3
    assert_allclose(found.inputs["a"], [u_input, 0.0, u_input], rtol=1e-9, atol=1e-15)
    assert_allclose(found.uncertainty("a"), np.hypot([1e-4, 2e-4, 2e-4], [u_input, 0, u_input]), rtol=1e-9)
    assert_allclose(found.uncertainty("b"), [1e-4, 2e-4, 2e-4], rtol=1e-12)


def known(displacement: float, bend: float = 0.0) -> InputSpread:
    parts = displacement * np.array([0.99, 0.05])
    spread = ModelSpread(displacement, displacement, parts, bend)
    return InputSpread(
        [E, NU],
        ["Pa", "1"],
        np.array([5e3, 0.45]),
        np.array([300.0, 0.01]),
        {"fem-linear": spread},
    )


@pytest.mark.parametrize(("spread", "lost"), [(0.05, False), (0.2, True)])
def test_the_table_says_where_the_error_is_below_what_is_not_known(spread: float, lost: bool) -> None:
    case = dataclasses.replace(make_case({"fem-linear": 0.1}, reference="fem"), inputs=known(spread))
    section = inputs(Digest(make_run([case])))
    table = section.blocks[0]
    assert (table.rows[0][-1].detail == "below what is not known") == lost


def test_a_region_that_moves_no_node_is_named_whatever_rounding_leaves() -> None:
    """Answers solved side by side differ in the last digit."""
    case = make_case({"fem-linear": 0.1}, reference="fem")
    for key, part, told in ((BASE, 2.8e-15, True), (BASE, 0.01, False), (E, 0.0, False)):
        spread = {"fem-linear": ModelSpread(0.1, 0.1, np.array([part]), 0.0)}
        found = InputSpread([key], ["1"], np.array([0.2]), np.array([0.02]), spread)
        _, said = inputs(Digest(make_run([dataclasses.replace(case, inputs=found)]))).blocks
        assert (f"{key} moves none of this mesh" in said.text) == told


def test_the_commented_table_of_a_new_study_is_right(tmp_path: Path) -> None:
    lines = resources.files("vdmbench.cli").joinpath("new_study.toml").read_text().splitlines()
    start = lines.index("# [inputs]")
    table = [line.removeprefix("# ") for line in lines[start : lines.index("", start)]]
    text = "\n".join([*lines[:start], *table, *lines[start + len(table) :]])
    (tmp_path / "new.toml").write_text(text)
    study = load_study(tmp_path / "new.toml")
    assert [one.key for one in inputs_of(study)] == [FORCE, E]
