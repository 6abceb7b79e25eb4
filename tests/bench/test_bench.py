"""A benchmark is a run of a study on several mesh sizes; its table, on numbers chosen by hand."""

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.testing import assert_allclose

from tests.command import vdmbench
from tests.report.runs import make_case, make_run, typed_study
from vdmbench.bench import SIZES, rows, study_to_run
from vdmbench.cli.verbs_of_trials import bodies_to_measure
from vdmbench.scene.result import FrameTimes
from vdmbench.store.cases import read_run
from vdmbench.study.config import expand, load_study

STUDY = """
[study]
name = "ball"
models = ["vdm-consistent"]
condition = true

[geometry]
shape = "sphere"
radius = "50 mm"
mesh_size = "{size} mm"

[tissue]
youngs_modulus = "5 kPa"
poisson_ratio = 0.45

[regions.base]
below = {{ axis = "z", fraction = 0.3 }}

[regions.finger]
above = {{ axis = "z", fraction = {fraction} }}

[[constraints]]
kind = "fixed"
region = "base"

[[constraints]]
name = "finger"
kind = "contact"
region = "finger"
pressure = "100 Pa"

[sweep]
"constraints.finger.pressure" = ["100 Pa", "200 Pa"]
"""

HELD: dict[str, Any] = {
    "regions": {"base": {"below": {"axis": "z", "fraction": 0.3}}},
    "constraints": [{"kind": "fixed", "region": "base"}],
    "gravity": {"acceleration": [0.0, 0.0, -9.81]},
}


def test_a_benchmark_is_a_run_of_the_sizes_that_the_body_stands(tmp_path: Path) -> None:
    """A ball of 100 mm has no mesh with edges of 56 or 73 mm; models answer the first case of the study."""
    (tmp_path / "ball.toml").write_text(STUDY.format(size=28, fraction=0.7))
    done = vdmbench("bench", "ball.toml", "--out", "there", "--json", cwd=tmp_path, times=True)
    assert done.returncode == 0, done.stderr
    assert re.findall("left out (.*) times the mesh_size: ", done.stderr) == ["2.6", "2"]
    (report,) = json.loads(done.stdout)["reports"]
    run = read_run((tmp_path / report).parent)
    assert run.study.study.name == "ball-bench"
    assert "vdmbench report there/ball-bench<" in (tmp_path / report).read_text()
    assert len(run.cases) == 2
    found = [(row["model"], int(row["nodes"])) for row in json.loads(done.stdout)["rows"]]
    nodes = [len(case.points) for case in run.cases]
    assert found == [(name, count) for count in nodes for name in ("vdm-consistent", "fem-linear")]
    for case in run.cases:
        assert case.study.constraints[1].pressure == 100.0
        assert_allclose(case.load_factors, [0.5, 1.0], rtol=1e-12, atol=0)
        for name in ("vdm-consistent", "fem-linear"):
            times = case.models[name].frames
            assert times.contact.shape == times.everywhere.shape == (5,)


def test_a_study_that_cannot_be_measured_at_all_says_why(tmp_path: Path) -> None:
    (tmp_path / "ball.toml").write_text(STUDY.format(size=30, fraction=0.999))
    done = vdmbench("bench", "ball.toml", cwd=tmp_path)
    assert done.returncode == 3
    assert "enlarge its region" in done.stderr


def test_a_body_of_its_own_tetrahedra_is_measured_as_it_is() -> None:
    own = typed_study(geometry={"shape": "file", "path": "body.msh"}, **HELD)
    assert own.geometry.has_own_tetrahedra
    assert len(expand(study_to_run(own, ["bem"]))) == 1
    swept = study_to_run(typed_study(**HELD), ["bem"])
    assert [case.swept["geometry.mesh_size"] for case in expand(swept)] == [0.006 * size for size in SIZES]


def test_the_study_to_run_is_one_that_a_file_can_say(tmp_path: Path) -> None:
    study = study_to_run(typed_study(**HELD), ["bem"])
    (tmp_path / "study.toml").write_text(study.text)
    assert load_study(tmp_path / "study.toml") == study


def test_a_row_is_of_medians_and_of_ratios_inside_rounds() -> None:
    def times(setup: list[float], contact: list[float]) -> FrameTimes:
        return FrameTimes(np.array(setup), np.array(contact), np.full(len(setup), np.nan))

    case = make_case(
        {"bem": 0.2}, reference_error={"levels": 2.0, "gci:relative_l2_displacement_error": 0.01}
    )
    frames = {
        # the machine did something else in the last round; of the slow model there are two rounds
        "fem-linear": times([2.0, 2.0, 2.0, 2.0, 1e4], [0.1, 0.1, 0.1, 0.1, 1e4]),
        "bem": times([4.0, 8.0], [0.01, 0.03]),
    }
    models = {name: dataclasses.replace(one, frames=frames[name]) for name, one in case.models.items()}
    bem, elements = rows(make_run([dataclasses.replace(case, models=models)]))
    assert elements["set-up"] == "2.00 s [2.00 s, 2.00 s]"
    assert elements["frame ratio"] == "1.0 [1.0, 1.0]"
    assert bem["set-up"] == "6.00 s [5.00 s, 7.00 s]"
    assert bem["set-up ratio"] == "3.0 [2.5, 3.5]"
    assert bem["frame ratio"] == "0.20 [0.15, 0.25]"
    assert bem["frame, all nodes"] == "–"
    assert bem["error"] == "20.0 % ± 1 %"
    unsure = dataclasses.replace(
        case, reference_error={"levels": 2.0, "gci:relative_l2_displacement_error": 0.04}
    )
    (row, _) = rows(make_run([unsure]))
    assert row["error"] == "~20.0 % ± 4 %", "more than a tenth is not resolved"
    assert row["set-up"] == "–", "not measured"


def test_a_surface_is_measured_beside_the_built_in_bodies() -> None:
    built_in = bodies_to_measure(None, None)
    assert bodies_to_measure(None, Path("liver.stl")) == [*built_in, ("accuracy-organ", Path("liver.stl"))]
    assert bodies_to_measure("mine.toml", Path("liver.stl")) == [("mine.toml", Path("liver.stl"))]
