"""Every mistake in a sweep is told with its line and key."""

from __future__ import annotations

from pathlib import Path

import pytest

from vdmbench.study.config import StudyError, expand
from vdmbench.work.plan import make_plan

from .study_texts import SWEPT, load, sweep_problems, swept

WRONG = {
    "unknown key": (
        '"tissue.poison_ratio" = [1]',
        '0: sweep."tissue.poison_ratio"',
        'mean "tissue.poisson_ratio"?',
    ),
    "dotted unknown": (
        "tissue.poison_ratio = [1]",
        "0: sweep.tissue.poison_ratio",
        'mean "tissue.poisson_ratio"?',
    ),
    "constraint unknown": (
        '"constraints.fingr.pressure" = [1]',
        '0: sweep."constraints.fingr.pressure"',
        "did you mean",
    ),
    "constraint of another kind, which has no such key": (
        '"constraints.baze.pressure" = [1]',
        '0: sweep."constraints.baze.pressure"',
        'did you mean "constraints.finger.pressure"?',
    ),
    "misspelt mode": ("mod = 'zip'", "0: sweep.mod", "unknown key"),
    "wrong mode": ("mode = 'zap'", "0: sweep.mode", 'did you mean "zip"?'),
    "name": ('"study.name" = ["a"]', '0: sweep."study.name"', "unknown key"),
    "whole vector": ('"geometry.semi_axes" = [[1, 2, 3]]', '0: sweep."geometry.semi_axes"', "unknown key"),
    "beyond a vector": ('"geometry.semi_axes.3" = [1]', '0: sweep."geometry.semi_axes.3"', "unknown key"),
    "table": ('"tissue" = [1]', "0: sweep.tissue", "unknown key"),
    "empty": ('"tissue.poisson_ratio" = []', '0: sweep."tissue.poisson_ratio"', "has no values"),
    "scalar": ('"tissue.poisson_ratio" = 0.3', '0: sweep."tissue.poisson_ratio"', "must be a list of values"),
    "repeated": (
        '"tissue.poisson_ratio" = [0.3, 0.4, 3e-1]',
        '0: sweep."tissue.poisson_ratio"',
        "0.3 is listed 2 times",
    ),
    "repeated in another unit": (
        '"geometry.mesh_size" = ["5 mm", 0.005]',
        '0: sweep."geometry.mesh_size"',
        "2 times",
    ),
    "twice": (
        '"tissue.poisson_ratio" = [0.3]\ntissue.poisson_ratio = [0.4]',
        "1: sweep.tissue.poisson_ratio",
        "swept twice",
    ),
    "unit": (
        '"tissue.youngs_modulus" = [\n1000,\n"5 mm"]',
        '2: sweep."tissue.youngs_modulus"[1]',
        "not a unit of",
    ),
    "bool": ('"tissue.youngs_modulus" = [true]', '0: sweep."tissue.youngs_modulus"[0]', "not true or false"),
    "nan": ('"tissue.youngs_modulus" = [nan]', '0: sweep."tissue.youngs_modulus"[0]', "finite"),
    "bool for a choice": ('"vdm.rotation" = [true]', '0: sweep."vdm.rotation"[0]', "not true or false"),
    "list for a choice": ('"vdm.rotation" = [["none"]]', '0: sweep."vdm.rotation"[0]', "not a list"),
    "unknown choice": (
        '"vdm.rotation" = ["none", "globe"]',
        '0: sweep."vdm.rotation"',
        'did you mean "global"?',
    ),
    "a choice that is gone": (
        '"vdm.rotation" = ["global", "nodal"]',
        '0: sweep."vdm.rotation"',
        'write rotation = "global", one rotation for the body',
    ),
    "out of range": ('"tissue.poisson_ratio" = [0.3, 0.6]', '0: sweep."tissue.poisson_ratio"', "at most 0.5"),
    "wrong in a combination": (
        '"tissue.youngs_modulus" = [19, 20, 2e3]',
        "-2: constraints.finger.pressure",
        "(in the case youngs_modulus = 19 Pa)",
    ),
    "range of a choice": (
        '"vdm.rotation" = { start = 1, stop = 2, num = 2 }',
        '0: sweep."vdm.rotation"',
        "list its values",
    ),
    "range without num": (
        '"tissue.poisson_ratio" = { start = 0, stop = 0.1 }',
        '0: sweep."tissue.poisson_ratio".num',
        "whole number from 2",
    ),
    "num of one": (
        '"tissue.poisson_ratio" = { start = 0, stop = 0.1, num = 1 }',
        '0: sweep."tissue.poisson_ratio".num',
        "whole number from 2",
    ),
    "num as bool": (
        '"tissue.poisson_ratio" = { start = 0, stop = 0.1, num = true }',
        '0: sweep."tissue.poisson_ratio".num',
        "whole number from 2",
    ),
    "range without stop": (
        '"tissue.poisson_ratio" = { start = 0, num = 3 }',
        '0: sweep."tissue.poisson_ratio"',
        "stop is missing",
    ),
    "range of nothing": (
        '"tissue.poisson_ratio" = { start = 0, stop = 0, num = 3 }',
        '0: sweep."tissue.poisson_ratio"',
        "the same value",
    ),
    "range key": (
        '"tissue.poisson_ratio" = { start = 0, stop = 0.1, nun = 3 }',
        '0: sweep."tissue.poisson_ratio".nun',
        'did you mean "num"?',
    ),
    "range scale": (
        '"tissue.poisson_ratio" = { start = 0, stop = 0.1, num = 3, scale = "lin" }',
        '0: sweep."tissue.poisson_ratio".scale',
        "linear or log",
    ),
    "log through zero": (
        '"tissue.poisson_ratio" = { start = 0, stop = 0.1, num = 3, scale = "log" }',
        '0: sweep."tissue.poisson_ratio"',
        "positive start",
    ),
    "zip of unequal": (
        'mode = "zip"\n"tissue.poisson_ratio" = [0.3]\n"vdm.penalty" = [1, 2]',
        "-1: sweep",
        "tissue.poisson_ratio has 1, vdm.penalty has 2",
    ),
    "zip with a repetition": (
        'mode = "zip"\n"tissue.poisson_ratio" = [0.3, 0.3]\n"vdm.penalty" = [1, 1]',
        "-1: sweep",
        "more than once",
    ),
    "one at a time with a repetition": (
        'mode = "one-at-a-time"\n"tissue.poisson_ratio" = [0.3, 0.4, 0.3]',
        '1: sweep."tissue.poisson_ratio"',
        "0.3 is listed 2 times",
    ),
    "one at a time with a wrong value": (
        'mode = "one-at-a-time"\n"vdm.penalty" = [1]\n"tissue.poisson_ratio" = [0.3, 0.6]',
        '2: sweep."tissue.poisson_ratio"',
        "(in the case poisson_ratio = 0.6)",
    ),
    "seed of one at a time": (
        'mode = "one-at-a-time"\nseed = 1\n"tissue.poisson_ratio" = [0.3]',
        "1: sweep.seed",
        'only mode = "latin-hypercube"',
    ),
    "another model's table": (
        '"models.vdm-vector.penalty" = [1]',
        '0: sweep."models.vdm-vector.penalty"',
        'did you mean "models.vdm-vector:lu.penalty"?',
    ),
    "samples of a grid": ("samples = 3", "0: sweep.samples", 'only mode = "latin-hypercube"'),
    "latin without samples": (
        'mode = "latin-hypercube"\n"vdm.penalty" = { start = 1, stop = 2 }',
        "-1: sweep.samples",
        "is missing",
    ),
    "latin of a list": (
        'mode = "latin-hypercube"\nsamples = 2\n"vdm.penalty" = [1, 2]',
        '2: sweep."vdm.penalty"',
        "samples ranges",
    ),
    "latin with num": (
        'mode = "latin-hypercube"\nsamples = 2\n"vdm.penalty" = { start = 1, stop = 2, num = 2 }',
        '2: sweep."vdm.penalty".num',
        "leave num out",
    ),
    "latin of nothing": ('mode = "latin-hypercube"\nsamples = 2', "0: sweep.mode", "no axis"),
    "samples as text": (
        'mode = "latin-hypercube"\nsamples = "2"\n"vdm.penalty" = { start = 1, stop = 2 }',
        "1: sweep.samples",
        "must be a whole number",
    ),
    "samples of zero": (
        'mode = "latin-hypercube"\nsamples = 0\n"vdm.penalty" = { start = 1, stop = 2 }',
        "1: sweep.samples",
        "greater than or equal to 1",
    ),
    "too many": (
        '"tissue.poisson_ratio" = { start = 0, stop = 0.4, num = 1001 }',
        "-1: sweep",
        "makes 1001 cases, more than the 1000 allowed",
    ),
    "far too many": (
        "tissue.poisson_ratio = { start = 0, stop = 0.4, num = 99999 }\n"
        "vdm.penalty = { start = 1, stop = 2, num = 99999 }",
        "-1: sweep",
        "makes 9999800001 cases",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_sweep_is_told_with_its_line_and_key(tmp_path: Path, case: str) -> None:
    sweep, where, message = WRONG[case]
    [found] = sweep_problems(tmp_path, sweep)
    assert found[0] == where
    assert message in found[1]


def test_a_sweep_that_is_no_table_is_told(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"study\.toml:1: sweep: must be a table, not a whole number"):
        load(tmp_path, "sweep = 3\n" + SWEPT)


def test_all_faulty_axes_are_told_at_once(tmp_path: Path) -> None:
    sweep = '"tissue.poisson_ratio" = [0.3, 0.7]\n"geometry.mesh_size" = ["5 mm", "50 mm"]'
    places = [where for where, _ in sweep_problems(tmp_path, sweep)]
    assert places == ['0: sweep."tissue.poisson_ratio"', '1: sweep."geometry.mesh_size"']


def test_the_number_of_cases_allowed_can_be_raised(tmp_path: Path) -> None:
    sweep = '"tissue.poisson_ratio" = { start = 0, stop = 0.4, num = 6 }'
    assert len(swept(tmp_path, sweep, SWEPT.replace("[geometry]", "max_cases = 6\n[geometry]"))) == 6
    [(_, message)] = sweep_problems(tmp_path, sweep, SWEPT.replace("[geometry]", "max_cases = 5\n[geometry]"))
    assert "makes 6 cases, more than the 5 allowed" in message


@pytest.mark.parametrize(
    ("text", "line", "key"),
    [
        (SWEPT.replace("mesh_size = 0.006", "mesh_size = 1e-4"), 7, "geometry.mesh_size"),
        (f'{SWEPT}[sweep]\n"geometry.mesh_size" = [6e-3, 1e-4]\n', 27, 'sweep."geometry.mesh_size"'),
    ],
)
def test_too_many_nodes_are_told_where_the_mesh_size_is_written(
    tmp_path: Path, text: str, line: int, key: str
) -> None:
    study = load(tmp_path, text)
    with pytest.raises(StudyError) as caught:
        make_plan(study, expand(study), tmp_path / "run", tmp_path / "cache")
    (problem,) = caught.value.problems
    assert (problem.line, problem.key) == (line, key)
    assert (
        "mesh_size 0.0001 m would give about 2.3e+06 nodes, more than the 2000000 allowed" in problem.message
    )
