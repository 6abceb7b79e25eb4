"""Every solver against the direct one, the border against Sherman-Morrison, large deformation, warm steps."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.vdm.vdm_shapes import (
    BASE,
    BODY,
    POINTS,
    TRIANGLES,
    WITH_MATRIX,
    model,
    pressed,
    torus,
)
from vdm import Load, Model, Parameters, SurfaceMesh
from vdm.deformed import DeformableSurface
from vdm.solvers import SOLVERS
from vdm.solvers.bicg import BicgSolver
from vdm.solvers.quasi_linear import sherman_morrison

DEFORMABLE = DeformableSurface(BODY)
TOP = (POINTS[TRIANGLES][:, :, 2] > 0.03).all(axis=1)
PUSH = pressed(BODY, np.where(TOP, 100.0, 0.0))
NAMES = WITH_MATRIX
VECTOR_FORMS = [
    Parameters(surface_tension=60.0, rotation="none"),
    Parameters(surface_tension=60.0, rotation="global", stretch_stiffness=10.0, foundation=1e3),
]


def drift(displacement) -> float:
    return DEFORMABLE.at(displacement).volume / BODY.volume - 1.0


def kept_drift(solver: Model, displacement) -> float:
    """Of the volume that a model's formulation keeps."""
    state = DeformableSurface(solver.surface).at(displacement)
    kept = solver.formulation.kept_volume(solver.formulation.unknown(displacement), state)
    return kept / solver.surface.volume - 1.0


# without those that are refused: `test_a_foundation_needs_nothing_held`, `test_vdm_bad_input`
OTHERS = [
    (formulation, solver)
    for formulation in ("paper", "consistent", "vector", "bem")
    for solver in ("lu", "bicg", "bicg-cold", "single", "refined")
    if (formulation, solver) not in (("bem", "single"), ("bem", "refined"))
]


@pytest.mark.parametrize(("formulation", "solver"), OTHERS)
def test_other_solvers_equal_the_direct_one(formulation, solver):
    constrained = POINTS[:, 0] > 0.045
    moved = np.where(constrained[:, None], [1e-3, 0.0, 2e-3], 0.0)
    loads = [Load(s * PUSH.contact_pressure, s * PUSH.contact_force, s * moved) for s in (0.5, 1.0)]
    options = {"constrained": constrained, "density": 1060.0, "gravity": (0.0, 1.0, -9.81)}
    options["environment_pressure"] = 50.0
    direct = model(formulation, **options).solve(loads)
    solution = model(formulation, solver=solver, **options).solve(loads)
    assert all(status.ok for status in solution.status)
    steps = {"lu": (0, 0), "single": (0, 0), "refined": (0, 10)}
    fewest, most = steps.get(solver, (6, 10_000))
    assert np.all((fewest <= solution.iterations) & (solution.iterations <= most))
    # residual 1e-10, or that of 32 bits, times a condition of some 1e3
    tolerance = {"single": 1e-4, "lu": 1e-10}.get(solver, 1e-8)
    size = np.abs(direct.displacement).max()
    assert_allclose(solution.displacement, direct.displacement, rtol=0.0, atol=tolerance * size)
    assert_allclose(solution.fluid_pressure, direct.fluid_pressure, rtol=10 * tolerance, atol=0.0)
    # what is held stays, what is moved goes where it is told: as a whole, or along the normal
    assert_allclose(direct.displacement[:, BASE], 0.0, rtol=0.0, atol=0.0)
    given = np.stack([load.prescribed[constrained] for load in loads])
    found = direct.displacement[:, constrained]
    if formulation in ("paper", "consistent"):
        found, given = (np.einsum("sic,ic->si", u, BODY.normals[constrained]) for u in (found, given))
    assert_allclose(found, given, rtol=1e-14, atol=1e-18)
    if solver == "lu":
        for name in ("reaction_force", "energy"):
            other, right = getattr(solution, name), getattr(direct, name)
            assert_allclose(other, right, rtol=1e-10, atol=1e-10 * np.abs(right).max())


