"""The plain path: scikit-fem's own forms, against the fast path and against what is known of any equilibrium."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from fem_reference import finite_strain_assembly
from fem_reference.finite_strain import FiniteStrainProblem
from fem_reference.forces import traction_forces
from fem_reference.linear import LinearProblem
from fem_reference.plain_finite_strain import PlainFiniteStrainProblem
from fem_reference.plain_linear import PlainLinearProblem
from fem_reference.springs import ElasticSupport
from tests.fem.shapes import FIELDS, Body, assert_same, cube

FIBRES = {"fibre_direction": [1.0, 2.0, 0.5], "contrast": 5.0}


def rollers(b: Body) -> NDArray[np.bool_]:
    """Single components held at parts of two faces of the cube, some of them at lone vertices."""
    x, y, _ = b.surface.T
    return np.stack([b.bottom & (x < 0.5), b.bottom & (y < 0.8), b.bottom | (x < 1e-12)], axis=1)


@pytest.mark.parametrize("fibres", [{}, FIBRES], ids=["isotropic", "fibres"])
@pytest.mark.parametrize("nu", [-0.4, 0.5])
@pytest.mark.parametrize("support", [lambda b: b.bottom, rollers], ids=["base", "rollers"])
def test_linear_equals_the_fast_path(
    support, nu: float, fibres: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(finite_strain_assembly, "_CHUNK", 20)  # several passes on a small mesh
    b = cube(2, distort=0.25)
    rng = np.random.default_rng(0)
    pressure = rng.uniform(0.0, 200.0, (len(b.triangles), 6))  # its own value at every point of every facet
    moved = rng.uniform(-0.1, 0.1, (len(b.surface), 3))
    loads = [b.load(pressure, gravity=(0.4, -0.7, 0.5)), b.load(0.1 * pressure, prescribed=moved)]
    young = 3000.0 * np.linspace(1.0, 3.0, len(b.tetrahedra)) if fibres else 3000.0
    settings = {"youngs_modulus": young, "poisson_ratio": nu, "density": 300.0, "held": support(b), **fibres}
    plain = PlainLinearProblem(*b.arrays, **settings).solve(loads)
    fast = LinearProblem(*b.arrays, **settings, solver="direct").solve(loads)
    assert_same(plain, fast, 1e-10)
    assert all(np.abs(getattr(fast, name)).max() > 0.0 for name in FIELDS)
    unknowns = fast.parameters["dofs"]
    if support is not rollers:  # where nodes are held whole, the fast path takes them out as well
        assert plain.parameters["dofs"] == unknowns


def two_parts(b: Body) -> dict[str, NDArray[np.float64] | NDArray[np.int64]]:
    """Moduli that vary from tetrahedron to tetrahedron, in two parts."""
    rng = np.random.default_rng(3)
    right = b.points[b.tetrahedra].mean(axis=1)[:, 0] > 0.5
    young = rng.uniform(1000.0, 4000.0, len(right)) * np.where(right, 10.0, 1.0)
    ratio = np.where(right, 0.5, rng.uniform(0.3, 0.49, len(right)))
    return {"youngs_modulus": young, "poisson_ratio": ratio, "parts": right.astype(np.int64)}


def test_moduli_of_each_tetrahedron_and_a_pressure_that_jumps_are_the_fast_paths() -> None:
    b = cube(2, distort=0.25)
    load = b.load(np.where(b.top, 300.0, 0.0), gravity=(1.0, 2.0, 3.0))
    settings = {**two_parts(b), "density": 300.0, "held": b.bottom}
    plain = PlainLinearProblem(*b.arrays, **settings)
    fast = LinearProblem(*b.arrays, **settings, solver="direct")
    assert_same(plain.solve([load]), fast.solve([load]), 1e-10)
    found, fields = plain.dofs(load), fast.fields(load)
    assert_allclose(found.pressure, fields.pressure[0], rtol=0, atol=1e-9 * np.abs(found.pressure).max())
    assert len(found.pressure) > len(b.points), "the vertices between the parts have two pressures"
    small = cube(1)
    load = small.load(100.0, gravity=(1.0, 2.0, 3.0))
    settings = {**two_parts(small), "density": 300.0, "held": small.bottom}
    plain_large = PlainFiniteStrainProblem(*small.arrays, **settings).solve([load])
    fast_large = FiniteStrainProblem(*small.arrays, **settings, tolerance=1e-11).solve([load])
    assert_same(plain_large, fast_large, 1e-9)


def test_springs_and_given_forces_are_the_fast_paths() -> None:
    b = cube(1)
    side, top = (b.facets_where(lambda x, i=i: x[:, i] > 1.0 - 1e-12) for i in (0, 2))
    rng = np.random.default_rng(0)
    supports = [
        ElasticSupport(side, rng.uniform(1e3, 1e4, len(side))),
        ElasticSupport(side | top, 500.0, "full"),
    ]
    held = b.bottom & (b.surface[:, 0] < 0.5)
    settings = {"youngs_modulus": 3000.0, "poisson_ratio": 0.45, "held": held, "elastic_supports": supports}
    fast = LinearProblem(*b.arrays, **settings, solver="direct")
    forces = traction_forces(fast.mesh, np.where(top[:, None, None], (200.0, -100.0, 150.0), 0.0))
    load = dataclasses.replace(b.load(np.where(side, 100.0, 0.0)), forces=forces)
    assert_same(PlainLinearProblem(*b.arrays, **settings).solve([load]), fast.solve([load]), 1e-10)
    large = FiniteStrainProblem(*b.arrays, **settings, tolerance=1e-11).solve([load])
    assert_same(PlainFiniteStrainProblem(*b.arrays, **settings).solve([load]), large, 1e-9)


@pytest.mark.parametrize(
    ("nu", "pressure", "fibres"),
    [
        (0.4999, "follower", {**FIBRES, "material": "transversely-isotropic"}),
        (0.5, "dead", {}),
    ],
)
def test_finite_strain_equals_the_fast_path(nu: float, pressure: str, fibres: dict[str, object]) -> None:
    b = cube(1)
    top = b.top
    press = np.where(top[:, None], np.random.default_rng(0).uniform(200.0, 400.0, (len(top), 6)), 0.0)
    loads = [b.load(press, prescribed=(0.1, 0.2, -0.1), gravity=(0.4, -0.7, 0.5))]
    settings = {
        "youngs_modulus": 3000.0,
        "poisson_ratio": nu,
        "density": 300.0,
        "held": b.bottom,
        "pressure": pressure,
        **fibres,
    }
    outputs = frozenset({"max_det_f_deviation", "max_principal_strain", "p95_principal_strain", "volume"})
    plain = PlainFiniteStrainProblem(*b.arrays, **settings).solve(loads, outputs)
    fast = FiniteStrainProblem(*b.arrays, **settings, tolerance=1e-11).solve(loads, outputs)
    assert np.abs(plain.displacement).max() > 0.1, "the deformation is large"
    assert_same(plain, fast, 1e-9)
    for name in (*outputs, "load_factor"):
        assert_allclose(plain.scalars[name], fast.scalars[name], rtol=1e-8, atol=0, err_msg=name)


def test_a_load_beyond_the_first_attempt_is_reached_in_substeps_or_refused() -> None:
    b = cube(1)
    settings = {
        "youngs_modulus": 1.0,
        "poisson_ratio": 0.45,
        "held": b.bottom | (b.surface[:, 2] > 1 - 1e-12),
    }
    top = b.surface[:, 2] > 1.0 - 1e-12
    problem = PlainFiniteStrainProblem(*b.arrays, **settings)

    def pressed(depth: float):
        return b.load(prescribed=np.where(top[:, None], (0.0, 0.0, -depth), 0.0))

    through = problem.solve([pressed(0.6), pressed(1.2), pressed(0.1)], frozenset({"volume"}))
    assert [s.code for s in through.status] == ["converged", "not-converged", "not-reached"]
    assert 0.0 < through.scalars["load_factor"][1] < 1.0
    assert np.isnan(through.displacement[2]).all()
    assert "of load step 2" in through.status[1].message
