"""What an answer's motion is made of: closed forms on a ball, and the words of the verdict."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.unit.report_runs import REFERENCE, make_case, make_run
from tests.vdm.vdm_shapes import icosphere
from vdmbench.body.surface_measures import Surface, weighted_norm
from vdmbench.measures.case import Run
from vdmbench.measures.metrics import METRICS, History
from vdmbench.report import headline
from vdmbench.verdict.digest import Digest
from vdmbench.verdict.formatting import percent
from vdmbench.verdict.motion import along_normals, motion_in_words
from vdmbench.work.case import compare

POINTS, TRIANGLES = icosphere(4, (0.05, 0.05, 0.05))
SURFACE = Surface(POINTS, TRIANGLES)


def share(name: str, displacement: np.ndarray) -> float:
    steps = displacement[None]
    history = History(steps, np.zeros_like(steps), np.ones(1))
    return float(METRICS[name].function(SURFACE, history)[0])


def test_a_translation_of_a_ball_is_rigid_and_mostly_tangential() -> None:
    moved = np.tile([0.0, 0.0, 1e-3], (len(POINTS), 1))
    assert_allclose(share("rigid_share", moved), 1.0, rtol=1e-12, atol=0)
    # e - (e.n) n has the mean square 1 - 1/3 over a sphere; the flat facets change it by their size squared
    assert_allclose(share("tangential_share", moved), np.sqrt(2 / 3), rtol=1e-3, atol=0)


def test_a_ball_that_swells_moves_along_its_normals() -> None:
    swollen = 1e-2 * SURFACE.normals
    assert share("tangential_share", swollen) < 1e-12
    assert share("rigid_share", swollen) < 1e-3
    mixed = swollen + np.array([0.0, 0.0, 1e-2])
    assert_allclose(share("rigid_share", mixed), np.sqrt(0.5), rtol=1e-3, atol=0)


@pytest.mark.parametrize("name", ["rigid_share", "tangential_share"])
def test_a_body_at_rest_has_no_share(name: str) -> None:
    assert np.isnan(share(name, np.zeros_like(POINTS)))


def run_with_a_scalar_form() -> Run:
    """The hand-made ball with the model `flat`, which has a tenth too much of the reference's normal component."""
    case = make_case({"flat": 0.0, "vector": 0.1})
    surface = Surface(case.points, case.triangles)
    true = case.models[REFERENCE].displacement
    normal = (true * surface.normals).sum(axis=2, keepdims=True) * surface.normals
    flat = dataclasses.replace(case.models["flat"], displacement=1.1 * normal)
    models = {**case.models, "flat": flat}
    metrics = compare(surface, models, case.load_factors, REFERENCE)
    return make_run([dataclasses.replace(case, models=models, metrics=metrics)])


def test_tables_tell_the_floor_of_a_form_along_normals_and_its_own_measure() -> None:
    run = run_with_a_scalar_form()
    digest = Digest(run)
    found = along_normals(digest, "flat")
    assert found is not None
    floor, own = found
    case = run.cases[0]
    surface, true = Surface(case.points, case.triangles), case.models[REFERENCE].displacement[-1]
    inside = true - (true * surface.normals).sum(axis=1, keepdims=True) * surface.normals
    assert_allclose(
        floor, weighted_norm(inside, surface.areas) / weighted_norm(true, surface.areas), rtol=1e-12
    )
    assert_allclose(own, 0.1, rtol=1e-9, atol=0)
    assert along_normals(digest, "vector") is None
    told = f"at least {percent(floor)}, normal component 10.0 %"
    rows = {row["model"]: row["along normals"] for row in headline.headline_rows(run)}
    assert rows == {"flat": told, "vector": "", f"{REFERENCE} (reference)": ""}
    terminal = [row["model"] for row in headline.terminal_rows(digest)]
    assert f"  along normals: {told}" in terminal
    assert max(map(len, terminal)) <= 80
    section = headline.headline(digest)
    assert section is not None
    page = str(section)
    assert f"along normals: {told}" in page
    assert "A form along normals cannot have" in page
    assert "1 model can move nodes along normals only" in motion_in_words(digest)[-1]
