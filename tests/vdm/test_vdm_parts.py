"""A body of boundary elements in parts: cuts, the energy that all follows from, and a beam bent far."""

import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_equal
from scipy import sparse

from solver_common.closed_surfaces import solid_angles
from tests.vdm.vdm_shapes import box, icosphere
from vdm import Load, Model, Parameters, SurfaceMesh
from vdm.bending import bending_error
from vdm.boundary.operators import surface_stiffness
from vdm.deformed import best_rotation
from vdm.parts.body import Parts
from vdm.parts.caps import CutError, cap
from vdm.parts.cut import cut, volume
from vdm.parts.guess import guessed
from vdm.parts.joined import JoinedFormulation
from vdm.parts.solve import PartsSolver
from vdm.parts.unloaded import Unloaded, Unloading
from vdm.peers.bem import BoundaryFormulation, DenseFactor, Swelling, SwollenFactor
from vdm.peers.bem_sparse import SparseFormulation
from vdm.solution import SolverError, Status
from vdm.solvers.linear import LinearSolver
from vdm.solvers.nonlinear import Balance, DeformedStep, NonlinearSolver

Array = np.ndarray
E, LENGTH, SIDE = 3e4, 0.1, 0.01
BAR = box(counts=(24, 3, 3), size=(LENGTH, SIDE, SIDE))
ROD = icosphere(2, (0.06, 0.02, 0.02))
CUBE = box(6, (0.04, 0.04, 0.04))  # with nodes of its loops in line


def clamped(
    body: tuple[Array, Array], share: float = 0.0, solver: str = "nonlinear", **options: Any
) -> Model:
    """Held below a share of its length; `poisson_ratio` is 1/2 where none is given."""
    points, triangles = body
    end = points[:, 0].min() + share * np.ptp(points[:, 0]) + 1e-9
    nu = options.pop("poisson_ratio", 0.5)
    mu = E / (2.0 * (1.0 + nu))
    parameters = Parameters(shear_modulus=mu, poisson_ratio=nu, parts=options.pop("parts", None))
    given = {"formulation": "bem", "solver": solver, "fixed": points[:, 0] <= end, **options}
    return Model(points, triangles, parameters, **given)


def at_tip(points: Array, force: Array) -> Load:
    """A dead force, shared by the nodes of the far end."""
    tip = points[:, 0] > points[:, 0].max() - 1e-9
    return Load(np.zeros(len(points)), dead_force=np.where(tip[:, None], force / tip.sum(), 0.0))


@pytest.mark.parametrize("count", [2, 4, 8])
def test_parts_fill_the_body(count: int) -> None:
    for points, triangles in (BAR, ROD, CUBE):
        found = cut(points, triangles, count)
        assert len(found.parts) >= count or found.refused
        volumes = [volume(found.points, part) for part in found.parts]
        assert min(volumes) > 0.0
        assert_allclose(sum(volumes), SurfaceMesh(points, triangles).volume, rtol=1e-12, atol=0.0)
        assert_allclose(found.points[: len(points)], points, rtol=0.0, atol=0.0)


@pytest.mark.parametrize("place", [0.0, 0.8])
def test_a_cut_goes_through_a_cavity_or_leaves_it_whole(place: float) -> None:
    (x, outer), (y, inner) = icosphere(3), icosphere(2)
    points = np.vstack([x * [1.5, 1.0, 1.0], 0.4 * y + [place, 0.0, 0.0]])
    triangles = np.vstack([outer, inner[:, ::-1] + len(x)])
    found = cut(points, triangles, 2)
    bodies = [
        SurfaceMesh(found.points[nodes], local.reshape(-1, 3))
        for nodes, local in (np.unique(part, return_inverse=True) for part in found.parts)
    ]
    assert [body.shells.max() for body in bodies].count(1) == (place > 0.0)
    total = sum(body.volume for body in bodies)
    assert_allclose(total, SurfaceMesh(points, triangles).volume, rtol=1e-12, atol=0.0)


def test_no_cap_cuts_through_a_cavity_smaller_than_its_facets() -> None:
    """A wall at a place of a cap that is neither near its nodes nor in the middle of a facet."""
    (x, outer), (y, inner) = icosphere(2), icosphere(0)
    points = x * [1.6, 1.0, 0.9]
    plain = cut(points, outer, 2)
    facets = plain.parts[0][(plain.parts[0] >= len(x)).all(axis=1)]  # of its cap, inside
    for a, b, c in plain.points[facets[::9]]:
        normal = np.cross(b - a, c - a)
        middle = 0.5 * a + 0.35 * b + 0.15 * c - 0.029 * normal / np.linalg.norm(normal)
        hollow = np.vstack([points, middle + 0.03 * y])
        triangles = np.vstack([outer, inner[:, ::-1] + len(x)])
        found = cut(hollow, triangles, 2)
        of_cavity = (triangles.min(axis=1) >= len(x)).sum()
        for part in found.parts:
            is_wall = ((part >= len(x)) & (part < len(hollow))).all(axis=1)
            if is_wall.sum() == of_cavity:  # a wall that is left whole lies within all else of its part
                inside = solid_angles(hollow[len(x) :], found.points, part[~is_wall])
                assert_allclose(inside, 1.0, rtol=0.0, atol=1e-6)


def test_a_cap_narrower_than_its_edges_has_nodes_inside() -> None:
    """Without one, nothing tells the volumes apart of the parts beside it."""
    turn = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    loops = [np.arange(12), 12 + np.arange(12)[::-1]]
    new, facets = cap(np.vstack([ring, 0.6 * ring]), loops, np.array([0.0, 0.0, 1.0]))
    assert len(new) > 0
    assert (facets < 24 + len(new)).all()
    assert len(np.unique(facets)) == 24 + len(new)


