"""The border of a free rotation from one pull per node: the same numbers as its columns written out."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.vdm.vdm_shapes import BASE, BODY, POINTS, TRIANGLES
from vdm import FORMULATIONS, Load, Model, Parameters
from vdm.formulations.border import Columns, DenseColumns, TurningColumns
from vdm.formulations.vector import VectorFormulation
from vdm.problem import Problem
from vdm.solvers.linear import BorderedFactor

RULE = Parameters.from_tissue(5000.0, BODY, "vector")
RNG = np.random.default_rng(3)


def turning(n: int = 7) -> tuple[TurningColumns, DenseColumns]:
    """The same four columns in both forms, the second by numpy's cross product."""
    first, pull = RNG.standard_normal((2, n, 3))
    turns = [np.cross(axis, pull) for axis in np.eye(3)]
    return TurningColumns(first, pull), DenseColumns(np.stack([first, *turns], axis=2))


def test_turning_columns_are_cross_products():
    short, long = turning()
    assert_allclose(short.dense(), long.dense(), rtol=0.0, atol=1e-15)
    assert_allclose(short.at(np.arange(7) > 3).dense(), long.values[4:], rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("sets", [(), (1,), (5,)], ids=["one vector", "a block of one", "a block of five"])
def test_products_with_turning_columns_equal_dense_ones(sets):
    short, long = turning()
    border, vector = RNG.standard_normal((4, *sets)), RNG.standard_normal((21, *sets))
    # sums of four and of twenty-one numbers of the order of one
    assert short.times(border).shape == (7, 3, *sets)
    assert_allclose(short.times(border), long.values @ border, rtol=0.0, atol=1e-14)
    assert short.dotted(vector).shape == (4, *sets)
    assert_allclose(short.dotted(vector), long.values.reshape(21, 4).T @ vector, rtol=0.0, atol=2e-14)
    assert_allclose(long.times(border), short.times(border), rtol=0.0, atol=1e-14)
    assert_allclose(long.dotted(vector), short.dotted(vector), rtol=0.0, atol=2e-14)


def test_magnitudes_are_the_products_of_absolute_values():
    short, long = turning()
    vector = RNG.standard_normal(21)
    expected = np.abs(long.values).reshape(21, 4).T @ np.abs(vector)
    assert_allclose(short.magnitude(vector), expected, rtol=1e-14, atol=0.0)
    assert_allclose(long.magnitude(vector), expected, rtol=1e-14, atol=0.0)


class Written(VectorFormulation):
    """The same form with its border written out: the factor solves every column."""

    def response(self, factor, columns: Columns) -> Columns:
        return super(VectorFormulation, self).response(factor, columns)


def test_responses_of_a_shared_factor_turn_with_the_columns():
    support = Model(POINTS, TRIANGLES, RULE, formulation="vector", fixed=BASE).problem.support
    short, long = (
        BorderedFactor(Problem(form(BODY, RULE), support)) for form in (VectorFormulation, Written)
    )
    assert isinstance(short.response, TurningColumns)
    assert isinstance(long.response, DenseColumns)
    expected = long.response.values
    size = np.abs(expected).max(axis=(0, 1))
    assert_allclose(short.response.dense() / size, expected / size, rtol=0.0, atol=1e-13)
    scale = np.sqrt(np.outer(np.abs(long.schur).diagonal(), np.abs(long.schur).diagonal()))
    assert_allclose(short.schur / scale, long.schur / scale, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("solver", ["linear", "quasi-linear", "nonlinear"])
def test_the_short_border_changes_no_answer(solver, monkeypatch):
    moved = np.where((POINTS[:, 0] > 0.045)[:, None], [1e-3, 0.0, 2e-3], 0.0)
    push = np.where(POINTS[:, 2] > 0.035, 50.0, 0.0)
    loads = [Load(s * push, None, s * moved) for s in (0.5, 1.0)]

    def solved():
        options = {"fixed": BASE, "constrained": moved.any(axis=1), "solver": solver}
        return Model(POINTS, TRIANGLES, RULE, formulation="vector", **options).solve(loads)

    short = solved()
    monkeypatch.setitem(FORMULATIONS, "vector", Written)
    long = solved()
    size = np.abs(long.displacement).max()
    # rounding times the condition; the nonlinear steps may stop at another iterate of the same residual
    tolerance = 1e-8 if solver == "nonlinear" else 1e-12
    assert_allclose(short.displacement, long.displacement, rtol=0.0, atol=tolerance * size)
    assert_allclose(short.fluid_pressure, long.fluid_pressure, rtol=10 * tolerance, atol=0.0)
    force = np.abs(long.reaction_force).max()
    assert_allclose(short.reaction_force, long.reaction_force, rtol=0.0, atol=10 * tolerance * force)


def test_a_coupled_factor_solves_every_column():
    stretched = Parameters(surface_tension=60.0, stretch_stiffness=10.0)
    solver = Model(POINTS, TRIANGLES, stretched, formulation="vector", fixed=BASE).solver
    assert isinstance(solver.problem.formulation.columns, TurningColumns)
    assert isinstance(solver.factor.response, DenseColumns)
