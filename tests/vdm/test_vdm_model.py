"""The entry `Model`: identities of the linear model, shortcuts, bad input, and bodies that lie otherwise."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.vdm.vdm_shapes import BASE, BODY, POINTS, TRIANGLES, box, icosphere, model, torus
from tests.verification.records import Verified
from vdm import (
    FORMULATIONS,
    Load,
    Model,
    ParameterError,
    Parameters,
    SolverError,
    SurfaceMesh,
)
from vdm.material import ROTATIONS, ball_compliance
from vdm.solvers import SOLVERS

FINGER = Load(np.where(POINTS[:, 2] > 0.035, 200.0, 0.0))
NAMES = list(FORMULATIONS)


SHAPES = {"ellipsoid": lambda: (POINTS, TRIANGLES), "torus": torus, "box": lambda: box(4, (0.1, 0.1, 0.05))}


@pytest.mark.anchor("VDM: fluid pressure of a free body", "dP = sum A_i p_i / A, from equations 16 and 19")
@pytest.mark.parametrize("links", ["constant", "random"])
@pytest.mark.parametrize("shape", SHAPES)
def test_fluid_pressure_of_a_free_body_is_the_mean_contact_pressure(shape, links, verified: Verified):
    points, triangles = SHAPES[shape]()
    surface = SurfaceMesh(points, triangles)
    rng = np.random.default_rng(0)
    coupling = rng.uniform(10.0, 1e4, len(surface.edges)) if links == "random" else 3000.0
    pressure = rng.uniform(0.0, 500.0, len(points))
    solution = Model(points, triangles, Parameters(bulk_modulus=7.0, connectivity_modulus=coupling)).solve(
        [Load(pressure)]
    )
    expected = surface.nodal_areas @ pressure / surface.area
    # the matrix has condition 1e3 to 1e5
    verified.at_most(f"dP, {links} B_ij, {shape}", solution.fluid_pressure / expected - 1.0, 1e-10)


@pytest.mark.parametrize("formulation", NAMES)
def test_a_push_dents_and_the_printed_sign_bulges(formulation):
    inward = model(formulation).solve([FINGER])
    printed = model(formulation, contact_sign="printed").solve([FINGER])
    top = np.argmax(POINTS[:, 2])
    assert inward.displacement[0, top, 2] < -1e-4
    assert_allclose(printed.displacement, -inward.displacement, rtol=0.0, atol=1e-17)
    # an environment's pressure only shifts the fluid's
    shifted = model(formulation, environment_pressure=1e3).solve([FINGER])
    assert_allclose(shifted.fluid_pressure, inward.fluid_pressure + 1e3, rtol=1e-14, atol=0.0)
    assert_allclose(shifted.displacement, inward.displacement, rtol=0.0, atol=0.0)


@pytest.mark.parametrize("formulation", NAMES)
def test_gravity_datum_changes_the_pressure_only(formulation):
    def hanging(gravity, shift):
        points = POINTS + np.array([0.0, 0.0, shift])
        return Model(
            points,
            TRIANGLES,
            Parameters.from_tissue(5000.0, BODY, formulation),
            formulation=formulation,
            fixed=BASE,
            density=1060.0,
            gravity=gravity,
        ).solve([Load(np.zeros(len(points)))])

    low, high = hanging((0.0, 0.0, -9.81), 0.0), hanging((0.0, 0.0, -9.81), 2.0)
    size = np.abs(low.displacement).max()
    assert size > 1e-5
    assert_allclose(high.displacement, low.displacement, rtol=0.0, atol=1e-9 * size)
    assert_allclose(high.fluid_pressure, low.fluid_pressure, rtol=1e-9, atol=0.0)
    # delta_i as a further contact: a datum 1 m higher adds rho g to every delta and takes it from dP
    depth = POINTS[:, 2].max() - POINTS[:, 2]
    by_hand = model(formulation).solve([Load(-1060.0 * 9.81 * (depth + 1.0))])
    # weight also presses the nodes that boundary elements add at rims, a pressure on given nodes does not
    left = 0.02 if formulation.startswith("bem") else 1e-9
    assert_allclose(by_hand.displacement, low.displacement, rtol=0.0, atol=left * size)
    assert_allclose(by_hand.fluid_pressure, low.fluid_pressure - 1060.0 * 9.81, rtol=0.1 * left, atol=0.0)


@pytest.mark.parametrize("formulation", NAMES)
def test_normal_traction_balances_fluid_and_contact(formulation):
    body = model(formulation)
    step = body.solver.step(FINGER)
    expected = step.pressure_change - FINGER.contact_pressure
    assert_allclose(step.normal_traction[~BASE], expected[~BASE], rtol=0.0, atol=1e-8)
    assert body.solve([]).displacement.shape == (0, len(POINTS), 3)


def test_rule_from_tissue_matches_the_ball():
    ball = SurfaceMesh(*icosphere(4, (0.05, 0.05, 0.05)))
    mu, radius = 5000.0 / 3.0, ball.equivalent_radius
    rule = Parameters.from_tissue(5000.0, ball, "consistent")
    for degree in (2, 3):
        compliance = 1.0 / (rule.foundation + degree * (degree + 1) * rule.surface_tension / radius**2)
        assert_allclose(compliance, ball_compliance(degree) * radius / mu, rtol=1e-13, atol=0.0)
    assert_allclose(
        [ball_compliance(n) for n in (2, 3, 4, 5)], [0.26316, 0.15909, 0.11765, 0.09418], rtol=0.0, atol=5e-6
    )
    paper = Parameters.from_tissue(5000.0, ball, "paper")
    assert_allclose(paper.bulk_modulus * ball.area / ball.volume, rule.foundation, rtol=1e-14, atol=0.0)


def test_tension_grows_as_the_root_of_the_distance_from_the_support():
    """And is 0.7 mu R where nothing is held."""
    held = BODY.points[:, 2] < BODY.points[:, 2].min() + 1e-3
    i, j = BODY.edges.T
    nearest = np.linalg.norm(BODY.points[:, None] - BODY.points[held][None], axis=2).min(axis=1)
    length = np.linalg.norm(BODY.points[i] - BODY.points[j], axis=1)
    distance = np.maximum(0.5 * (nearest[i] + nearest[j]), 0.5 * length)
    assert held.any()
    assert (distance > 0.5 * length).any()
    for rotation in ROTATIONS:
        rule = Parameters.from_tissue(5000.0, BODY, "vector", rotation, held)
        expected = 1.1 * 5000.0 / 3.0 * np.sqrt(BODY.equivalent_radius * distance)
        assert rule.rotation == rotation
        assert_allclose(rule.surface_tension, expected, rtol=1e-12, atol=0.0)
        free = Parameters.from_tissue(5000.0, BODY, "vector", rotation)
        assert free == Parameters.from_tissue(5000.0, BODY, "vector", rotation, held=np.zeros_like(held))
        assert_allclose(
            free.surface_tension, 0.7 * 5000.0 / 3.0 * BODY.equivalent_radius, rtol=1e-13, atol=0.0
        )
    with pytest.raises(ParameterError, match="rotation must be one of none, global, not 'each'"):
        Parameters.from_tissue(5000.0, BODY, "vector", "each")


LINE = np.flatnonzero(np.abs(POINTS[:, 1:]).max(axis=1) < 1e-12)  # both ends of one axis
LOOSE = "free to move without any resistance"
AREA = "hold an area of the surface, the nodes of some of its facets"
# formulation, parameters (None: by rule), nodes held, remedy
SINGULAR = [
    ("vector", Parameters(surface_tension=1.0, rotation="none"), [], AREA),
    ("vector", Parameters(surface_tension=1.0, rotation="global"), [0], AREA),
    ("vector", Parameters(surface_tension=0.0, stretch_stiffness=1.0, rotation="none"), LINE, AREA),
    ("bem", None, [], AREA),
    ("bem", None, LINE, AREA),
    ("mass-spring", None, [], AREA),
    ("mass-spring", None, LINE, AREA),
    ("paper", Parameters(bulk_modulus=0.0, connectivity_modulus=1.0), [], "hold a node"),
    ("consistent", Parameters(foundation=0.0, surface_tension=1.0), [], "hold a node"),
]


@pytest.mark.parametrize("solver", ["linear", "lu", "nonlinear"])
@pytest.mark.parametrize(("formulation", "parameters", "held", "remedy"), SINGULAR)
def test_nothing_held_where_the_operator_needs_it(formulation, parameters, held, remedy, solver, monkeypatch):
    def assembled(*_):
        pytest.fail("assembled before the supports were checked")

    monkeypatch.setattr(FORMULATIONS[formulation], "__init__", assembled)
    fixed = np.zeros(len(POINTS), dtype=bool)
    fixed[held] = True
    with pytest.raises(SolverError, match=f"{LOOSE}; {remedy}") as error:
        model(formulation, parameters=parameters, fixed=fixed, solver=solver)
    assert error.value.status.code == "singular"


@pytest.mark.parametrize(("formulation", "parameters"), [case[:2] for case in SINGULAR])
def test_just_enough_held(formulation, parameters):
    fixed = np.zeros(len(POINTS), dtype=bool)
    fixed[:3] = True
    moved = model(formulation, parameters=parameters, fixed=fixed).solve([FINGER]).displacement
    assert_allclose(moved[0, :3], 0.0, rtol=0.0, atol=0.0)
    assert 1e-6 < np.abs(moved).max() < 10.0


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_foundation_needs_nothing_held(solver):
    free = model("consistent", solver=solver, fixed=None).solve([FINGER])
    assert free.status[0].code == "converged"
    direct = model("consistent", fixed=None).solve([FINGER]).displacement
    tolerance = 0.2 if solver == "nonlinear" else 1e-3 if solver == "quasi-linear" else 1e-6
    assert_allclose(free.displacement, direct, rtol=0.0, atol=tolerance * np.abs(direct).max())


def test_one_frame_is_spent_before_any_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once for each set-up: the first is slower than those after it."""
    body = model("paper")
    seen: list[Load] = []
    step = body.solver.step

    def counted(load, previous=None):
        seen.append(load)
        return step(load, previous)

    monkeypatch.setattr(body.solver, "step", counted)
    half = Load(0.5 * FINGER.contact_pressure)
    assert len(body.solve([half, FINGER]).seconds_per_step) == 2
    body.solve([FINGER])
    pressed = [load.contact_pressure.max() for load in seen]
    assert pressed == [100.0, 100.0, 200.0, 200.0]