@pytest.mark.parametrize("formulation", ["paper", "vector"])
def test_bicg_does_not_depend_on_the_units(formulation):
    """m and Pa, mm and MPa, inch and psi: the same iterations, and the same answer to the tolerance."""
    found = []
    for length, stress in ((1.0, 1.0), (1e-3, 1e6), (0.0254, 6894.757)):
        surface = SurfaceMesh(POINTS / length, TRIANGLES)
        material = Parameters.from_tissue(5000.0 / stress, surface, formulation)
        body = Model(POINTS / length, TRIANGLES, material, formulation=formulation, fixed=BASE)
        load = pressed(surface, np.where(TOP, 100.0, 0.0) / stress)
        step = BicgSolver(body.problem, tolerance=1e-11).step(load)
        assert step.status.ok, (length, stress)
        found.append((step.iterations, step.displacement * length, step.pressure_change * stress))
    first = found[0]
    for iterations, displacement, pressure in found[1:]:
        # rounding differs, and at the last of them decides
        assert abs(iterations - first[0]) <= max(1, 0.03 * first[0])
        assert_allclose(displacement, first[1], rtol=0.0, atol=1e-9 * np.abs(first[1]).max())
        assert_allclose(pressure, first[2], rtol=1e-9, atol=0.0)


@pytest.mark.parametrize(
    ("formulation", "solver"),
    [("vector", solver) for solver in SOLVERS] + [(name, "nonlinear") for name in NAMES],
)
def test_a_pressure_from_all_sides_moves_nothing_and_is_no_failure(formulation, solver):
    """The answer is the rounding of what cancels, and that is what it is measured by."""
    loads = [pressed(BODY, np.full(len(TRIANGLES), p)) for p in (100.0, 200.0)]
    body = model(formulation, solver=solver)
    solution = body.solve(loads)
    moves = np.abs(body.solve([PUSH]).displacement).max()
    for status in solution.status:
        assert status.ok, status
    # the tolerance of iterative solvers, of single precision, or rounding
    assert np.abs(solution.displacement).max() < 1e-6 * moves
    assert_allclose(solution.fluid_pressure, [100.0, 200.0], rtol=1e-6, atol=0.0)


@pytest.mark.parametrize("formulation", NAMES)
def test_a_vanishing_movement_has_the_answer_of_the_linear_model(formulation):
    """What the tool pushes in, the rest of the surface gives way to: the volume row counts the moved nodes."""
    top = POINTS[:, 2] > 0.035
    moved = Load(np.zeros(len(POINTS)), None, np.where(top[:, None], [0.0, 0.0, -1e-8], 0.0))
    linear, other = (
        model(formulation, constrained=top, solver=name).solve([moved]).displacement[0]
        for name in ("linear", "quasi-linear")
    )
    # the printed volume row sum A_i L_i is not the gradient of the volume
    tolerance = 1e-5 * np.abs(linear).max()
    assert_allclose(other, linear, rtol=0.0, atol=tolerance)


@pytest.mark.parametrize("formulation", NAMES)
def test_border_update_equals_dense_sherman_morrison(formulation):
    solver = model(formulation, fixed=None if formulation == "paper" else BASE, solver="quasi-linear")
    first, second = solver.solve([PUSH.scaled(3.0), PUSH.scaled(4.0)]).displacement
    problem, form = solver.problem, solver.formulation
    free = np.repeat(problem.free, form.components)
    keep = np.append(free, np.ones(form.columns.count, dtype=bool))
    matrix = form.state_matrix().toarray()[np.ix_(keep, keep)]
    # move the volume row to the end, where the paper has it
    order = np.r_[: free.sum(), free.sum() + np.arange(1, form.columns.count), free.sum()].astype(int)
    matrix = matrix[np.ix_(order, order)]
    state = DEFORMABLE.at(first)
    row = form.deformed_columns(state)[1].reshape(-1) * form.column_scale
    change = np.append(row[free], np.zeros(form.columns.count)) - matrix[-1]
    inverse = sherman_morrison(np.linalg.inv(matrix), change)
    target = (
        row @ (form.unknown(first).reshape(-1) / form.column_scale) - kept_drift(solver, first) * BODY.volume
    )
    force = form.row_scale * problem.force(PUSH.scaled(4.0)).reshape(-1)
    right = np.concatenate([force[free], np.zeros(form.columns.count - 1), [target]])
    x = np.zeros(free.size)
    x[free] = (inverse @ right)[: free.sum()]
    by_formula = form.displacement((x * form.column_scale).reshape(-1, form.components))
    assert_allclose(second, by_formula, rtol=0.0, atol=1e-10 * np.abs(second).max())