def test_loops_that_no_cap_fills_are_refused() -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    loop = np.arange(24)
    for other in (ring + np.array([0.7, 0.0, 0.0]), 0.4 * ring):  # one crosses, one runs the same way round
        with pytest.raises(CutError, match="loops of the cut"):
            cap(np.vstack([ring, other]), [loop, 24 + loop], np.array([0.0, 0.0, 1.0]))
    new, facets = cap(np.vstack([ring, 0.4 * ring]), [loop, 24 + loop[::-1]], np.array([0.0, 0.0, 1.0]))
    assert len(new) > 0
    assert len(facets) > 48
    small = cut(*icosphere(1), 2)
    assert len(small.parts) == 1
    assert "too small to be cut" in small.refused


def test_a_star_is_cut_as_far_as_caps_fit_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seven arms of a facet each: some planes leave loops that no cap fills, of others caps cross the surface."""
    told: list[str] = []

    def watched(*given: Any, **how: bool) -> tuple[Array, Array]:
        try:
            return cap(*given, **how)
        except CutError as error:
            told.append(f"{error}")
            raise

    monkeypatch.setattr("vdm.parts.cut.cap", watched)
    x, triangles = icosphere(3)
    dents = (x[:, :2] ** 2).sum(axis=1) * (1.0 - np.cos(7.0 * np.arctan2(x[:, 1], x[:, 0])))
    points = x * (1.0 - 0.45 * dents)[:, None]
    found = cut(points, triangles, 8)
    assert 1 < len(found.parts) < 8
    assert found.refused == "caps of the cut cross the surface"
    assert "loops of the cut cannot be paired" in told
    volumes = [volume(found.points, part) for part in found.parts]
    assert_allclose(sum(volumes), SurfaceMesh(points, triangles).volume, rtol=1e-12, atol=0.0)


def bent(model: Model, parts: int) -> tuple[Parts, Array]:
    """The body in parts, and a bend of it by 40 degrees with some noise."""
    body = Parts(model.problem, parts)
    x = body.rest - body.rest.min(axis=0)
    k = np.radians(40.0) / x[:, 0].max()
    along, up = x[:, 0], x[:, 2]
    moved = np.zeros_like(x)
    moved[:, 0] = (1.0 / k - up) * np.sin(k * along) - along
    moved[:, 2] = 1.0 / k - (1.0 / k - up) * np.cos(k * along) - up
    noise = np.random.default_rng(0).standard_normal(x.shape)
    return body, np.where(body.free[:, None], moved + 1e-3 * SIDE * noise, 0.0)


@pytest.mark.parametrize("ratio", [0.1, 0.45, 0.5])
def test_forces_are_the_derivative_of_the_energy_and_balance(ratio: float) -> None:
    """The pressures of compressible parts are those of their volumes; that of rims does work on theirs."""
    body, x = bent(clamped(BAR, poisson_ratio=ratio), 4)
    load, pressure = Load(np.zeros(len(BAR[0]))), np.zeros(body.n_pressures)
    state, m = body.balance(load, x, pressure), body.n_parts
    if ratio < 0.5:
        pressure[:m] = -(state.gap * body.volumes)[:m] / body.give[:m]
    pressure[m:] = 400.0
    state = body.balance(load, x, pressure)
    if ratio < 0.5:
        assert np.abs(state.gap[:m]).max() < 1e-12

    def energy(way: Array) -> float:
        at = body.balance(load, x + way, pressure)
        return body.energy(at) - float(pressure[m:] @ (at.gap * body.volumes)[m:])

    force = state.lacking
    way = np.random.default_rng(1).standard_normal(x.shape)
    step = 1e-6 * SIDE
    ahead, behind = (energy(s * way) for s in (step, -step))
    assert len(pressure) == m + 1
    assert (ahead - behind) / (2.0 * step) == pytest.approx(np.vdot(force, way), rel=1e-6)
    size = np.abs(force).sum()
    assert_allclose(force.sum(axis=0), 0.0, rtol=0.0, atol=1e-10 * size)
    assert_allclose(np.cross(body.rest + x, force).sum(axis=0), 0.0, rtol=0.0, atol=1e-10 * size * LENGTH)


@pytest.mark.parametrize(
    ("gravity", "ratio"), [((0.0, 0.0, 0.0), 0.5), ((0.0, -1.0, -9.0), 0.5), ((0.0, -0.1, -0.9), 0.45)]
)
def test_a_correction_has_the_slope_of_the_state(gravity: tuple[float, float, float], ratio: float) -> None:
    """What it supplies is what was lacking but for terms of the order of the strain, 5 %, in a body bent far.

    Where the pressure times a section is ten times that, and six times Euler's load, it is nearly singular.
    """
    body, x = bent(clamped(BAR, density=1000.0, gravity=gravity, poisson_ratio=ratio), 4)
    load, pressure = Load(np.zeros(len(BAR[0]))), np.full(body.n_pressures, 40.0)
    state = body.balance(load, x, pressure)
    change, pushed = body.correction(state, state.lacking, state.gap, np.eye(3))
    way = np.zeros_like(x)
    way[body.free] = change
    ahead, behind = (body.balance(load, x + s * way, pressure + s * pushed) for s in (1e-5, -1e-5))
    supplied, lacking = (ahead.lacking - behind.lacking)[body.free] / 2e-5, state.lacking[body.free]
    assert np.linalg.norm(supplied + lacking) < 0.1 * np.linalg.norm(lacking)
    # where a part turns, what quadrature leaves of a uniform pressure turns with it
    left = (1e-6 if ratio == 0.5 else 1e-4) * np.abs(state.gap).max()
    assert_allclose((ahead.gap - behind.gap) / 2e-5, -state.gap, rtol=0.0, atol=left)


@pytest.mark.parametrize(
    ("share", "side", "along"), [(0.0, SIDE, 20), (0.5, SIDE, 20), (0.5, LENGTH / 50.0, 60)]
)
def test_a_bar_pressed_along_has_the_stiffness_that_its_load_of_buckling_leaves(
    share: float, side: float, along: int
) -> None:
    """Euler's: pi^2 E I / (4 L^2) of a bar that is held at one end; slender ones are as soft as they are."""
    body = box(counts=(along, 2, 2), size=(LENGTH, side, side))
    model = clamped(body, parts=4)
    assert isinstance(model.solver, PartsSolver)
    solver = model.solver.solver
    load = at_tip(body[0], np.array([-share * np.pi**2 * E * side**4 / 48.0 / LENGTH**2, 0.0, 0.0]))
    step = solver.step(load)
    assert isinstance(step, DeformedStep)
    assert step.balance is not None
    assert solver.body.stiffness_left(step.balance) == pytest.approx(1.0 - share, abs=0.08)


