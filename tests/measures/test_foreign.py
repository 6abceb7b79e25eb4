"""Another program's result: read, put on the mesh, and judged like a model of the study."""

import json
import os
from pathlib import Path

import meshio
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.command import SMALL_STUDY, vdmbench
from vdmbench.body import read_apart
from vdmbench.body.mesh_file import read_point_fields, write_surface_vtu
from vdmbench.measures import foreign
from vdmbench.measures.foreign import ForeignResultError, read_foreign
from vdmbench.store.cases import read_run

from .test_measured import ball


def field(points: np.ndarray) -> np.ndarray:
    return 1e-3 * points @ np.arange(9.0).reshape(3, 3).T


def csv(path: Path, header: str, *columns: np.ndarray) -> Path:
    rows = (",".join(repr(float(x)) for x in row) for row in np.column_stack(columns))
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


PLACES, MOVED = "x,y,z", "displacement_x,displacement_y,displacement_z"


def test_every_kind_of_file_gives_the_same_field(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foreign, "point_fields_of", read_point_fields)  # others read apart
    mesh = ball()
    points, u = mesh.points, field(mesh.points)
    mixed = np.random.default_rng(3).permutation(len(points))
    write_surface_vtu(tmp_path / "u.vtu", points[mixed], mesh.triangles, {"displacement": u[mixed]})
    write_surface_vtu(tmp_path / "own.vtu", points, mesh.triangles, {"motion": u, "stress": np.zeros(162)})
    write_surface_vtu(tmp_path / "x.vtu", points, mesh.triangles, {"position": points + u})
    in_mm = u[mixed] * [1e3, 1.0, 1.0]
    deformed = "deformed_x,deformed_y,deformed_z"
    found = [
        read_foreign(csv(tmp_path / "a.csv", f"{PLACES},{MOVED}", points[mixed], u[mixed]), mesh),
        read_foreign(csv(tmp_path / "b.csv", f"node,{MOVED}", mixed, u[mixed]), mesh),
        read_foreign(csv(tmp_path / "c.csv", f"node,{deformed}", mixed, (points + u)[mixed]), mesh),
        read_foreign(csv(tmp_path / "d.csv", f"{PLACES},{deformed}", points, points + u), mesh),
        read_foreign(csv(tmp_path / "e.csv", f"node,{MOVED}".replace("_x", "_x [mm]"), mixed, in_mm), mesh),
        read_foreign(tmp_path / "u.vtu", mesh),
        read_foreign(tmp_path / "own.vtu", mesh, "motion"),
        read_foreign(tmp_path / "x.vtu", mesh),
    ]
    for one in found:
        assert_allclose(one.displacement, u, rtol=1e-9, atol=1e-15)
        assert one.exact == 1.0
        assert one.distance < 1e-12


def test_a_node_without_a_point_takes_the_nearest_and_its_distance_is_told(tmp_path: Path) -> None:
    mesh = ball()
    points, u = mesh.points.copy(), field(mesh.points)
    points[7] *= 1.01
    found = read_foreign(csv(tmp_path / "a.csv", f"{PLACES},{MOVED}", points, u), mesh)
    assert_allclose(found.displacement, u)
    assert found.exact == pytest.approx(161 / 162)
    assert found.distance == pytest.approx(0.01)
    # the field changes by at most its largest stretch, 14.2e-3, over that distance
    assert 0.5 * 0.01 * 14.2e-3 < found.bend < 0.01 * 14.3e-3


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("x,y,z,displacement_x\n0,0,1,0\n", "a.csv:1: has no column 'displacement_y'"),
        (
            "x,y,z,displacement_x,displacement_y,displacement_z\n0,0,1,0,0,0\n",
            "has no point within 0.5 of an edge",
        ),
        ("node,displacement_x,displacement_y,displacement_z\n0,0,0,0\n", "is not each of 0 to 161 once"),
        ("node,displacement_x,displacement_y,displacement_z\n0,0,,0\n", "a.csv:2: has no displacement_y"),
        (
            "node,displacement_x,displacement_y,displacement_z\n0,0,nan,0\n",
            "a.csv:2: displacement_y: must be",
        ),
        ("node,displacement_x,displacement_y,displacement_z\n0.5,0,0,0\n", "is not each of 0 to 161 once"),
        (
            f"node,{PLACES},{MOVED}\n0,0,0,1,0,0,0\n",
            "a.csv:1: unknown column 'node'; a table of displacements at places has",
        ),
        (
            f"{PLACES},{MOVED},deformed_x\n0,0,1,0,0,0,0\n",
            "a.csv:1: unknown column 'deformed_x'; a table of displacements at places has",
        ),
        (f"{PLACES},{MOVED}\n0,0,1,0,0,{'0' * 200_000}\n", "a.csv:2: is no table: field larger than"),
    ],
)
def test_a_bad_file_is_told(tmp_path: Path, text: str, told: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ForeignResultError) as caught:
        read_foreign(tmp_path / "a.csv", ball())
    assert told in str(caught.value).replace('"', "'")


