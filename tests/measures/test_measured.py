"""What was measured: read from a file, put on a mesh, and models held against it."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.command import vdmbench
from tests.report.runs import example_measurement, icosphere, make_case, make_run
from vdmbench.body.mesh import Mesh
from vdmbench.measures.measurement import MOST, RMS, hold_against, step_rms
from vdmbench.measures.pushed import Answer
from vdmbench.report.blocks import Table
from vdmbench.report.section_measurement import against_measurement
from vdmbench.scene.measured_points import place_measured
from vdmbench.scene.regions import SceneError
from vdmbench.study.config import Study, load_study
from vdmbench.verdict.digest import Digest

STUDY = """\
[study]
name = "tips"
models = ["bem"]
[geometry]
shape = "sphere"
radius = 1
mesh_size = 0.2
[tissue]
youngs_modulus = 5000
poisson_ratio = 0.45
[regions.base]
below = { axis = "z", fraction = 0.1 }
[[constraints]]
kind = "fixed"
region = "base"
[load]
factors = [0.5, 1.0]
[[measured]]
path = "tips.csv"
source = "a ruler"
"""
GOOD = """\
# who, when
point, x [mm], y, z [m], displacement_z [mm], displacement_x, uncertainty [um], load_factor, COMSOL.displacement_z
top, 0, 0, 1, -2, , 100, 1, -0.0021
side, 1000, 0, 0, 0.5, 0.001, 200, 0.5,
"""


def load(tmp_path: Path, table: str, study: str = STUDY) -> Study:
    (tmp_path / "tips.toml").write_text(study)
    (tmp_path / "tips.csv").write_text(table)
    return load_study(tmp_path / "tips.toml")


def ball() -> Mesh:
    points, triangles = icosphere(2)
    return Mesh(points, np.zeros((0, 4), dtype=np.int64), np.arange(len(points)), triangles)


def test_check_ends_with_2_for_a_point_off_the_body(tmp_path: Path) -> None:
    load(tmp_path, GOOD.replace("top, 0, 0, 1,", "top, 0, 0, 1.2,"))
    result = vdmbench("check", "tips.toml", cwd=tmp_path)
    assert result.returncode == 2
    (line,) = result.stderr.strip().splitlines()
    assert "tips.toml:18: " in line
    assert "point 'top' (line 3 of its file) of 'tips' is 0.2 m off the body" in line


def test_more_points_than_nodes_and_a_surface_in_another_unit_are_refused(tmp_path: Path) -> None:
    rows = "".join("0,0,1,0\n" for _ in range(163))
    study = STUDY + "uncertainty = 0.001\n"
    with pytest.raises(SceneError, match="has 163 points, the mesh 162 surface nodes"):
        place_measured(load(tmp_path, "x,y,z,displacement_x\n" + rows, study), ball())
    cloud = "deformed_x,deformed_y,deformed_z\n0,0,1000\n0,0,-1000\n"
    with pytest.raises(SceneError, match="a mixed-up unit"):
        place_measured(load(tmp_path, cloud, study), ball())


def test_a_linear_field_is_read_exactly_where_it_was_measured(tmp_path: Path) -> None:
    """Barycentric interpolation reproduces linear functions; a point at the middle of a facet is on no node."""
    mesh = ball()
    place = mesh.points[mesh.triangles[7]].mean(axis=0)
    table = "x,y,z,displacement_x\n" + ",".join(repr(float(x)) for x in place) + ",0\n"
    study = load(tmp_path, table, STUDY + "uncertainty = 0.001\n")
    matrix = np.arange(9.0).reshape(3, 3)
    found = hold_against(study, mesh, {"m": Answer(np.stack([mesh.points @ matrix.T] * 2))})
    assert_allclose(found.simulated["m"], (matrix @ place)[:1], rtol=0, atol=1e-12)
    assert_allclose(found.quantities[0].distance, 0.0, atol=1e-12)


def test_error_and_uncertainty_by_hand(tmp_path: Path) -> None:
    """Top at -2 mm +- 0.1, side at (1, 0.5) mm +- 0.2 at half the load; the model moves by (0, 0, -2.05) mm."""
    study, mesh = load(tmp_path, GOOD), ball()
    field = np.zeros((2, 162, 3))
    field[:, :, 2] = -2.05e-3
    levels = [Answer(field * factor) for factor in (1.05, 1.01, 1.0)]
    results = {"a": Answer(field * 1.05), "b": Answer(field), "none": Answer(field * np.nan)}
    found = hold_against(study, mesh, results, list(zip(("a", "", "b"), levels, strict=True)))
    assert [(q.point, q.component, q.step) for q in found.quantities] == [
        ("top", "z", 1),
        ("side", "x", 0),
        ("side", "z", 0),
    ]
    assert_allclose(found.values, [-2e-3, 1e-3, 0.5e-3], rtol=1e-12)
    assert_allclose(found.error("b"), [-0.05e-3, -1e-3, -2.55e-3], rtol=1e-9)
    assert np.isnan(found.error("none")).all()
    assert not found.within("none").any()
    # differences 0.01 and 0.04 of 2.05 mm: order 2, error a third of the first, GCI 1.25 of that
    gci = 1.25 * 0.01 * 2.05e-3 / 3
    assert_allclose(found.numerical["b"], [gci, 0.0, gci], rtol=1e-6, atol=1e-15)
    assert_allclose(
        found.numerical["a"], [gci + 0.05 * 2.05e-3, 0.0, gci + 0.05 * 2.05e-3], rtol=1e-6, atol=1e-15
    )
    assert_allclose(found.uncertainty("b"), np.hypot([1e-4, 2e-4, 2e-4], [gci, 0, gci]), rtol=1e-6)
    assert found.within("b").tolist() == [True, False, False]
    assert found.with_levels == ["a", "b"]
    assert found.as_good_as("b", "a").all(), "u_num of the coarse one has their distance in it"
    assert found.as_good_as("a", "b").tolist() == [False, True, False]
    assert found.others == ("COMSOL",)
    assert_allclose(found.error("COMSOL"), [-1e-4, np.nan, np.nan], rtol=1e-9)
    expected = [np.sqrt((1.0**2 + 2.55**2) / 2) * 1e-3, 0.05e-3]
    assert_allclose(step_rms(found, "b", 2), expected, rtol=1e-9)


def test_a_measured_surface_is_as_far_as_it_is(tmp_path: Path) -> None:
    """The nodes of the moved ball themselves are on it; outward by 1 mm they are 1 mm off, but for its facets."""
    mesh = ball()
    moved = mesh.points + np.array([0.0, 0.0, -0.1])
    field = np.zeros((2, 162, 3))
    field[1, :, 2] = -0.1
    for outward in (0.0, 1e-3):
        rows = "\n".join(",".join(map(repr, p)) for p in (moved + outward * mesh.points).tolist())
        study = load(
            tmp_path, f"deformed_x,deformed_y,deformed_z\n{rows}\n", STUDY + "uncertainty = 0.0001\n"
        )
        found = hold_against(study, mesh, {"m": Answer(field), "lost": Answer(field * np.nan)})
        assert [q.component for q in found.quantities] == [RMS, MOST]
        assert_allclose(found.simulated["m"], outward, rtol=1e-6, atol=1e-15)
        assert found.within("m").all() == (outward == 0.0)
        assert np.isnan(found.simulated["lost"]).all()


def test_an_unknown_u_num_counts_neither_inside_nor_outside() -> None:
    found = example_measurement()
    answers = {**found.simulated, "fem:direct": np.array([-6.4e-3, 2e-3])}
    found = dataclasses.replace(
        found, simulated=answers, numerical={**found.numerical, "fem:direct": np.array([1e-4, np.nan])}
    )
    case = dataclasses.replace(make_case({"vdm-paper": 0.1}), measurement=found)
    section = against_measurement(Digest(make_run([case])))
    table = next(block for block in section.blocks if isinstance(block, Table))
    (place,) = (k for k, one in enumerate(table.columns) if one.title == "Within u_num of fem:direct")
    assert {row[0].text: row[place].text for row in table.rows if row[place].text}["vdm-paper"] == "1 of 1"
