"""No answer of the surface model is wrong in silence: each is held against extended precision where it may break.

The truth is the same linear system, solved in double precision and refined with residuals of long double. Estimates
of the condition are held to numpy's.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import linalg

from solver_common.condition import estimated_norm, operator
from tests.bodies import shaped
from tests.vdm.vdm_shapes import WITH_MATRIX, icosphere, model
from vdm import Load, Model, Parameters, SurfaceMesh
from vdm.problem import Problem
from vdm.solvers import audit
from vdm.solvers.linear import BorderedFactor
from vdmbench.body.distort import distorted
from vdmbench.body.geometry import build_mesh

Array = np.ndarray
POINTS, TRIANGLES = icosphere(1, (0.05, 0.06, 0.045))
BASE = POINTS[:, 2] < -0.03
BODY = SurfaceMesh(POINTS, TRIANGLES)
FINGER = Load(np.where(POINTS[:, 2] > 0.03, 20.0, 0.0))
SOLVERS = ("linear", "lu", "bicg", "bicg-cold")
MODULI = {
    "paper": ("bulk_modulus", "connectivity_modulus"),
    "consistent": ("foundation", "surface_tension"),
    "vector": ("foundation", "surface_tension"),
}


def truth(problem: Problem, load: Load) -> tuple[Array, float]:
    """(N, 3) displacement, and how much the last refinement moved it."""
    formulation = problem.formulation
    n, m = problem.free.size * formulation.components, formulation.columns.count
    wide = [a.dense().reshape(n, m).astype(np.longdouble) for a in (formulation.columns, formulation.rows)]
    stiffness = formulation.stiffness().toarray().astype(np.longdouble)
    matrix = np.block([[stiffness, -wide[0]], [wide[1].T, formulation.corner.astype(np.longdouble)]])
    free = np.append(np.repeat(problem.free, formulation.components), np.ones(m, dtype=bool))
    right = np.append(problem.force(load).reshape(-1), np.zeros(m)).astype(np.longdouble)[free]
    matrix = matrix[free][:, free]
    scale = np.ones(len(right), dtype=np.longdouble)
    for _ in range(5):
        scale = scale / np.sqrt(np.abs(matrix * scale[:, None] * scale).max(axis=1))
    scaled = matrix * scale[:, None] * scale
    factor = linalg.lu_factor(scaled.astype(np.float64))
    x = np.zeros_like(right)
    moved = 1.0
    for _ in range(40):
        change = linalg.lu_solve(factor, (right * scale - scaled @ x).astype(np.float64))
        x = x + change
        moved = float(np.abs(change).max() / np.abs(x).max())
        if moved < 1e-16:
            break
    full = np.zeros(len(free))
    full[free] = x * scale
    return formulation.displacement(full[:n].reshape(-1, formulation.components)), moved


def held_to_the_truth(model: Model, load: Load, tolerance: float) -> str:
    """The status of a step; where it says converged, the step is right."""
    found = model.solve([load])
    u, moved = truth(model.problem, load)
    (status,) = found.status
    if status.ok:
        assert_allclose(found.displacement[0], u, rtol=0, atol=(tolerance + 10 * moved) * np.abs(u).max())
        assert found.scalars["relative_residual"][0] <= audit.RESIDUAL_LIMIT
    else:
        assert status.message
        assert status.remedy
    return status.code


@pytest.mark.parametrize(
    ("formulation", "solver"),
    [("vector", solver) for solver in SOLVERS] + [(form, "linear") for form in ("paper", "consistent")],
)
@pytest.mark.filterwarnings("ignore:overflow|invalid value|divide by zero")
def test_moduli_far_apart(formulation: str, solver: str) -> None:
    grounded, joined = MODULI[formulation]
    codes = []
    for exponent in (-16, -8, -4, 0, 4, 8, 12):
        parameters = Parameters(**{grounded: 1e3 * 10.0**exponent, joined: 1e3})
        model = Model(POINTS, TRIANGLES, parameters, formulation=formulation, fixed=BASE, solver=solver)
        codes.append(held_to_the_truth(model, FINGER, 1e-5))
    if solver in ("linear", "lu"):
        assert codes[:6] == ["converged"] * 6


@pytest.mark.parametrize("method", ["penalty-added", "penalty-replaced"])
@pytest.mark.parametrize("formulation", ["paper", "vector"])
def test_penalties_of_eighteen_orders(formulation: str, method: str) -> None:
    rule = Parameters.from_tissue(5000.0, SurfaceMesh(POINTS, TRIANGLES), formulation)
    for exponent in (2, 4, 8, 12, 16, 20):
        options = {"constraint_method": method, "penalty": 10.0**exponent}
        model = Model(POINTS, TRIANGLES, rule, formulation=formulation, fixed=BASE, solver="lu", **options)
        # a penalty that lets held nodes move by 1e-4 of the largest displacement says so
        expected = "inaccurate" if exponent == 2 else "converged"
        assert held_to_the_truth(model, FINGER, 10.0**-exponent + 1e-9) == expected


def made(points: Array, formulation: str, fixed: Array, solver: str = "linear") -> Model | str:
    """The model, or why it was refused."""
    rule = Parameters.from_tissue(5000.0, SurfaceMesh(points, TRIANGLES), formulation)
    try:
        return Model(points, TRIANGLES, rule, formulation=formulation, fixed=fixed, solver=solver)
    except ValueError as refused:
        return str(refused)


@pytest.mark.parametrize("formulation", WITH_MATRIX)
def test_slivers(formulation: str) -> None:
    for ratio in (1e1, 1e2, 1e4, 1e6):
        points = POINTS.copy()
        for a, b, _ in TRIANGLES[::20]:
            points[a] = points[b] + (points[a] - points[b]) / ratio
        model = made(points, formulation, BASE)
        if isinstance(model, str):
            assert formulation == "bem", model
            assert "slivers" in model
        else:
            assert held_to_the_truth(model, FINGER, 1e-6) == "converged"


@pytest.mark.parametrize("formulation", ["consistent", "vector"])
def test_refinement_takes_slivers_out_of_a_factor_in_single_precision(formulation: str) -> None:
    """By as many sweeps as it takes, each of which must halve the rest; without any, the audit says so."""
    body = build_mesh(shaped("sphere", 0.015, {"radius": 0.05}), volume=False)
    for ratio in (1e2, 1e5, 1e6):
        mesh = distorted(body, slivers=ratio, perturbation=None)
        points, triangles = mesh.surface_points, mesh.triangles
        fixed, load = points[:, 2] < -0.03, Load(np.where(points[:, 2] > 0.03, 20.0, 0.0))
        rule = Parameters.from_tissue(5000.0, SurfaceMesh(points, triangles), formulation, held=fixed)
        single, refined = (
            Model(points, triangles, rule, formulation=formulation, fixed=fixed, solver=solver)
            for solver in ("single", "refined")
        )
        assert held_to_the_truth(refined, load, 1e-9) == "converged"
    assert single.solve([load]).status[0].code == "inaccurate"


def linear(formulation: str) -> Model:
    model = made(POINTS, formulation, BASE)
    assert isinstance(model, Model), model
    return model


@pytest.mark.parametrize("formulation", WITH_MATRIX)
def test_a_factor_that_is_a_little_off_is_refined(formulation: str, monkeypatch: pytest.MonkeyPatch) -> None:
    model = linear(formulation)
    exact = model.solve([FINGER])
    _perturb(model.solver, 1e-4, monkeypatch)
    found = model.solve([FINGER])
    assert found.status[0].ok
    size = np.abs(exact.displacement).max()
    assert_allclose(found.displacement, exact.displacement, rtol=0, atol=1e-9 * size)


@pytest.mark.parametrize("formulation", WITH_MATRIX)
def test_a_factor_that_is_wrong_is_found_out(formulation: str, monkeypatch: pytest.MonkeyPatch) -> None:
    model = linear(formulation)
    _perturb(model.solver, 3.0, monkeypatch)
    found = model.solve([FINGER, FINGER.scaled(0.5)])
    assert [status.code for status in found.status] == ["inaccurate"] * 2
    assert found.scalars["relative_residual"].min() > audit.RESIDUAL_LIMIT


def _perturb(solver: object, share: float, monkeypatch: pytest.MonkeyPatch) -> None:
    original = BorderedFactor._solve
    wrong = 1.0 + share * np.random.default_rng(1).standard_normal(solver.factor.response.first.size)

    def off(self: BorderedFactor, *arguments: Array) -> tuple[Array, Array, Array | None]:
        x, border, held = original(self, *arguments)
        return x * wrong, border, held

    monkeypatch.setattr(BorderedFactor, "_solve", off)


def test_an_answer_that_rounding_moves_is_called_ill_conditioned() -> None:
    found = audit.judged(linear("paper").solver.step(FINGER), audit.Audit(1e-15, 2e-3))
    assert found.status.code == "ill-conditioned"
    assert found.status.remedy


def bent_line(offset: float) -> tuple[Array, Array]:
    """Points, and a mask of three: one lies beside the line of the others by a share of their distance."""
    first, second, third = np.argsort(POINTS[:, 2])[:3]
    points = POINTS.copy()
    length = np.linalg.norm(points[first] - points[second])
    points[third] = 0.5 * (points[first] + points[second]) - [0.0, 0.0, offset * length]
    return points, np.isin(np.arange(len(POINTS)), [first, second, third])


@pytest.mark.parametrize("solver", ["linear", "single", "refined", "lu", "bicg", "bicg-cold"])
@pytest.mark.filterwarnings("ignore:overflow|invalid value|divide by zero")
def test_three_held_nodes_nearly_on_one_line(solver: str) -> None:
    """The body turns about the line: called converged is only what is right to a thousandth."""
    for offset in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 0.0):
        points, held = bent_line(offset)
        model = made(points, "vector", held, solver)
        if isinstance(model, str):
            assert offset < 1e-1 or solver in ("single", "refined"), model
            assert "hold an area" in model or "use the linear solver" in model
        else:
            assert offset > 1e-6
            held_to_the_truth(model, FINGER, 1e-3)


@pytest.mark.parametrize(
    ("formulation", "solver"),
    [("vector", solver) for solver in ("linear", "single", "refined", "lu", "bicg")]
    + [(form, "linear") for form in ("mass-spring", "bem")],
)
def test_a_body_that_its_support_carries_along_is_right(formulation: str, solver: str) -> None:
    """No force is left but rounding, of which nothing can be lacking."""
    rule = Parameters.from_tissue(5000.0, BODY, formulation)
    model = Model(POINTS, TRIANGLES, rule, formulation=formulation, constrained=BASE, solver=solver)
    shift = np.array([1e-3, -2e-3, 5e-3])
    load = Load(np.zeros(len(POINTS)), prescribed=np.where(BASE[:, None], shift, 0.0))
    solution = model.solve([load])
    assert solution.status[0].ok, solution.status[0].message
    tolerance = 1e-5 if solver == "single" else 1e-10
    assert_allclose(solution.displacement[0], shift + 0.0 * POINTS, rtol=0, atol=tolerance * 5e-3)


def dense_operator(body: Model) -> tuple[np.ndarray, np.ndarray]:
    """Block and whole matrix of the free nodes, scaled as `condition_of_operator` says, by inverses in numpy."""
    form = body.formulation
    m, inside = form.columns.count, np.repeat(body.problem.free, form.components)
    block = form.stiffness().toarray()[np.ix_(inside, inside)]
    unit = 1.0 / np.sqrt(np.diag(block))
    block = block * np.outer(unit, unit)
    inverse, corner = np.linalg.inv(block), np.abs(np.diag(form.corner))
    columns, rows = (
        unit[:, None] * part.dense().reshape(-1, m)[inside] for part in (form.columns, form.rows)
    )
    of_column, of_row = (
        1.0 / np.sqrt(np.maximum(np.diag(b.T @ inverse @ b), corner)) for b in (columns, rows)
    )
    below = [(rows * of_row).T, form.corner * np.outer(of_row, of_column)]
    return block, np.block([[block, -columns * of_column], below])


def dense_state(body: Model, penalty: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Block and whole of the printed matrix, held nodes left out or given a diagonal of alpha."""
    form, held = body.formulation, np.repeat(~body.problem.free, body.formulation.components)
    m = form.columns.count
    held = np.append(held, np.zeros(m, dtype=bool))
    whole = form.state_matrix().toarray()
    if penalty is None:
        whole = whole[np.ix_(~held, ~held)]
    else:
        whole[held, held] = penalty * np.abs(np.diag(whole)).max()
    return whole[:-m, :-m], whole


