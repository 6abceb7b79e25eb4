"""Local contact in single precision and with a shortened far field: the same displacements as the long way."""

from __future__ import annotations

import numpy as np
import pytest

from tests.vdm.vdm_shapes import icosphere
from vdm import ConstraintError, Load, Model, Parameters, SurfaceMesh
from vdm.solvers import columns
from vdm.solvers.compliance import ContactCompliance

POINTS, TRIANGLES = icosphere(4, (0.06, 0.05, 0.045))
BODY = SurfaceMesh(POINTS, TRIANGLES)
BASE = POINTS[:, 2] < -0.035
PATCH = np.argsort(-POINTS[:, 2])[:50]


@pytest.fixture(scope="module", params=["paper", "consistent", "vector"])
def solver(request) -> Model:
    material = Parameters.from_tissue(5000.0, BODY, request.param)
    return Model(POINTS, TRIANGLES, material, formulation=request.param, fixed=BASE)


def error_of_a_frame(contact: ContactCompliance, body: Model, nodes, pressure) -> float:
    """Of displacement and fluid's pressure against the full solve, the larger in parts of its largest value."""
    load = np.zeros(len(POINTS))
    load[nodes] = pressure
    solution = body.solve([Load(load)])
    unknown, fluid = contact.frame(nodes, pressure)
    moved, full = body.formulation.displacement(unknown), solution.displacement[0]
    size = np.abs(full).max()
    if not size:
        return float(np.abs(moved).max())
    return max(np.abs(moved - full).max() / size, abs(fluid / solution.fluid_pressure[0] - 1.0))


def test_frames_of_a_resting_contact_equal_the_full_solve(solver):
    contact = ContactCompliance(solver.problem)
    rng = np.random.default_rng(5)
    pressures = [rng.random(50), rng.random(50) ** 8, np.eye(50)[7], np.eye(50)[49], np.zeros(50)]
    for k, pressure in enumerate(100.0 * np.array(pressures)):
        assert error_of_a_frame(contact, solver, PATCH, pressure) < 1e-6
        assert (contact.prepare(PATCH)._short is not None) == (k > 0), "shortened at the second frame"
    columns = contact.prepare(PATCH)
    short = columns._short
    assert short is not None
    assert len(short.bases) == solver.formulation.components
    assert all(basis.shape[1] < 30 for basis in short.bases)
    assert sum(basis.shape[1] for basis in short.bases) == len(short.mixes)
    assert columns.nbytes < 0.75 * columns.columns.nbytes


def test_a_contact_all_over_the_body_is_not_shortened(solver):
    nodes = np.flatnonzero(~BASE)[::50]
    contact = ContactCompliance(solver.problem)
    for _ in range(3):
        assert error_of_a_frame(contact, solver, nodes, np.full(len(nodes), 50.0)) < 1e-6
    assert contact.prepare(nodes)._short is None
    with pytest.raises(ConstraintError, match="contact nodes"):
        contact.prepare(np.array([len(POINTS)]))


@pytest.mark.parametrize(("axis", "least"), [(0, 0.5), (2, 0.3)])
def test_a_contact_is_shortened_from_where_it_reads_least(axis, least, monkeypatch):
    """Amid a long body more of its nodes stay whole than at its end; no other reach gives less."""
    points, triangles = icosphere(4, (0.02, 0.02, 0.12))
    body = SurfaceMesh(points, triangles)
    material = Parameters.from_tissue(5000.0, body, "vector")
    model = Model(points, triangles, material, formulation="vector", fixed=points[:, 2] < -0.1)
    nodes = np.argsort(-points[:, axis])[:20]
    sizes = []
    for reaches in (columns.REACHES, *columns.REACHES[:, None]):
        monkeypatch.setattr(columns, "REACHES", reaches)
        contact = ContactCompliance(model.problem)
        for _ in range(2):
            contact.frame(nodes, np.full(len(nodes), 50.0))
        sizes.append(contact.prepare(nodes).nbytes)
    assert sizes[0] == min(sizes[1:])
    assert least < sizes[0] / contact.prepare(nodes).columns.nbytes < least + 0.4


def test_the_printed_sign_holds_for_columns_too():
    material = Parameters.from_tissue(5000.0, BODY, "consistent")
    body = Model(POINTS, TRIANGLES, material, formulation="consistent", fixed=BASE, contact_sign="printed")
    pressure = np.linspace(1.0, 50.0, len(PATCH))
    contact = ContactCompliance(body.problem)
    assert error_of_a_frame(contact, body, PATCH, pressure) < 1e-6
    found = body.formulation.displacement(contact.frame(PATCH, pressure)[0])
    assert found[PATCH[0]] @ BODY.normals[PATCH[0]] > 0.0, "bulges towards the finger"


def test_the_sparse_form_leaves_out_what_its_own_error_hides():
    """Its columns look alike only but for their interpolation, 1e-4 of them."""
    body = Model(
        POINTS,
        TRIANGLES,
        Parameters(shear_modulus=2e3, coarse_nodes=400),
        formulation="bem-sparse",
        fixed=BASE,
    )
    contact, pressure = ContactCompliance(body.problem), np.random.default_rng(7).random(50)
    contact.frame(PATCH, pressure)
    error = error_of_a_frame(contact, body, PATCH, pressure)
    columns = contact.prepare(PATCH)
    assert columns.nbytes < 0.8 * columns.columns.nbytes
    assert 1e-7 < error < 1e-4
