"""Loads and moduli of any size: the answer follows them to the last, or a status says that it does not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fem_reference.condensed import CondensedProblem
from fem_reference.finite_strain import FiniteStrainProblem
from tests.fem.shapes import ball
from tests.vdm.vdm_shapes import icosphere
from vdm import Load, Model, Parameters, SurfaceMesh

POINTS, TRIANGLES = icosphere(2, (0.05, 0.06, 0.045))
SURFACE = SurfaceMesh(POINTS, TRIANGLES)
BASE, TOP = POINTS[:, 2] < -0.03, POINTS[:, 2] > 0.035
NONLINEAR = ("paper", "vector", "mass-spring")

BODY = ball(1)
HELD = BODY.surface[:, 2] < -0.6
PRESSED = np.where(BODY.facets_where(lambda x: x[:, 2] > 0.5), 1.0, 0.0)
TINY = (1e-300, 1e-170, 1e-40, 1e-18)


def surface_model(formulation: str, solver: str, scale: float = 1.0) -> Model:
    rule = Parameters.from_tissue(5000.0, SURFACE, formulation, held=BASE)
    moduli = {name: np.asarray(value) * scale for name, value in rule.moduli().items()}
    if "shear_modulus" in moduli:
        moduli = {"shear_modulus": float(moduli["shear_modulus"])}
    rule = dataclasses.replace(rule, **moduli)
    return Model(POINTS, TRIANGLES, rule, formulation=formulation, solver=solver, fixed=BASE)


@pytest.mark.parametrize("formulation", NONLINEAR)
def test_a_surface_model_at_large_displacements_refuses_what_rounding_hides(formulation: str) -> None:
    linear, nonlinear = (surface_model(formulation, solver) for solver in ("linear", "nonlinear"))
    # the rule of the linear paper form keeps A_i L_i, the nonlinear one the polyhedron's volume
    slack = 0.01 if formulation == "paper" else 3e-3
    seen = set()
    for pressure in (*TINY, 1e-14, 1e-10, 1e-8, 1e-6, 1e-4):
        load = Load(np.where(TOP, pressure, 0.0))
        status = nonlinear.solve([load]).status[0]
        seen.add(status.code)
        if status.ok:
            expected = linear.solve([load]).displacement[0]
            found = nonlinear.solve([load]).displacement[0]
            assert np.abs(found - expected).max() <= slack * np.abs(expected).max(), pressure
        else:
            assert (status.code, "linear solver" in status.remedy) == ("too-small", True)
            assert pressure <= 1e-6
    assert seen == {"converged", "too-small"}


def test_a_load_that_is_taken_off_is_not_too_small() -> None:
    nonlinear = surface_model("vector", "nonlinear")
    factors = (0.0, 1.0, 1e-13, 0.0, 1e-17)
    found = nonlinear.solve([Load(np.where(TOP, 100.0 * factor, 0.0)) for factor in factors])
    assert all(status.ok for status in found.status)
    largest = np.abs(found.displacement[1]).max()
    assert np.abs(found.displacement[2:]).max() < 1e-6 * largest
    # but the first of a history is: rounding is all that it would be measured by
    assert nonlinear.solve([Load(np.where(TOP, 1e-15, 0.0))]).status[0].code == "too-small"


def test_linear_elements_follow_a_load_of_any_size() -> None:
    for solver in ("direct", "iterative"):
        problem = BODY.problem(HELD, poisson_ratio=0.49, solver=solver)
        whole = problem.solve([BODY.load(PRESSED)])
        for factor in (*TINY, 1e40, 1e99):
            part = problem.solve([BODY.load(factor * PRESSED)])
            assert part.status[0].ok
            assert_allclose(
                part.displacement / factor, whole.displacement, rtol=0, atol=1e-7 * whole_size(whole)
            )
    condensed = CondensedProblem(
        BODY.problem(HELD, poisson_ratio=0.49, solver="direct"), BODY.surface[:, 2] > 0.5
    )
    part = condensed.solve([BODY.load(1e-300 * PRESSED)])
    assert_allclose(part.displacement / 1e-300, whole.displacement, rtol=0, atol=1e-7 * whole_size(whole))


def whole_size(solution: object) -> float:
    return float(np.abs(solution.displacement).max())  # type: ignore[attr-defined]


def test_elements_at_finite_strain_refuse_what_rounding_hides() -> None:
    linear = BODY.problem(HELD, poisson_ratio=0.49)
    problem = FiniteStrainProblem(*BODY.arrays, youngs_modulus=1.0, poisson_ratio=0.49, held=HELD)
    seen = set()
    for pressure in (*TINY, 1e-15, 1e-13, 1e-11, 1e-8):
        load = BODY.load(pressure * PRESSED)
        found = problem.solve([load])
        status = found.status[0]
        seen.add(status.code)
        if status.ok:
            expected = linear.solve([load]).displacement[0]
            assert np.abs(found.displacement[0] - expected).max() <= 1e-4 * np.abs(expected).max(), pressure
        else:
            assert (status.code, "linear solver" in status.remedy) == ("too-small", True)
            assert pressure < 1e-12
    assert seen == {"converged", "too-small"}
    # held nodes that move take the others along, however little
    moved = problem.solve([BODY.load(prescribed=[0.0, 0.0, 1e-18])])
    assert moved.status[0].ok
    assert_allclose(
        moved.displacement[0], np.broadcast_to([0.0, 0.0, 1e-18], (len(HELD), 3)), rtol=0, atol=1e-22
    )
    # a load that is taken off is not too small
    history = problem.solve([BODY.load(factor * PRESSED) for factor in (0.0, 0.05, 1e-15, 0.0)])
    assert all(status.ok for status in history.status)
    assert np.abs(history.displacement[2:]).max() < 1e-6 * np.abs(history.displacement[1]).max()


@pytest.mark.parametrize("scale", [1e-90, 1e90])
@pytest.mark.parametrize("solver", ["single", "refined"])
def test_single_precision_does_not_care_for_the_unit_of_the_moduli(solver: str, scale: float) -> None:
    load = Load(np.where(TOP, 100.0 * scale, 0.0))
    expected = surface_model("vector", "linear").solve([Load(np.where(TOP, 100.0, 0.0))])
    found = surface_model("vector", solver, scale).solve([load])
    assert found.status[0].ok
    tolerance = 1e-5 if solver == "single" else 1e-10
    assert_allclose(found.displacement, expected.displacement, rtol=0, atol=tolerance * whole_size(expected))
