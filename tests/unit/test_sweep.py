"""A sweep becomes cases with SI values, in order, each a valid study."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from numpy.testing import assert_allclose

from studies.config import ResolvedCase, Study, StudyError, case_inputs, expand, load_study, resolved

BASE = """\
[study]
name = "swept"
models = ["vdm-paper"]
[geometry]
shape = "ellipsoid"
semi_axes = [0.05, 0.04, 0.03]
mesh_size = 0.006
[tissue]
youngs_modulus = 5e3
poisson_ratio = 0.45
[models."vdm-paper"]
penalty = 1e6
[regions."left.base"]
below = { axis = "z", fraction = 0.15 }
[regions.tip]
cap = { direction = [0, 0, 1], angle = 0.4 }
[[constraints]]
kind = "constrained"
region = "left.base"
displacement = [0, 0, 0]
[[constraints]]
name = "finger"
kind = "contact"
region = "tip"
pressure = 200
"""


def load(directory: Path, text: str) -> Study:
    path = directory / "study.toml"
    path.write_text(text, encoding="utf-8")
    return load_study(path)


def swept(directory: Path, sweep: str, base: str = BASE) -> list[ResolvedCase]:
    return expand(load(directory, f"{base}[sweep]\n{sweep}"))


def problems(directory: Path, sweep: str, base: str = BASE) -> list[tuple[str, str]]:
    with pytest.raises(StudyError) as caught:
        swept(directory, sweep, base)
    first = base.count("\n") + 2  # the line after [sweep]
    return [(f"{p.line - first}: {p.key}", p.message) for p in caught.value.problems]


def test_without_a_sweep_there_is_one_case(tmp_path: Path) -> None:
    study = load(tmp_path, BASE)
    [case] = expand(study)
    assert (case.label, case.swept, case.swept_units) == ("", {}, {})
    assert resolved(case.study) == resolved(study)


def test_a_grid_is_every_combination_last_axis_fastest(tmp_path: Path) -> None:
    cases = swept(
        tmp_path,
        '"tissue.youngs_modulus" = ["2 kPa", 5000]\ngeometry.mesh_size = ["8 mm", "6 mm", 0.005]\n',
    )
    assert [case.label for case in cases] == [
        f"youngs_modulus = {e} Pa, mesh_size = {h} m" for e in (2000, 5000) for h in (0.008, 0.006, 0.005)
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
        (
            "regions.left.base.below.fraction",
            "[0.1, 0.2]",
            "1",
            lambda s: s.regions["left.base"].below.fraction,
        ),
        ("regions.tip.cap.angle", '["0.3 rad", 0.5]', "rad", lambda s: s.regions["tip"].cap.angle),
        ("regions.tip.cap.direction.0", "[0.5, 1]", "1", lambda s: s.regions["tip"].cap.direction[0]),
        ("geometry.semi_axes.1", '["45 mm", "44 mm"]', "m", lambda s: s.geometry.semi_axes[1]),
        ("vdm.bulk_modulus", '[0, "1 kPa"]', "Pa", lambda s: s.vdm.bulk_modulus),
        ("vdm.rotation", '["none", "nodal"]', "1", lambda s: s.vdm.rotation),
        ("environment.pressure", "[1, 2]", "Pa", lambda s: s.environment.pressure),
        ("load.factors.0", "[0.5, 2]", "1", lambda s: s.load.factors[0]),
        ("uncertainty.levels", "[2, 3]", "1", lambda s: s.uncertainty.levels),
    ],
)
def test_any_value_of_a_study_can_be_swept(
    tmp_path: Path, key: str, values: str, unit: str, read: Callable[[Study], float | str]
) -> None:
    base = BASE.replace("[models", "[load]\nfactors = [1]\n[models")
    cases = swept(tmp_path, f'"{key}" = {values}', base)
    assert len(cases) == 2
    for case in cases:
        assert read(case.study) == case.swept[key]
        assert case.swept_units == {key: unit}
    assert cases[0].swept != cases[1].swept
    assert case_inputs(cases[0].study) != case_inputs(cases[1].study)


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


@pytest.mark.parametrize(
    "sweep",
    [
        '"tissue.poisson_ratio" = [0.3, 0.4]\n"constraints.finger.pressure" = { start = 1, stop = "1 kPa", num = 2 }',
        'mode = "zip"\n"tissue.poisson_ratio" = [0.3, 0.4]\n"vdm.rotation" = ["none", "global"]',
        LATIN,
    ],
)
def test_the_resolved_study_is_a_study_file_of_the_same_cases(tmp_path: Path, sweep: str) -> None:
    study = load(tmp_path, f"{BASE}[sweep]\n{sweep}")
    again = load(tmp_path, tomli_w.dumps(resolved(study)))
    assert resolved(again) == resolved(study)

    def inputs(one: Study) -> list[str]:
        return sorted(json.dumps(case_inputs(case.study)) for case in expand(one))

    assert inputs(again) == inputs(study)


def test_a_key_may_be_left_to_the_sweep(tmp_path: Path) -> None:
    base = BASE.replace("poisson_ratio = 0.45\n", "").replace("pressure = 200\n", "")
    sweep = 'tissue.poisson_ratio = [0.3, 0.4]\nconstraints.finger.force = ["1 N"]\n'
    cases = swept(tmp_path, sweep, base)
    assert [case.study.tissue.poisson_ratio for case in cases] == [0.3, 0.4]
    assert [case.study.constraints[1].force for case in cases] == [1.0, 1.0]


def test_files_can_be_swept(tmp_path: Path) -> None:
    base = BASE.replace('shape = "ellipsoid"\nsemi_axes = [0.05, 0.04, 0.03]', 'shape = "file"\nsize = 0.1')
    for name in ("a.stl", "b.obj"):
        (tmp_path / name).write_text("")
    cases = swept(tmp_path, 'geometry.path = ["a.stl", "b.obj"]', base)
    assert [case.label for case in cases] == ["path = a.stl", "path = b.obj"]
    assert [case.study.geometry.path for case in cases] == [tmp_path / "a.stl", tmp_path / "b.obj"]
    [(where, message)] = problems(tmp_path, 'geometry.path = ["a.stl", "none.obj", "/etc/passwd"]', base)
    assert where == "0: sweep.geometry.path"
    assert '"none.obj" does not exist' in message
    assert "1 more cases" in message


WRONG = {
    "unknown key": ('"tissue.poison_ratio" = [1]', '0: sweep."tissue.poison_ratio"', 'mean "tissue.poisson_ratio"?'),
    "dotted unknown": ("tissue.poison_ratio = [1]", "0: sweep.tissue.poison_ratio", 'mean "tissue.poisson_ratio"?'),
    "constraint unknown": ('"constraints.fingr.pressure" = [1]', '0: sweep."constraints.fingr.pressure"', "did you mean"),
    "misspelt mode": ("mod = 'zip'", "0: sweep.mod", "unknown key"),
    "wrong mode": ("mode = 'zap'", "0: sweep.mode", 'did you mean "zip"?'),
    "name": ('"study.name" = ["a"]', '0: sweep."study.name"', "unknown key"),
    "whole vector": ('"geometry.semi_axes" = [[1, 2, 3]]', '0: sweep."geometry.semi_axes"', "unknown key"),
    "beyond a vector": ('"geometry.semi_axes.3" = [1]', '0: sweep."geometry.semi_axes.3"', "unknown key"),
    "table": ('"tissue" = [1]', "0: sweep.tissue", "unknown key"),
    "empty": ('"tissue.poisson_ratio" = []', '0: sweep."tissue.poisson_ratio"', "has no values"),
    "scalar": ('"tissue.poisson_ratio" = 0.3', '0: sweep."tissue.poisson_ratio"', "must be a list of values"),
    "repeated": ('"tissue.poisson_ratio" = [0.3, 0.4, 3e-1]', '0: sweep."tissue.poisson_ratio"', "0.3 is listed 2 times"),
    "repeated in another unit": ('"geometry.mesh_size" = ["5 mm", 0.005]', '0: sweep."geometry.mesh_size"', "2 times"),
    "twice": ('"tissue.poisson_ratio" = [0.3]\ntissue.poisson_ratio = [0.4]', "1: sweep.tissue.poisson_ratio", "swept twice"),
    "unit": ('"tissue.youngs_modulus" = [\n1000,\n"5 mm"]', '2: sweep."tissue.youngs_modulus"[1]', "not a unit of"),
    "bool": ('"tissue.youngs_modulus" = [true]', '0: sweep."tissue.youngs_modulus"[0]', "not true or false"),
    "nan": ('"tissue.youngs_modulus" = [nan]', '0: sweep."tissue.youngs_modulus"[0]', "finite"),
    "bool for a choice": ('"vdm.rotation" = [true]', '0: sweep."vdm.rotation"[0]', "not true or false"),
    "list for a choice": ('"vdm.rotation" = [["none"]]', '0: sweep."vdm.rotation"[0]', "not a list"),
    "unknown choice": ('"vdm.rotation" = ["global", "noddle"]', '0: sweep."vdm.rotation"', 'did you mean "nodal"?'),
    "out of range": ('"tissue.poisson_ratio" = [0.3, 0.6]', '0: sweep."tissue.poisson_ratio"', "at most 0.5"),
    "wrong in a combination": ('"tissue.youngs_modulus" = [19, 20, 2e3]', "-2: constraints.finger.pressure", "(in the case youngs_modulus = 19 Pa)"),
    "range of a choice": ('"vdm.rotation" = { start = 1, stop = 2, num = 2 }', '0: sweep."vdm.rotation"', "list its values"),
    "range without num": ('"tissue.poisson_ratio" = { start = 0, stop = 0.1 }', '0: sweep."tissue.poisson_ratio".num', "whole number from 2"),
    "num of one": ('"tissue.poisson_ratio" = { start = 0, stop = 0.1, num = 1 }', '0: sweep."tissue.poisson_ratio".num', "whole number from 2"),
    "num as bool": ('"tissue.poisson_ratio" = { start = 0, stop = 0.1, num = true }', '0: sweep."tissue.poisson_ratio".num', "whole number from 2"),
    "range without stop": ('"tissue.poisson_ratio" = { start = 0, num = 3 }', '0: sweep."tissue.poisson_ratio"', "stop is missing"),
    "range of nothing": ('"tissue.poisson_ratio" = { start = 0, stop = 0, num = 3 }', '0: sweep."tissue.poisson_ratio"', "the same value"),
    "range key": ('"tissue.poisson_ratio" = { start = 0, stop = 0.1, nun = 3 }', '0: sweep."tissue.poisson_ratio".nun', 'did you mean "num"?'),
    "range scale": ('"tissue.poisson_ratio" = { start = 0, stop = 0.1, num = 3, scale = "lin" }', '0: sweep."tissue.poisson_ratio".scale', "linear or log"),
    "log through zero": ('"tissue.poisson_ratio" = { start = 0, stop = 0.1, num = 3, scale = "log" }', '0: sweep."tissue.poisson_ratio"', "positive start"),
    "range too wide": ('"constraints.finger.pressure" = { start = -1e308, stop = 1e308, num = 3 }', '0: sweep."constraints.finger.pressure"', "too far apart"),
    "zip of unequal": ('mode = "zip"\n"tissue.poisson_ratio" = [0.3]\n"vdm.penalty" = [1, 2]', "-1: sweep", "tissue.poisson_ratio has 1, vdm.penalty has 2"),
    "zip with a repetition": ('mode = "zip"\n"tissue.poisson_ratio" = [0.3, 0.3]\n"vdm.penalty" = [1, 1]', "-1: sweep", "more than once"),
    "samples of a grid": ("samples = 3", "0: sweep.samples", 'only mode = "latin-hypercube"'),
    "latin without samples": ('mode = "latin-hypercube"\n"vdm.penalty" = { start = 1, stop = 2 }', "-1: sweep.samples", "is missing"),
    "latin of a list": ('mode = "latin-hypercube"\nsamples = 2\n"vdm.penalty" = [1, 2]', '2: sweep."vdm.penalty"', "samples ranges"),
    "latin with num": ('mode = "latin-hypercube"\nsamples = 2\n"vdm.penalty" = { start = 1, stop = 2, num = 2 }', '2: sweep."vdm.penalty".num', "leave num out"),
    "latin of nothing": ('mode = "latin-hypercube"\nsamples = 2', "0: sweep.mode", "no axis"),
    "samples as text": ('mode = "latin-hypercube"\nsamples = "2"\n"vdm.penalty" = { start = 1, stop = 2 }', "1: sweep.samples", "must be a whole number"),
    "samples of zero": ('mode = "latin-hypercube"\nsamples = 0\n"vdm.penalty" = { start = 1, stop = 2 }', "1: sweep.samples", "greater than or equal to 1"),
    "too many": ('"tissue.poisson_ratio" = { start = 0, stop = 0.4, num = 1001 }', "-1: sweep", "makes 1001 cases, more than the 1000 allowed"),
    "far too many": ('"tissue.poisson_ratio" = { start = 0, stop = 0.4, num = 99999 }\n"vdm.penalty" = { start = 1, stop = 2, num = 99999 }', "-1: sweep", "makes 9999800001 cases"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_sweep_is_told_with_its_line_and_key(tmp_path: Path, case: str) -> None:
    sweep, where, message = WRONG[case]
    [found] = problems(tmp_path, sweep)
    assert found[0] == where
    assert message in found[1]


def test_a_sweep_that_is_no_table_is_told(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="study.toml:1: sweep: must be a table, not a whole number"):
        load(tmp_path, "sweep = 3\n" + BASE)


def test_all_faulty_axes_are_told_at_once_with_faults_elsewhere(tmp_path: Path) -> None:
    base = BASE.replace("youngs_modulus = 5e3", "youngs_modulus = 0")
    sweep = '"tissue.poisson_ratio" = [0.3, 0.7]\n"geometry.mesh_size" = ["5 mm", "50 mm"]'
    places = [where for where, _ in problems(tmp_path, sweep, base)]
    assert places == [
        f"{base.split(chr(10)).index('youngs_modulus = 0') - base.count(chr(10)) - 1}: tissue.youngs_modulus",
        '0: sweep."tissue.poisson_ratio"',
        '1: sweep."geometry.mesh_size"',
    ]


def test_the_number_of_cases_allowed_can_be_raised(tmp_path: Path) -> None:
    sweep = '"tissue.poisson_ratio" = { start = 0, stop = 0.4, num = 6 }'
    assert len(swept(tmp_path, sweep, BASE.replace("[geometry]", "max_cases = 6\n[geometry]"))) == 6
    [(_, message)] = problems(tmp_path, sweep, BASE.replace("[geometry]", "max_cases = 5\n[geometry]"))
    assert "makes 6 cases, more than the 5 allowed" in message