def check(estimate: float, matrix: np.ndarray) -> None:
    truth = np.linalg.cond(matrix, 1)
    # a lower bound to rounding, which the inverses in both lose in proportion to the condition
    assert truth / 3.0 <= estimate <= truth * (1.0 + 1e-13 * truth), (estimate, truth)


@pytest.mark.parametrize("solver", ["linear", "lu", "bicg"])
@pytest.mark.parametrize("formulation", WITH_MATRIX)
def test_estimates_bound_the_condition_from_below(formulation, solver):
    body = model(formulation, solver=solver)
    estimate = body.condition_estimate()
    block, whole = dense_state(body, None) if solver != "linear" else dense_operator(body)
    check(estimate.block, block)
    check(estimate.system, whole)
    assert estimate == body.condition_estimate()


@pytest.mark.parametrize("penalty", [1e2, 1e5])
def test_a_penalty_is_in_the_estimate(penalty):
    body = model("consistent", solver="lu", constraint_method="penalty-replaced", penalty=penalty)
    block, whole = dense_state(body, penalty)
    check(body.condition_estimate().block, block)
    check(body.condition_estimate().system, whole)
    # alpha over the smallest pivot: the block's condition grows as the penalty
    assert body.condition_estimate().block > penalty


def test_the_walk_alone_would_miss_this_matrix():
    """Higham's example: from the middle of the simplex every column of the inverse looks alike."""
    n = 20
    inverse = np.eye(n) + 50.0 * np.outer(*(2 * [np.array([1.0, -1.0] + (n - 2) * [0.0])]))
    matrix = np.linalg.inv(inverse)

    def solve(b):
        return np.linalg.solve(matrix, b)

    assert estimated_norm(operator(n, solve, solve)) >= np.linalg.norm(inverse, 1) / 3.0
