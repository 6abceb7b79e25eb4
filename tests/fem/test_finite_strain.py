"""The finite-strain problem: tangent, invariance, exact homogeneous states, balance, load histories, failures."""

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse import bsr_array

from fem_reference import linear_algebra
from fem_reference.assembly import coupling_pattern, scalar_pattern
from fem_reference.condensed import CondensedProblem
from fem_reference.finite_strain import OUTPUTS, FiniteStrainProblem
from fem_reference.finite_strain_assembly import ElementAssembly
from fem_reference.follower import FollowerPressure
from fem_reference.loads import Load, nodal_forces
from fem_reference.materials import make_law
from fem_reference.mesh import TetMesh
from fem_reference.newton import LoadPath, Newton
from fem_reference.solution import Solution
from fem_reference.surface_stretch import BIOT, most_compressed
from fem_reference.tangent_solver import Factors
from solver_common.progress import Progress, reported
from tests.fem.shapes import Array, Body, assert_same, ball, cube, mapped_box
from tests.verification.records import Verified

EVERYTHING = frozenset(OUTPUTS)
TILT = (0.3, -0.2, 1.0)
FIBRES = {"material": "transversely-isotropic", "fibre_direction": TILT, "contrast": 5.0}


@pytest.fixture(scope="module")
def block() -> Body:
    return cube(2, distort=0.25)


FOLLOWS = 1e-6  # a pressure under which states are not examined, so that what buckles goes on


def _converged(solution: Solution) -> Solution:
    assert [s.code for s in solution.status] == ["converged"] * len(solution.status), solution.status
    return solution


def _random_state(mesh: TetMesh) -> tuple[Array, Array]:
    rng = np.random.default_rng(7)
    smooth = mesh.node_points @ rng.uniform(-0.3, 0.3, (3, 3)).T
    u = smooth + rng.uniform(-0.03, 0.03, (mesh.n_nodes, 3))
    return u / mesh.mean_edge, rng.uniform(-1.0, 1.0, mesh.n_vertices)


# ---------------------------------------------------------------- tangent


