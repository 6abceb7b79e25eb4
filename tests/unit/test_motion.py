"""What an answer's motion is made of: closed forms on a ball, and the words of the verdict."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.unit.vdm_shapes import icosphere
from vdmbench.body.surface_measures import Surface
from vdmbench.measures.metrics import METRICS, History

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