def test_sherman_morrison_as_printed_is_no_inverse():
    rng = np.random.default_rng(0)
    matrix, v = rng.standard_normal((6, 6)) + 6.0 * np.eye(6), rng.standard_normal(6)
    changed = matrix.copy()
    changed[-1] += v
    inverse = np.linalg.inv(matrix)
    assert_allclose(sherman_morrison(inverse, v) @ changed, np.eye(6), rtol=0.0, atol=1e-13)
    z, w = inverse[:, -1], inverse.T @ v
    # equation 37: a plus sign, and 1 + (K^-1 u) in the denominator, taken entry by entry
    printed = inverse + np.outer(z, w) / (1.0 + z)[:, None]
    assert np.abs(printed @ changed - np.eye(6)).max() > 0.05
    # the sign alone does not mend it
    assert np.abs((inverse + np.outer(z, w) / (1.0 + v @ z)) @ changed - np.eye(6)).max() > 0.05
    singular = -matrix[-1]
    with pytest.raises(ValueError, match="singular"):
        sherman_morrison(inverse, singular)


@pytest.mark.parametrize("formulation", ["paper", "vector"])
def test_quasi_linear_drift_falls_with_the_square_of_the_step(formulation):
    def last_drift(row, steps):
        loads = [PUSH.scaled(4.0 * s) for s in np.arange(1, steps + 1) / steps]
        solver = model(formulation, solver="quasi-linear", volume_row=row)
        return kept_drift(solver, solver.solve(loads).displacement[-1])

    exact = [last_drift("corrected", n) for n in (4, 16)]
    assert 13.0 < exact[0] / exact[1] < 19.0
    # the printed row does not converge to the rest volume
    printed = [abs(last_drift("printed", n)) for n in (4, 16)]
    assert printed[1] > 0.5 * printed[0]
    assert printed[1] > 20.0 * abs(exact[1])


def test_quasi_linear_tells_what_the_path_has_left():
    """Loads on and off: what remains of the displacement is the path's; steps on the spot take it away."""
    off_axis = Load(np.where(POINTS @ [0.7, 0.2, 0.6] > 0.035, 300.0, 0.0))
    solver = model("vector", solver="quasi-linear")

    def cycles(count):
        up = np.arange(1, count + 1) / count
        return [off_axis.scaled(s) for s in np.tile(np.r_[up, up[-2::-1], 0.0], 2)]

    told = {}
    for count in (2, 8, 80):
        loads = cycles(count)
        solution = solver.solve(loads)
        errors = solution.scalars["path_error"]
        largest = np.abs(solution.displacement).max()
        assert_allclose(errors[-1], np.abs(solution.displacement[-1]).max() / largest, rtol=0.01, atol=0.0)
        for status, error in zip(solution.status, errors, strict=True):
            assert status.ok
            assert (
                ("load steps" in status.message) == ("smaller load steps" in status.remedy) == (error > 1e-3)
            )
        told[count] = solution
    assert told[2].scalars["path_error"].max() > 1e-3 > told[80].scalars["path_error"].max()
    # of the second order in the step
    last = [told[count].scalars["path_error"][-1] for count in (8, 80)]
    assert_allclose(last[0] / last[1], 100.0, rtol=0.05, atol=0.0)
    message = told[2].status[-1].message
    assert f"{told[2].scalars['path_error'][-1]:.1e} of the largest displacement" in message
    assert "smaller load steps, or the nonlinear solver" in told[2].status[-1].remedy
    # the full load in two steps, and then the same load again: each closes the volume that the last one left open
    rest = solver.solve([*cycles(2)[:2], *[off_axis] * 5])
    gap = np.abs(rest.displacement[1] - rest.displacement[-1]).max() / np.abs(rest.displacement[1]).max()
    assert_allclose(rest.scalars["path_error"][1], gap, rtol=0.01, atol=0.0)
    assert rest.scalars["path_error"][-1] < 1e-12
    assert "load steps" not in rest.status[-1].message


