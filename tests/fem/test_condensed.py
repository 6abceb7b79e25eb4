"""The condensed problem: equal to the linear solve, and clear about what it cannot do."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fem_reference.condensed import CondensedProblem
from fem_reference.linear import LinearProblem
from fem_reference.solution import SolverError
from tests.fem.shapes import FIELDS, Body, assert_same, ball, cube


@pytest.fixture(scope="module")
def body() -> Body:
    return ball(2, 0.05)


def _linear(b: Body, **options: object) -> LinearProblem:
    settings: dict[str, object] = {
        "youngs_modulus": 5e3,
        "poisson_ratio": 0.4999,
        "solver": "direct",
        **options,
    }
    return b.problem(b.surface[:, 2] < -0.03, **settings)


def _upper(b: Body) -> np.ndarray:
    return b.surface[:, 2] > 0.01


def test_what_it_cannot_do_is_refused(body: Body) -> None:
    condensed = CondensedProblem(_linear(body, density=1e3), _upper(body))
    good = body.load(1.0 * body.facets_where(lambda x: x[:, 2] > 0.03))
    everywhere = body.load(1.0)
    moved = replace(good, prescribed=np.full((len(body.surface), 3), 1e-3))
    for load, words in (
        (everywhere, "load step 2 has pressure outside the contact region; enlarge contact"),
        (moved, "load step 2 moves held nodes in a way that is not among motions; add it to motions or use"),
        (replace(good, gravity=np.full(3, np.nan)), "gravity of load step 2 has values that are not finite"),
    ):
        with pytest.raises(SolverError, match=words):
            condensed.solve([good, load])
    free = np.repeat(body.surface[:, 2:] >= -0.03, 3, axis=1) * 1.0
    condensed.solve([replace(good, prescribed=free)])  # free nodes' values are ignored


def test_a_node_is_pushed_only_where_pressure_can_push_it() -> None:
    """On a flat face one column a node and the same answer; on a curved one two at an edge's middle."""
    box = cube(3)
    top, base = box.surface[:, 2] > 1.0 - 1e-9, box.surface[:, 2] < 1e-9
    linear = box.problem(base, poisson_ratio=0.49, solver="direct")
    flat = CondensedProblem(linear, top)
    assert len(flat.pushed) == len(flat.nodes) == 49  # 16 vertices and 33 edges
    assert_allclose(np.abs(flat.directions), [[0.0, 0.0, 1.0]] * 49, rtol=0, atol=1e-12)
    rng = np.random.default_rng(2)
    load = box.load(rng.uniform(-1.0, 1.0, (len(box.triangles), 6)) * top[box.triangles].all(axis=1)[:, None])
    expected = linear.solve([load]).displacement
    assert_allclose(flat.solve([load]).displacement, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    b = ball(2, 0.05)
    curved = CondensedProblem(_linear(b), _upper(b))
    middles = curved.nodes[curved.pushed] >= curved.problem.mesh.n_vertices
    of_node = np.bincount(curved.pushed)
    assert of_node[np.unique(curved.pushed[middles])].max() == 2
    assert of_node.max() == 3
    assert len(curved.pushed) < 0.75 * 3 * len(curved.nodes)


@pytest.mark.parametrize("rollers", [False, True])
@pytest.mark.parametrize(("element", "poisson_ratio"), [("P2-P1", 0.5), ("P2", 0.3), ("P1", 0.45)])
def test_equal_to_the_linear_solve(body: Body, element: str, poisson_ratio: float, rollers: bool) -> None:
    """Two motions in any combination, with pressure and weight, in every field; reciprocal as forces are."""
    rng = np.random.default_rng(4)
    held = np.repeat(body.surface[:, 2:] < -0.02, 3, axis=1)
    if rollers:
        held[:, 0] &= body.surface[:, 2] < -0.03
    settings = {"youngs_modulus": 5e3, "poisson_ratio": poisson_ratio, "solver": "direct", "density": 1e3}
    linear = body.problem(held, element=element, **settings)
    motions = rng.uniform(-1e-3, 1e-3, (2, len(body.surface), 3))
    model = CondensedProblem(linear, _upper(body), motions=motions)
    inside = _upper(body)[body.triangles].all(axis=1)
    free = np.where(held, 0.0, rng.uniform(-1.0, 1.0, held.shape))  # ignored
    loads = [
        body.load(
            rng.uniform(-1e2, 1e2, (len(inside), 6)) * inside[:, None] * pressed,
            prescribed=a * motions[0] + b * motions[1] + free,
            gravity=rng.uniform(-9, 9, 3) * pressed,
        )
        for pressed, a, b in ((1.0, 0.5, -2.0), (0.0, 3.0, 0.0), (1.0, 0.0, 0.0))
    ]
    expected, found = linear.solve(loads, frozenset({"compliance"})), model.solve(loads)
    assert_same(found, expected, 1e-10)
    assert found.iterations.sum() == 0
    work = expected.scalars["compliance"]
    assert_allclose(found.scalars["compliance"], work, rtol=0, atol=1e-10 * np.abs(work).max())
    reactions = model.matrix[-2:, -2:]
    assert_allclose(reactions, reactions.T, rtol=0, atol=1e-10 * np.abs(reactions).max())
    own, surface = len(model.pushed), 3 * len(body.surface)
    given_way = model.matrix[
        surface : surface + own, -2:
    ]  # what a motion moves against a force, and the reverse
    assert_allclose(given_way, -model.matrix[-2:, :own].T, rtol=0, atol=1e-10 * np.abs(given_way).max())


@pytest.mark.parametrize("density", [0.0, 1e3])
def test_a_body_without_contact_has_its_weight_or_stays_at_rest(body: Body, density: float) -> None:
    linear = _linear(body, density=density)
    model = CondensedProblem(linear, np.zeros(len(body.surface), dtype=bool))
    loads = [body.load(0.0), body.load(0.0, gravity=(1.0, 2.0, -9.81))]
    expected, found = linear.solve(loads), model.solve(loads)
    assert all(status.ok for status in found.status)
    assert_same(found, expected, 1e-10)
    for name in FIELDS:
        assert not getattr(found, name)[0].any()
        assert bool(density) == getattr(found, name)[1].any()
