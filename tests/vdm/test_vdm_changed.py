"""Supports that change without a new set-up: the same answers as a new factor of the same form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.vdm.vdm_shapes import BASE, POINTS, TRIANGLES
from vdm import FORMULATIONS, ConstraintError, Load, Model, Parameters, SolverError, SurfaceMesh
from vdm.solvers.changed import ChangedSupport
from vdm.solvers.linear import LinearSolver

FEWER = BASE & (POINTS[:, 0] > -0.01)
SIDE = POINTS[:, 1] > 0.05
NOBODY = np.zeros(len(POINTS), dtype=np.bool_)
PUSH = Load(np.where(POINTS[:, 2] > 0.035, 20.0, 0.0))
PULL = np.where(SIDE[:, None], [0.001, 0.002, -0.001], 0.0)
GRAVITY = {"density": 1060.0, "gravity": (0.0, 0.0, -9.81)}


def model(formulation: str, fixed, constrained=NOBODY, rule_of=BASE) -> Model:
    """The parameters are those of one support, as they would be without a new set-up."""
    rule = Parameters.from_tissue(5000.0, SurfaceMesh(POINTS, TRIANGLES), formulation, held=rule_of)
    return Model(
        POINTS, TRIANGLES, rule, formulation=formulation, fixed=fixed, constrained=constrained, **GRAVITY
    )


@pytest.mark.parametrize(
    ("formulation", "fixed", "moved"),
    [("vector", *held) for held in ((BASE | SIDE, NOBODY), (FEWER, NOBODY), (BASE, SIDE), (BASE, NOBODY))]
    + [(name, FEWER, SIDE) for name in FORMULATIONS],
)
def test_a_changed_support_answers_as_the_long_way(formulation, fixed, moved):
    solver = model(formulation, BASE).solver
    assert isinstance(solver, LinearSolver)
    load = Load(PUSH.contact_pressure, None, PULL) if moved.any() else PUSH
    step = ChangedSupport(solver, fixed, moved).step(load)
    support = replace(solver.problem.support, fixed=fixed, constrained=moved)
    right = LinearSolver(replace(solver.problem, support=support)).step(load)
    for found, expected in (
        (step.displacement, right.displacement),
        (step.reaction_force, right.reaction_force),
        (step.pressure_change, right.pressure_change),
        (step.energy, right.energy),
    ):
        # two ways to the same numbers: rounding, and what the conditions of the two systems make of it
        assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    # the supports matter here: the model's own answer is another
    if formulation != "paper" and not np.array_equal(fixed | moved, BASE):
        own = solver.step(PUSH).displacement
        assert np.abs(own - step.displacement).max() > 0.03 * np.abs(own).max()


def test_supports_that_let_the_body_go_are_refused():
    solver = model("bem", BASE).solver
    with pytest.raises(SolverError, match="leave the body free to move"):
        ChangedSupport(solver, NOBODY)
    with pytest.raises(ConstraintError, match="mask of 162 booleans"):
        ChangedSupport(solver, BASE[:5])