@pytest.mark.parametrize(
    ("formulation", "parameters"), [(n, None) for n in NAMES] + [("vector", p) for p in VECTOR_FORMS]
)
def test_nonlinear_keeps_the_volume_and_meets_the_linear_model_at_small_loads(formulation, parameters):
    loads = [PUSH.scaled(s) for s in (1e-4, 1e-3, 1.0, 4.0)]
    solver = model(formulation, parameters, solver="nonlinear")
    solution = solver.solve(loads)
    linear = model(formulation, parameters).solve(loads)
    assert all(status.ok for status in solution.status)
    for displacement in solution.displacement:
        assert abs(kept_drift(solver, displacement)) < 1e-12
        # what facets turn away is no part of the printed volume sum A_i L_i
        assert abs(drift(displacement)) < (1e-2 if formulation == "paper" else 1e-12)
    assert abs(drift(linear.displacement[-1])) > 1e-6
    gaps = [
        np.abs(a - b).max() / np.abs(b).max()
        for a, b in zip(solution.displacement, linear.displacement, strict=True)
    ]
    # springs that turn with the surface depart from the linear model sooner
    assert gaps[1] < (1e-4 if formulation == "mass-spring" else 2e-5)
    assert gaps[3] > 1e-3
    assert_allclose(gaps[1] / gaps[0], 10.0, rtol=0.1, atol=0.0)
    assert np.all(np.diff(solution.energy) > 0.0)


def test_nonlinear_follower_pressure_balances_in_the_deformed_state():
    solver = model("vector", solver="nonlinear")
    pressure = np.where(POINTS[:, 0] > 0.02, 500.0, 0.0)
    solution = solver.solve([Load(pressure)])
    state = DEFORMABLE.at(solution.displacement[0])
    applied = (solution.fluid_pressure[0] - pressure)[:, None] * state.area_vectors
    total = solution.reaction_force[0].sum(axis=0) + applied.sum(axis=0)
    size = np.abs(solution.reaction_force[0].sum(axis=0)).max()
    assert_allclose(total, 0.0, rtol=0.0, atol=1e-6 * size)
    positions = POINTS + solution.displacement[0]
    torque = np.cross(positions, solution.reaction_force[0] + applied).sum(axis=0)
    assert_allclose(torque, 0.0, rtol=0.0, atol=1e-6 * np.abs(np.cross(positions, applied)).sum())


@pytest.mark.parametrize("formulation", ["consistent", "vector"])
def test_a_small_weight_gives_the_pressure_of_the_linear_model_at_the_same_datum(formulation):
    # one thousandth of a weight: the body hardly moves, and what is left is where the pressure is measured
    weight = {"density": 1.0, "gravity": (3.0, 0.0, -9.81)}
    rest = [Load(np.zeros(len(POINTS)))]
    pressures = [
        model(formulation, solver=s, **weight).solve(rest).fluid_pressure[0] for s in ("linear", "nonlinear")
    ]
    height = np.ptp(POINTS @ weight["gravity"])
    assert_allclose(pressures[1], pressures[0], rtol=0.0, atol=1e-3 * height)


@pytest.mark.parametrize("formulation", ["paper", "vector", "mass-spring"])
def test_nonlinear_prescribed_displacement_and_genus_one(formulation):
    points, triangles = torus()
    surface = SurfaceMesh(points, triangles)
    base, top = points[:, 2] < -0.015, points[:, 2] > 0.018
    load = Load(np.zeros(len(points)), None, np.where(top[:, None], [0.0, 0.0, -0.004], 0.0))
    parameters = Parameters.from_tissue(5000.0, surface, formulation)
    body = Model(
        points,
        triangles,
        parameters,
        formulation=formulation,
        fixed=base,
        constrained=top,
        solver="nonlinear",
    )
    solution = body.solve([load])
    assert solution.status[0].ok
    moved = np.einsum("ic,ic->i", solution.displacement[0], surface.normals)[top]
    expected = np.einsum("ic,ic->i", load.prescribed, surface.normals)[top]
    assert_allclose(moved, expected, rtol=1e-12, atol=1e-16)
    assert abs(kept_drift(body, solution.displacement[0])) < 1e-12
    # the support below pushes up what the tool above pushes down
    assert solution.reaction_force[0, top, 2].sum() < 0.0 < solution.reaction_force[0, base, 2].sum()