def column(share: float, parts: int) -> Model:
    """Upright, under a share of the weight that it buckles under, Greenhill's 7.84 E I / L^2."""
    body = box(counts=(12, 2, 2), size=(0.12, 0.02, 0.02))
    weight = share * 0.653 * E * (0.02 / 0.12) ** 2 / 0.12
    return clamped(body, parts=parts, poisson_ratio=0.45, density=1.0, gravity=(-weight, 0, 0))


@pytest.mark.parametrize("parts", [1, 2])
@pytest.mark.parametrize("share", [0.8, 1.2])
def test_a_column_that_stays_straight_stands_up_to_the_weight_that_it_buckles_under(
    parts: int, share: float
) -> None:
    """Few corrections find it straight beyond too, where it does not stay."""
    model = column(share, parts)
    solution = model.solve([Load(np.zeros(model.surface.n_nodes))])
    assert solution.status[0].ok == (share < 1.0)
    assert ("that was found is not stable" in solution.status[0].message) == (share > 1.0)
    reached = solution.scalars.get("load_factor", np.ones(1))[0]
    assert share * reached == pytest.approx(min(share, 1.0), abs=0.1)


@pytest.mark.parametrize(("share", "is_known"), [(0.9, True), (1.1, False)])
def test_no_answer_is_held_against_an_unstable_one_of_twice_the_parts(share: float, is_known: bool) -> None:
    """Of a bar pressed along by a share of Euler's load: in one part it stands up to more than in two."""
    side = LENGTH / 8.0
    body = box(counts=(16, 2, 2), size=(LENGTH, side, side))
    euler = np.pi**2 * E * side**4 / 48.0 / LENGTH**2
    solution = clamped(body, parts=1).solve([at_tip(body[0], np.array([-share * euler, 0.0, 0.0]))])
    assert solution.status[0].ok
    assert np.isfinite(solution.scalars["parts_error"][0]) == is_known


def test_no_balance_is_examined_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a column that buckles, in a step that fails after all of its balances were examined."""
    examined, seen = Parts.stiffness_left, list[Balance]()

    def watched(body: Parts, balance: Balance) -> float:
        seen.append(balance)
        return examined(body, balance)

    monkeypatch.setattr(Parts, "stiffness_left", watched)
    solver = column(1.2, 1).solver
    load = Load(np.zeros(solver.problem.formulation.surface.n_nodes))
    assert isinstance(solver, PartsSolver)
    step, _ = solver.audited(load, solver.step(load))
    assert not step.status.ok
    assert len({id(balance) for balance in seen}) == len(seen) > 1


@pytest.mark.parametrize("ratio", [0.45, 0.499, 0.5])
def test_a_pressure_from_all_sides_is_as_easy_in_parts_as_in_one(ratio: float) -> None:
    """Beyond the modulus, which no tangent of parts is exact for; an incompressible body does not move."""
    pressure = 0.3 * E if ratio < 0.49 else 4.0 * E
    ball = icosphere(2, (0.05, 0.05, 0.05))
    load = Load(np.full(len(ball[0]), pressure))
    steps = [clamped(ball, 0.1, parts=parts, poisson_ratio=ratio).solver.step(load) for parts in (1, 2, 4)]
    moved = np.abs(steps[0].displacement).max()
    for step in steps:
        assert step.status.ok
        assert step.iterations <= 10
        assert step.pressure_change == pytest.approx(pressure, rel=0.02 if ratio < 0.5 else 1e-9)
        assert_allclose(step.displacement, steps[0].displacement, rtol=0.0, atol=0.05 * moved + 1e-14)


def test_a_step_that_fails_holds_a_stable_balance_too() -> None:
    """Of a ball on its lowest nodes under a pressure, which few corrections find unstable on its way."""
    ball = icosphere(2, (0.05, 0.05, 0.05))
    parameters = Parameters(shear_modulus=1e4, poisson_ratio=0.45, parts=1)
    model = Model(*ball, parameters, formulation="bem", solver="nonlinear", fixed=ball[0][:, 2] < -0.045)
    parts, load = model.solver, Load(np.full(len(ball[0]), 2e5))
    assert isinstance(parts, PartsSolver)
    step, _ = parts.audited(load, parts.step(load))
    assert isinstance(step, DeformedStep)
    assert step.balance is not None
    assert parts.body.stiffness_left(step.balance) > 0.0


def test_the_time_of_a_step_is_without_what_is_told_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a bar that is strained, so that its status is another."""
    audited, late = NonlinearSolver.audited, [0.0]

    def slow(*given: Any) -> Any:
        late[0] = 1e6
        return audited(*given)

    monkeypatch.setattr(NonlinearSolver, "audited", slow)
    clock = SimpleNamespace(perf_counter=lambda: time.perf_counter() + late[0])
    monkeypatch.setattr("vdm.model.time", clock)
    body = box(counts=(12, 2, 2), size=(LENGTH, SIDE, SIDE))
    solution = clamped(body, parts=2).solve([at_tip(body[0], np.array([0.0, 0.0, -0.01]))])
    assert "is strained by" in solution.status[0].message
    assert solution.seconds_per_step[0] < 1e6


