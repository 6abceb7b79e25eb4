"""The candidates' dense matrices against the library's own operators, and the table against their list."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.unit.vdm_shapes import icosphere
from tools import candidates as c
from tools.accuracy import STUDIES
from vdm.formulations.base import Formulation
from vdm.formulations.vector import VectorFormulation
from vdm.material import Parameters
from vdm.surface import SurfaceMesh

SURFACE = SurfaceMesh(*icosphere(1, (0.06, 0.05, 0.04)))
HELD = SURFACE.points[:, 2] < -0.02
BODY = c.Body(SURFACE, HELD)


def condensed(form: Formulation) -> c.Array:
    """The library's operator with the border unknowns of its rotation eliminated."""
    turns = form.columns.dense()[:, :, 1:].reshape(form.stiffness().shape[0], -1)
    relief = turns @ np.linalg.solve(form.corner[1:, 1:], turns.T) if turns.shape[1] else 0.0
    return np.asarray(form.stiffness().toarray() + relief)


@pytest.mark.parametrize(
    ("matrix", "parameters"),
    [
        (BODY.membrane, Parameters(surface_tension=1.0)),
        (BODY.stretch, Parameters(surface_tension=0.0, stretch_stiffness=1.0, rotation="none")),
        (
            1.1 * SURFACE.equivalent_radius * BODY.grown_membrane,
            Parameters.from_tissue(3.0, SURFACE, "vector", held=HELD),
        ),
    ],
)
def test_sparse_candidates_are_the_library_s_operators(matrix: c.Array, parameters: Parameters) -> None:
    expected = condensed(VectorFormulation(SURFACE, parameters))
    assert_allclose(matrix, expected, rtol=1e-10, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("candidate", c.CANDIDATES, ids=lambda candidate: candidate.name)
def test_rigid_motions_cost_nothing(candidate: c.Candidate) -> None:
    stiffness = candidate.build(BODY, np.array([0.7, 0.3]))
    turned = np.cross([0.3, -0.5, 0.8], SURFACE.points) + np.array([0.01, 0.02, -0.01])
    largest = np.abs(stiffness).max() * np.abs(turned).max()
    rounding = 1e-5 if candidate.name == "boundary integrals" else 1e-11  # quadrature, at single precision
    assert_allclose(stiffness @ turned.reshape(-1), 0.0, rtol=0.0, atol=rounding * largest)
    assert_allclose(stiffness, stiffness.T, rtol=0.0, atol=1e-12 * np.abs(stiffness).max())


def test_the_table_has_a_row_for_every_candidate_and_a_column_for_every_body() -> None:
    columns = c.table_in_readme()
    assert set(STUDIES) <= set(columns)
    names = [candidate.name for candidate in c.CANDIDATES]
    assert all(list(column) == names for column in columns.values())
    assert c.written(columns) in c.README.read_text(encoding="utf-8")
