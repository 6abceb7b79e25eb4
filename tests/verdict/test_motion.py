"""What an answer's motion is made of: closed forms on a ball, and the floor of forms along normals."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.report.runs import REFERENCE, make_case, make_run
from tests.vdm.vdm_shapes import icosphere
from vdmbench.body.surface_measures import Surface, weighted_norm
from vdmbench.measures.case import Run
from vdmbench.measures.metrics import METRICS, History
from vdmbench.verdict.digest import Digest
from vdmbench.verdict.verdict import verdicts
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
    """The hand-made ball with vdm-paper, which has a tenth too much of the reference's normal component."""
    case = make_case({"vdm-paper": 0.0, "vdm-vector": 0.1})
    surface = Surface(case.points, case.triangles, case.regions["finger"])
    true = case.models[REFERENCE].displacement
    normal = (true * surface.normals).sum(axis=2, keepdims=True) * surface.normals
    models = {
        **case.models,
        "vdm-paper": dataclasses.replace(case.models["vdm-paper"], displacement=1.1 * normal),
    }
    metrics = compare(surface, models, case.load_factors, REFERENCE)
    return make_run([dataclasses.replace(case, models=models, metrics=metrics)])


def test_the_normal_error_leads_for_a_form_along_normals_beside_its_floor() -> None:
    digest = Digest(run_with_a_scalar_form())
    case = digest.cases[0]
    surface, true = Surface(case.points, case.triangles), case.models[REFERENCE].displacement[-1]
    inside = true - (true * surface.normals).sum(axis=1, keepdims=True) * surface.normals
    floor = weighted_norm(inside, surface.areas) / weighted_norm(true, surface.areas)
    assert_allclose(digest.floor("vdm-paper"), floor, rtol=1e-12, atol=0)
    assert np.isnan(digest.floor("vdm-vector"))
    found = verdicts(digest)
    printed, derived = found["vdm-printed"].figures, found["vdm-derived"].figures
    assert (printed.lead, derived.lead) == ("normal error", "displacement error")
    assert_allclose(printed.value, 0.1, rtol=1e-9, atol=0)
