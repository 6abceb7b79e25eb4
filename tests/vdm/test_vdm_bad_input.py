"""Loads, choices and moduli that mean nothing: one sentence each, before anything is solved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.vdm.vdm_shapes import icosphere
from vdm import Load, Model, Parameters, SurfaceMesh
from vdm.constraints import ConstraintError
from vdm.material import ParameterError

POINTS, TRIANGLES = icosphere(1, (0.05, 0.06, 0.045))
N = len(POINTS)
BASE = POINTS[:, 2] < -0.03
RULE = Parameters.from_tissue(5000.0, SurfaceMesh(POINTS, TRIANGLES), "vector", held=BASE)
PUSH = np.where(POINTS[:, 2] > 0.03, 20.0, 0.0)
ZERO = Load(np.zeros(N), np.zeros((N, 3)), np.zeros((N, 3)))


def model(**options) -> Model:
    return Model(POINTS, TRIANGLES, RULE, formulation="vector", fixed=BASE, **options)


@pytest.mark.parametrize(
    ("part", "value", "words"),
    [
        ("contact_pressure", None, "contact_pressure is missing"),
        ("contact_pressure", "20", "contact_pressure must be real numbers"),
        ("contact_pressure", np.zeros(N, dtype=complex), "contact_pressure must be real numbers"),
        ("contact_pressure", [None] * N, "contact_pressure must be real numbers"),
        ("contact_pressure", [[1.0], [1.0, 2.0]], "contact_pressure must have shape"),
        (
            "contact_pressure",
            np.full(N, 1e200),
            "contact_pressure has values beyond 1e\\+100; check its unit",
        ),
        ("contact_force", np.full((N, 3), -1e200), "contact_force has values beyond"),
        ("prescribed", np.full((N, 3), 1e200), "prescribed has values beyond"),
        ("prescribed", np.zeros((3, N)), "prescribed must have shape"),
        ("contact_pressure", np.full(N, np.nan), "nan or inf"),
        ("contact_force", np.zeros((N, 2)), "contact_force must have shape"),
        (
            "prescribed",
            np.full((N, 3), 1e-3),
            "moves nodes and none is constrained; name them in constrained",
        ),
    ],
)
def test_a_load_that_is_none(part, value, words, monkeypatch):
    body = model()
    monkeypatch.setattr(body.solver, "step", lambda *_: pytest.fail("solved"))
    with pytest.raises(ConstraintError, match=words):
        body.solve([ZERO, replace(ZERO, **{part: value})])


def test_constrained_nodes_need_a_displacement():
    with pytest.raises(ConstraintError, match="prescribed displacement"):
        model(constrained=PUSH > 0.0).solve([Load(PUSH)])


def test_one_load_without_a_list():
    with pytest.raises(ConstraintError, match=r"solve takes a list of loads, .* solve\(\[load\]\)"):
        model().solve(ZERO)


def test_a_load_may_be_lists_of_whole_numbers():
    exact, listed = (model().solve([Load(p)]).displacement for p in (PUSH, [int(p) for p in PUSH]))
    assert np.array_equal(exact, listed)


@pytest.mark.parametrize(
    ("option", "value"),
    [("contact_sign", "outward"), ("volume_row", "exactly"), ("formulation", "paper "), ("solver", "")],
)
def test_a_choice_that_there_is_not(option, value):
    with pytest.raises(ParameterError, match=f"{option} must be one of .*, not '{value}'"):
        Model(POINTS, TRIANGLES, RULE, **{"formulation": "vector", "fixed": BASE, option: value})


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_environment_without_a_pressure(value):
    with pytest.raises(ConstraintError, match="environment_pressure must be finite"):
        model(environment_pressure=value)


@pytest.mark.parametrize("value", ["stiff", 1.0 + 2.0j, [1.0, None], True, -1.0, np.nan])
def test_a_modulus_that_is_no_number(value):
    with pytest.raises(ParameterError, match="bulk_modulus must be finite and not negative"):
        Parameters(bulk_modulus=value)
    with pytest.raises(ParameterError, match="tension_stiffening must be finite and not negative"):
        Parameters(tension_stiffening=value)


@pytest.mark.parametrize("solver", ["linear", "lu", "cg"])
def test_an_answer_beyond_all_numbers_is_a_status(solver):
    soft = Parameters(surface_tension=1e-120)
    body = Model(POINTS, TRIANGLES, soft, formulation="vector", fixed=BASE, solver=solver)
    [status] = body.solve([Load(PUSH)]).status
    assert status.code == "not-finite"
    assert "check the size of the loads and moduli" in status.remedy
