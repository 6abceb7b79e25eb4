"""Large deformation, every formulation: forces from an energy, work, unloading, and turning with the body."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import sparse

from tests.vdm.vdm_shapes import BASE, BODY, POINTS, TRIANGLES, model, pressed
from vdm import FORMULATIONS, Load, Parameters
from vdm.deformed import DeformableSurface
from vdm.formulations.base import Formulation

DEFORMABLE = DeformableSurface(BODY)
# off the axis: the body dents and leans
SIDE = Load(np.where(POINTS @ [0.7, 0.2, 0.6] > 0.035, 300.0, 0.0))
TISSUE = {name: Parameters.from_tissue(5000.0, BODY, name, held=BASE) for name in FORMULATIONS}
SPREAD = sparse.random_array((3 * len(POINTS),) * 2, density=0.01, rng=np.random.default_rng(4), format="csr")
GROUND = sparse.csr_array(5.0 * SPREAD @ SPREAD.T)
FORMS = {
    **{name: (name, parameters) for name, parameters in TISSUE.items()},
    **{
        f"{name}, ground": (name, replace(TISSUE[name], ground=GROUND))
        for name in ("vector", "bem", "mass-spring")
    },
    "paper, stiffening": (
        "paper",
        Parameters(bulk_modulus=20.0, connectivity_modulus=200.0, tension_stiffening=50.0),
    ),
    "vector, none": ("vector", Parameters(surface_tension=60.0, rotation="none")),
    "vector, stretch and foundation": (
        "vector",
        Parameters(surface_tension=60.0, stretch_stiffness=10.0, foundation=1e3),
    ),
    "vector, stretch": ("vector", Parameters(surface_tension=200.0, stretch_stiffness=10.0)),
}
WITH_ENERGY = [name for name in FORMS if not name.startswith("paper")]


@pytest.fixture
def form(request) -> Formulation:
    name, parameters = FORMS[request.param]
    return FORMULATIONS[name](BODY, parameters)


def slope_and_force(form: Formulation) -> tuple[float, float]:
    """Change of the energy along a random direction, by differences, and the work of the force on it."""
    rng = np.random.default_rng(1)
    x = form.unknown(0.003 * rng.standard_normal(POINTS.shape) + 0.1 * POINTS[:, [2, 0, 1]])
    direction = form.unknown(rng.standard_normal(POINTS.shape))

    def energy(step: float) -> float:
        y = x + step * direction
        return form.deformed_energy(y, DEFORMABLE.at(form.displacement(y)))

    h = 1e-5
    slope = (8.0 * (energy(h) - energy(-h)) - (energy(2.0 * h) - energy(-2.0 * h))) / (12.0 * h)
    force = form.deformed_internal_force(x, DEFORMABLE.at(form.displacement(x)))
    return slope, float(np.vdot(form.nodal_force(force), form.displacement(direction)))


@pytest.mark.parametrize("form", WITH_ENERGY, indirect=True)
def test_the_force_is_the_gradient_of_the_energy(form):
    slope, force = slope_and_force(form)
    # fourth-order differences: what they leave out is of the order of (1e-5 / edge length)^4
    assert_allclose(force, slope, rtol=1e-8, atol=0.0)


@pytest.mark.parametrize("formulation", ["consistent", "vector", "bem"])
def test_the_energy_is_the_work_of_the_load_and_goes_back_with_it(formulation):
    body = model(formulation, TISSUE[formulation], solver="nonlinear")

    def history(shares):
        loads = [SIDE.scaled(s) for s in shares]
        solution = body.solve(loads)
        forces = [
            body.formulation.deformed_contact_force(load, DEFORMABLE.at(u))
            for load, u in zip(loads, solution.displacement, strict=True)
        ]
        x = np.array([body.formulation.unknown(u) for u in solution.displacement])
        # the fluid keeps its volume: its pressure does no work
        means = 0.5 * (np.array(forces[1:]) + np.array(forces[:-1]))
        return np.einsum("snc,snc->s", means, np.diff(x, axis=0)), solution.energy

    gaps = []
    for count in (6, 12):
        work, energy = history(np.linspace(0.0, 1.0, count + 1))
        gaps.append(work.sum() / energy[-1] - 1.0)
    # the trapezoidal rule along the path, of second order
    assert abs(gaps[1]) < 5e-4
    assert_allclose(gaps[0] / gaps[1], 4.0, rtol=0.05, atol=0.0)
    # a load taken away never adds energy: it falls at every step, to nothing
    work, energy = history([1.0, 0.8, 0.6, 0.4, 0.2, 0.0])
    assert np.all(work < 0.0)
    assert np.all(np.diff(energy) < 0.0)
    assert abs(energy[-1]) < 1e-12 * energy[0]


@pytest.mark.parametrize("angle", [1.0, 3.0])
@pytest.mark.parametrize("formulation", ["vector", "bem", "mass-spring"])
def test_a_support_that_turns_turns_the_answer(formulation, angle):
    """Held nodes turned by 57 and 172 degrees under facet pressures that follow the surface: the answer, turned."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    body = model(formulation, TISSUE[formulation], solver="nonlinear", fixed=None, constrained=BASE)
    facets = np.where((SIDE.contact_pressure[TRIANGLES] > 0.0).all(axis=1), 300.0, 0.0)
    pushed = pressed(BODY, facets, np.zeros_like(POINTS))
    moved = pressed(BODY, facets, np.where(BASE[:, None], POINTS @ turn - POINTS, 0.0))
    still, turned = (body.solve([load]) for load in (pushed, moved))
    assert still.status[0].ok
    assert turned.status[0].ok
    assert turned.iterations[0] == still.iterations[0], "the body starts carried along, in its own frame"
    # both stop at a residual of 1e-8 of the forces
    size = np.abs(still.displacement).max()
    assert_allclose(
        POINTS + turned.displacement[0],
        (POINTS + still.displacement[0]) @ turn,
        rtol=0.0,
        atol=1e-6 * size,
    )
    assert_allclose(turned.energy, still.energy, rtol=1e-6, atol=0.0)
    assert_allclose(turned.fluid_pressure, still.fluid_pressure, rtol=1e-6, atol=0.0)
    force = np.abs(still.reaction_force).max()
    assert_allclose(turned.reaction_force[0], still.reaction_force[0] @ turn, rtol=0.0, atol=1e-6 * force)


def test_the_body_is_carried_only_by_supports_that_move_as_one():
    """Two nodes say nothing of a rotation about their line: none is made. A finger that pushes carries nothing."""
    ends = np.isin(np.arange(len(POINTS)), [POINTS[:, 2].argmin(), POINTS[:, 2].argmax()])
    rotation_free = Parameters(surface_tension=100.0, rotation="none")
    rod = model("vector", rotation_free, fixed=None, constrained=ends, solver="nonlinear").solver
    rest = np.zeros_like(POINTS)
    shift = np.where(ends[:, None], [0.01, 0.02, 0.0], 0.0)
    moved, turn = rod.carried(rest, shift)
    assert_allclose(turn, np.eye(3), rtol=0.0, atol=1e-12)
    assert_allclose(moved, np.tile([0.01, 0.02, 0.0], (len(POINTS), 1)), rtol=0.0, atol=1e-12)
    finger = POINTS[:, 2] > 0.03
    pushed = model("vector", constrained=finger, solver="nonlinear").solver
    dent = np.where(finger[:, None], [0.0, 0.0, -0.01], 0.0)
    moved, turn = pushed.carried(rest, dent)
    assert_allclose(turn, np.eye(3), rtol=0.0, atol=0.0)
    assert_allclose(moved, dent, rtol=0.0, atol=0.0)