def test_a_failed_step_keeps_what_it_reached_and_the_history_goes_on():
    solution = model("vector", solver="nonlinear").solve([PUSH, PUSH.scaled(300.0), PUSH.scaled(1.1)])
    assert [status.ok for status in solution.status] == [True, False, True]
    assert solution.status[1].code == "not-converged"
    assert "smaller load" in solution.status[1].remedy
    share = solution.scalars["load_factor"][1]
    assert 0.0 < share < 1.0
    assert f"beyond {share:.4g} of load step 2" in solution.status[1].message
    assert solution.scalars["relative_residual"][1] < 1e-6
    for step, factor in ((1, 1.0 + 299.0 * share), (2, 1.1)):
        alone = model("vector", solver="nonlinear").solve([PUSH.scaled(factor)])
        for name in ("displacement", "reaction_force", "fluid_pressure", "energy"):
            found, expected = getattr(solution, name)[step], getattr(alone, name)[0]
            assert_allclose(found, expected, rtol=0.0, atol=1e-6 * np.abs(expected).max(), err_msg=name)


@pytest.mark.parametrize("method", ["penalty-added", "penalty-replaced"])
def test_a_penalty_is_that_of_equations_25_and_26(method):
    constrained = POINTS[:, 0] > 0.045
    load = Load(PUSH.contact_pressure, None, np.where(constrained[:, None], [1e-4, 0.0, 2e-4], 0.0))
    body = model(
        "paper",
        solver="lu",
        constraint_method=method,
        penalty=10.0,
        constrained=constrained,
        density=1000.0,
        gravity=(0.0, 0.0, -9.81),
    )
    form, held = body.formulation, BASE | constrained
    matrix = form.state_matrix().toarray()
    alpha = 10.0 * np.abs(np.diag(matrix)).max()
    right = np.append(form.row_scale * body.problem.force(load)[:, 0], 0.0)
    given = np.einsum("ic,ic->i", load.prescribed, BODY.normals)  # C of (26), zero at fixed nodes
    for i in np.flatnonzero(held):
        added = method == "penalty-added"
        matrix[i, i] = alpha + (matrix[i, i] if added else 0.0)
        right[i] = alpha * given[i] + (right[i] if added else 0.0)
    expected = np.linalg.solve(matrix, right)[:-1, None] * BODY.normals
    found = body.solve([load]).displacement[0]
    assert_allclose(found, expected, rtol=0.0, atol=1e-10 * np.abs(expected).max())


SIDE = (POINTS[TRIANGLES][:, :, 0] > 0.03).all(axis=1)
FINGER = pressed(BODY, np.where(TOP, 400.0, 0.0))
NUDGE = pressed(BODY, np.where(SIDE, 400.0, 0.0))


@pytest.mark.parametrize("formulation", ["vector", "bem", "mass-spring"])
def test_warm_steps_equal_each_load_from_rest_in_fewer_iterations(formulation):
    # on, a turn back, the same again, another finger, and nothing
    loads = [FINGER.scaled(s) for s in (1.0, 1.1, 1.2, 1.3, 1.15, 1.15, 1.16)] + [NUDGE, FINGER.scaled(0.0)]
    solver = model(formulation, solver="nonlinear")
    warm = solver.solve(loads)
    cold = [solver.solve([load]) for load in loads]
    assert all(status.ok for status in warm.status)
    size = np.abs(warm.displacement).max()
    body = DeformableSurface(BODY)
    for k, alone in enumerate(cold):
        # both stop at a residual of 1e-8 of the forces
        assert_allclose(warm.displacement[k], alone.displacement[0], rtol=0.0, atol=1e-6 * size)
        assert_allclose(warm.fluid_pressure[k], alone.fluid_pressure[0], rtol=1e-6, atol=1e-4)
        assert_allclose(warm.energy[k], alone.energy[0], rtol=1e-5, atol=1e-6 * warm.energy.max())
        x = solver.formulation.unknown(warm.displacement[k])
        kept = solver.formulation.kept_volume(x, body.at(warm.displacement[k]))
        assert abs(kept / BODY.volume - 1.0) < 1e-12
    assert (
        abs(warm.iterations[0] - cold[0].iterations[0]) <= 1
    )  # a slope that is kept serves the next first load
    # where the load goes on; 0.7 of them without the start ahead
    needed = [int(alone.iterations[0]) for alone in cold[1:5]]
    share = 0.8 if formulation == "mass-spring" else 0.7  # 0.73 and up to 0.67
    assert warm.iterations[1:5].sum() < share * sum(needed)