def test_a_part_that_swells_as_one_costs_nothing() -> None:
    """The product of rank 2 is P^T S P, and the factor by Woodbury that of the sum."""
    form = clamped(BAR).formulation
    swelling, surface = Swelling.of(form), form.surface
    arms = surface.points - surface.points.mean(axis=0)
    g, x = surface.area_vectors.reshape(-1), arms.reshape(-1)
    without = np.eye(len(x)) - np.outer(x, g) / (3.0 * surface.volume)
    every = np.arange(len(x))
    long_way = without.T @ form.matrix @ without
    assert_allclose(
        form.matrix + swelling.block(every, every), long_way, rtol=0.0, atol=1e-12 * np.abs(long_way).max()
    )
    u = np.random.default_rng(1).normal(size=(len(arms), 3, 2))
    assert_allclose(swelling.forces(u).reshape(-1, 2), swelling.block(every, every) @ u.reshape(-1, 2))
    assert np.abs(long_way @ x).max() < 1e-10 * np.abs(form.matrix @ x).max()
    free = every[len(x) // 4 :]
    factor = SwollenFactor(DenseFactor(form.matrix[np.ix_(free, free)]), swelling, free)
    b = np.random.default_rng(2).normal(size=(len(free), 2))
    assert_allclose(factor.solve(b), np.linalg.solve(long_way[np.ix_(free, free)], b), rtol=1e-7)


@pytest.mark.parametrize("coarse_nodes", [None, 200])
def test_a_compressible_part_swells_by_its_volume_alone(coarse_nodes: int | None) -> None:
    """`S = S_0 + b b^T / a`: a uniform swelling costs nothing beside that, and nothing costs less than nothing."""
    body = box(counts=(24, 3, 3), size=(LENGTH, SIDE, SIDE))
    surface = SurfaceMesh(*body)
    parameters = Parameters(shear_modulus=1.0, poisson_ratio=0.45, coarse_nodes=coarse_nodes)
    form = (SparseFormulation if coarse_nodes else BoundaryFormulation)(
        surface, parameters, np.zeros(surface.n_nodes, np.bool_)
    )
    swelling, every = Swelling.of(form), np.arange(3 * surface.n_nodes)
    whole = form.elastic_forces(np.eye(len(every)).reshape(-1, 3, len(every))).reshape(len(every), -1)
    without = whole + swelling.block(every, every)
    b = (surface.area_vectors + swelling.beyond).reshape(-1)
    assert_allclose(
        without + np.outer(b, b) / swelling.give, whole, rtol=0.0, atol=1e-12 * np.abs(whole).max()
    )
    arms = (surface.points - surface.points.mean(axis=0)).reshape(-1)
    assert np.abs(without @ arms).max() < 1e-10 * np.abs(whole @ arms).max()
    assert np.linalg.eigvalsh(0.5 * (without + without.T))[0] > -1e-5 * np.abs(whole).max()
    if coarse_nodes is None:  # S X = 3 kappa g, but for quadrature
        assert np.abs(swelling.beyond).max() < 1e-4 * np.abs(surface.area_vectors).max()
        assert form.bulk_modulus * swelling.give == pytest.approx(surface.volume, rel=1e-4)


@pytest.mark.parametrize("ratio", [0.1, 0.45, 0.4997, 0.4999])
def test_one_part_of_any_ratio_answers_a_small_load_as_the_linear_form(ratio: float) -> None:
    points = ROD[0]
    tip = points[:, 0] > 0.6 * points[:, 0].max()
    load = Load(np.where(tip, 1e-3, 0.0), dead_force=np.where(tip[:, None], [2e-9, 0.0, 1e-9], 0.0))
    linear, nonlinear = (
        clamped(ROD, 0.3, solver, poisson_ratio=ratio, parts=1).solve([load])
        for solver in ("linear", "nonlinear")
    )
    size = np.abs(linear.displacement[0]).max()
    assert_allclose(nonlinear.displacement[0], linear.displacement[0], rtol=0.0, atol=1e-6 * size)
    assert nonlinear.energy[0] == pytest.approx(linear.energy[0], rel=1e-5)
    surface = SurfaceMesh(*ROD)
    swollen = abs(np.vdot(surface.area_vectors, linear.displacement[0])) / (surface.area * size)
    assert (swollen < 1e-9) == (ratio == 0.4999), "only of a fluid's ratio is the volume kept"


def test_a_compressible_body_hangs_from_its_weight_as_the_linear_form_says() -> None:
    """To what quadrature leaves of a uniform pressure; in two parts to 0.5 %."""
    small = {"density": 1e3, "gravity": (2e-4, 0.0, 1e-4), "poisson_ratio": 0.3}
    load = Load(np.zeros(len(ROD[0])))
    linear = clamped(ROD, 0.3, "linear", **small).solve([load]).displacement[0]
    size = np.abs(linear).max()
    for parts, left in ((1, 1e-5), (2, 5e-3)):
        found = clamped(ROD, 0.3, parts=parts, **small).solve([load])
        assert_allclose(found.displacement[0], linear, rtol=0.0, atol=left * size)


def test_no_matrix_of_the_whole_is_made_of_a_body_in_parts() -> None:
    """Not for the weight of a compressible one either, whose force asks for the stiffness; nor on springs."""
    points, triangles = BAR
    at_end = np.repeat(np.where(points[:, 0] < 1e-9, 100.0, 0.0), 3)
    ground = sparse.csr_array(sparse.diags_array(at_end))
    parameters = Parameters(shear_modulus=E / 2.9, poisson_ratio=0.45, ground=ground)
    given = {"formulation": "bem", "solver": "nonlinear", "density": 1e3, "gravity": (0.0, 0.0, -1.0)}
    held = clamped(BAR, poisson_ratio=0.45, density=1e3, gravity=(0.0, 0.0, -1.0))
    for model in (held, Model(points, triangles, parameters, **given)):
        assert model.solve([Load(np.zeros(len(points)))]).scalars["parts"][0] > 1
        assert "matrix" not in vars(model.formulation)


@pytest.mark.parametrize("ratio", [0.0, 0.3, 0.5])
def test_a_guess_bends_a_beam_as_its_theory_does(ratio: float) -> None:
    points, tip = BAR[0], BAR[0][:, 0] > BAR[0][:, 0].max() - 1e-9
    force = np.array([0.0, 0.0, -1e-3])
    found = guessed(clamped(BAR, poisson_ratio=ratio).problem, at_tip(points, force))[tip].mean(axis=0)
    assert_allclose(found[2], force[2] * LENGTH**3 / (3.0 * E * SIDE**4 / 12.0), rtol=0.06)
    weight = {"density": 1e3, "gravity": (0.0, 0.0, -1.0)}
    heavy = clamped(BAR, poisson_ratio=ratio, **weight).problem
    found = guessed(heavy, Load(np.zeros(len(points))))[tip].mean(axis=0)
    assert_allclose(found[2], -1e3 * SIDE**2 * LENGTH**4 / (8.0 * E * SIDE**4 / 12.0), rtol=0.06)


def test_a_guess_follows_given_motions_however_the_body_lies() -> None:
    points, triangles = BAR
    tip = points[:, 0] > points[:, 0].max() - 1e-9
    moved = np.where(tip[:, None], [0.0, 0.0, -0.2 * LENGTH], 0.0)
    turn = best_rotation(np.array([[3.0, 1.0, -1.0], [0.0, 2.0, 1.0], [1.0, -1.0, 2.0]]))
    found, turned = (
        guessed(clamped(body, constrained=tip, fixed=points[:, 0] < 1e-9).problem, load)
        for body, load in (
            (BAR, Load(np.zeros(len(points)), prescribed=moved)),
            ((points @ turn + 3.0, triangles), Load(np.zeros(len(points)), prescribed=moved @ turn)),
        )
    )
    assert_allclose(found[tip].mean(axis=0), moved[tip][0], rtol=0.02, atol=0.01 * LENGTH)
    assert_allclose(turned, found @ turn, rtol=0.0, atol=1e-8 * LENGTH)


def test_a_guess_rests_on_its_springs() -> None:
    points, triangles = CUBE
    surface = SurfaceMesh(points, triangles)
    ground = sparse.csr_array(sparse.diags_array(np.repeat(1e3 * surface.nodal_areas, 3)))
    parameters = Parameters(shear_modulus=1e6, poisson_ratio=0.3, ground=ground)
    given = {"formulation": "bem", "solver": "nonlinear", "density": 1e3, "gravity": (0.0, 0.0, -1.0)}
    found = guessed(Model(points, triangles, parameters, **given).problem, Load(np.zeros(len(points))))
    assert_allclose(found.mean(axis=0), [0.0, 0.0, -surface.volume / surface.area], rtol=1e-6, atol=1e-15)


@pytest.mark.parametrize("parts", [None, 1])
def test_a_body_too_large_for_one_matrix_is_cut_where_its_load_would_not_ask_for_it(
    parts: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    load = at_tip(BAR[0], np.array([0.0, 0.0, 1e-6]))
    assert clamped(BAR, share=0.3).solve([load]).scalars["parts"] == 1
    monkeypatch.setattr("vdm.peers.bem.MAX_NODES", len(BAR[0]) - 1)
    large = clamped(BAR, share=0.3, parts=parts)
    if parts:
        with pytest.raises(SolverError, match="nodes are more than"):
            large.solve([load])
    else:
        assert large.solve([load]).scalars["parts"] == 2


@pytest.mark.parametrize("parts", [1, 4])
def test_the_pressure_of_a_compressible_body_is_what_its_volume_lost(parts: int) -> None:
    """Under weight too, where the middle of its nodes is not that of its volume."""
    points, triangles = box(counts=(14, 3, 3), size=(LENGTH, SIDE, SIDE))
    points[:, 0] = LENGTH * (points[:, 0] / LENGTH) ** 1.6
    weight = {"density": 1e3, "gravity": (-2.0, 0.0, -1.0)}
    model = clamped((points, triangles), 0.2, parts=parts, poisson_ratio=0.3, **weight)
    found = model.solve([Load(np.zeros(len(points)))])
    rest, now = (SurfaceMesh(at, triangles).volume for at in (points, points + found.displacement[0]))
    bulk_modulus = E / (3.0 * (1.0 - 2.0 * 0.3))
    assert found.fluid_pressure[0] == pytest.approx(bulk_modulus * (1.0 - now / rest), rel=1e-3)


def test_answers_go_over_into_those_of_the_fluid() -> None:
    """At large rotations, where one that knew the flux alone would be stiffer by the square of what turns."""
    bar = box(counts=(12, 3, 3), size=(LENGTH, SIDE, SIDE))
    force = at_tip(bar[0], np.array([0.0, 0.0, -E * SIDE**4 / 12.0 / LENGTH**2]))
    one, other = (
        clamped(bar, poisson_ratio=nu, parts=2).solve([force]).displacement[0] for nu in (0.5, 0.4997)
    )
    size = np.abs(one).max()
    assert size > 0.2 * LENGTH
    assert_allclose(other, one, rtol=0.0, atol=2e-3 * size)


def test_frames_on_a_kept_slope_are_those_of_one_made_for_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a force that turns and grows: from where a cubic of the last loads points to, and from rest."""
    made: list[None] = []
    make = Parts._slope_at
    monkeypatch.setattr(Parts, "_slope_at", lambda *given, **how: (made.append(None), make(*given, **how))[1])
    bar = box(counts=(16, 3, 3), size=(LENGTH, SIDE, SIDE))
    loads = [
        at_tip(bar[0], 1e-5 * np.array([0.0, 3.0 * np.sin(0.7 * k), -100.0 - 2.0 * np.cos(k)]))
        for k in range(12)
    ]
    model = clamped(bar, parts=4)
    warm = model.solve(loads)
    assert isinstance(model.solver, PartsSolver)
    assert len(made) < warm.iterations.sum() / 2  # of a slope each
    assert warm.iterations[-3:].mean() < 0.8 * warm.iterations[:3].mean()
    cold = clamped(bar, parts=4).solve(loads[-1:])
    size = np.abs(cold.displacement[0]).max()
    assert size > 0.01 * LENGTH
    assert_allclose(warm.displacement[-1], cold.displacement[0], rtol=0.0, atol=1e-6 * size)


def test_a_beam_bends_as_the_elastica(monkeypatch: pytest.MonkeyPatch) -> None:
    """`P L^2 / (E I) = 2`: the tip comes down by 0.4935 L and back by 0.1606 L (Bisshopp and Drucker 1945).

    E I is the mesh's own: of the force under which the linear answer is `P L^3 / (3 E I) = 2 L / 3`. The body that
    parts are cut of is not made as one.
    """
    points = BAR[0]
    small = clamped(BAR, solver="linear").solve([at_tip(points, np.array([0.0, 0.0, -1e-6]))])
    force = 1e-6 * LENGTH * 2.0 / 3.0 / np.abs(small.displacement[0, :, 2]).max()
    assert force == pytest.approx(2.0 * E * SIDE**4 / 12.0 / LENGTH**2, rel=0.1)
    sizes: list[int] = []
    make = BoundaryFormulation._dense
    monkeypatch.setattr(
        BoundaryFormulation,
        "_dense",
        lambda form, rims, held: (sizes.append(rims.body.n_nodes), make(form, rims, held))[1],
    )
    model = clamped(BAR)
    found = model.solve([at_tip(points, np.array([0.0, 0.0, -force]))])
    assert found.status[0].ok
    assert max(sizes) < len(points)
    tip = found.displacement[0][points[:, 0] > LENGTH - 1e-9].mean(axis=0) / LENGTH
    assert_allclose(tip[[2, 0]], [-0.4935, -0.1606], rtol=0.04, atol=0.0)
    assert found.scalars["parts"][0] >= 4
    assert found.scalars["parts_error"][0] < 0.03
    own = model.solver.body.cut.parts
    facets = {tuple(row): k for k, part in enumerate(own, 1) for row in part.tolist()}
    whole = [row for row in BAR[1].tolist() if tuple(row) in facets]  # but at the rim
    assert len(whole) > 0.9 * len(BAR[1])
    assert [facets[tuple(row)] for row in whole] == found.part_of_node[whole].min(axis=1).tolist()
    strains = [found.scalars[f"strain_of_part_{k + 1}"][0] for k in range(len(own))]
    assert max(strains) == found.scalars["part_strain"][0]
    assert_allclose(found.reaction_force[0].sum(axis=0), [0.0, 0.0, force], rtol=0.0, atol=1e-6 * force)
    assert found.iterations[0] < 15  # by a slope without the stretch that turning feigns
    moved = SurfaceMesh(points + found.displacement[0], BAR[1]).volume
    assert_allclose(moved, SIDE**2 * LENGTH, rtol=1e-9, atol=0.0)


def test_parts_are_doubled_as_the_answers_ask_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where one part finds no balance, until twice as many change an answer by less than is told."""
    prepare = PartsSolver.prepare

    def as_one(self: PartsSolver, loads: Any, compared: bool = True) -> float:
        with monkeypatch.context() as while_prepared:
            while_prepared.setattr("vdm.parts.body.MOST_TURN", np.inf)
            return prepare(self, loads, compared)

    monkeypatch.setattr(PartsSolver, "prepare", as_one)
    solve = NonlinearSolver._solve
    monkeypatch.setattr(
        NonlinearSolver,
        "_solve",
        lambda self, *given: (None, 0, "lost") if self.body.n_pressures == 1 else solve(self, *given),
    )
    body = box(counts=(12, 3, 3), size=(LENGTH, SIDE, SIDE))
    found = clamped(body).solve(
        [at_tip(body[0], np.array([0.0, 0.0, -2.0 * E * SIDE**4 / 12.0 / LENGTH**2]))]
    )
    assert found.status[0].ok
    assert found.scalars["parts"][0] > 1
    assert found.scalars["parts_error"][0] < 0.1


def test_a_bar_is_not_known_where_twice_the_parts_find_no_balance(monkeypatch: pytest.MonkeyPatch) -> None:
    body = box(counts=(16, 3, 3), size=(LENGTH, SIDE, SIDE))
    model = clamped(body, parts=2)
    load = at_tip(body[0], np.array([0.0, 0.0, -0.1 * E * SIDE**4 / 12.0 / LENGTH**2]))
    assert 0.0 < model.solve([load]).scalars["parts_error"][0] < 0.1
    step = NonlinearSolver.step

    def lost(self: NonlinearSolver, load: Load, previous: Any = None) -> Any:
        found = step(self, load, previous)
        return (
            found if self is model.solver.solver else replace(found, status=Status("not-converged", "lost"))
        )

    monkeypatch.setattr(NonlinearSolver, "step", lost)
    answered = model.solve([load])
    assert answered.status[0].ok
    assert np.isnan(answered.scalars["parts_error"]).all()


def test_what_the_parts_do_not_follow_is_told() -> None:
    """Strain within a part beyond 10 %, and the share of a load that was reached."""
    points = ROD[0]
    model = clamped(ROD, share=0.3, parts=2)
    stretched = model.solve(
        [at_tip(points, np.array([1.0, 0.0, 0.0])), at_tip(points, np.array([9e3, 0.0, 0.0]))]
    )
    assert stretched.status[0].ok
    assert "follows small strain inside" in stretched.status[0].message
    assert not stretched.status[1].ok
    assert "beyond 0 of load step 2" in stretched.status[1].message
    assert_allclose(stretched.displacement[1], stretched.displacement[0], rtol=0.0)


def test_errors_are_those_of_the_load_that_was_reached() -> None:
    """Of a step that failed those of the state that it holds; none where nothing acts, not one of rounding."""
    points = ROD[0]
    none, across, along = (
        at_tip(points, np.array(force)) for force in ((0.0, 0.0, 0.0), (0.0, 0.0, -2e-3), (9e3, 0.0, 0.0))
    )
    model = clamped(ROD, share=0.3, parts=2)
    found = model.solve([across, along, none])
    assert [status.ok for status in found.status] == [True, False, True]
    for name in ("mesh_error", "shape_error", "parts_error"):
        known, reached, unloaded = found.scalars[name]
        assert reached == pytest.approx(known, rel=1e-6)
        assert np.isnan(unloaded)
    assert "open" not in found.status[2].message
    at_rest = model.solve([along]).scalars
    assert at_rest["load_factor"] == 0.0
    assert np.isnan(at_rest["parts_error"]).all()
    assert "mesh_error" not in at_rest


def test_a_body_that_is_strained_too_far_is_not_cut_for_it() -> None:
    """Where no balance is found and its parts hardly turn, more parts are as strained; where they turn it is."""
    model = clamped(ROD, share=0.3)
    found = model.solve([at_tip(ROD[0], np.array([0.01, 0.0, 0.0]))])
    ended = Status("not-converged", "ended")
    x = ROD[0] - ROD[0].min(axis=0)
    bent = np.stack([-x[:, 0] * x[:, 2], 0.0 * x[:, 0], 0.5 * x[:, 0] ** 2], axis=1) / x[:, 0].max()
    for strain, moved, is_doubled in ((0.5, 0.0 * x, False), (0.05, 0.0 * x, True), (0.5, bent, True)):
        scalars = {**found.scalars, "part_strain": np.array([strain])}
        failed = replace(found, status=(ended,), scalars=scalars, displacement=moved[None])
        assert model.solver.doubled(failed) == is_doubled


def test_a_body_whose_answer_turns_as_its_linear_one_did_not_is_cut_for_it() -> None:
    """By more than 10 degrees within it; not where it turns as one, as far as that may be."""
    model = clamped(ROD, share=0.3)
    found = model.solve([at_tip(ROD[0], np.array([0.01, 0.0, 0.0]))])
    x = ROD[0] - ROD[0].min(axis=0)
    bent = np.stack([-x[:, 0] * x[:, 2], 0.0 * x[:, 0], 0.5 * x[:, 0] ** 2], axis=1) / x[:, 0].max()
    turned = x @ np.diag([-1.0, -1.0, 1.0]) - x
    for moved, is_doubled in ((turned, False), (0.1 * bent, False), (bent, True)):
        assert model.solver.doubled(replace(found, displacement=moved[None])) == is_doubled


def test_twice_the_parts_are_compared_in_their_change_of_shape_too() -> None:
    """Where it is a small share of what moves; what is carried as one has none."""
    solver = clamped(ROD, share=0.3).solver
    x, quarter = ROD[0], np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

    def carried(strain: float) -> Array:
        return (x * [1.0 + strain, 1.0, 1.0]) @ quarter - x + [0.0, 0.0, 0.5]

    assert solver._apart(carried(0.012), carried(0.01)) == pytest.approx(0.2)
    assert solver._apart(1.1 * carried(0.0), carried(0.0)) == pytest.approx(0.1)
    assert solver._apart(carried(0.0), carried(0.0)) == 0.0
    assert np.isnan(solver._apart(carried(0.0), 0.0 * x))


def test_fewer_parts_than_were_given_are_told() -> None:
    found = clamped(ROD, share=0.3, parts=64).solve([at_tip(ROD[0], np.array([0.01, 0.0, 0.0]))])
    assert found.status[0].ok
    assert f"64 parts are called for, and {found.scalars['parts'][0]:.0f} made (" in found.status[0].message


def test_no_slope_is_kept_of_a_load_that_ended_far_from_its_balance() -> None:
    """From where that started another load starts too: parts have not turned, but the weight is another one."""
    model = clamped(ROD, share=0.3, density=1e3, gravity=(0.0, 0.0, -300.0))
    corrections = []
    for weights in ((1.0, 0.01), (0.01,)):
        body = Parts(model.problem, 2)
        for weight in weights:
            load = Load(np.zeros(len(ROD[0])), weight=weight)
            state = body.balance(load, np.zeros_like(body.rest), np.zeros(body.n_pressures))
            change = body.correction(state, state.lacking, state.gap, np.eye(3))[0]
        corrections.append(change)
    size = np.abs(corrections[1]).max()
    assert_allclose(corrections[0], corrections[1], rtol=0.0, atol=1e-6 * size)


@pytest.mark.parametrize("ratio", [0.3, 0.5])
def test_parts_at_small_displacements_are_one_body(ratio: float) -> None:
    """Without a matrix of the whole: symmetric, solved by its factor, and 0.5 % from the whole body's."""
    model = clamped(BAR, solver="linear", poisson_ratio=ratio)
    body = Parts(model.problem, 4)
    form, free = body.problem.formulation, np.repeat(body.problem.free, 3)
    assert isinstance(form, JoinedFormulation)
    x, y = np.random.default_rng(0).standard_normal((2, *BAR[0].shape))
    assert np.vdot(y, form.apply(x)) == pytest.approx(np.vdot(x, form.apply(y)), rel=1e-10)
    x[~body.problem.free] = 0.0
    back = form.factor(body.problem.free).solve(form.apply(x).reshape(-1)[free])
    assert_allclose(back, x.reshape(-1)[free], rtol=0.0, atol=1e-8)
    load = at_tip(BAR[0], np.array([0.0, 0.0, 1e-6]))
    whole = model.solve([load]).displacement[0]
    found = LinearSolver(body.problem, factor=body.factor).step(load).displacement
    assert np.linalg.norm(found - whole) < 0.005 * np.linalg.norm(whole)
    bent = bending_error(body.problem, body.factor)
    assert bent == pytest.approx(model.bending_error, rel=0.2)


@pytest.mark.parametrize(("body", "share", "count"), [(BAR, 0.25, 4), (box(8, (0.06, 0.05, 0.04)), 0.15, 8)])
def test_parts_at_a_rim_are_one_body(body: tuple[Array, Array], share: float, count: int) -> None:
    """Of a bar whose first cut would lie on it, of the quarters of a block that bends: they were 3 to 4 % off."""
    model = clamped(body, share, "linear", density=1.0, gravity=(0.0, 0.0, -1e-3))
    parts, load = Parts(model.problem, count), Load(np.zeros(len(body[0])))
    whole = model.solve([load]).displacement[0]
    found = LinearSolver(parts.problem, factor=parts.factor).step(load).displacement
    assert parts.n_parts == count
    assert np.linalg.norm(found - whole) < 0.005 * np.linalg.norm(whole)


@pytest.mark.parametrize("ratio", [0.4, 0.5])
def test_a_body_is_led_back_from_its_sag_to_rest_by_the_slope_of_what_is_tried(ratio: float) -> None:
    model = clamped(ROD, 0.2, density=1e3, gravity=(0.0, 10.0, -60.0), parts=2, poisson_ratio=ratio)
    body, load = model.solver.body, Load(np.zeros(len(ROD[0])))
    step = model.solver.step(load)
    seen = body.cut.points + step.balance.x
    sag = np.abs(step.balance.x).max()
    assert sag > 0.005
    back = Unloaded(body, seen)
    rng = np.random.default_rng(0)
    x = np.where(body.free[:, None], 1e-3 * rng.normal(size=seen.shape), 0.0)
    pressure = rng.normal(size=body.n_pressures)
    lacking, gap = rng.normal(size=seen.shape), rng.normal(size=body.n_pressures)
    change, pushed = back.correction(back.balance(load, x, pressure), lacking, gap, np.eye(3))
    near, h = [], 1e-6 / np.abs(change).max()
    for sign in (-h, h):
        moved = x.copy()
        moved[body.free] += sign * change
        near.append(back.balance(load, moved, pressure + sign * pushed))
    size = np.abs(lacking).max()
    supplied = (near[1].lacking - near[0].lacking)[body.free] / (2.0 * h)
    assert_allclose(supplied, -lacking[body.free], rtol=0.0, atol=1e-5 * size)
    left = 1e-5 if ratio == 0.5 else 2e-4  # what quadrature leaves of a uniform pressure turns with a part
    assert_allclose((near[1].gap - near[0].gap) / (2.0 * h), -gap, rtol=0.0, atol=left)
    led = NonlinearSolver(body.problem, back, model.solver.factor).step(load)
    assert_allclose(led.balance.x, -step.balance.x, rtol=0.0, atol=1e-6 * sag)


@pytest.mark.parametrize("precise", [100, 10_000])
def test_a_cut_that_is_passed_on_has_the_tractions_that_its_facets_shared(
    precise: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the shape that a search passes through they would be others, and a liver's did not end.

    Of a large body, in single precision, most facets share one; of a small one those of caps do.
    """
    monkeypatch.setattr("vdm.boundary.operators.DOUBLE_NODES", precise)
    first = Parts(clamped(ROD, share=0.2).problem, 4)
    n, n_caps, of_caps = len(ROD[0]), len(first.cut.points) - len(first.cut.ends), 0
    for triangles, numbers in zip(first.cut.parts, first.cut.tractions, strict=True):
        _, which, members = np.unique(numbers, return_inverse=True, return_counts=True)
        inside = ((triangles >= n) & (triangles < n_caps)).any(axis=1)
        on_surface = (triangles < n).all(axis=1)
        paired = members[which] == 2
        assert paired[inside].mean() > 0.7
        assert paired[on_surface].any() == (precise == 100)
        of_caps += inside.sum()
    assert of_caps > 50
    points, other = first.cut.points * [1.0, 1.3, 0.8], list[Any]()
    moved = clamped((points[:n], ROD[1]), share=0.2).problem

    def watched(facets: Any, ratio: float, dtype: type, *rest: Any) -> Array:
        other.append(facets.numbers)
        return surface_stiffness(facets, ratio, dtype, *rest)

    monkeypatch.setattr("vdm.boundary.operators.surface_stiffness", watched)
    Parts(moved, 4, replace(first.cut, points=points))
    assert_equal(other, first.cut.tractions)


@pytest.mark.parametrize("parts", [2, None])
def test_a_cut_into_more_parts_than_were_asked_for_is_kept(parts: int | None) -> None:
    """As of a fork: shapes of which each asks for the other's cut have no end if they are cut anew."""
    kept = Parts(clamped(BAR).problem, 3).cut
    model = clamped(BAR, parts=parts)
    solver = PartsSolver(model.problem, kept)
    solver.prepare([Load(np.zeros(len(BAR[0])))], compared=False, count=2)
    assert solver.body.cut is kept


def test_a_load_that_cannot_be_undone_is_named_with_the_share_that_was() -> None:
    model = clamped(ROD, 0.2, density=1e3, gravity=(0.0, 0.0, -1e5), parts=2)
    search = Unloading(ROD[0], Load(np.zeros(len(ROD[0]))))
    with pytest.raises(SolverError, match=r"beyond \d+ % of its weight the scan cannot be undone"):
        search.rest(model.solver)
