"""Lumps in a body of boundary elements, against the exact answer of a layered ball and against no lump at all."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.vdm.vdm_shapes import icosphere
from vdm import Load, Model, Parameters, SurfaceMesh
from vdm.material import Lumps, ParameterError
from vdm.parts.lumps import LumpyFormulation
from vdm.peers.bem import BoundaryFormulation

BALL = SurfaceMesh(*icosphere(2))
GRAVITY = np.array([1.0, 2.0, -9.0])


def balls(
    places: list[tuple[float, float, float]], radii: list[float], moduli: list[float], nu: float
) -> Lumps:
    """Balls of 42 nodes, each inside the one before it where `places` are the same, else apart."""
    x, t = icosphere(1)
    n = len(x)
    points = np.vstack([np.array(place) + radius * x for place, radius in zip(places, radii, strict=True)])
    facets = np.vstack([len(BALL.points) + k * n + t for k in range(len(radii))])
    around = [0, *(1 + k if one == two else 0 for k, (one, two) in enumerate(pairwise(places)))]
    sides = np.repeat(np.stack([np.arange(1, len(radii) + 1), around], axis=1), len(t), axis=0)
    return Lumps(points, facets, sides, np.array(moduli), np.full(len(radii), nu))


def form_of(lumps: Lumps | None, nu: float) -> BoundaryFormulation:
    parameters = Parameters(shear_modulus=1.0, poisson_ratio=nu, lumps=lumps)
    form = BoundaryFormulation if lumps is None else LumpyFormulation
    return form(BALL, parameters, np.zeros(BALL.n_nodes, bool))


def spheroidal(shear: float, nu: float, r: float) -> np.ndarray:
    """(4, 4) f, g, sigma_rr and sigma_rt at r of the four `u = f s n + g (E n - s n)`, `s = n.E n` of trace E = 0.

    The first two are regular at r = 0 (Christensen and Lo 1979, with s in place of sin^2 cos 2 phi).
    """
    k = 1.0 / (1.0 - 2.0 * nu)
    powers, along = (
        np.array([1.0, 3.0, -4.0, -2.0]),
        np.array([1.0, -6.0 * nu * k, 3.0, (5.0 - 4.0 * nu) * k]),
    )
    across = np.array([1.0, -(7.0 - 4.0 * nu) * k, -2.0, 2.0])
    f, g = along * r**powers, across * r**powers
    df, dg = powers * f / r, powers * g / r
    swells = df + (2.0 * f - 3.0 * g) / r
    stress = 2.0 * shear * (nu * k * swells + df)
    return np.array([f, g, stress, shear * (dg + (2.0 * f - g) / r)])


def radial(shear: float, nu: float, r: float) -> np.ndarray:
    """(2, 2) u and sigma_rr of `u = A r` and `u = B / r^2`."""
    bulk = (1.0 + nu) / (1.0 - 2.0 * nu)
    return np.array([[r, r**-2], [2.0 * shear * bulk, -4.0 * shear / r**3]])


def layered(
    modes: Callable[[float, float, float], np.ndarray], radii: list[float], moduli: list[float], nu: float
) -> np.ndarray:
    """Displacements at the outermost of concentric layers under unit tractions, the first the core's."""
    (inner, *further), (core, *around) = radii, moduli
    state = modes(core, nu, inner)
    known = state[:, : len(state) // 2]
    for before, r, shear in zip(radii, further, around, strict=False):
        known = modes(shear, nu, r) @ np.linalg.solve(modes(shear, nu, before), known)
    moved, stress = np.split(known, 2)
    return np.asarray(moved @ np.linalg.solve(stress, np.ones(len(stress))))


@pytest.mark.parametrize("ratio", [0.1, 3.0, 10.0, 100.0])
@pytest.mark.parametrize(("radii", "core"), [([0.6, 1.0], None), ([0.35, 0.7, 1.0], 1.0)])
def test_a_ball_with_a_lump_and_with_one_in_a_lump(
    ratio: float, radii: list[float], core: float | None
) -> None:
    """Compliance under a uniform and under a deviatoric stress, against balls of the same volumes: 0.4 %."""
    nu, lumps = 0.3, [ratio] if core is None else [ratio, core]
    size, outer = (
        (4.0 / 3.0 * np.pi / surface.volume) ** (1.0 / 3.0) for surface in (SurfaceMesh(*icosphere(1)), BALL)
    )
    form = form_of(balls([(0.0, 0.0, 0.0)] * len(lumps), [size * r for r in radii[-2::-1]], lumps, nu), nu)
    radii, moduli = [*radii[:-1], 1.0 / outer], [*reversed(lumps), 1.0]
    area = 4.0 * np.pi * radii[-1] ** 2
    (swelling,), (along, across) = (layered(modes, radii, moduli, nu) for modes in (radial, spheroidal))
    deviator = np.diag([1.0, -1.0, 0.0])  # means of s^2 and |E n|^2 over a ball: 2 E:E / 15 and E:E / 3
    for stress, exact in (
        (np.eye(3), swelling),
        (deviator, along * 4.0 / 15.0 + across * (2.0 / 3.0 - 4.0 / 15.0)),
    ):
        force = (BALL.area_vectors @ stress).reshape(-1)
        moved = np.linalg.lstsq(form.matrix, force, rcond=1e-10)[0]
        assert force @ moved == pytest.approx(area * exact, rel=0.004)


@pytest.mark.parametrize("nu", [0.3, 0.5])
def test_lumps_of_the_bodys_own_material_change_nothing(nu: float) -> None:
    apart = [(0.4, 0.0, 0.1), (-0.4, 0.1, 0.0)]
    lumpy, plain = form_of(balls(apart, [0.3, 0.2], [1.0, 1.0], nu), nu), form_of(None, nu)
    x = BALL.points
    smooth = np.stack([x[:, 1] * x[:, 2], x[:, 0] ** 2 - x[:, 1] ** 2, x[:, 0] + x[:, 2] ** 2], axis=1)
    if nu == 0.5:  # a change of volume is the constraint's
        smooth -= x * (np.vdot(smooth, BALL.area_vectors) / np.vdot(x, BALL.area_vectors))
    forces = [form.elastic_force(smooth) for form in (lumpy, plain)]
    if nu == 0.5:  # forces of a uniform pressure are the border's
        forces = [
            f - BALL.area_vectors * (np.vdot(f, BALL.area_vectors) / (BALL.area_vectors**2).sum())
            for f in forces
        ]
    size = np.abs(forces[1]).max()
    assert_allclose(forces[0], forces[1], rtol=0.0, atol=0.01 * size)
    weights = [form.pressure_force(x @ GRAVITY) for form in (lumpy, plain)]
    assert_allclose(weights[0], weights[1], rtol=0.0, atol=0.01 * np.abs(weights[1]).max())


def test_rigid_motions_cost_nothing_and_the_matrix_is_symmetric() -> None:
    form = form_of(balls([(0.0, 0.0, 0.0)] * 2, [0.6, 0.3], [10.0, 0.1], 0.5), 0.45)
    assert_allclose(form.matrix, form.matrix.T, rtol=0.0, atol=1e-12 * np.abs(form.matrix).max())
    turn = np.cross([0.3, -1.0, 2.0], BALL.points) + np.array([1.0, 2.0, 3.0])
    assert np.abs(form.elastic_force(turn)).max() < 1e-10 * np.abs(form.matrix).max()


def test_supports_carry_the_weight_and_a_stiff_lump_stiffens() -> None:
    held, top = BALL.points[:, 2] < -0.6, BALL.points[:, 2] > 0.8
    sag = []
    for ratio in (0.1, 1.0, 100.0):
        parameters = Parameters(
            shear_modulus=1e3, poisson_ratio=0.4, lumps=balls([(0.0, 0.0, 0.2)], [0.5], [1e3 * ratio], 0.4)
        )
        model = Model(
            BALL.points,
            BALL.triangles,
            parameters,
            formulation="bem",
            fixed=held,
            density=10.0,
            gravity=GRAVITY,
        )
        found = model.solve([Load(np.where(top, 50.0, 0.0))])
        assert found.status[0].ok
        push = -(BALL.area_vectors * np.where(top, 50.0, 0.0)[:, None]).sum(axis=0)
        weight = 10.0 * BALL.volume * GRAVITY
        assert_allclose(-found.reaction_force[0].sum(axis=0), weight + push, rtol=1e-6, atol=1e-6)
        sag.append(np.abs(found.displacement[0][top]).max())
    assert sag[0] > 1.05 * sag[1] > 1.05 * 1.05 * sag[2]


def test_what_they_cannot_do_is_told() -> None:
    one = balls([(0.4, 0.0, 0.0), (-0.4, 0.0, 0.0)], [0.2, 0.2], [1.0, 1.0], 0.3)
    circle = np.tile([[1, 0], [2, 0], [1, 2]], (len(one.facets) // 3 + 1, 1))[: len(one.facets)]
    with pytest.raises(ParameterError, match="lumps touch each other"):
        replace(one, sides=circle)
    for formulation, solver in (("bem", "nonlinear"), ("bem-sparse", "linear")):
        with pytest.raises(ValueError, match="lumps inside need"):
            Model(
                BALL.points,
                BALL.triangles,
                Parameters(shear_modulus=1.0, lumps=one),
                formulation=formulation,
                fixed=BALL.points[:, 2] < 0.0,
                solver=solver,
            )
