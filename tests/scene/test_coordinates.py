"""A body from a file stays where it is: coordinates are the file's, and no answer depends on its place."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.bodies import shaped
from tests.work.shared_work import TABLES, plan_of, run
from vdmbench.body.geometry import build_mesh
from vdmbench.report.export import surface_fields

pytestmark = pytest.mark.usefixtures("read_here")

PLACE = np.array([-0.4, 0.3, 1.5])  # m, as in a scan of a whole body


def _regions(place: np.ndarray) -> dict[str, Any]:
    """Each kind of region, of a ball of 5 cm about a place."""
    low = np.subtract(place, (0.02, 0.02, 0.0))
    return {
        "below": {"below": {"axis": "z", "value": place[2] - 0.02}},
        "above": {"above": {"axis": "x", "fraction": 0.6}},
        "ball": {"ball": {"center": np.add(place, (0.0, 0.03, 0.03)).tolist(), "radius": 0.03}},
        "box": {"box": {"min": low.tolist(), "max": np.add(low, (0.04, 0.04, 0.06)).tolist()}},
        "cap": {"cap": {"direction": [1, 1, 1], "angle": 0.6}},
    }


def test_no_answer_depends_on_the_place_of_the_body(tmp_path: Path) -> None:
    """The ball as a file in millimetres; as tetrahedra, which are not remeshed."""
    models = ["vdm-paper", "vdm-vector", "bem", "fem-linear"]
    study = {**TABLES["study"], "models": models, "reference": "fem-linear"}
    ball = build_mesh(shaped("sphere", 0.02, {"radius": 0.05}))
    middle = (ball.points.min(axis=0) + ball.points.max(axis=0)) / 2
    answers = []
    for place in (np.zeros(3), PLACE):
        where = tmp_path / f"{place[0]}"
        where.mkdir()
        scan = 1e3 * (ball.points - middle + place)
        meshio.write_points_cells(where / "scan.vtu", scan, [("tetra", ball.tetrahedra)])
        x, y, z = np.add(place, (0.003, 0.001, 0.05)).tolist()
        probe = {"x": x, "y": y, "z": z, "displacement_z": 0.0, "uncertainty": 1e-3}
        tables = {
            "geometry": {"shape": "file", "path": str(where / "scan.vtu"), "scale": 1e-3},
            "regions": _regions(place),
            "constraints": [
                {"kind": "fixed", "region": "below"},
                {"kind": "contact", "region": "ball", "force": 0.1, "profile": "hertz"},
            ],
            "measured": [{"name": "probe", "points": [probe]}],
        }
        answers.append(
            run(plan_of(where / "run", where / "cache", study=study, sweep={}, uncertainty=None, **tables))[0]
        )
    near, far = answers
    assert_allclose(far.points, near.points + PLACE, rtol=0, atol=1e-12)
    points, _ = surface_fields(far)  # as an export has them: in the unit of the scan
    assert_allclose(points.min(axis=0), scan.min(axis=0), rtol=1e-12, atol=0)
    assert_allclose(points.max(axis=0), scan.max(axis=0), rtol=1e-12, atol=0)
    for name, nodes in near.regions.items():
        assert 0 < nodes.sum() < len(nodes), name
        assert_array_equal(far.regions[name], nodes, err_msg=name)
    for model in models:
        moved = near.models[model].displacement
        assert_allclose(
            far.models[model].displacement, moved, rtol=0, atol=1e-7 * abs(moved).max(), err_msg=model
        )
    assert far.measurement is not None
    assert near.measurement is not None
    for model, simulated in near.measurement.simulated.items():
        assert_allclose(far.measurement.simulated[model], simulated, rtol=1e-6, atol=1e-9, err_msg=model)
