"""A sweep becomes cases with SI values, in order, each a valid study."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from numpy.testing import assert_allclose

from vdmbench.study.config import Study, case_inputs, expand, resolved

from .study_texts import SMALL, SWEPT, load, sweep_problems, swept


def test_without_a_sweep_there_is_one_case(tmp_path: Path) -> None:
    study = load(tmp_path, SWEPT)
    [case] = expand(study)
    assert (case.label, case.swept, case.swept_units) == ("", {}, {})
    assert resolved(case.study) == resolved(study)


def test_a_grid_is_every_combination_last_axis_fastest(tmp_path: Path) -> None:
    cases = swept(
        tmp_path,
        '"tissue.youngs_modulus" = ["2 kPa", 5000]\ngeometry.mesh_size = ["8 mm", "6 mm", 0.005]\n',
    )
    assert [case.label for case in cases] == [
        f"youngs_modulus = {e} Pa, mesh_size = {h} mm" for e in (2000, 5000) for h in (8, 6, 5)
    ]
    assert cases[1].swept == {"tissue.youngs_modulus": 2000.0, "geometry.mesh_size": 0.006}
    assert cases[1].swept_units == {"tissue.youngs_modulus": "Pa", "geometry.mesh_size": "m"}
    assert [case.study.tissue.youngs_modulus for case in cases] == [2000.0] * 3 + [5000.0] * 3
    assert [case.study.geometry.mesh_size for case in cases] == [0.008, 0.006, 0.005] * 2
    for case in cases:
        assert resolved(case.study)["sweep"] == {"mode": "grid"}
        assert resolved(Study.model_validate(json.loads(json.dumps(resolved(case.study))))) == resolved(
            case.study
        )


@pytest.mark.parametrize(
    ("key", "values", "unit", "read"),
    [
        ("constraints.finger.pressure", '["0.1 kPa", 300]', "Pa", lambda s: s.constraints[1].pressure),
        (
            "constraints.left.base.displacement.2",
            '["-1 mm", 0.002]',
            "m",
            lambda s: s.constraints[0].displacement[2],
        ),
        ("regions.tip.cap.angle", '["0.3 rad", 0.5]', "rad", lambda s: s.regions["tip"].cap.angle),
        ("geometry.semi_axes.1", '["45 mm", "44 mm"]', "m", lambda s: s.geometry.semi_axes[1]),
        ("vdm.rotation", '["none", "global"]', "1", lambda s: s.vdm.rotation),
        ("load.factors.0", "[0.5, 2]", "1", lambda s: s.load.factors[0]),
        ("uncertainty.levels", "[2, 3]", "1", lambda s: s.uncertainty.levels),
    ],
)
def test_any_value_of_a_study_can_be_swept(
    tmp_path: Path, key: str, values: str, unit: str, read: Callable[[Study], float | str]
) -> None:
    base = SWEPT.replace("[models", "[load]\nfactors = [1]\n[models")
    base = base.replace("[geometry]", 'reference = "vdm-vector:lu"\n[geometry]')  # which [uncertainty] is of
    cases = swept(tmp_path, f'"{key}" = {values}', base)
    assert len(cases) == 2
    for case in cases:
        assert read(case.study) == case.swept[key]
        assert case.swept_units == {key: unit}
    assert cases[0].swept != cases[1].swept
    assert case_inputs(cases[0].study) != case_inputs(cases[1].study)


def test_steps_lead_from_factor_to_factor(tmp_path: Path) -> None:
    cases = swept(tmp_path, '"load.steps" = [1, 2, 5]', SMALL + "[load]\nfactors = [1, -0.5]\n")
    histories = [case.study.load.history for case in cases]
    assert histories[0] == (1.0, -0.5)
    assert histories[1] == (0.5, 1.0, 0.25, -0.5)
    assert_allclose(histories[2], [0.2, 0.4, 0.6, 0.8, 1, 0.7, 0.4, 0.1, -0.2, -0.5], rtol=0, atol=1e-15)


def test_zip_goes_in_step_and_may_repeat_a_value(tmp_path: Path) -> None:
    cases = swept(
        tmp_path,
        'mode = "zip"\n"tissue.poisson_ratio" = [0.3, 0.3, 0.5]\n"constraints.finger.pressure" = [1, 2, 2]\n',
    )
    assert [tuple(case.swept.values()) for case in cases] == [(0.3, 1.0), (0.3, 2.0), (0.5, 2.0)]


def test_ranges_hit_their_ends_and_round_numbers(tmp_path: Path) -> None:
    def values(table: str) -> list[float | str]:
        return [
            c.swept["constraints.finger.pressure"]
            for c in swept(tmp_path, f"constraints.finger.pressure = {table}")
        ]

    assert values('{ start = "0.1 Pa", stop = 0.7, num = 7 }') == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]
    assert values('{ start = "50 Pa", stop = "800 Pa", num = 5, scale = "log" }') == [50, 100, 200, 400, 800]
    assert values("{ start = 3, stop = 1, num = 3 }") == [3, 2, 1]
    assert values("{ start = 3, stop = -1, num = 2 }") == [3, -1]
    assert_allclose(
        np.array(values('{ start = 1, stop = 1000, num = 13, scale = "log" }'), dtype=float),
        np.geomspace(1, 1000, 13),
        rtol=1e-11,  # values are rounded to 12 digits
        atol=0,
    )


STAR = (
    'mode = "one-at-a-time"\n"constraints.finger.pressure" = ["0.1 kPa", "0.2 kPa", 200.01]\n'
    '"vdm.penalty" = [1e2, 1e4]\n"models.vdm-paper.penalty" = [1e6, 1e8]\n'
)
LATIN = (
    'mode = "latin-hypercube"\nsamples = 16\nseed = 3\n"tissue.poisson_ratio" = { start = 0.3, stop = 0.5 }\n'
    '"constraints.finger.pressure" = { start = 1, stop = 10000, scale = "log" }\n'
)


def test_a_latin_hypercube_has_one_sample_in_each_slice_of_each_range(tmp_path: Path) -> None:
    cases = swept(tmp_path, LATIN)
    nu = np.array([case.swept["tissue.poisson_ratio"] for case in cases], dtype=float)
    pressure = np.array([case.swept["constraints.finger.pressure"] for case in cases], dtype=float)
    assert sorted(np.floor((nu - 0.3) / 0.2 * 16)) == list(range(16))
    assert sorted(np.floor(np.log10(pressure) / 4 * 16)) == list(range(16))


def test_a_latin_hypercube_depends_on_its_seed_and_not_on_the_order_of_the_axes(tmp_path: Path) -> None:
    def samples(text: str) -> set[frozenset[tuple[str, float | str]]]:
        return {frozenset(case.swept.items()) for case in swept(tmp_path, text)}

    *own, first, second = LATIN.splitlines()
    assert samples(LATIN) == samples("\n".join([*own, second, first]))
    assert samples(LATIN) != samples(LATIN.replace("seed = 3", "seed = 4"))


@pytest.mark.parametrize("ends", ["start = -1, stop = 0.4", "start = 0.4, stop = -1"])
@pytest.mark.parametrize("own", ["", "poisson_ratio = 0.45\n"])
def test_the_ends_of_a_latin_hypercube_are_no_samples(tmp_path: Path, ends: str, own: str) -> None:
    """No material has a Poisson ratio of -1."""
    sweep = f'mode = "latin-hypercube"\nsamples = 3\ntissue.poisson_ratio = {{ {ends} }}\n'
    assert len(swept(tmp_path, sweep, SWEPT.replace("poisson_ratio = 0.45\n", own))) == 3


@pytest.mark.parametrize(
    "sweep",
    [
        'tissue.poisson_ratio = [0.3, 0.4]\n"constraints.finger.pressure" = { start = 1, stop = "1 kPa", num = 2 }',
        'mode = "zip"\n"tissue.poisson_ratio" = [0.3, 0.4]\n"vdm.rotation" = ["none", "global"]',
        STAR,
        LATIN,
    ],
)
def test_the_resolved_study_is_a_study_file_of_the_same_cases(tmp_path: Path, sweep: str) -> None:
    study = load(tmp_path, f"{SWEPT}[sweep]\n{sweep}")
    again = load(tmp_path, tomli_w.dumps(resolved(study)))
    assert resolved(again) == resolved(study)

    def inputs(one: Study) -> list[str]:
        return sorted(json.dumps(case_inputs(case.study)) for case in expand(one))

    assert inputs(again) == inputs(study)


def test_a_key_may_be_left_to_the_sweep(tmp_path: Path) -> None:
    base = SWEPT.replace("poisson_ratio = 0.45\n", "").replace("pressure = 200\n", "")
    sweep = 'tissue.poisson_ratio = [0.3, 0.4]\nconstraints.finger.force = ["1 N"]\n'
    cases = swept(tmp_path, sweep, base)
    assert [case.study.tissue.poisson_ratio for case in cases] == [0.3, 0.4]
    assert [case.study.constraints[1].force for case in cases] == [1.0, 1.0]
    [(where, message)] = sweep_problems(tmp_path, sweep.replace("0.3", "0.7"), base)
    assert where == "0: sweep.tissue.poisson_ratio"
    assert "at most 0.5" in message


def test_files_can_be_swept(tmp_path: Path) -> None:
    base = SWEPT.replace('shape = "ellipsoid"\nsemi_axes = [0.05, 0.04, 0.03]', 'shape = "file"\nsize = 0.1')
    for name in ("a.stl", "b.obj"):
        (tmp_path / name).write_text("")
    cases = swept(tmp_path, 'geometry.path = ["a.stl", "b.obj"]', base)
    assert [case.label for case in cases] == ["path = a.stl", "path = b.obj"]
    assert [case.study.geometry.path for case in cases] == [tmp_path / "a.stl", tmp_path / "b.obj"]
    [(where, message)] = sweep_problems(
        tmp_path, 'geometry.path = ["a.stl", "none.obj", "/etc/passwd"]', base
    )
    assert where == "0: sweep.geometry.path"
    assert '"none.obj" does not exist' in message
    assert "1 more cases" in message


def test_a_model_of_the_study_needs_no_table_of_its_own(tmp_path: Path) -> None:
    assert "vdm-vector:lu" not in load(tmp_path, SWEPT).models
    cases = swept(tmp_path, '"models.vdm-vector:lu.foundation" = [1.0, 2.0]\n')
    assert [case.study.models["vdm-vector:lu"].foundation for case in cases] == [1.0, 2.0]


def test_labels_tell_lengths_as_the_page_does(tmp_path: Path) -> None:
    cases = swept(tmp_path, 'geometry.mesh_size = ["12 mm", 0.0123]\n')
    assert [case.label for case in cases] == ["mesh_size = 12 mm", "mesh_size = 12.3 mm"]
    assert [case.study.geometry.mesh_size for case in cases] == [0.012, 0.0123]


def test_one_at_a_time_is_a_base_and_each_axis_alone(tmp_path: Path) -> None:
    cases = swept(tmp_path, STAR)
    pressure, penalty = "constraints.finger.pressure", "models.vdm-paper.penalty"
    base = {pressure: 200.0, penalty: 1e6}
    assert [(case.label, case.swept) for case in cases] == [
        ("base", base),
        ("pressure = 100 Pa", {**base, pressure: 100.0}),
        ("pressure = 200.01 Pa", {**base, pressure: 200.01}),
        ("vdm.penalty = 100", {**base, "vdm.penalty": 100.0}),
        ("vdm.penalty = 10000", {**base, "vdm.penalty": 10000.0}),
        ("models.vdm-paper.penalty = 1e+08", {**base, penalty: 1e8}),
    ]
    assert [case.study.vdm.penalty for case in cases] == [None, None, None, 100.0, 10000.0, None]
    assert [case.study.models["vdm-paper"].penalty for case in cases] == [1e6] * 5 + [1e8]
    assert [case.study.constraints[1].pressure for case in cases] == [200, 100, 200.01, 200, 200, 200]
    assert cases[0].swept_units[pressure] == "Pa"


def test_one_at_a_time_needs_a_base_that_is_sound(tmp_path: Path) -> None:
    base = SWEPT.replace("poisson_ratio = 0.45\n", "")
    sweep = 'mode = "one-at-a-time"\ntissue.poisson_ratio = [0.3, 0.4]\n'
    [(_, message)] = sweep_problems(tmp_path, sweep, base)
    assert "missing" in message