@pytest.mark.anchor("assembled tangent at a random state", "central differences")
@pytest.mark.parametrize("law", ["neo-hookean", "transversely-isotropic", "yeoh"])
def test_element_tangent_by_finite_differences(block: Body, law: str, verified: Verified) -> None:
    mesh = TetMesh(*block.arrays)
    pattern = scalar_pattern(mesh)
    fibres = law == "transversely-isotropic"
    shape = {"second_ratio": 0.5, "third_ratio": 0.3} if law == "yeoh" else None
    coupling = coupling_pattern(mesh, pattern)
    assembly = ElementAssembly(
        mesh,
        pattern,
        coupling,
        make_law(law, 2.6, 1.0, TILT if fibres else None, 5.0 if fibres else 1.0, shape),
    )
    u, p = _random_state(mesh)
    blocks, volumes = assembly.tangent(u, p)
    size, n = 3 * mesh.n_nodes, mesh.n_vertices
    stiffness = bsr_array((blocks, pattern.indices, pattern.indptr), shape=(size, size))
    divergence = bsr_array((volumes, coupling.indices, coupling.indptr), shape=(n, size))
    rng = np.random.default_rng(8)
    for k in range(3):
        du, dp = rng.standard_normal(u.shape), rng.standard_normal(p.shape)
        h = 1e-6
        ahead, behind = (assembly.forces(u + s * du, p + s * dp) for s in (h, -h))
        nodal = (ahead.nodal - behind.nodal) / (2.0 * h)
        expected = (stiffness @ du.ravel() - divergence.T @ dp).reshape(-1, 3)
        difference = (nodal - expected) / np.abs(expected).max()
        verified.at_most(f"{law}: forces along random direction {k}", difference, 1e-8)
        volume = (ahead.volume - behind.volume) / (2.0 * h)
        expected = divergence @ du.ravel()
        assert_allclose(volume, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.anchor("assembled tangent at a random state", "central differences")
def test_follower_tangent_by_finite_differences(block: Body, verified: Verified) -> None:
    """A pressure that varies over part of the surface: the tangent is not symmetric."""
    mesh = TetMesh(*block.arrays)
    pattern = scalar_pattern(mesh)
    follower = FollowerPressure(mesh, pattern)
    rng = np.random.default_rng(10)
    x = mesh.node_points + rng.uniform(-0.05, 0.05, (mesh.n_nodes, 3))
    pressure = rng.uniform(-1.0, 1.0, (len(block.triangles), 6)) * block.top[:, None]
    places, blocks = follower.stiffness(x, pressure)
    whole = np.zeros((pattern.size, 3, 3))
    whole[places] = blocks
    size = 3 * mesh.n_nodes
    stiffness = bsr_array((whole, pattern.indices, pattern.indptr), shape=(size, size))
    assert abs(stiffness - stiffness.T).max() > 0.1 * abs(stiffness).max()
    for k in range(3):
        dx, h = rng.standard_normal(x.shape), 1e-6
        slope = (follower.forces(x + h * dx, pressure) - follower.forces(x - h * dx, pressure)) / (2.0 * h)
        expected = -(stiffness @ dx.ravel()).reshape(-1, 3)
        difference = (slope - expected) / np.abs(expected).max()
        verified.at_most(f"follower pressure: forces along random direction {k}", difference, 1e-8)


# ---------------------------------------------------------------- exact states


@pytest.mark.anchor(
    "patch test and outputs, finite strain",
    "homogeneous F; energy and mean stress of the neo-Hookean law; Taylor et al. 1986, doi 10.1002/nme.1620220105",
)
@pytest.mark.parametrize("poisson_ratio", [-0.3, 0.0, 0.3, 0.45, 0.4999])
def test_patch_test_with_the_whole_surface_given(
    block: Body, poisson_ratio: float, verified: Verified
) -> None:
    """Any homogeneous deformation is reproduced inside."""
    stretch = np.array([[1.1, 0.3, 0.0], [-0.1, 0.9, 0.2], [0.15, 0.0, 1.05]])
    held = np.ones(len(block.surface), dtype=bool)
    given = block.surface @ (stretch - np.eye(3)).T
    # Nearly incompressible, the residual is measured against a pressure that is thousands of moduli.
    problem = block.finite(held, poisson_ratio=poisson_ratio, tolerance=1e-12)
    attempts = [a for _, a in problem.substeps([block.load(prescribed=given)])]
    assert attempts[-1].converged
    assert attempts[-1].load_factor == 1.0
    mesh = problem.mesh
    expected = mesh.node_points @ (stretch - np.eye(3)).T
    title = f"nu = {poisson_ratio}"
    difference = attempts[-1].state.displacement * mesh.mean_edge - expected
    verified.at_most(f"{title}: displacement on a distorted mesh", difference, 1e-9)
    s = _converged(problem.solve([block.load(prescribed=given)], EVERYTHING))
    determinant = np.linalg.det(stretch)
    out = s.scalars
    verified.equal(f"{title}: volume", out["volume"][0], determinant, rtol=1e-9)
    verified.equal(f"{title}: det F - 1", out["max_det_f_deviation"][0], abs(determinant - 1.0), atol=1e-8)
    strain = 0.5 * np.linalg.eigvalsh(stretch.T @ stretch - np.eye(3))[-1]
    verified.equal(
        f"{title}: largest Green-Lagrange strain", out["max_principal_strain"][0], strain, atol=1e-8
    )
    # Energy density and mean stress from the closed form of the law.
    g = 0.5 / (1.0 + poisson_ratio)
    lame = 2.0 * g * poisson_ratio / (1.0 - 2.0 * poisson_ratio)
    squares = np.sum(stretch**2)
    energy = 0.5 * g * (squares - 3.0 - 2.0 * np.log(determinant)) + 0.5 * lame * (determinant - 1.0) ** 2
    trace = g * (squares - 3.0) / determinant + 3.0 * lame * (determinant - 1.0)
    verified.equal(f"{title}: mean pressure", s.fluid_pressure[0], -trace / 3.0, rtol=1e-8, atol=1e-9)
    verified.equal(f"{title}: energy", s.energy[0], energy, rtol=1e-8)


@pytest.mark.parametrize("solver", ["direct", "iterative"])
def test_uniaxial_stretch_on_rollers(block: Body, solver: str) -> None:
    """Incompressible, with free sides. Held components of nodes that are free otherwise arrive exactly."""
    g, stretch, x = 1.0 / 3.0, 1.7, block.surface
    held = x == 0.0
    held[:, 2] |= x[:, 2] == 1.0
    given = (x[:, 2:] == 1.0) * [0.0, 0.0, stretch - 1.0]
    s = _converged(block.finite(held, poisson_ratio=0.5, solver=solver).solve([block.load(prescribed=given)]))
    assert_array_equal(s.displacement[0][held], given[held])
    expected = x * (np.array([stretch**-0.5, stretch**-0.5, stretch]) - 1.0)
    assert_allclose(s.displacement[0], expected, rtol=0, atol=1e-8)
    force = s.reaction_force[0][x[:, 2] == 1.0, 2].sum()
    assert_allclose(force, g * (stretch - stretch**-2), rtol=0, atol=1e-8)


# ---------------------------------------------------------------- invariance and balance


turned = pytest.mark.anchor("rigid-motion invariance", "the same answer, turned")


@turned
@pytest.mark.parametrize("options", [{}, FIBRES], ids=["neo-hookean", "fibres"])
def test_a_rigid_turn_of_the_support_strains_nothing(
    block: Body, options: dict[str, object], verified: Verified
) -> None:
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    given = block.surface @ (turn - np.eye(3)).T + np.array([3.0, -1.0, 2.0])
    problem = block.finite(block.bottom, poisson_ratio=0.5, **options)
    solution = _converged(problem.solve([block.load(prescribed=given)], EVERYTHING))
    title = f"finite strain, {'fibres' if options else 'neo-Hookean'}, support turned by 0.7 rad"
    verified.at_most(f"{title}: displacement", solution.displacement[0] - given, 1e-9)
    verified.at_most(f"{title}: energy", solution.energy, 1e-16)
    assert_allclose(solution.reaction_force, 0.0, rtol=0, atol=1e-9)
    assert_allclose(solution.scalars["max_principal_strain"], 0.0, rtol=0, atol=1e-9)


@turned
@pytest.mark.parametrize("pressure", ["follower", "dead"])
def test_the_whole_scene_can_be_turned(block: Body, pressure: str, verified: Verified) -> None:
    turn, _ = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    gravity = np.array([0.05, 0.0, -0.1])
    options: dict[str, object] = {**FIBRES, "poisson_ratio": 0.4999, "density": 1.0, "pressure": pressure}
    problem = block.finite(block.bottom, **options)
    here = _converged(problem.solve([block.load(0.1 * block.top, gravity=gravity)], EVERYTHING))
    there_body = Body(block.points @ turn.T, *block.arrays[1:])
    options["fibre_direction"] = turn @ np.array(TILT)
    problem = there_body.finite(block.bottom, **options)
    there = _converged(problem.solve([block.load(0.1 * block.top, gravity=turn @ gravity)], EVERYTHING))
    difference = there.displacement[0] - here.displacement[0] @ turn.T
    verified.at_most(f"finite strain, {pressure} pressure, scene turned: displacement", difference, 1e-9)
    assert_allclose(there.reaction_force[0], here.reaction_force[0] @ turn.T, rtol=0, atol=1e-9)
    assert_allclose(there.energy, here.energy, rtol=1e-8, atol=0)
    for name in OUTPUTS.keys() - {"condition_estimate"}:  # the 1-norm knows the axes
        assert_allclose(there.scalars[name], here.scalars[name], rtol=1e-7, atol=0)


@pytest.mark.anchor("outputs: reactions balance the load, finite strain", "equilibrium of forces")
@pytest.mark.parametrize("poisson_ratio", [0.3, 0.5])
def test_reactions_balance_a_follower_pressure(block: Body, poisson_ratio: float, verified: Verified) -> None:
    """Pressure on all of the surface but a rigid face: the resultant is that on the face, however it deforms."""
    pressure = -0.3 * ~block.facets_where(lambda x: x[:, 2] == 0.0)
    s = _converged(block.finite(block.bottom, poisson_ratio=poisson_ratio).solve([block.load(pressure)]))
    unbalanced = s.reaction_force[0].sum(axis=0) - [0.0, 0.0, -0.3]
    verified.at_most(f"follower pressure, nu = {poisson_ratio}: sum of forces", unbalanced, 1e-9)
    if poisson_ratio < 0.5:
        assert np.abs(s.displacement).max() > 0.05


# ---------------------------------------------------------------- load histories


def test_substeps_are_cut_and_grow(block: Body) -> None:
    """Pressed flat in one load step: too much for one solve, not for several."""
    x = block.surface
    held = block.bottom | (x[:, 2] == 1.0)
    given = (x[:, 2:] == 1.0) * np.array([0.0, 0.0, -0.4])
    problem = block.finite(held, poisson_ratio=0.45, max_newton=2)
    attempts = [a for _, a in problem.substeps([block.load(prescribed=given)])]
    reached = [a.load_factor for a in attempts if a.converged]
    assert not all(a.converged for a in attempts)
    assert reached[-1] == 1.0
    assert reached == sorted(reached)
    s = _converged(problem.solve([block.load(prescribed=given)]))
    assert s.scalars["substeps"][0] == len(reached)
    assert s.iterations[0] == sum(len(a.residuals) - 1 for a in attempts)
    assert_allclose(s.displacement[0][held], given[held], rtol=0, atol=1e-15)


def test_a_load_out_of_reach_is_a_status_with_a_remedy_and_a_solve_tells_where_it_is(block: Body) -> None:
    problem = block.finite(block.bottom, poisson_ratio=0.45)
    loads = [block.load(-share * block.top) for share in (0.1, 20.0, 0.1)]
    told: list[Progress] = []
    with reported(told.append):
        s = problem.solve(loads, EVERYTHING)
    count = len(told)
    problem.solve(loads[:1])
    assert len(told) == count, "a solve outside of the block"
    assert [status.code for status in s.status][::2] == ["converged", "not-reached"]
    failed = s.status[1]
    assert failed.code in {"not-converged", "inverted"}
    assert not failed.ok
    assert "of load step 2" in failed.message
    assert "load the body less" in failed.remedy
    # The last state in equilibrium is kept.
    assert 0.0 < s.scalars["load_factor"][1] < 0.5
    assert np.abs(s.displacement[1]).max() > 2.0 * np.abs(s.displacement[0]).max()
    for values in (s.displacement, s.reaction_force, s.fluid_pressure, s.energy, *s.scalars.values()):
        assert np.isfinite(values[:2]).all()
        assert np.isnan(values[2]).all()
    assert s.iterations[2] == 0
    assert {(one.step, one.steps) for one in told} == {(0, 3), (1, 3)}
    for step, iterations in enumerate(s.iterations[:2]):
        here = [one for one in told if one.step == step]
        starts = [k for k, one in enumerate(here) if one.iteration == 0]
        assert sum(one.iteration > 0 for one in here) == iterations
        assert all(here[k].reached < here[k].share <= 1.0 for k in starts)
        assert max(one.reached for one in here) == (step and s.scalars["load_factor"][1])
    (last,) = [one for one in told if one.step == 0][-1:]
    assert (last.share, last.residual) == (1.0, s.scalars["relative_residual"][0])


def test_a_first_step_out_of_reach_leaves_the_body_at_rest(block: Body) -> None:
    s = block.finite(block.bottom, pressure="dead").solve([block.load(1e9 * block.top)], EVERYTHING)
    assert s.status[0].code == "inverted"
    assert s.scalars["load_factor"] == 0.0
    assert_array_equal(s.displacement, 0.0)
    assert_array_equal(s.reaction_force, 0.0)
    assert_allclose(s.scalars["volume"], 1.0, rtol=1e-14, atol=0)


def test_nodal_fields_are_those_of_the_surface_and_none_beyond_reach(block: Body) -> None:
    problem = block.finite(block.bottom, pressure="dead", density=1.0)
    loads = [block.load(size * block.top) for size in (0.1, 1e9, 0.1)]
    forces = nodal_forces(problem.mesh, loads, 1.0)
    fields = problem.solve_nodal(forces, np.zeros_like(forces))
    s = problem.solve(loads[:1])
    assert_allclose(fields.displacement[0][problem.mesh.surface_nodes], s.displacement[0], rtol=0, atol=1e-12)
    assert fields.residual[0] <= 1e-9
    assert np.isnan(fields.displacement[1:]).all()
    assert np.isnan(fields.residual[1:]).all()


def test_auto_turns_to_multigrid_when_the_analysis_finds_too_much_fill(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    b = cube(3)
    top = b.load(0.05 * b.top)
    direct, iterative = (
        b.finite(b.bottom, solver=solver).solver.preconditioner.estimated_bytes
        for solver in ("direct", "iterative")
    )
    assert iterative < direct
    monkeypatch.setattr(linear_algebra, "faster_that_fits", lambda *_: ("direct", "hopeful"))
    problem = b.finite(b.bottom, memory_limit=0.5 * (iterative + direct))
    assert problem.solver.preconditioner.name == "iterative"
    assert problem.solver.reason == "hopeful; the analysis found that the factors need more"
    found, expected = (
        _converged(p.solve([top])).displacement for p in (problem, b.finite(b.bottom, solver="direct"))
    )
    assert_allclose(found, expected, rtol=0, atol=1e-7 * np.abs(expected).max())


ASKED = frozenset({"max_principal_strain", "volume"})
SHARES = (0.01, 0.5, 1.0, 0.25, 0.75, 0.6, 0.75)


@pytest.fixture(scope="module")
def cell() -> Body:
    return cube(1)


def _at_rest(b: Body) -> FiniteStrainProblem:
    """One that has solved nothing yet."""
    return b.finite(b.bottom, poisson_ratio=0.45)


def _pulled(b: Body, pressure: float) -> Load:
    return b.load(-pressure * b.top)


def _assert_same_outputs(one: Solution, other: Solution) -> None:
    assert other.status[0].ok
    assert_same(one, other, 1e-8)
    for name in ASKED:
        assert_allclose(one.scalars[name], other.scalars[name], rtol=1e-8, atol=0)


def test_each_load_gives_what_it_gives_from_rest_and_is_nearer(cell: Body) -> None:
    problem, path = _at_rest(cell), LoadPath()
    loads = [_pulled(cell, 0.4 * share) for share in SHARES]
    short = [problem.solve([load], ASKED, path) for load in loads]
    long = [_at_rest(cell).solve([load], ASKED) for load in loads]
    for one, other in zip(short, long, strict=True):
        _assert_same_outputs(one, other)
    steps = np.array(
        [[one.iterations[0], other.iterations[0]] for one, other in zip(short, long, strict=True)]
    )
    assert steps[3:, 0].sum() < steps[3:, 1].sum(), "between loads that are known"
    assert steps[-1, 0] == 0, "a load that is known"


def test_the_end_of_the_way_is_looked_for_once(cell: Body) -> None:
    """Too small a load is no end."""
    problem, path = _at_rest(cell), LoadPath()
    assert problem.solve([_pulled(cell, 1e-17)], ASKED, path).status[0].code == "too-small"
    stopped = problem.solve([_pulled(cell, -2.0)], ASKED, path)
    assert stopped.status[0].code in {"not-converged", "inverted"}
    end = -2.0 * stopped.scalars["load_factor"][0]
    again = problem.solve([_pulled(cell, -2.0)], ASKED, path)
    assert again.status[0].code == stopped.status[0].code
    assert again.iterations[0] == 0
    assert_allclose(again.displacement, stopped.displacement, rtol=1e-14, atol=0)
    below = _pulled(cell, 0.4 * end)  # nearer to the end the path branches
    _assert_same_outputs(problem.solve([below], ASKED, path), _at_rest(cell).solve([below], ASKED))


HEAVY = {"poisson_ratio": 0.4999, "density": 1.0}


def test_a_rim_that_creases_is_named_and_ends_the_way_soon() -> None:
    body = mapped_box((2, 2, 2), lambda x: x)
    # what solvers remember moves the end of the way: each begins anew
    problem, other = (body.finite(body.bottom, **HEAVY) for _ in range(2))
    load = body.load(1.0 * body.top)
    attempts = [attempt for _, attempt in problem.substeps([load])]
    last = [attempt for attempt in attempts if attempt.converged][-1]
    worst = most_compressed(problem.mesh, last.state.displacement * problem.mesh.mean_edge)
    assert worst.plane < BIOT
    beyond = [one for one in attempts if not one.converged and one.state is last.state]
    assert len(beyond) == 1, "no shorter steps beyond Biot's stretch"
    assert not problem._newton._is_unstable(replace(beyond[0], code="passed")), "a shorter way may touch"
    solution = other.solve([load])
    (status,) = solution.status
    x, y, z = 1e3 * worst.place
    assert f"at ({x:.1f}, {y:.1f}, {z:.1f}) mm is compressed to {worst.least:.3f}" in status.message
    assert "creasing" in status.message
    assert "`elastic`" in status.remedy
    assert solution.scalars["load_factor"][0] == last.load_factor, "the state up to there is kept"


def test_substeps_that_head_for_an_element_inside_out_before_a_load_that_did_are_the_last() -> None:
    """They would go on halving the way there, ever nearer to a tetrahedron without volume."""
    body = mapped_box((4, 2, 2), lambda x: x)
    problem = body.finite(body.bottom, **HEAVY)
    *before, last = [a for _, a in problem.substeps([body.load(gravity=(0.0, 0.0, -1.5))])]
    failed = [(one.load_factor, one.code) for one in before if not one.converged]
    assert (last.load_factor, last.code) in failed, "no load is new"
    assert before[-1].converged
    assert last.state is before[-1].state, "the state up to there is kept"


def test_an_element_inside_out_from_rest_does_not_end_a_way_that_goes_on() -> None:
    """At half of this weight the least J falls on as if it were gone before all of it, which failed at once."""
    body = mapped_box((2, 2, 4), lambda x: x)
    problem = body.finite(body.bottom, poisson_ratio=0.45, density=1.0)
    load = body.load(FOLLOWS * body.top, gravity=(0.0, 0.0, -2.0))
    first, *_, last = [a for _, a in problem.substeps([load])]
    assert first.code == "inverted"
    assert last.converged
    assert last.load_factor == 1.0


def test_a_load_that_turned_an_element_inside_out_is_tried_again_before_the_way_ends() -> None:
    """The body bulges on the way, from where J falls slower."""
    body = mapped_box((2, 2, 4), lambda x: x * (1.0, 0.5, 2.0))
    top = body.surface[:, 2] == 2.0
    problem = body.finite(body.bottom | top, poisson_ratio=0.49)
    side = body.facets_where(lambda x: x[:, 0] == 1.0)
    load = body.load(FOLLOWS * side, prescribed=top[:, None] * np.array([0.354, 0.0, -0.59]))
    attempts = [attempt for _, attempt in problem.substeps([load])]
    failed = [one for one in attempts if one.code == "inverted"]
    assert [one.load_factor for one in failed] == [1.0, 1.0], "from rest and from a state on the way"
    assert not failed[0].state.displacement.any()
    assert failed[1].state.displacement.any()
    assert attempts[-1].converged
    assert attempts[-1].load_factor == 1.0


def test_a_pull_whose_first_tangent_cannot_be_solved_is_reached_in_shorter_steps() -> None:
    """At rest under all of it the stiffness of a pressure that follows the surface is more than the body's."""
    body = mapped_box((8, 8, 2), lambda x: x * (1.0, 1.0, 0.5))
    top = (body.surface[:, 2] == 0.5)[body.triangles].all(axis=1)
    problem = body.finite(body.bottom, poisson_ratio=0.49, solver="iterative")
    first, *_, last = [a for _, a in problem.substeps([body.load(-0.92 * top)])]
    assert (first.code, len(first.residuals)) == ("linear-solver", 1)
    assert last.converged
    assert last.load_factor == 1.0


@pytest.mark.parametrize("poisson_ratio", [-0.3, 0.3, 0.45, 0.5])
@pytest.mark.parametrize("share", [0.8, 1.2])
def test_a_column_that_stays_straight_stands_up_to_the_weight_that_it_buckles_under(
    share: float, poisson_ratio: float
) -> None:
    """Greenhill's, 7.84 E I / L^2, with E = L = 1: Newton's method finds it straight beyond, on this mesh."""
    body = mapped_box((2, 2, 12), lambda x: x / (6.0, 6.0, 1.0))
    problem = body.finite(body.bottom, poisson_ratio=poisson_ratio, density=1.0)
    weight = share * 7.84 / 12.0 / 36.0
    solution = problem.solve([body.load(gravity=(0.0, 0.0, -weight))])
    (status,) = solution.status
    assert status.ok == (share < 1.0)
    assert share * solution.scalars["load_factor"][0] == pytest.approx(min(share, 1.05), abs=0.06)
    if not status.ok and poisson_ratio > 0.0:
        # near it rounding decides whether Newton's method converges to a state that is not stable, or does not
        assert "limit point" in status.message


def test_a_pressure_of_which_the_load_tells_that_it_has_no_energy_takes_no_tangent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """On the top of a column that its weight buckles; on all of its free surface it is judged as without."""
    body = mapped_box((2, 2, 12), lambda x: x / (6.0, 6.0, 1.0))
    problem = body.finite(body.bottom, poisson_ratio=0.45, density=1.0)
    gravity = (0.0, 0.0, -1.2 * 7.84 / 12.0 / 36.0)
    newton, state = problem._newton, problem._state(problem.sag(gravity))
    bottom, top = (body.facets_where(lambda x, z=z: x[:, 2] == z) for z in (0.0, 1.0))
    loads = [problem._scaled(body.load(1e-6 * part, gravity=gravity)) for part in (~bottom, top)]
    assert not newton.is_stable(state, loads[0])
    monkeypatch.setattr(Newton, "tangent", None)
    assert newton.is_stable(state, loads[1])


def test_the_time_of_a_step_is_without_what_is_told_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    examined, late = Factors.is_stable, [0.0]

    def slow(*given: Any) -> bool:
        late[0] += 1e6
        return examined(*given)

    monkeypatch.setattr(Factors, "is_stable", slow)
    for user in ("newton", "finite_strain_outputs"):
        monkeypatch.setattr(f"fem_reference.{user}.clock", lambda: time.perf_counter() + late[0])
    body = cube(2)
    problem = body.finite(body.bottom, density=1.0)
    solution = problem.solve([body.load(gravity=(0.0, 0.0, -0.01))])
    assert solution.seconds_per_step[0] < 1e6 <= problem._newton.seconds_examined


@pytest.mark.parametrize(("along", "stands"), [(0, True), (1, False), (2, False)])
def test_a_volume_that_is_kept_holds_the_mode_that_it_is_of(along: int, stands: bool) -> None:
    """Of a column that buckles along x, tied by one row of the mean motion of its top along an axis."""
    body = mapped_box((2, 2, 12), lambda x: x / (6.0, 4.0, 1.0))
    problem = body.finite(body.bottom, poisson_ratio=0.45, density=1.0)
    gravity = (0.0, 0.0, -1.2 * 7.84 / 12.0 / 36.0)
    newton, state = problem._newton, problem._state(problem.sag(gravity))
    tangent = newton.tangent(state, problem._weight(gravity)).symmetric()
    tie = np.zeros((problem.mesh.n_nodes, 3))
    tie[problem.mesh.surface_nodes[body.surface[:, 2] == 1.0], along] = 1.0
    factors = Factors(tangent, None)
    assert not factors.is_stable(tangent, np.zeros((0, newton.system.size)))
    assert factors.is_stable(tangent, newton._nodal_rows(tie)[None]) == stands


@pytest.mark.parametrize(("sides", "at_the_rim"), [((2, 2, 2), False), ((4, 2, 2), True)])
def test_what_creases_at_the_rim_of_what_is_held_is_said_to_be_there(
    sides: tuple[int, int, int], at_the_rim: bool
) -> None:
    body = mapped_box(sides, lambda x: x)
    problem = body.finite(body.bottom, **HEAVY)
    (status,) = problem.solve([body.load(FOLLOWS * body.top, gravity=(0.0, 0.0, -4.0))]).status
    assert "creasing" in status.message
    assert ("at the rim of what is held" in status.message) == at_the_rim


def test_a_limit_point_is_named() -> None:
    """A shallow arch under its weight, just before it snaps through."""

    def arch(x: Array) -> Array:
        return np.c_[x[:, 0], 0.2 * x[:, 1], 0.8 * x[:, 0] * (1.0 - x[:, 0]) + 0.05 * (x[:, 2] - 0.5)]

    body = mapped_box((10, 2, 1), arch)
    x = body.surface[:, 0]
    problem = body.finite((x < 1e-9) | (x > 1.0 - 1e-9), **HEAVY)
    (status,) = problem.solve([body.load(gravity=(0.0, 0.0, -0.1))]).status
    assert not status.ok
    assert "a limit point" in status.message
    assert "displacement in place of the load" in status.remedy
    small = [a for _, a in problem.substeps([body.load(gravity=(0.0, 0.0, -1e-4))])][-1]
    assert_allclose(problem.softest(small), 1.0, rtol=0.05, atol=0)


# ---------------------------------------------------------------- loads of any size: followed, or said not to be

SMALL = ball(1)
HELD = SMALL.surface[:, 2] < -0.6
PRESSED = np.where(SMALL.facets_where(lambda x: x[:, 2] > 0.5), 1.0, 0.0)
TINY = (1e-300, 1e-170, 1e-40, 1e-18)


def test_linear_elements_follow_a_load_of_any_size() -> None:
    direct, iterative = (
        SMALL.problem(HELD, poisson_ratio=0.49, solver=name) for name in ("direct", "iterative")
    )
    condensed = CondensedProblem(direct, SMALL.surface[:, 2] > 0.5)
    whole = direct.solve([SMALL.load(PRESSED)]).displacement
    for problem, factors in ((direct, (*TINY, 1e99)), (iterative, (*TINY, 1e99)), (condensed, TINY[:1])):
        for factor in factors:
            part = problem.solve([SMALL.load(factor * PRESSED)])
            assert part.status[0].ok
            assert_allclose(part.displacement / factor, whole, rtol=0, atol=1e-7 * np.abs(whole).max())


def test_elements_at_finite_strain_refuse_what_rounding_hides() -> None:
    linear = SMALL.problem(HELD, poisson_ratio=0.49)
    problem = SMALL.finite(HELD, poisson_ratio=0.49)
    seen = set()
    for pressure in (*TINY, 1e-15, 1e-13, 1e-11, 1e-8):
        load = SMALL.load(pressure * PRESSED)
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
    moved = problem.solve([SMALL.load(prescribed=[0.0, 0.0, 1e-18])])
    assert moved.status[0].ok
    assert_allclose(
        moved.displacement[0], np.broadcast_to([0.0, 0.0, 1e-18], (len(HELD), 3)), rtol=0, atol=1e-22
    )
    # a load that is taken off is not too small
    history = problem.solve([SMALL.load(factor * PRESSED) for factor in (0.0, 0.05, 1e-15, 0.0)])
    assert all(status.ok for status in history.status)
    assert np.abs(history.displacement[2:]).max() < 1e-6 * np.abs(history.displacement[1]).max()