def test_what_has_no_end_or_unpacks_to_too_much_is_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = ball()
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "zero.csv").symlink_to("/dev/zero")
    with (tmp_path / "large.csv").open("wb") as file:
        file.truncate(foreign.MOST_CSV_BYTES + 1)
    points = np.zeros((3_000_000, 3))  # 72 MB in a file of less than one
    meshio.vtu.write(tmp_path / "zeros.vtu", meshio.Mesh(points, [], {"u": points}))
    assert (tmp_path / "zeros.vtu").stat().st_size < 1e6
    monkeypatch.setattr(read_apart, "MEMORY", 100_000_000)
    for name, told in (
        ("pipe.csv", "is no regular file"),
        ("zero.csv", "is no regular file"),
        ("large.csv", "is larger than 20 MB"),
        ("zeros.vtu", "takes more than|cannot be read|ends its reader"),
    ):
        with pytest.raises(ForeignResultError, match=told):
            read_foreign(tmp_path / name, mesh)


def test_a_file_without_the_field_names_those_that_it_has(tmp_path: Path) -> None:
    mesh = ball()
    write_surface_vtu(tmp_path / "a.vtu", mesh.points, mesh.triangles, {"velocity": mesh.points})
    write_surface_vtu(tmp_path / "b.vtu", mesh.points, mesh.triangles, {"u": mesh.points * np.nan})
    for name, told in (
        ("a.vtu", "it has velocity: name one by --array"),
        ("b.vtu", "point 0 has numbers that are not finite"),
        ("gone.vtu", "cannot be read"),
        ("a.stl", "cannot be read"),
    ):
        with pytest.raises(ForeignResultError, match=told):
            read_foreign(tmp_path / name, mesh)


def test_a_model_that_comes_back_as_a_file_is_judged_as_it_was(tmp_path: Path) -> None:
    """The round trip: what vdm-paper answered, written as a file, has the metrics of vdm-paper and its page."""
    (tmp_path / "small.toml").write_text(SMALL_STUDY)
    assert vdmbench("run", "small.toml", "--out", "out", cwd=tmp_path).returncode == 0
    (case,) = read_run(tmp_path / "out").cases
    own = case.models["vdm-paper"].displacement[case.full_load]
    csv(tmp_path / "theirs.csv", f"{PLACES},{MOVED}", case.points, own)
    options = ("compare", "small.toml", "--out", "out", "--result", "theirs.csv")
    result = vdmbench(*options, "--name", "peer-engine", "--json", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    metrics = json.loads(result.stdout)["metrics"]
    measures = ("relative_l2_displacement_error", "relative_l2_deformation_error", "volume_drift")
    for measure in measures:
        theirs, ours = (metrics[name][measure]["value"] for name in ("peer-engine", "vdm-paper"))
        assert theirs == pytest.approx(ours, rel=1e-9), measure
    page = (tmp_path / "out" / "report-peer-engine.html").read_text()
    assert "peer-engine" in page
    assert "peer-engine" not in (tmp_path / "out" / "report.html").read_text(), (
        "the run's own page is as it was"
    )
    wrong = vdmbench(*options, "--name", "vdm-paper", cwd=tmp_path)
    assert wrong.returncode == 2
    assert "is a model of the study" in wrong.stderr