def test_a_history_does_not_remember_the_one_before():
    solver = model("vector", solver="nonlinear")
    loads = [FINGER.scaled(s) for s in (1.0, 1.1, 1.2)]
    first = solver.solve(loads)
    solver.solve([NUDGE])
    again = solver.solve(loads)
    assert np.array_equal(first.displacement, again.displacement)
    assert np.array_equal(first.iterations, again.iterations)


SCRIPT = """
import numpy as np
from scipy import sparse
from vdm.solution import SolverError
from vdm.solvers.cholesky import Cholesky
for off in (2.0, -1.0):  # indefinite, singular
    try:
        Cholesky(sparse.csr_array(np.array([[1.0, off], [off, 1.0]])))
    except SolverError as error:
        print(error)
"""


def test_a_factor_that_fails_says_one_line():
    """In a process of its own: what a library writes by C passes by what Python captures."""
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    assert len(lines) == 2, done.stdout
    for line in lines:
        assert line.startswith("the operator is not positive definite; hold an area of the surface")
    assert done.stderr == ""


# --- loads and moduli of any size: the answer follows them to the last, or a status says that it does not ---

TINY = (1e-300, 1e-170, 1e-40, 1e-18)


ABOVE = POINTS[:, 2] > 0.035


@pytest.mark.parametrize("formulation", ["paper", "vector", "mass-spring"])
def test_a_surface_model_at_large_displacements_refuses_what_rounding_hides(formulation: str) -> None:
    linear, nonlinear = (model(formulation, solver=solver) for solver in ("linear", "nonlinear"))
    # the rule of the linear paper form keeps A_i L_i, the nonlinear one the polyhedron's volume
    slack = 0.01 if formulation == "paper" else 3e-3
    seen = set()
    for pressure in (*TINY, 1e-14, 1e-10, 1e-8, 1e-6, 1e-4):
        load = Load(np.where(ABOVE, pressure, 0.0))
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
    nonlinear = model("vector", solver="nonlinear")
    factors = (0.0, 1.0, 1e-13, 0.0, 1e-17)
    found = nonlinear.solve([Load(np.where(ABOVE, 100.0 * factor, 0.0)) for factor in factors])
    assert all(status.ok for status in found.status)
    largest = np.abs(found.displacement[1]).max()
    assert np.abs(found.displacement[2:]).max() < 1e-6 * largest
    # but the first of a history is: rounding is all that it would be measured by
    assert nonlinear.solve([Load(np.where(ABOVE, 1e-15, 0.0))]).status[0].code == "too-small"


@pytest.mark.parametrize("scale", [1e-90, 1e90])
@pytest.mark.parametrize("solver", ["single", "refined"])
def test_single_precision_does_not_care_for_the_unit_of_the_moduli(solver: str, scale: float) -> None:
    rule = Parameters.from_tissue(5000.0, BODY, "vector", held=BASE)
    load = Load(np.where(ABOVE, 100.0 * scale, 0.0))
    expected = model("vector", rule).solve([Load(np.where(ABOVE, 100.0, 0.0))]).displacement
    scaled = replace(rule, surface_tension=scale * rule.surface_tension)
    found = model("vector", scaled, solver=solver).solve([load])
    assert found.status[0].ok
    tolerance = 1e-5 if solver == "single" else 1e-10
    assert_allclose(found.displacement, expected, rtol=0, atol=tolerance * np.abs(expected).max())