RANDOM = np.random.default_rng(5)
REGULAR, FACETS = icosphere(2, (0.06, 0.045, 0.03))
ROUGH = REGULAR + 2e-3 * RANDOM.standard_normal(REGULAR.shape)
FOOT, TIP = ROUGH[:, 2] < -0.02, ROUGH[:, 0] > 0.05
# a sixth of the stiffness: second-order terms are some percent
PUSH = np.where((ROUGH[:, 2] > 0.015) & ~TIP, 300.0, 0.0)
PULL = np.where(TIP[:, None], [1e-3, 2e-3, 0.0], 0.0)
ALL = np.arange(len(ROUGH))
STILL = np.eye(3)
TURN = np.linalg.qr(RANDOM.standard_normal((3, 3)))[0]
TURN *= np.sign(np.linalg.det(TURN))
MIRROR = np.diag([1.0, -1.0, 1.0])
# where the nodes go to, the order in which they come, and that the facets turn inside out
TWIN = (TURN @ MIRROR, RANDOM.permutation(len(ROUGH)), True)


def answer(
    formulation: str, solver: str, motion: np.ndarray = STILL, order: np.ndarray = ALL, flip: bool = False
) -> tuple[np.ndarray, np.ndarray, float]:
    """Displacement and reaction (N, 3) [m, N] and pressure [Pa], taken back to how the body was."""
    place = np.argsort(order)
    triangles = place[FACETS[:, ::-1] if flip else FACETS]
    points = ROUGH[order] @ motion.T
    held = (FOOT | TIP)[order]
    rule = Parameters.from_tissue(5000.0, SurfaceMesh(points, triangles), formulation, "global", held)
    model = Model(
        points,
        triangles,
        rule,
        formulation=formulation,
        fixed=FOOT[order],
        constrained=TIP[order],
        density=1060.0,
        gravity=motion @ [0.0, 1.0, -3.0],
        solver=solver,
    )
    solution = model.solve([Load(PUSH[order], prescribed=PULL[order] @ motion.T)])
    assert solution.status[0].ok, solution.status[0].message
    fields = (solution.displacement[0], solution.reaction_force[0])
    displacement, reaction = (values[place] @ motion for values in fields)
    return displacement, reaction, float(solution.fluid_pressure[0])


@pytest.mark.parametrize(
    ("formulation", "solver"),
    [(name, "linear") for name in FORMULATIONS] + [(name, "nonlinear") for name in ("vector", "mass-spring")],
)
def test_the_answer_does_not_depend_on_how_the_body_lies(formulation: str, solver: str) -> None:
    """Nor on the order of its nodes, nor on left and right."""
    plain, other = answer(formulation, solver), answer(formulation, solver, *TWIN)
    # a nonlinear balance is found to 1e-8 of its forces, an answer to that times its condition
    # quadrature over the slender facets at a rim depends by 4e-8 on which corner of a facet comes first
    by_facet = 1e-6 if formulation in ("bem", "bem-sparse") else 1e-9
    tolerance = by_facet if solver == "linear" else 2e-6
    for a, b in zip(other, plain, strict=True):
        assert_allclose(a, b, rtol=0, atol=tolerance * np.abs(b).max())
