"""A body from a file stays where it is: regions by fraction, in the file's coordinates, or from its middle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.bodies import shaped
from tests.command import write_study
from tests.work.shared_work import TABLES, plan_of, run
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh import Mesh
from vdmbench.body.refine import refined
from vdmbench.measures.reference import level_scene
from vdmbench.report.export import surface_fields
from vdmbench.scene.measured_points import place_measured
from vdmbench.scene.scene import build_scene
from vdmbench.study.config import StudyError, load_study
from vdmbench.study.schema import Study

pytestmark = pytest.mark.usefixtures("read_here")

PLACE = np.array([-0.4, 0.3, 1.5])  # m, as in a scan of a whole body
FROM_MIDDLE: dict[str, Any] = {
    "below": {"below": {"axis": "z", "value": -0.02}},
    "above": {"above": {"axis": "x", "fraction": 0.6}},
    "ball": {"ball": {"center": [0.0, 0.03, 0.03], "radius": 0.03}},
    "box": {"box": {"min": [-0.02, -0.02, 0.0], "max": [0.02, 0.02, 0.06]}},
    "cap": {"cap": {"direction": [1, 1, 1], "angle": 0.6}},
    "both": {"ball": {"center": [0.0, 0.03, 0.03], "radius": 0.03}, "above": {"axis": "z", "value": 0.03}},
}
IN_FILE: dict[str, Any] = {
    **FROM_MIDDLE,
    "below": {"below": {"axis": "z", "value": 1.48}},
    "ball": {"ball": {"center": [-0.4, 0.33, 1.53], "radius": 0.03}},
    "box": {"box": {"min": [-0.42, 0.28, 1.5], "max": [-0.38, 0.32, 1.56]}},
    "both": {"ball": {"center": [-0.4, 0.33, 1.53], "radius": 0.03}, "above": {"axis": "z", "value": 1.53}},
}


@pytest.fixture(scope="module")
def ball() -> Mesh:
    return build_mesh(shaped("sphere", 0.02, {"radius": 0.05}))


def _scan(path: Path, ball: Mesh, place: np.ndarray) -> Path:
    """The ball as a file in millimetres, with its middle at a place [m]; as tetrahedra, which are not remeshed."""
    middle = (ball.points.min(axis=0) + ball.points.max(axis=0)) / 2
    meshio.write_points_cells(path, 1e3 * (ball.points - middle + place), [("tetra", ball.tetrahedra)])
    return path


def _study(path: Path, coordinates: str, regions: dict[str, Any]) -> Study:
    held = {"kind": "fixed", "region": "below"}
    pressed = {"kind": "contact", "region": "ball", "force": 0.1, "profile": "hertz"}
    geometry = {"shape": "file", "path": str(path), "scale": 1e-3, "coordinates": coordinates}
    tables = {"geometry": geometry, "regions": regions, "constraints": [held, pressed]}
    return Study.model_validate({**TABLES, "sweep": {}, **tables})


def test_the_same_regions_by_the_file_and_by_the_middle(tmp_path: Path, ball: Mesh) -> None:
    path = _scan(tmp_path / "scan.vtu", ball, PLACE)
    mesh = build_mesh(shaped("file", 0.0, {"path": str(path), "scale": 1e-3}))
    corners = mesh.surface_points.min(axis=0), mesh.surface_points.max(axis=0)
    assert_allclose(np.mean(corners, axis=0), PLACE, rtol=0, atol=1e-12)
    by_file, by_middle = (_study(path, *told) for told in (("file", IN_FILE), ("centred", FROM_MIDDLE)))
    there, here = build_scene(by_file, mesh), build_scene(by_middle, mesh)
    for name in FROM_MIDDLE:
        assert 0 < here.regions[name].sum() < len(mesh.surface_nodes), name
        assert_array_equal(there.regions[name], here.regions[name], err_msg=name)
    largest = abs(here.facet_pressure).max()
    assert_allclose(there.facet_pressure, here.facet_pressure, rtol=0, atol=1e-9 * largest)
    placed = []
    for study, start in ((by_file, PLACE), (by_middle, np.zeros(3))):
        x, y, z = start + np.array([0.003, 0.001, 0.05])
        point = {"x": x, "y": y, "z": z, "displacement_z": 0.0, "uncertainty": 1e-3}
        tables = study.model_dump() | {"measured": [{"name": "probe", "points": [point]}]}
        placed += place_measured(Study.model_validate(tables), mesh)
    assert_array_equal(placed[0].facet, placed[1].facet)
    assert_allclose(placed[0].weights, placed[1].weights, rtol=0, atol=1e-9)
    finer = [level_scene(study, refined(mesh, 1)).facet_pressure for study in (by_file, by_middle)]
    assert_allclose(finer[0], finer[1], rtol=0, atol=1e-9 * abs(finer[0]).max())


def test_no_answer_depends_on_the_place_of_the_body(tmp_path: Path, ball: Mesh) -> None:
    models = ["vdm-paper", "vdm-vector", "bem", "fem-linear"]
    study = {**TABLES["study"], "models": models, "reference": "fem-linear"}
    answers = []
    for place in (np.zeros(3), PLACE):
        where = tmp_path / f"{place[0]}"
        where.mkdir()
        given = _study(_scan(where / "scan.vtu", ball, place), "centred", FROM_MIDDLE)
        tables = {key: given.model_dump()[key] for key in ("geometry", "regions")}
        tables["constraints"] = [part.model_dump(exclude_none=True) for part in given.constraints]
        answers.append(
            run(plan_of(where / "run", where / "cache", study=study, sweep={}, uncertainty=None, **tables))[0]
        )
    near, far = answers
    assert_allclose(far.points, near.points + PLACE, rtol=0, atol=1e-12)
    scan = meshio.read(next(tmp_path.glob("-*/scan.vtu"))).points
    points, _ = surface_fields(far)  # as an export has them: in the unit of the scan
    assert_allclose(
        [points.min(axis=0), points.max(axis=0)], [scan.min(axis=0), scan.max(axis=0)], rtol=1e-12, atol=0
    )
    for model in models:
        moved = near.models[model].displacement
        assert_allclose(
            far.models[model].displacement, moved, rtol=0, atol=1e-7 * abs(moved).max(), err_msg=model
        )


def test_coordinates_need_a_word_on_their_origin(tmp_path: Path) -> None:
    (tmp_path / "scan.stl").write_text("")
    shape = ('shape = "sphere"\nradius = "50 mm"', 'shape = "file"\npath = "scan.stl"')
    load_study(write_study(tmp_path, shape=shape))  # fractions and caps need none
    coordinates = ("fraction = 0.2", 'value = "-30 mm"')
    with pytest.raises(
        StudyError, match=r'small.toml:8: geometry.coordinates: is missing, and region "base"'
    ):
        load_study(write_study(tmp_path, shape=shape, at=coordinates))
    told = (shape[0], f'{shape[1]}\ncoordinates = "file"')
    load_study(write_study(tmp_path, shape=told, at=coordinates))
    wrong = ('shape = "sphere"', 'shape = "sphere"\ncoordinates = "file"')
    with pytest.raises(StudyError, match="a sphere has no coordinates"):
        load_study(write_study(tmp_path, shape=wrong))


def test_a_study_takes_another_surface_wherever_that_lies(tmp_path: Path) -> None:
    """Its regions were written for a body about the origin."""
    (tmp_path / "scan.stl").write_text("")
    study = write_study(tmp_path, at=("fraction = 0.2", 'value = "-30 mm"'))
    assert load_study(study, surface=tmp_path / "scan.stl").geometry.coordinates == "centred"
